"""The wheel holds the shipped data, and finds it where it is installed."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SHELVES = ("plants", "materials", "recipes")


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel's content in a folder."""
    folder = tmp_path_factory.mktemp("wheel")
    command = (
        sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check",
        "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(ROOT),
    )  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (wheel,) = folder.glob("pepperscene-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "content")
    return folder / "content"


@pytest.mark.parametrize("shelf", SHELVES)
def test_the_wheel_holds_what_the_checkout_holds(unpacked: Path, shelf: str) -> None:
    def held(folder: Path) -> dict[str, bytes]:
        return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    shipped = held(unpacked / "pepperscene" / "shipped" / shelf)
    assert shipped
    assert shipped == held(ROOT / shelf)


def test_the_wheel_carries_its_licence_and_finds_its_data(unpacked: Path) -> None:
    (licence,) = unpacked.glob("pepperscene-*.dist-info/licenses/LICENSE")
    assert licence.read_text(encoding="utf-8").startswith("MIT License")

    code = (
        "import json, pepperscene.shipped as s\n"
        f"print(json.dumps([s.__file__, *(str(s.shelf(name)) for name in {SHELVES!r})]))"
    )
    command = [
        sys.executable,
        "-S",
        "-c",
        f"import sys; sys.path[:0] = {[str(unpacked), *sys.path]!r}\n{code}",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    for path in json.loads(done.stdout):
        assert Path(path).is_relative_to(unpacked)
        assert Path(path).exists()

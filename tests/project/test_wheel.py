"""The wheel contains the shipped data and finds it after installation."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("plants", "materials", "recipes")


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the unpacked wheel."""
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


@pytest.mark.parametrize("folder", FOLDERS)
def test_wheel_contains_all_data_files(unpacked: Path, folder: str) -> None:
    def contents(root: Path) -> dict[str, bytes]:
        return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}

    shipped = contents(unpacked / "pepperscene" / "shipped" / folder)
    assert shipped
    assert shipped == contents(ROOT / folder)


def test_wheel_has_a_licence_and_finds_its_data(unpacked: Path) -> None:
    (licence,) = unpacked.glob("pepperscene-*.dist-info/licenses/LICENSE")
    assert licence.read_text(encoding="utf-8").startswith("MIT License")

    code = (
        "import json, pepperscene.shipped as s\n"
        f"print(json.dumps([s.__file__, *(str(s.shipped_folder(name)) for name in {FOLDERS!r})]))"
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

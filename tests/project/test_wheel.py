"""Wheel and source distribution contain the shipped data, and nothing whose licence they do not name."""

from __future__ import annotations

import json
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("plants", "materials", "recipes")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the unpacked source distribution."""
    folder = tmp_path_factory.mktemp("source")
    command = (sys.executable, "-m", "hatchling", "build", "--target", "sdist", "--directory", str(folder))
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (archive,) = folder.glob("pepperscene-*.tar.gz")
    with tarfile.open(archive) as content:
        content.extractall(folder / "content", filter="data")
    (top,) = (folder / "content").iterdir()
    return top


@pytest.fixture(scope="module")
def unpacked(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the unpacked wheel."""
    folder = tmp_path_factory.mktemp("unpacked")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def test_wheel_contains_all_data_files(unpacked: Path) -> None:
    for folder in FOLDERS:
        shipped, expected = files(unpacked / "pepperscene" / "shipped" / folder), files(ROOT / folder)
        assert shipped
        assert shipped.keys() == expected.keys()
        assert all(path.read_bytes() == expected[name].read_bytes() for name, path in shipped.items())


def test_wheel_has_a_licence_and_finds_its_data(unpacked: Path) -> None:
    (licence,) = unpacked.glob("pepperscene-*.dist-info/licenses/LICENSE")
    assert licence.read_text(encoding="utf-8").startswith("MIT License")

    code = (
        "import json, pepperscene.shipped as s\n"
        f"print(json.dumps([s.__file__, *(str(s.shipped_folder(name)) for name in {FOLDERS!r})]))"
    )
    # Without byte code in the folder, whose files are listed.
    path = f"import sys; sys.path[:0] = {[str(unpacked), *sys.path]!r}\n"
    command = [sys.executable, "-B", "-S", "-c", path + code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    for path in json.loads(done.stdout):
        assert Path(path).is_relative_to(unpacked)
        assert Path(path).exists()


def files(folder: Path) -> dict[str, Path]:
    return {str(path.relative_to(folder)): path for path in sorted(folder.rglob("*")) if path.is_file()}


def licences_of_data(folder: Path) -> dict[str, str]:
    """SPDX identifier of each file with a licence of its own, from the beginning of that licence."""
    identifiers = {name: name for name in ("MIT", "BSD-3-Clause", "Apache-2.0")}
    identifiers |= {"CC0 1.0": "CC0-1.0", "CC BY-SA": "CC-BY-SA-4.0"}
    found = {}
    for name, path in files(folder).items():
        if path.suffix != ".toml" or path.name == "pyproject.toml":
            continue
        licence = tomllib.loads(path.read_text(encoding="utf-8")).get("licence")
        if licence is not None:
            (found[name],) = {spdx for start, spdx in identifiers.items() if licence.startswith(start)}
    return found


def test_licence_expression_names_the_licences_of_all_files(unpacked: Path, source: Path) -> None:
    expression = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["license"]
    (metadata,) = unpacked.glob("pepperscene-*.dist-info/METADATA")
    assert f"License-Expression: {expression}\n" in metadata.read_text(encoding="utf-8")
    for folder in (unpacked, source):
        licences = licences_of_data(folder)
        assert len(licences) > 40
        assert set(licences.values()) == set(expression.split(" AND "))
    for name in ("LICENSE", "materials/LICENCES.md"):
        assert (metadata.parent / "licenses" / name).read_bytes() == (ROOT / name).read_bytes()
        assert (source / name).read_bytes() == (ROOT / name).read_bytes()


def test_no_photograph_is_distributed(unpacked: Path, source: Path) -> None:
    """The photographs of the documentation are under CC BY-SA."""
    for folder in (unpacked, source):
        suffixes = {path.suffix for path in files(folder).values()}
        assert suffixes <= {
            ".py", ".pyi", ".typed", ".toml", ".csv", ".md", ".css", ".js", ".html", ".cff", ".txt", "",
        }  # fmt: skip
        texts = b"".join(path.read_bytes() for path in files(folder).values() if path.suffix != ".md")
        assert b"CC BY-SA" not in texts


def test_distributions_are_small_and_hold_only_what_runs(wheel: Path, unpacked: Path, source: Path) -> None:
    assert wheel.stat().st_size < 2_000_000
    assert {path.name for path in unpacked.iterdir()} == {"pepperscene", f"{source.name}.dist-info"}
    for folder in (unpacked, source):
        for name, path in files(folder).items():
            assert path.stat().st_size < 200_000, name
            others = {"tests", "docs", "benchmarks", "notebooks", "__pycache__"}
            assert not others & set(Path(name).parts), name


def test_every_table_of_numbers_has_its_licence_beside_it(unpacked: Path) -> None:
    tables = sorted((unpacked / "pepperscene" / "shipped").rglob("*.csv"))
    assert len(tables) > 30
    for table in tables:
        description = tomllib.loads(table.with_suffix(".toml").read_text(encoding="utf-8"))
        assert description["licence"], table
        assert description["source"], table


@pytest.mark.long
def test_source_distribution_builds_the_same_wheel(unpacked: Path, source: Path, tmp_path: Path) -> None:
    command = (sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(tmp_path))
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("pepperscene-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "content")
    rebuilt, original = files(tmp_path / "content"), files(unpacked)
    assert rebuilt.keys() == original.keys()
    assert all(path.read_bytes() == rebuilt[name].read_bytes() for name, path in original.items())

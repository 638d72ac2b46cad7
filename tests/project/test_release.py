"""One version in all places; locked versions satisfy the requirements; the README names all extras."""

from __future__ import annotations

import re
import tomllib
from datetime import date
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from pepperscene.version import __version__

ROOT = Path(__file__).resolve().parents[2]
RELEASE = re.compile(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d{2}-\d{2})$", re.MULTILINE)
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]


def test_changelog_and_citation_have_the_version() -> None:
    releases = RELEASE.findall((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    assert releases[0][0] == __version__
    numbers = [tuple(int(part) for part in version.split(".")) for version, _ in releases]
    assert numbers == sorted(set(numbers), reverse=True)
    days = [date.fromisoformat(day) for _, day in releases]
    assert days == sorted(days, reverse=True)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["version"], citation["date-released"]) == (__version__, days[0])
    assert PYPROJECT["tool"]["hatch"]["version"]["path"] == "src/pepperscene/version.py"


def test_lock_satisfies_the_requirements() -> None:
    lines = (ROOT / "requirements" / "lock.txt").read_text(encoding="utf-8").splitlines()
    pinned = [line.split("==") for line in lines if not line.startswith("#")]
    locked = {canonicalize_name(name): Version(version) for name, version in pinned}
    extras = [PROJECT["optional-dependencies"][name] for name in ("test", "test-learn", "docs", "notebooks")]
    for requirement in map(Requirement, sum(extras, PROJECT["dependencies"])):
        if requirement.name != PROJECT["name"]:
            version = locked[canonicalize_name(requirement.name)]
            assert version in requirement.specifier, f"{requirement} and {version}"


def test_every_direct_dependency_of_the_renderer_has_an_upper_bound() -> None:
    """Except pyarrow, whose numbers rise every three months, and Dr.Jit, which Mitsuba pins."""
    unbounded = {
        requirement.name
        for requirement in map(Requirement, PROJECT["dependencies"])
        if not any(part.operator in ("<", "==") for part in requirement.specifier)
    }
    assert unbounded == {"pyarrow", "drjit"}


def test_readme_lists_every_extra() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `([a-z-]+)` \| .+ \| .+ \|$", text.split("## Requirements")[1], re.MULTILINE)
    assert len(listed) == len(set(listed))
    (line,) = re.findall(r"^The extras (.+) are for development", text, re.MULTILINE)
    assert set(PROJECT["optional-dependencies"]) == {*listed, *re.findall(r"`([a-z-]+)`", line)}

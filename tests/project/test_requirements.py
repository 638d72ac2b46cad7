"""The locked versions are those that the package allows, and complete; the README names all extras."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[2]


def test_lock_satisfies_the_requirements() -> None:
    lines = (ROOT / "requirements" / "lock.txt").read_text(encoding="utf-8").splitlines()
    pinned = [line.split("==") for line in lines if not line.startswith("#")]
    locked = {canonicalize_name(name): Version(version) for name, version in pinned}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    texts = [
        *project["dependencies"],
        *(text for name in ("test", "test-learn", "docs", "notebooks") for text in extras[name]),
    ]
    for requirement in map(Requirement, texts):
        if requirement.name != project["name"]:
            version = locked[canonicalize_name(requirement.name)]
            assert version in requirement.specifier, f"{requirement} and {version}"


def test_every_direct_dependency_of_the_renderer_has_an_upper_bound() -> None:
    """Except pyarrow, whose numbers rise every three months, and Dr.Jit, which Mitsuba pins."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    unbounded = {
        requirement.name
        for requirement in map(Requirement, project["dependencies"])
        if not any(part.operator in ("<", "==") for part in requirement.specifier)
    }
    assert unbounded == {"pyarrow", "drjit"}


def test_readme_lists_every_extra() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `([a-z-]+)` \| .+ \| .+ \|$", text.split("## Requirements")[1], re.MULTILINE)
    assert [name for name in listed if listed.count(name) > 1] == []
    (line,) = re.findall(r"^The extras (.+) are for development", text, re.MULTILINE)
    assert set(project["optional-dependencies"]) == set(listed) | set(re.findall(r"`([a-z-]+)`", line))

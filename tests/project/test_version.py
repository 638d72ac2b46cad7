"""One version in all places, which records what made a frame and never decides what is in it."""

from __future__ import annotations

import ast
import re
import tomllib
from datetime import date
from pathlib import Path

import yaml

import pepperscene
from pepperscene.version import __version__

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = Path(pepperscene.__file__).parent
RELEASE = re.compile(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d{2}-\d{2})$", re.MULTILINE)

RECORDS = {
    "bench/scenes.py",  # identity of a cached reference
    "cli/application.py",  # --version
    "building/execution/dask_worker.py",  # workers have the version of the build
    "building/execution/job.py",  # dataset.json
    "export/bop.py",  # plants are grown again only by the version that grew them
    "review/report/scene_view.py",  # as in bop
    "building/viewpoints/table.py",  # metadata of a table
    "learning/experiments/run.py",
    "learning/models/trained_model.py",
    "learning/training/run.py",
    "render/doctor.py",
    "render/renderer.py",  # a frame's JSON
    "tuning/report.py",
}
"""Modules that write the version into a file or a message, or compare what was written."""


def test_changelog_and_citation_have_the_version() -> None:
    releases = RELEASE.findall((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    assert releases[0][0] == __version__
    numbers = [tuple(int(part) for part in version.split(".")) for version, _ in releases]
    assert numbers == sorted(set(numbers), reverse=True)
    days = [date.fromisoformat(day) for _, day in releases]
    assert days == sorted(days, reverse=True)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    assert citation["date-released"] == days[0]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["tool"]["hatch"]["version"]["path"] == "src/pepperscene/version.py"


def test_version_is_recorded_and_draws_nothing() -> None:
    """Growing, placing and drawing modules do not know the version: it cannot enter a random stream."""
    users = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            named = isinstance(node, ast.ImportFrom) and node.module == "pepperscene.version"
            read = isinstance(node, ast.Attribute) and ast.unparse(node) == "pepperscene.__version__"
            if named or read:
                users.add(path.relative_to(PACKAGE).as_posix())
    assert users == RECORDS

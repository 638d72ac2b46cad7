"""The linter, the type checker and the import directions hold for every change."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CODE = (
    "src", "tests", "benchmarks", "docs/conf.py", "docs/figures.py", "docs/plant_figures.py",
    "docs/harvest_figure.py", "docs/colour_figures.py", "notebooks",
)  # fmt: skip


def _passes(*command: str) -> None:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("check", [("check",), ("format", "--check")], ids=["lint", "format"])
def test_ruff(check: tuple[str, ...]) -> None:
    _passes(sys.executable, "-m", "ruff", *check, *CODE)


def test_types() -> None:
    _passes(sys.executable, "-m", "mypy")


def test_imports_go_down_the_floors() -> None:
    # The console script of import-linter, whose module has no entry of its own.
    _passes(sys.executable, "-c", "from importlinter.cli import lint_imports_command as main; main()")

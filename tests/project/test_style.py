"""Linter, formatter, type checker, import layers and plain words."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ORNATE = re.compile(r"\b(told|teller|dear|dearest|lest|so-manieth)\b", re.IGNORECASE)


def _check(*command: str) -> None:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("arguments", [("check",), ("format", "--check")], ids=["lint", "format"])
def test_ruff(arguments: tuple[str, ...]) -> None:
    _check(sys.executable, "-m", "ruff", *arguments, "src", "tests", "benchmarks", "docs", "notebooks")


def test_types() -> None:
    _check(sys.executable, "-m", "mypy")


def test_import_layers() -> None:
    # The console script of import-linter; its module has no entry point.
    _check(sys.executable, "-c", "from importlinter.cli import lint_imports_command as main; main()")


def test_words_are_plain() -> None:
    own = Path(__file__).resolve()
    files = [
        ROOT / "README.md",
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "src").rglob("*.py"),
        *(ROOT / "tests").rglob("*.py"),
    ]
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in files
        if path != own and "_build" not in path.parts
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if ORNATE.search(line)
    ]
    assert found == []

"""Runs command lines in this process, and checks the one line in which wrong input is rejected."""

from __future__ import annotations

from typer.testing import CliRunner

from pepperscene.cli import app
from pepperscene.errors import EXIT_BAD_INPUT


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def rejected(*words):
    """The error of an invalid command line: one line, and nothing else is printed."""
    result = run(*words)
    assert result.exit_code == EXIT_BAD_INPUT, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    return result.stderr

"""The command `view`: Rerun where it is installed, else the report in a browser."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from traced_set import make_traced_set

from pepperscene.cli import datasets


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_traced_set(tmp_path_factory.mktemp("view") / "set").folder


@pytest.fixture
def opened(monkeypatch):
    """Pages that a browser is asked to open."""
    pages = []
    monkeypatch.setattr("webbrowser.open", lambda address: pages.append(address) or True)
    return pages


def has_rerun(monkeypatch, installed):
    monkeypatch.setattr(datasets, "find_spec", lambda _name: object() if installed else None)


def test_without_rerun_the_report_is_opened(folder, opened, monkeypatch, command):
    has_rerun(monkeypatch, installed=False)
    result = command("view", folder)
    assert result.exit_code == 0
    assert opened == [(folder / "index.html").as_uri()]
    assert result.stdout.strip() == str(folder / "index.html")
    # Without a browser the page is named.
    monkeypatch.setattr("webbrowser.open", lambda _address: False)
    result = command("view", folder, "--program", "browser")
    assert (result.exit_code, "no browser was found" in result.stderr) == (0, True)


def test_rerun_gets_the_recordings_of_the_frames(folder, monkeypatch, command):
    pytest.importorskip("rerun")
    calls = []

    def run(command, check):
        assert Path(command[-1]).stat().st_size > 10_000
        calls.append(command)
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(datasets.subprocess, "run", run)
    assert command("view", folder, "--frames", "0:2").exit_code == 0
    ((*program, file),) = calls
    assert program == [sys.executable, "-P", "-m", "rerun"]
    # The temporary recording is removed when the viewer is closed.
    assert not Path(file).exists()
    monkeypatch.setattr(datasets.subprocess, "run", lambda *_args, **_kwargs: SimpleNamespace(returncode=3))
    result = command("view", folder)
    assert result.exit_code == 2
    assert "ended with exit code 3" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--program", "paint"], "--program: must be rerun or browser, not 'paint'"),
        (["--program", "browser", "--frames", "0:1"], "--frames: applies only to rerun"),
        (["--program", "rerun"], "pepperscene[rerun]"),
    ],
)
def test_wrong_options_are_one_sentence(folder, arguments, message, opened, monkeypatch, rejects):
    has_rerun(monkeypatch, installed=False)
    rejects(message, "view", folder, *arguments)
    assert not opened

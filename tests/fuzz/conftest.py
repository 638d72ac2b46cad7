"""Rules for all attempts: no reader starts a process, and none takes long."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

_HELPERS = [str(Path(__file__).parents[1] / folder) for folder in ("dataset", "geometry")]
sys.path[:0] = [folder for folder in _HELPERS if folder not in sys.path]


@pytest.fixture(autouse=True)
def no_processes(monkeypatch):
    def start(*_args, **_kwargs):
        raise AssertionError("a reader must not start a process")

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr("os.fork", start)

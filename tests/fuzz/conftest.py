"""Rules for all attempts: no reader starts a process, and none takes long."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

_DATA_SETS = Path(__file__).parents[1] / "dataset"
sys.path[:0] = [str(folder) for folder in (_DATA_SETS,) if str(folder) not in sys.path]


@pytest.fixture(autouse=True)
def no_processes(monkeypatch):
    def start(*_args, **_kwargs):
        raise AssertionError("a reader must not start a process")

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr("os.fork", start)

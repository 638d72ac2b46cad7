"""Rules for all attempts: no reader starts a process, and none takes long."""

from __future__ import annotations

import subprocess

import pytest


@pytest.fixture(autouse=True)
def no_processes(monkeypatch):
    def start(*_args, **_kwargs):
        raise AssertionError("a reader must not start a process")

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr("os.fork", start)

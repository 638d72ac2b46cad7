"""Measuring in processes of their own, one after the other or several at a time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from pepperscene.bench.frames_child import Asked
from pepperscene.errors import SetupError

_CHILD: Final = Path(__file__).with_name("frames_child.py")
"""Run as a file: as a module, its room would be imported before its clock starts."""


def in_child(asked: Asked, environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """What one process found.

    Raises:
        SetupError: it failed.
    """
    return in_children([asked], environment)[0]


def in_children(asked: Sequence[Asked], environment: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    """What several processes found that ran at the same time.

    Raises:
        SetupError: one failed.
    """
    running = [
        subprocess.Popen(
            [sys.executable, "-P", str(_CHILD), json.dumps(asdict(one))],
            env={**os.environ, **(environment or {})},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for one in asked
    ]
    found, faults = [], []
    for process in running:
        out, said = process.communicate()
        if process.returncode:
            faults.append((said.strip().splitlines() or [f"exit code {process.returncode}"])[-1])
        else:
            found.append(json.loads(out.splitlines()[-1]))
    if faults:
        raise SetupError(f"a process of the bench failed: {faults[0]}")
    return found


def seconds_of(command: Sequence[str]) -> float:
    """Seconds that a command takes, from its start to its end.

    Raises:
        SetupError: it failed.
    """
    start = perf_counter()
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode:
        raise SetupError(f"{' '.join(command)} failed: {done.stderr.strip()[-200:]}")
    return perf_counter() - start

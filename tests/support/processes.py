"""New Python processes that can import the test modules."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from pepperscene.building.subprocess_rpc import THREADS

_HERE = Path(__file__).parent
FOLDERS = [str(folder) for folder in (_HERE, _HERE.parent / "laws", _HERE.parent / "laws" / "stress")]


def run_python(code: str, timeout_s: float = 600.0, **environment: str):
    """The JSON value on the last line that code prints in a new interpreter."""
    path = os.pathsep.join([*FOLDERS, *filter(None, [os.environ.get("PYTHONPATH")])])
    # `make test` limits the threads of tests; this process has a thread on each core, as for a user.
    inherited = {name: value for name, value in os.environ.items() if name not in THREADS}
    process = subprocess.run(
        [sys.executable, "-c", code],
        env={**inherited, "PYTHONPATH": path, **environment},
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout.splitlines()[-1])

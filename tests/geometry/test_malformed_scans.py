"""Malformed scans, read in a process with 2 GB of memory: each is refused in one sentence, or is a fruit."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from malformed_scans import contents, large_scan, special_files

MEMORY = 2 * 10**9

CHILD = f"""
import json, resource, sys, traceback, warnings
from pathlib import Path

resource.setrlimit(resource.RLIMIT_AS, ({MEMORY}, {MEMORY}))
import numpy as np

warnings.simplefilter("error")
from pepperscene.errors import InputError
from pepperscene.geometry.fruit.scan import load_scan

results = []
for path, colour in json.loads(Path(sys.argv[1]).read_text()):
    try:
        scan = load_scan(Path(path), colour=colour)
    except InputError as error:
        results.append(str(error))
        continue
    except Exception:
        results.append(traceback.format_exc())
        continue
    assert all(np.isfinite(values).all() for values in (scan.points, scan.normals, scan.uv))
    a, b, c = np.moveaxis(scan.points[scan.faces], 1, 0)
    # Closed, and its faces outwards: axes up, right and along are left-handed.
    results.append(float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0))
print(json.dumps(results))
"""


def read_all(usable, folder):
    """Usable or not, and the volume or the error, by path, from a process with little memory."""
    tasks = folder / "tasks.json"
    coloured = ("texture", "colour")
    tasks.write_text(
        json.dumps([(str(path), any(word in path.name for word in coloured)) for path in usable])
    )
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(tasks)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return {
        path: (usable[path], result) for path, result in zip(usable, json.loads(done.stdout), strict=True)
    }


@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.long)])
def test_each_is_refused_in_one_sentence_or_is_a_fruit(tmp_path, step):
    usable = {}
    for name, (content, can_be_used) in list(contents().items())[::step]:
        (path := tmp_path / name).write_bytes(content)
        usable[path] = can_be_used
    results = read_all(usable | dict.fromkeys(special_files(tmp_path), False), tmp_path)
    assert len(results) > 200 / step
    for path, (can_be_used, result) in results.items():
        assert can_be_used is None or can_be_used == isinstance(result, float), (path.name, result)
        if isinstance(result, float):
            # A body of length and diameter 1.
            assert 0.2 < abs(result) < 1.0, path.name
        else:
            assert result.startswith(f"{path}: "), path.name
            assert len(result.splitlines()) == 1, path.name
            assert len(result) < len(str(path)) + 600, path.name


@pytest.mark.long
def test_large_scan_is_read_with_little_memory(tmp_path):
    pytest.importorskip("fast_simplification")
    (path := tmp_path / "colour.ply").write_bytes(large_scan())
    _, volume = read_all({path: True}, tmp_path)[path]
    # A sphere of length and diameter 1.
    assert abs(volume) == pytest.approx(np.pi / 6.0, rel=0.03)

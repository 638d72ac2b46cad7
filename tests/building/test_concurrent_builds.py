"""Several builds of one folder at once make a correct data set, whoever writes last."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from stand_in import PYTHONPATH

from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.review.check import check_dataset

FRAMES = 24
BUILDS = (
    (range(24), "class,instance,distance"),
    (range(24), "colour,class"),
    (range(23, 5, -1), "class,instance,distance,colour"),
    (range(0, 24, 3), "distance,instance"),
)
"""Frames and outputs of the builds: they overlap, and two of them have frames of each other's."""

_SCRIPT = """
import sys
from data_sets import set_without_plants
from disc_set import DiscRenderer
changes = {"plan.sets": 4, "plan.rotations": 1, "plan.frames": 6}
set_without_plants(sys.argv[1], eval(sys.argv[2]), sys.argv[3].split(","), DiscRenderer, changes)
"""


def build_at_once(folder, builds):
    """Start builds at the same time; returns their exit codes and messages."""
    environment = {**os.environ, "PYTHONPATH": PYTHONPATH}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", _SCRIPT, str(folder), repr(frames), outputs],
            env=environment,
            stderr=subprocess.PIPE,
        )
        for frames, outputs in builds
    ]
    messages = [process.communicate(timeout=300)[1].decode() for process in processes]
    return [(process.returncode, text) for process, text in zip(processes, messages, strict=True)]


def check_round(folder, builds=BUILDS):
    assert build_at_once(folder, builds) == [(0, "")] * len(builds)
    manifest = folder / "manifest.parquet"
    before = manifest.read_bytes()
    result = check_dataset(folder, workers=1, frames=f"0:{FRAMES}")
    assert result.findings == ()
    rows = open_dataset(folder).manifest().to_pylist()
    assert manifest.read_bytes() == before, "the manifest of the builds was not complete"
    assert [row["index"] for row in rows] == list(range(FRAMES))
    # Whichever build made a frame, its timings are known, and all outputs of all builds are listed.
    for row in rows:
        assert row["render_s"] >= 0
        for name in ("colour", "class", "instance", "distance"):
            assert row[f"{name}_sha256"], f"{name} of frame {row['index']} is lost"


def test_two_builds_of_one_folder(tmp_path):
    # From both ends, so that they meet, and each has frames and outputs of the other's.
    builds = (range(24), "colour,class"), (range(23, -1, -1), "class,instance,distance,colour")
    check_round(tmp_path / "set", builds)


@pytest.mark.long
@pytest.mark.parametrize("number", range(10))
def test_four_builds_of_one_folder_ten_times(tmp_path, number):
    check_round(tmp_path / f"set{number}")

"""A build that is killed at any time is resumed by the same command, and makes the same files."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from data_sets import contents
from stand_in import PYTHONPATH, process_fields, rendered, wait_for

from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.recipe.plan import frame_seed

FRAMES = 60
SEED = 2018

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="children are found in /proc")

_SCRIPT = """
import sys
from stand_in import {renderer} as Renderer
from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.recipe.resolve.load import load_recipe
recipe = load_recipe("barth2018", {{"cultivar": "kaite_february", "plan.sets": 2, "plan.rotations": 2,
    "plan.frames": 15, "row.plants_front": {front}, "row.plants_back": {back}}})
options = BuildOptions("draft", workers=int(sys.argv[2]) or None, renderer=Renderer)
build(recipe, sys.argv[1], None, {outputs}, options)
"""
FAKE = _SCRIPT.format(renderer="StandIn", front=1, back=0, outputs=("class", "distance", "colour"))
REAL = _SCRIPT.format(
    renderer="LoggedRenderer",
    front=2,
    back=1,
    outputs=("class", "instance", "distance", "distance_code", "harvest", "colour"),
)


@pytest.fixture
def log(tmp_path):
    return tmp_path / "log"


@pytest.fixture
def start(tmp_path, monkeypatch, log):
    """Starts a build of 60 frames in another process."""
    monkeypatch.setenv("PYTHONPATH", PYTHONPATH)
    monkeypatch.setenv("STAND_IN_LOG", str(log))
    monkeypatch.setenv("STAND_IN_S", "0.02")

    def run(out, workers=0, script=FAKE):
        return subprocess.Popen(
            [sys.executable, "-c", script, str(tmp_path / out), str(workers)],
            stderr=subprocess.PIPE,
            start_new_session=True,
        )

    return run


def descendants(process):
    """Ids of a process and of all that it has started, directly or not."""
    parents = {pid: parent for pid, _, parent, *_ in process_fields()}
    members = {process}
    while more := {pid for pid, parent in parents.items() if parent in members} - members:
        members |= more
    return members


def kill(process, with_workers):
    """Kill a build, with or without its workers; all have ended on return."""
    members = descendants(process.pid)
    for member in members if with_workers else [process.pid]:
        with suppress(ProcessLookupError):
            os.kill(member, signal.SIGKILL)
    process.communicate()
    wait_for(lambda: not any(pid in members and state != "Z" for pid, state, *_ in process_fields()), 60.0)


def complete_frames(folder):
    """Indices of the complete frames; none of them is damaged."""
    if not (folder / "dataset.json").is_file():
        return set()
    dataset = open_dataset(folder)
    for index in dataset.indices():
        entries = dataset.metadata(index)["outputs"]
        assert set(dataset.intact(index).outputs) == set(entries), f"frame {index} is damaged"
    return set(dataset.indices())


def interrupted_build(start, folder, rng, max_kills, script, max_s, log):
    """Kill a build at random times until it finishes; returns how often it was killed."""
    kills = 0
    while True:
        complete, started = complete_frames(folder), len(rendered(log))
        process = start(folder.name, workers=int(rng.integers(0, 3)), script=script)
        if kills == max_kills:
            assert process.communicate()[1] == b""
            assert process.returncode == 0
        else:
            try:
                process.wait(rng.uniform(0.3, max_s))
            except subprocess.TimeoutExpired:
                kill(process, with_workers=bool(rng.integers(2)))
                kills += 1
            else:
                process.communicate()
        seeds = {seed for _, seed in rendered(log)[started:]}
        assert not seeds & {frame_seed(SEED, index) for index in complete}, "a frame was rendered again"
        if process.returncode == 0:
            return kills


@pytest.mark.long
@pytest.mark.parametrize(
    ("script", "count", "max_s"), [(FAKE, 30, 4.0), (REAL, 10, 30.0)], ids=["noise", "colour and all labels"]
)
def test_builds_that_are_killed_at_random_times(start, tmp_path, log, script, count, max_s):
    rng, folder, kills = np.random.default_rng(count), tmp_path / "set", 0
    assert start("expected", script=script).communicate()[1] == b""
    expected = contents(tmp_path / "expected")
    while kills < count:
        kills += interrupted_build(start, folder, rng, count - kills, script, max_s, log)
        assert contents(folder) == expected
        manifest = open_dataset(folder).manifest()
        assert manifest["index"].to_pylist() == list(range(FRAMES))
        assert manifest["seed"].to_pylist() == [frame_seed(SEED, index) for index in range(FRAMES)]
        shutil.rmtree(folder)

"""A build killed at any moment is resumed by the same command, and ends as if it had never been killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from data_sets import contents
from stand_in import PYTHONPATH, rendered

from pepperscene.dataset import open_dataset
from pepperscene.dataset.recipe.plan import Plan, frame_seed

FRAMES = 60
SEED = 2018

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="children are found in /proc")

_SCRIPT = """
import sys
from stand_in import {renderer} as Renderer
from pepperscene.dataset import BuildOptions, build, load_recipe
recipe = load_recipe("barth2018", {{"cultivar": "kaite_february", "plan.sets": 2, "plan.rotations": 2,
    "plan.frames": 15, "row.plants_front": {front}, "row.plants_back": {back}}})
options = BuildOptions("draft", workers=int(sys.argv[2]) or None, renderer=Renderer)
build(recipe, sys.argv[1], None, {outputs}, options)
"""
STAND_IN = _SCRIPT.format(renderer="StandIn", front=1, back=0, outputs=("class", "distance", "colour"))
REAL = _SCRIPT.format(
    renderer="Logged",
    front=2,
    back=1,
    outputs=("class", "instance", "distance", "distance_code", "harvest", "colour"),
)


@pytest.fixture
def log(tmp_path):
    return tmp_path / "log"


@pytest.fixture
def begin(tmp_path, monkeypatch, log):
    """Starts a build of 60 frames in another process."""
    monkeypatch.setenv("PYTHONPATH", PYTHONPATH)
    monkeypatch.setenv("STAND_IN_LOG", str(log))
    monkeypatch.setenv("STAND_IN_S", "0.02")

    def start(out, workers=0, script=STAND_IN):
        return subprocess.Popen(
            [sys.executable, "-c", script, str(tmp_path / out), str(workers)],
            stderr=subprocess.PIPE,
            start_new_session=True,
        )

    return start


def family(process):
    """A process and all that it has started, directly or not."""
    parents = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(status.parent.name)] = int(status.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    members = {process}
    while more := {child for child, parent in parents.items() if parent in members} - members:
        members |= more
    return members


def kill(process, everybody):
    """`kill -9`, of the build alone or of its workers as well; all have ended on return."""
    members = family(process.pid)
    for member in members if everybody else [process.pid]:
        try:
            os.kill(member, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.communicate()
    deadline = time.monotonic() + 60
    while any(is_alive(member) for member in members) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(is_alive(member) for member in members), "workers outlive their build"


def is_alive(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def complete_frames(folder):
    """Frames that count, each verified to the last bit; none is damaged."""
    if not (folder / "dataset.json").is_file():
        return set()
    dataset = open_dataset(folder)
    for index in dataset.indices():
        entries = dataset.metadata(index)["outputs"]
        assert set(dataset.intact(index).outputs) == set(entries), f"frame {index} is damaged"
    return set(dataset.indices())


def interrupted_build(begin, folder, rng, kills, script, longest_s, log):
    """A build that is killed at random moments until the last one may finish; returns how often it was."""
    times = 0
    while True:
        before, started = complete_frames(folder), len(rendered(log))
        process = begin(folder.name, workers=int(rng.integers(0, 3)), script=script)
        if times == kills:
            assert process.communicate()[1] == b""
            assert process.returncode == 0
        else:
            try:
                process.wait(rng.uniform(0.3, longest_s))
            except subprocess.TimeoutExpired:
                kill(process, everybody=bool(rng.integers(2)))
                times += 1
            else:
                process.communicate()
        seeds = {frame_seed(SEED, index) for index in before}
        again = {seed for _, seed in rendered(log)[started:]}
        assert not seeds & again, "a complete frame was rendered again"
        if process.returncode == 0:
            return times


def test_killed_at_random_moments_and_resumed(begin, tmp_path, log):
    assert begin("whole").communicate()[1] == b""
    log.unlink()
    times = interrupted_build(begin, tmp_path / "set", np.random.default_rng(6), 6, STAND_IN, 4.0, log)
    assert times > 1
    assert contents(tmp_path / "set") == contents(tmp_path / "whole")
    manifest = open_dataset(tmp_path / "set").manifest()
    assert manifest["index"].to_pylist() == list(range(FRAMES))
    plan = Plan(sets=2, rotations=2, frames=15)
    assert manifest["seed"].to_pylist() == [frame_seed(SEED, plan.frame(i).index) for i in range(FRAMES)]


@pytest.mark.long
def test_thirty_kills_of_real_builds(begin, tmp_path, log):
    """Sixty frames in colour with all labels, killed at thirty random moments of several builds."""
    rng = np.random.default_rng(30)
    assert begin("whole", script=REAL).communicate()[1] == b""
    expected, kills = contents(tmp_path / "whole"), 0
    assert len(expected) == 1 + FRAMES * 7
    while kills < 30:
        kills += interrupted_build(begin, tmp_path / "set", rng, 30 - kills, REAL, 30.0, log)
        assert contents(tmp_path / "set") == expected
        for path in sorted((tmp_path / "set").rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()

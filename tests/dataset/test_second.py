"""Plants made by two processes are those made by one, whatever becomes of the second."""

from __future__ import annotations

import subprocess
import sys
import threading

import numpy as np
import pytest
from pepperscene.dataset.scenes.plant_worker import VARIABLE, processes

from pepperscene.cultivar import load_cultivar
from pepperscene.dataset import load_recipe
from pepperscene.dataset.scenes.scene_builder import SceneBuilder
from pepperscene.errors import InputError

SMALL = {"cultivar": "kaite_february", "row.plants_front": 6, "row.plants_back": 2}


@pytest.fixture(scope="module")
def cultivar():
    return load_cultivar(SMALL["cultivar"])


@pytest.fixture(scope="module")
def recipe():
    return load_recipe("barth2018", SMALL)


@pytest.fixture(scope="module")
def alone(recipe, cultivar):
    return SceneBuilder(recipe, cultivar, 1).plants(0)


@pytest.fixture
def started(monkeypatch):
    """The processes that were started."""
    found, real = [], subprocess.Popen

    def start(*args, **options):
        found.append(real(*args, **options))
        return found[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    return found


def alike(some, others):
    assert len(some) == len(others)
    for one, other in zip(some, others, strict=True):
        assert one.posture == other.posture
        assert one.contacts == other.contacts
        assert one.mesh.instances == other.mesh.instances
        for name in ("vertices", "normals", "uv", "state", "faces", "face_instance", "face_surface"):
            np.testing.assert_array_equal(getattr(one.mesh, name), getattr(other.mesh, name))


def test_two_processes_make_the_same_plants_as_one(recipe, cultivar, alone, started):
    planting = SceneBuilder(recipe, cultivar, 2)
    here, real = [], planting.plant

    def slowly(which, number):
        # The second process has made the others before this one goes on.
        here.append(number)
        made = real(which, number)
        if number == 0:
            next(one for one in threading.enumerate() if one.name == "second process").join(60)
        return made

    planting.plant = slowly
    alike(planting.plants(0), alone)
    assert here == [0]
    # It has ended, and nothing of it is left open.
    assert started[0].returncode == 0
    assert started[0].stdin.closed
    assert started[0].stdout.closed


@pytest.mark.parametrize("broken", ["no/such/python", "exit", "chatter"])
def test_without_a_second_process_that_works_all_plants_are_made_here(
    broken, recipe, cultivar, alone, monkeypatch, tmp_path
):
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\n" + {"exit": "exit 3\n", "chatter": "echo hello\n"}.get(broken, ""))
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", broken if "/" in broken else str(program))
    alike(SceneBuilder(recipe, cultivar, 2).plants(0), alone)


def test_a_process_that_was_stopped_leaves_none_behind(recipe, cultivar, started):
    planting = SceneBuilder(recipe, cultivar, 2)

    def stopped(which, number):
        raise KeyboardInterrupt

    planting.plant = stopped
    with pytest.raises(KeyboardInterrupt):
        planting.plants(0)
    assert started[0].returncode is not None


def test_few_plants_start_no_process(cultivar, started):
    recipe = load_recipe("barth2018", {**SMALL, "row.plants_front": 1})
    SceneBuilder(recipe, cultivar, 2).plants(0)
    assert not started


def test_arguments_come_before_the_environment_and_that_before_the_machine(monkeypatch):
    monkeypatch.setenv(VARIABLE, "1")
    assert processes() == 1
    assert processes(2) == 2
    monkeypatch.setenv(VARIABLE, "many")
    with pytest.raises(InputError, match="must be 1 or 2, not many"):
        processes()
    monkeypatch.delenv(VARIABLE)
    assert processes() in (1, 2)

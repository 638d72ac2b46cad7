"""Single plants: their growth stage, the arguments of `grow_plant`, and plants made by two processes."""

from __future__ import annotations

import sys
import threading

import numpy as np
import pytest
from contact_meshes import count_contacts

import pepperscene.geometry
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.scenes.plants import (
    PROCESSES,
    PlantFactory,
    grow_plant,
    make_plants,
    plant_processes,
)
from pepperscene.classes import OrganClass
from pepperscene.cultivar import interpolate_cultivars, load_cultivar
from pepperscene.errors import ArgumentError, InputError
from pepperscene.grammar import grow
from pepperscene.recipe.plan import Stream, random_generator
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.scene import Greenhouse, Twine

COUNT = 6


@pytest.fixture(scope="module")
def february():
    return load_cultivar("kaite_february")


def vertices(*args, **kwargs):
    return grow_plant(*args, **kwargs).mesh.vertices


def test_single_plant_is_grown_meshed_and_free_of_contacts(february):
    grown = grow_plant("kaite_february", 3, detail=0.5)
    assert [instance.kind for instance in grown.mesh.instances] == [
        organ.kind for organ in grown.plant.organs
    ]
    assert grown.contacts == count_contacts(grown.mesh)
    # Organs have the poses of the mesh, also those that were moved.
    again = pepperscene.geometry.mesh_plant(grown.plant, 0.5)
    distance = np.linalg.norm(again.vertices - grown.mesh.vertices, axis=1)
    rigid = np.isin(again.face_class, [OrganClass.LEAF, OrganClass.PEPPER])
    assert distance[np.unique(again.faces[rigid])].max() < 1e-4
    # Stalks are meshed to fit what they join, so a kink in a joint changes their shape a little.
    assert distance.max() < 2e-3
    for seed in (3, np.int64(3)):
        np.testing.assert_array_equal(vertices(february, seed, detail=0.5), grown.mesh.vertices)
    assert not np.array_equal(vertices(february, 4, detail=0.5), grown.mesh.vertices)


def test_single_plant_is_the_first_of_a_recipe_with_its_seed(february):
    changes = {"row.plants_front": 1, "row.plants_back": 0, "twine.diameter_mm": 0, "seed": 11}
    recipe = load_recipe("barth2018", {**changes, "cultivar": "kaite_february"})
    mesh = FrameRenderer(recipe, culled=False).scene(recipe.plan.frame(0), traced=False).mesh
    np.testing.assert_array_equal(mesh.vertices, vertices(february, 11))
    first = grow(february, random_generator(11, Stream.PLANT, 0, 0))
    assert len(first.organs) == len(mesh.instances)


def test_default_stage_is_half_way(february):
    middle = interpolate_cultivars(february, load_cultivar("kaite"), 0.5)
    grown = grow_plant("kaite_february", 2, detail=0.05, until="kaite")
    np.testing.assert_array_equal(grown.mesh.vertices, vertices(middle, 2, detail=0.05))
    assert len(grown.plant.of_form("internode")) == middle.stem.parts
    # The share counts from the first stage.
    quarter = grow_plant("kaite_february", 2, detail=0.05, until="kaite", share=0.25).plant
    stage = interpolate_cultivars(february, load_cultivar("kaite"), 0.25)
    assert len(quarter.of_form("internode")) == stage.stem.parts != middle.stem.parts


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, "at least 0 and below"),
        ({"seed": 1.5}, "must be a whole number"),
        ({"seed": True}, "must be a whole number"),
        ({"seed": 2**63}, "below 2\\^63"),
        ({"share": 0.5}, "needs `until`"),
        ({"share": 2, "until": "kaite"}, "must be between 0 and 1"),
        ({"until": "tomato"}, "species: must be the same in both"),
    ],
)
def test_rejects_invalid_arguments(february, arguments, message):
    with pytest.raises(InputError, match=message):
        grow_plant(february, **arguments)
    with pytest.raises(ValueError, match="detail"):
        grow_plant(february, detail=float("nan"))


@pytest.fixture(scope="module")
def factory(february):
    return PlantFactory(february, 7, Greenhouse(turn_sd_rad=0.5), Twine(0.003, 4.0))


@pytest.fixture(scope="module")
def expected(factory):
    return make_plants(factory, 0, COUNT, 1)


def assert_equal(plants, expected):
    for plant, other in zip(plants, expected, strict=True):
        assert plant.posture == other.posture
        assert plant.contacts == other.contacts
        assert plant.mesh.instances == other.mesh.instances
        for name in ("vertices", "normals", "uv", "state", "faces", "face_instance", "face_surface"):
            np.testing.assert_array_equal(getattr(plant.mesh, name), getattr(other.mesh, name))


def test_two_processes_make_the_same_plants_as_one(factory, expected, started, monkeypatch):
    made_here, make_plant = [], PlantFactory.plant

    def wait_for_worker(self, which, number):
        # The worker makes all others before the first plant of this process is done.
        made_here.append(number)
        plant = make_plant(self, which, number)
        # On a machine with other load, it may have ended by now.
        for thread in threading.enumerate():
            if thread.name == "plant worker":
                thread.join(60)
        return plant

    monkeypatch.setattr(PlantFactory, "plant", wait_for_worker)
    assert_equal(make_plants(factory, 0, COUNT, 2), expected)
    assert made_here == [0]
    (process,) = started
    assert (process.returncode, process.stdin.closed, process.stdout.closed) == (0, True, True)


@pytest.mark.parametrize("script", [None, "echo hello"])
def test_without_a_working_second_process_all_plants_are_made_here(
    script, factory, expected, monkeypatch, tmp_path
):
    program = tmp_path / "python"
    if script is not None:
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    assert_equal(make_plants(factory, 0, COUNT, 2), expected)


def test_few_plants_start_no_process(factory, started, monkeypatch):
    monkeypatch.setattr(PlantFactory, "plant", lambda _self, which, number, **_: (which, number))
    assert make_plants(factory, 3, COUNT - 1, 2) == [(3, number) for number in range(COUNT - 1)]
    assert not started


def test_number_of_processes_is_argument_then_environment_then_default(monkeypatch):
    monkeypatch.setenv(PROCESSES, "1")
    assert plant_processes() == 1
    assert plant_processes(2) == 2
    monkeypatch.setenv(PROCESSES, "many")
    with pytest.raises(InputError, match="must be 1 or 2, not many"):
        plant_processes()
    for wrong in (0, 3, "2", "many"):
        with pytest.raises(ArgumentError, match=f"^processes: must be 1 or 2, not {wrong}$"):
            plant_processes(wrong)
    monkeypatch.delenv(PROCESSES)
    assert plant_processes() in (1, 2)


def test_interrupt_ends_the_second_process(factory, started, monkeypatch):
    def interrupt(_self, _which, _number):
        raise KeyboardInterrupt

    monkeypatch.setattr(PlantFactory, "plant", interrupt)
    with pytest.raises(KeyboardInterrupt):
        make_plants(factory, 0, COUNT, 2)
    assert started[0].returncode is not None

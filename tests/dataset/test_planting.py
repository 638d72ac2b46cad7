"""Plants of a recipe in their greenhouse: what is grown once, what stands where, and what is labelled how."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import pepperscene.dataset.scenes.scene_builder
import pepperscene.geometry
from pepperscene.classes import OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.dataset import FrameRenderer, grow_plant, load_recipe
from pepperscene.dataset.recipe.plan import Stream, random_generator
from pepperscene.dataset.scenes.scene_builder import SceneBuilder
from pepperscene.grammar import grow
from pepperscene.scene.far_rows import FAR_ROW_PLANTS

SMALL = {
    "cultivar": "kaite_february",  # the smallest plants
    "row.plants_front": 2,
    "row.plants_back": 1,
    "greenhouse.far_rows": 1,
    "greenhouse.far_reach_mm": 700,
    "greenhouse.crop_wire_mm": 2000,
}


@pytest.fixture(scope="module")
def recipe():
    return load_recipe("greenhouse", SMALL)


def planting_of(recipe):
    return SceneBuilder(recipe, load_cultivar(recipe.cultivar))


@pytest.fixture(scope="module")
def planting(recipe):
    return planting_of(recipe)


@pytest.fixture(scope="module")
def planted(planting):
    return planting.scene(0, 0)


def of_plant(mesh, plant, organ_class=OrganClass.STEM):
    """`(n, 3)` vertices of a plant's organs of one class; by default its stem, which nothing moves."""
    owner = np.array([one.plant for one in mesh.instances])[mesh.face_instance]
    chosen = (owner == plant) & (mesh.face_class == organ_class)
    return mesh.vertices[np.unique(mesh.faces[chosen])].astype(float)


def foot(points):
    """`(2,)` middle of a stem's lowest centimetre."""
    return points[points[:, 2] < points[:, 2].min() + 0.01, :2].mean(axis=0)


# --- what is grown once -------------------------------------------------------------------------------------


def test_rotations_reuse_the_plants_of_their_set(recipe, monkeypatch):
    made = []
    real = pepperscene.geometry.mesh_plant
    monkeypatch.setattr(pepperscene.geometry, "mesh_plant", lambda *args: made.append(args) or real(*args))
    planting = planting_of(recipe)
    planting.scene(0, 0)
    before = [one.mesh for one in planting.plants(0)]
    planting.scene(0, 1)
    planting.scene(0, 2)
    assert all(one is other.mesh for one, other in zip(before, planting.plants(0), strict=True))
    assert len(made) == 3 + FAR_ROW_PLANTS
    # The far rows' plants serve all sets.
    planting.plants(1)
    assert len(made) == 6 + FAR_ROW_PLANTS


def test_a_scene_leaves_the_plants_of_its_set_alone(recipe):
    planting = planting_of(recipe)
    before = [one.mesh.vertices.copy() for one in planting.plants(0)]
    planting.scene(0, 0)
    for kept, one in zip(before, planting.plants(0), strict=True):
        np.testing.assert_array_equal(kept, one.mesh.vertices)


def test_scenes_depend_on_no_other_scene(recipe, planting):
    fresh = planting_of(recipe).scene(1, 1)
    planting.scene(0, 0)
    again = planting.scene(1, 1)
    np.testing.assert_array_equal(fresh.mesh.vertices, again.mesh.vertices)
    np.testing.assert_array_equal(fresh.mesh.faces, again.mesh.faces)
    assert fresh.contacts == again.contacts


SCRIPT = f"""
import hashlib
from pepperscene.cultivar import load_cultivar
from pepperscene.dataset import load_recipe
from pepperscene.dataset.scenes.scene_builder import SceneBuilder
recipe = load_recipe("greenhouse", {SMALL!r})
mesh = SceneBuilder(recipe, load_cultivar(recipe.cultivar)).scene(0, 0).mesh
arrays = (mesh.vertices, mesh.normals, mesh.uv, mesh.state, mesh.faces, mesh.face_instance)
print(hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest())
"""


def test_every_process_makes_the_same_bytes(planted):
    mesh = planted.mesh
    arrays = (mesh.vertices, mesh.normals, mesh.uv, mesh.state, mesh.faces, mesh.face_instance)
    here = hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()
    there = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "1", "OMP_NUM_THREADS": "1"},
    )
    assert there.stdout.strip() == here


# --- what stands where --------------------------------------------------------------------------------------


def test_the_greenhouse_of_the_recipe_in_metres(planting):
    house = planting.house
    assert house.row_lean_rad == pytest.approx(np.radians(4))
    assert (house.spacing_sd_m, house.across_sd_m) == (0.015, 0.01)
    assert (house.gutter_width_m, house.gutter_height_m, house.crop_wire_m) == (0.22, 0.4, 2.0)
    assert (house.far_rows, house.far_reach_m, house.aisle_m) == (1, 0.7, 1.3)
    assert (house.floor, house.pipes) == (True, True)


def test_rows_lean_apart_and_stand_on_their_blocks(planting, planted):
    for number, posture in enumerate(one.posture for one in planting.plants(0)):
        stem = of_plant(planted.mesh, number)
        assert stem[:, 2].min() == pytest.approx(planting.house.stem_base_m, abs=0.01)
        # The stem's own wander is some centimetres a metre; the rows' lean is 7.
        rise = stem[:, 2].max() - stem[:, 2].min()
        away = stem[stem[:, 2] > stem[:, 2].max() - 0.01, 1].mean() - foot(stem)[1]
        towards = -away if number < 2 else away
        assert towards / rise == pytest.approx(np.tan(posture.lean_rad), abs=0.06)


def test_plants_keep_their_posture_and_places_their_blocks(planting):
    feet = []
    for rotation in (0, 1):
        mesh = planting.scene(0, rotation).mesh
        feet.append([foot(of_plant(mesh, number)) for number in range(3)])
    row, postures = planting.row, [one.posture for one in planting.plants(0)]
    first, second = np.array(feet)
    # Along the row, places are off their even spots, and stay so when the plants move on.
    np.testing.assert_allclose(first[:, 0], second[:, 0], atol=2e-3)
    off = first[:, 0] - row.positions()[:, 0]
    assert 1e-3 < np.abs(off).max() <= 3 * 0.015 + 2e-3
    # Across, plants are, and take that along; away from the aisle is the other way in the back row.
    across = [postures[0].across_m, postures[1].across_m, row.gap_m - postures[2].across_m]
    np.testing.assert_allclose(first[:, 1], across, atol=2e-3)
    np.testing.assert_allclose(second[:, 1], [across[1], across[0], across[2]], atol=2e-3)


def test_the_twine_ends_at_the_wire(planting, planted):
    mesh = planted.mesh
    wires = [number for number, one in enumerate(mesh.instances) if one.kind == "crop_wire"][:2]
    for number in range(3):
        cord = of_plant(mesh, number, OrganClass.WIRE)
        end = cord[np.argmax(cord[:, 2])]
        wire = mesh.vertices[np.unique(mesh.faces[mesh.face_instance == wires[number // 2]])]
        low, high = wire.min(axis=0), wire.max(axis=0)
        assert (end[1:] > low[1:] - 4e-3).all()
        assert (end[1:] < high[1:] + 4e-3).all()


def test_without_the_table_plants_stand_evenly_and_alone(recipe, planting):
    alone = recipe.model_copy(update={"greenhouse": None})
    mesh = planting_of(alone).scene(0, 0).mesh
    assert {one.plant for one in mesh.instances} == {0, 1, 2}
    feet = [foot(of_plant(mesh, number)) for number in range(3)]
    np.testing.assert_allclose(feet, planting.row.positions(), atol=2e-3)
    assert mesh.vertices[:, 2].min() < 0.01
    # An empty table turns the back row, and is otherwise the same.
    tables = recipe.model_dump() | {"greenhouse": {}}
    empty = planting_of(type(recipe).model_validate(tables)).scene(0, 0).mesh
    assert len(empty.instances) == len(mesh.instances)
    np.testing.assert_allclose(of_plant(empty, 0), of_plant(mesh, 0))
    turned = (of_plant(mesh, 2) - [*planting.row.positions()[2], 0]) * [-1, -1, 1]
    np.testing.assert_allclose(of_plant(empty, 2) - [*planting.row.positions()[2], 0], turned, atol=1e-6)


# --- labels -------------------------------------------------------------------------------------------------


def test_what_belongs_to_no_plant_is_background_or_the_rows_own_wire(planted):
    mesh = planted.mesh
    around = [one for one in mesh.instances if one.plant < 0]
    assert {one.kind for one in around} == {
        "gutter", "slab", "block", "crop_wire", "heating_pipe", "floor_film", "far_row",
    }  # fmt: skip
    assert {one.kind for one in around if one.organ_class != OrganClass.BACKGROUND} == {"crop_wire"}
    # Plants come first, so that their numbers do not depend on what is around them.
    owners = [one.plant >= 0 for one in mesh.instances]
    assert owners == sorted(owners, reverse=True)
    assert [one.kind for one in mesh.instances].count("far_row") == 6


def test_neither_floor_nor_gutters_nor_wires_run_through_fruit():
    # Whole plants, at a stage that bears fruit from foot to top.
    recipe = load_recipe(
        "greenhouse", {"row.plants_front": 2, "row.plants_back": 2, "greenhouse.far_rows": 0}
    )
    mesh = SceneBuilder(recipe, load_cultivar(recipe.cultivar)).scene(0, 0).mesh
    fruit = mesh.vertices[np.unique(mesh.faces[mesh.face_class == OrganClass.PEPPER])]
    assert fruit.shape[0] > 0
    for number, one in enumerate(mesh.instances):
        # Blocks are one instance for all plants; what stands between them is no part of it.
        if one.plant >= 0 or one.kind == "block":
            continue
        body = mesh.vertices[np.unique(mesh.faces[mesh.face_instance == number])]
        low, high = body.min(axis=0), body.max(axis=0)
        inside = ((fruit > low) & (fruit < high)).all(axis=1)
        assert not inside.any(), one.kind
    assert fruit[:, 2].min() > 0


# --- one plant ----------------------------------------------------------------------------------------------


def test_one_plant_is_grown_meshed_and_settled():
    made = grow_plant("kaite_february", 3, detail=0.5)
    assert [one.kind for one in made.mesh.instances] == [organ.kind for organ in made.plant.organs]
    assert made.contacts == pepperscene.geometry.count_contacts(made.mesh)
    # Organs lie in the plant as in the mesh, also those that were moved.
    again = pepperscene.geometry.mesh_plant(made.plant, 0.5)
    np.testing.assert_allclose(again.vertices, made.mesh.vertices, atol=1e-4)
    np.testing.assert_array_equal(
        grow_plant("kaite_february", 3, detail=0.5).mesh.vertices, made.mesh.vertices
    )
    other = grow_plant("kaite_february", 4, detail=0.5).mesh.vertices
    assert other.shape != made.mesh.vertices.shape or (other != made.mesh.vertices).any()


def test_it_is_the_first_plant_of_a_recipe_with_that_seed():
    alone = {"row.plants_front": 1, "row.plants_back": 0, "twine.diameter_mm": 0, "seed": 11}
    recipe = load_recipe("barth2018", {**alone, "cultivar": "kaite_february"})
    mesh = FrameRenderer(recipe, culled=False).scene(recipe.plan.frame(0), traced=False).mesh
    np.testing.assert_array_equal(mesh.vertices, grow_plant("kaite_february", 11).mesh.vertices)
    first = grow(load_cultivar("kaite_february"), random_generator(11, Stream.PLANT, 0, 0))
    assert len(first.organs) == len(mesh.instances)


def test_between_two_stages_a_plant_is_neither():
    first, last = grow_plant("kaite", 5, detail=0.3), grow_plant("kaite_september", 5, detail=0.3)
    for share, end in ((0.0, first), (1.0, last)):
        made = grow_plant("kaite", 5, detail=0.3, until="kaite_september", share=share)
        assert abs(np.ptp(made.mesh.vertices[:, 2]) - np.ptp(end.mesh.vertices[:, 2])) < 0.02
    between = grow_plant("kaite", 5, detail=0.3, until="kaite_september", share=0.5)
    heights = [np.ptp(made.mesh.vertices[:, 2]) for made in (first, between, last)]
    assert heights == sorted(heights)


def test_what_touches_within_plants_counts_too(recipe, planted, monkeypatch):
    real = pepperscene.dataset.scenes.scene_builder.grow_plant_at

    def jammed(*args, **kwargs):
        made = real(*args, **kwargs)
        return replace(made, contacts=replace(made.contacts, fruit_touching=1, blades_touching=2))

    monkeypatch.setattr(pepperscene.dataset.scenes.scene_builder, "grow_plant_at", jammed)
    told = planting_of(recipe).scene(0, 0).contacts
    assert planted.contacts.fruit_touching == 0
    assert told.fruit_touching == 3
    assert told.blades_touching == planted.contacts.blades_touching + 6

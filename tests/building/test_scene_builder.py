"""Plants of a recipe in their greenhouse: what is grown once, where it is placed, and how it is labelled."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import pepperscene.geometry
from pepperscene.building.scenes import plants
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.classes import OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.recipe.resolve.load import load_recipe
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


def builder_of(recipe):
    return SceneBuilder(recipe, load_cultivar(recipe.cultivar))


@pytest.fixture(scope="module")
def builder(recipe):
    return builder_of(recipe)


@pytest.fixture(scope="module")
def scene(builder):
    return builder.scene(0, 0)


def plant_vertices(mesh, plant, organ_class=OrganClass.STEM):
    """`(n, 3)` vertices of a plant's organs of one class; by default its stem, which no contact moves."""
    owner = np.array([instance.plant for instance in mesh.instances])[mesh.face_instance]
    selected = (owner == plant) & (mesh.face_class == organ_class)
    return mesh.vertices[np.unique(mesh.faces[selected])].astype(float)


def instance_vertices(mesh, number):
    return mesh.vertices[np.unique(mesh.faces[mesh.face_instance == number])]


def foot(points):
    """`(2,)` mean of a stem's lowest centimetre."""
    return points[points[:, 2] < points[:, 2].min() + 0.01, :2].mean(axis=0)


def feet(mesh):
    return np.array([foot(plant_vertices(mesh, number)) for number in range(3)])


def test_rotations_reuse_the_plants_of_their_set(recipe, builder, monkeypatch):
    other, calls, mesh_plant = builder, [], pepperscene.geometry.mesh_plant
    monkeypatch.setattr(
        pepperscene.geometry, "mesh_plant", lambda *args: calls.append(args) or mesh_plant(*args)
    )
    builder = builder_of(recipe)
    before = [plant.mesh for plant in builder.plants(0)]
    copies = [mesh.vertices.copy() for mesh in before]
    for rotation in range(3):
        builder.scene(0, rotation)
    for mesh, vertices, plant in zip(before, copies, builder.plants(0), strict=True):
        assert plant.mesh is mesh
        np.testing.assert_array_equal(mesh.vertices, vertices)
    assert len(calls) == 3 + FAR_ROW_PLANTS
    # All sets share the plants of the far rows.
    builder.plants(1)
    assert len(calls) == 6 + FAR_ROW_PLANTS
    # A scene depends on no other scene, and a plant not on the number of plants.
    alone = builder_of(recipe.model_copy(update={"row": replace(recipe.row, plants_front=1)}))
    for number in range(2):
        vertices = alone.plants(number)[0].mesh.vertices
        np.testing.assert_array_equal(vertices, builder.plants(number)[0].mesh.vertices)
        assert not np.array_equal(vertices, builder.plants(1 - number)[0].mesh.vertices)
    result, expected = builder.scene(0, 0), other.scene(0, 0)
    np.testing.assert_array_equal(result.mesh.vertices, expected.mesh.vertices)
    assert result.contacts == expected.contacts


def mesh_digest(mesh):
    arrays = (mesh.vertices, mesh.normals, mesh.uv, mesh.state, mesh.faces, mesh.face_instance)
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def test_every_process_makes_the_same_bytes(scene):
    script = f"import test_scene_builder as t; r = t.load_recipe('greenhouse', {SMALL!r})"
    result = subprocess.run(
        [sys.executable, "-c", f"{script}; print(t.mesh_digest(t.builder_of(r).scene(0, 0).mesh))"],
        capture_output=True,
        text=True,
        check=True,
        cwd=os.path.dirname(__file__),
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(sys.path),
            "PYTHONHASHSEED": "1",
            "OMP_NUM_THREADS": "1",
        },
    )
    assert result.stdout.strip() == mesh_digest(scene.mesh)


def test_rows_lean_apart_and_stems_begin_on_blocks(builder, scene):
    for number, plant in enumerate(builder.plants(0)):
        stem = plant_vertices(scene.mesh, number)
        assert stem[:, 2].min() == pytest.approx(builder.greenhouse.stem_base_m, abs=0.01)
        # A stem's curvature is some centimetres a metre; the rows' lean is 7.
        height = stem[:, 2].max() - stem[:, 2].min()
        shift = stem[stem[:, 2] > stem[:, 2].max() - 0.01, 1].mean() - foot(stem)[1]
        towards_aisle = -shift if number < 2 else shift
        assert towards_aisle / height == pytest.approx(np.tan(plant.posture.lean_rad), abs=0.06)


def test_rotation_moves_plants_and_postures_but_not_blocks(builder):
    row, postures = builder.row, [plant.posture for plant in builder.plants(0)]
    meshes = [builder.scene(0, rotation).mesh for rotation in (0, 1)]
    before, after = ([plant_vertices(mesh, plant) for plant in range(3)] for mesh in meshes)
    for place, plant in ((1, 0), (0, 1), (2, 2)):
        shapes = [stem - stem.mean(axis=0) for stem in (after[place], before[plant])]
        np.testing.assert_allclose(*shapes, atol=1e-5)
    first, second = map(feet, meshes)
    # Along the row, places deviate from even spacing in the same way.
    np.testing.assert_allclose(first[:, 0], second[:, 0], atol=2e-3)
    deviation = first[:, 0] - row.positions()[:, 0]
    assert 1e-3 < np.abs(deviation).max() <= 3 * 0.015 + 2e-3
    # Across, the deviation belongs to the plant; in the back row it has the opposite sign.
    across = [postures[0].across_m, postures[1].across_m, row.gap_m - postures[2].across_m]
    np.testing.assert_allclose(first[:, 1], across, atol=2e-3)
    np.testing.assert_allclose(second[:, 1], [across[1], across[0], across[2]], atol=2e-3)


def test_twine_ends_at_the_crop_wire(scene):
    mesh = scene.mesh
    wires = [number for number, one in enumerate(mesh.instances) if one.kind == "crop_wire"][:2]
    for number in range(3):
        twine = plant_vertices(mesh, number, OrganClass.WIRE)
        end = twine[np.argmax(twine[:, 2])]
        wire = instance_vertices(mesh, wires[number // 2])
        assert (end[1:] > wire.min(axis=0)[1:] - 4e-3).all()
        assert (end[1:] < wire.max(axis=0)[1:] + 4e-3).all()


def test_without_greenhouse_table_plants_are_even_upright_and_alone(recipe, builder):
    positions = builder.row.positions()
    mesh = builder_of(recipe.model_copy(update={"greenhouse": None})).scene(0, 0).mesh
    assert {instance.plant for instance in mesh.instances} == {0, 1, 2}
    np.testing.assert_allclose(feet(mesh), positions, atol=2e-3)
    assert mesh.vertices[:, 2].min() < 0.01
    # An empty table turns the back row, and is otherwise the same.
    tables = recipe.model_dump() | {"greenhouse": {}}
    empty = builder_of(type(recipe).model_validate(tables)).scene(0, 0).mesh
    assert len(empty.instances) == len(mesh.instances)
    np.testing.assert_allclose(plant_vertices(empty, 0), plant_vertices(mesh, 0))
    centre = [*positions[2], 0]
    expected = (plant_vertices(mesh, 2) - centre) * [-1, -1, 1]
    np.testing.assert_allclose(plant_vertices(empty, 2) - centre, expected, atol=1e-6)


def test_surroundings_are_background_except_for_crop_wires(scene):
    instances = scene.mesh.instances
    surroundings = [item for item in instances if item.plant < 0 and item.far_row < 0]
    assert {instance.kind for instance in surroundings} == {
        "gutter", "slab", "block", "crop_wire", "heating_pipe", "floor_film",
    }  # fmt: skip
    labelled = [one for one in surroundings if one.organ_class != OrganClass.BACKGROUND]
    assert {instance.kind for instance in labelled} == {"crop_wire"}
    # Plants come first, so that their numbers do not depend on what is around them.
    order = [2 if item.far_row >= 0 else int(item.plant < 0) for item in instances]
    assert order == sorted(order)
    far = [item for item in instances if item.far_row >= 0]
    assert {item.far_row for item in far} == set(range(6))
    assert {item.plant for item in far} == set(range(3, 1 + max(item.plant for item in far)))


def test_no_part_of_the_greenhouse_intersects_fruit():
    # Whole plants, at a stage that bears fruit from bottom to top.
    changes = {"row.plants_front": 1, "row.plants_back": 1, "greenhouse.far_rows": 0}
    mesh = builder_of(load_recipe("greenhouse", changes)).scene(0, 0).mesh
    fruit = mesh.vertices[np.unique(mesh.faces[mesh.face_class == OrganClass.PEPPER])]
    assert fruit.shape[0] > 0
    for number, instance in enumerate(mesh.instances):
        # All blocks are one instance, whose bounds contain the space between them.
        if instance.plant < 0 and instance.kind != "block":
            body = instance_vertices(mesh, number)
            inside = ((fruit > body.min(axis=0)) & (fruit < body.max(axis=0))).all(axis=1)
            assert not inside.any(), instance.kind
    assert fruit[:, 2].min() > 0


def test_contacts_within_plants_are_added(recipe, scene, monkeypatch):
    grow_plant_at = plants.grow_plant_at

    def with_contacts(*args, **kwargs):
        grown = grow_plant_at(*args, **kwargs)
        return replace(grown, contacts=replace(grown.contacts, fruit_touching=1, blades_touching=2))

    monkeypatch.setattr(plants, "grow_plant_at", with_contacts)
    contacts = builder_of(recipe).scene(0, 0).contacts
    assert scene.contacts.fruit_touching == 0
    assert contacts.fruit_touching == 3
    assert contacts.blades_touching == scene.contacts.blades_touching + 6

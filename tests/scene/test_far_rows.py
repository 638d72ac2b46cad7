"""Far rows: few triangles, labels as fine as 16 bits allow, and plants at regular free positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.classes import IGNORE_CLASS, Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import concatenate_meshes, mesh_plant, sphere
from pepperscene.grammar import grow
from pepperscene.scene import DoubleRow, Greenhouse, coarsen_plant, draw_far_rows, far_row_meshes, far_rows
from pepperscene.scene.culling import mesh_chunks
from pepperscene.scene.far_rows import FarDetail, far_detail
from pepperscene.scene.greenhouse import FarRowsAs, row_lines

ROW = DoubleRow(plants_front=3, plants_back=2, spacing_m=0.25, gap_m=0.3, shift_m=0.125)
GREENHOUSE = Greenhouse(row_lean_rad=np.radians(5.0), far_rows=1, far_reach_m=2.0, aisle_m=1.2)
AS_BACKGROUND = replace(GREENHOUSE, far_rows_as=FarRowsAs.BACKGROUND)
AS_IGNORED = replace(GREENHOUSE, far_rows_as=FarRowsAs.IGNORE)


def rows(models, seed=1, greenhouse=GREENHOUSE, others=0):
    drawn = draw_far_rows(len(models), ROW, greenhouse, np.random.default_rng(seed))
    return far_row_meshes(models, drawn, greenhouse.far_rows_as, others)


def ball(radius):
    """A plant whose position is easy to measure: a ball around its stem base."""
    body = sphere((0, 0, 0), radius, subdivisions=1)
    return replace(body, instances=(Instance(OrganClass.PEPPER, "fruit"),))


@pytest.fixture(scope="module")
def plant():
    return mesh_plant(grow(load_cultivar("kaite"), np.random.default_rng(5)), 0.3)


@pytest.fixture(scope="module")
def coarse(plant):
    return coarsen_plant(plant)


def extent(mesh, number):
    points = mesh.vertices[np.unique(mesh.faces[mesh.face_instance == number])]
    return points.min(axis=0), points.max(axis=0)


def test_coarse_plant_has_few_valid_triangles_of_its_own_vertices(plant, coarse):
    assert len(coarse.faces) < 0.5 * len(plant.faces)
    assert len(coarse.faces) < 60 * len({*coarse.face_instance})
    own = {tuple(row) for row in np.column_stack([plant.vertices, plant.normals]).round(7)}
    assert {tuple(row) for row in np.column_stack([coarse.vertices, coarse.normals]).round(7)} <= own
    a, b, c = coarse.faces.T
    np.testing.assert_array_equal(np.unique(coarse.faces), np.arange(len(coarse.vertices)))
    assert ((a != b) & (b != c) & (c != a)).all()
    assert len(np.unique(np.sort(coarse.faces, axis=1), axis=0)) == len(coarse.faces)


def test_each_organ_keeps_its_extent(plant, coarse):
    kept = {*coarse.face_instance.tolist()}
    for number, instance in enumerate(plant.instances):
        if instance.kind == "calyx" or instance.organ_class in (OrganClass.CUT, OrganClass.WIRE):
            assert number not in kept
            continue
        assert number in kept, instance
        size = np.linalg.norm(np.subtract(*extent(plant, number)[::-1]))
        for coarse_corner, corner in zip(extent(coarse, number), extent(plant, number), strict=True):
            assert np.abs(coarse_corner - corner).max() < 0.3 * size, instance


def test_scanned_colours_follow_their_vertices(plant):
    # The colour of each vertex is its position.
    coarse = coarsen_plant(replace(plant, colour=plant.vertices))
    np.testing.assert_array_equal(coarse.colour, coarse.vertices)
    painted = ball(0.05)
    painted = replace(painted, colour=np.repeat(painted.vertices[:, 2:], 3, axis=1))
    upright = replace(GREENHOUSE, row_lean_rad=0.0)
    for mesh in rows([painted], greenhouse=upright):
        np.testing.assert_allclose(mesh.colour[:, 0], mesh.vertices[:, 2], atol=1e-6)


def test_rows_are_regular_and_leave_labelled_positions_free():
    lines, meshes = row_lines(ROW, GREENHOUSE), rows([ball(0.01)])
    assert len(meshes) == len(lines)
    for mesh, line in zip(meshes, lines, strict=True):
        centres = mesh.vertices.reshape(-1, len(ball(0.01).vertices), 3).mean(axis=1)
        np.testing.assert_allclose(centres[:, 1], line.y_m, atol=1e-6)
        np.testing.assert_allclose(centres[:, 2], GREENHOUSE.stem_base_m, atol=1e-6)
        x = np.sort(centres[:, 0])
        assert np.abs(x).max() <= GREENHOUSE.far_reach_m
        # There is a plant at every position as far as the row extends.
        steps = np.diff(x) / ROW.spacing_m
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-4)
        assert GREENHOUSE.far_reach_m - np.abs([x[0], x[-1]]).min() < 2 * ROW.spacing_m
        if line.labelled:
            taken = [x for x, y in ROW.positions() if y == line.y_m]
            assert np.abs(x[:, None] - taken).min() > 0.99 * ROW.spacing_m
            assert sorted(np.rint(steps))[-1] == len(taken) + 1
        else:
            np.testing.assert_allclose(steps, 1, atol=1e-4)


@pytest.mark.parametrize(
    ("greenhouse", "class_id"), [(AS_BACKGROUND, OrganClass.BACKGROUND), (AS_IGNORED, IGNORE_CLASS)]
)
def test_rows_without_labels_are_one_instance_each(coarse, greenhouse, class_id):
    for number, mesh in enumerate(rows([coarse, coarse], greenhouse=greenhouse)):
        (instance,) = mesh.instances
        far_row = number if class_id == IGNORE_CLASS else -1
        assert (instance.kind, instance.plant, instance.far_row) == ("far_row", -1, far_row)
        assert instance.class_id == class_id
        assert set(mesh.face_class) == {class_id}
        assert mesh.faces.max() == len(mesh.vertices) - 1
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)


def test_rows_lean_to_their_own_aisle():
    # A plant that leans towards -y: a ball at its base and one a metre up.
    leaning = concatenate_meshes([ball(0.01), ball(0.02).moved(np.eye(3), np.array([0.0, -0.1, 1.0]))])
    for mesh, line in zip(rows([leaning]), row_lines(ROW, GREENHOUSE), strict=True):
        high = mesh.vertices[mesh.vertices[:, 2] > 0.5]
        offset = line.aisle * (high[:, 1] - line.y_m)
        # Plants are rotated by less than 30 degrees either way.
        assert offset.min() > 0.1 * np.cos(np.radians(30)) - 0.021
        assert offset.max() <= 0.1 + 0.021


def test_how_rows_are_labelled_moves_no_triangle_and_culls_none(coarse):
    models = [coarse, ball(0.1)]
    expected = concatenate_meshes(rows(models, greenhouse=AS_BACKGROUND))
    leaf = expected.surfaces.index("leaf")
    assert len({*expected.face_appearance[expected.face_surface == leaf].tolist()}) > 10
    # The last scene has so many other instances that all organs of a class of a row are one.
    for greenhouse, others in ((GREENHOUSE, 0), (AS_IGNORED, 0), (GREENHOUSE, 60_000)):
        mesh = concatenate_meshes(rows(models, greenhouse=greenhouse, others=others))
        for name in ("vertices", "normals", "uv", "state", "faces", "face_surface", "face_appearance"):
            np.testing.assert_array_equal(getattr(mesh, name), getattr(expected, name))
        assert mesh.appearances == expected.appearances
        for name in ("faces", "vertices", "centres", "radii"):
            found, wanted = getattr(mesh_chunks(mesh), name), getattr(mesh_chunks(expected), name)
            np.testing.assert_array_equal(found, wanted)
        # Label images never show simplified organs.
        assert not mesh_chunks(mesh).whole.any()


def test_every_fruit_and_blade_is_an_instance_with_the_class_of_its_organ(plant, coarse):
    meshes = rows([coarse])
    shown = [item for number, item in enumerate(plant.instances) if number in {*coarse.face_instance}]
    for mesh in meshes:
        plants = {item.plant for item in mesh.instances}
        for organ_class in (OrganClass.PEPPER, OrganClass.LEAF):
            count = sum(item.organ_class == organ_class for item in shown)
            assert sum(item.organ_class == organ_class for item in mesh.instances) == count * len(plants)
        for organ_class in (OrganClass.STEM, OrganClass.SHOOT, OrganClass.PEDUNCLE):
            assert sum(item.organ_class == organ_class for item in mesh.instances) == len(plants)
        # All faces of a fruit of the model are one instance, and each plant repeats the model's classes.
        repeated = mesh.face_class.reshape(len(plants), -1)
        np.testing.assert_array_equal(repeated, np.tile(coarse.face_class, (len(plants), 1)))
        fruit = coarse.face_class == OrganClass.PEPPER
        for faces in mesh.face_instance.reshape(len(plants), -1):
            pairs = {*zip(coarse.face_instance[fruit].tolist(), faces[fruit].tolist(), strict=True)}
            assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})


def test_far_plants_are_numbered_after_the_labelled_ones_along_each_row(coarse):
    meshes = rows([coarse, coarse])
    numbers = [sorted({item.plant for item in mesh.instances}) for mesh in meshes]
    expected = list(range(5, 5 + sum(map(len, numbers))))
    assert [number for row in numbers for number in row] == expected
    for row_number, mesh in enumerate(meshes):
        assert {item.far_row for item in mesh.instances} == {row_number}
        owner = np.array([item.plant for item in mesh.instances])[mesh.face_instance]
        points = mesh.vertices[mesh.faces].mean(axis=1)
        x = [
            points[(owner == n) & (mesh.face_class == OrganClass.STEM), 0].mean() for n in numbers[row_number]
        ]
        # A leaning stem's middle is within a plant's spacing.
        assert (np.diff(x) > 0).all()


def test_parents_of_far_organs_are_instances_of_the_same_plant(coarse):
    for mesh in rows([coarse]):
        fruit = [item for item in mesh.instances if item.organ_class == OrganClass.PEPPER]
        assert {mesh.instances[item.parent].organ_class for item in fruit} == {OrganClass.PEDUNCLE}
        for item in mesh.instances:
            assert item.parent < 0 or mesh.instances[item.parent].plant == item.plant


@pytest.mark.parametrize(
    ("limit", "detail"),
    [(100_000, FarDetail.ORGANS), (3000, FarDetail.FRUIT), (500, FarDetail.PLANTS), (60, FarDetail.ROWS)],
)
def test_instances_are_merged_as_far_as_needed(coarse, monkeypatch, limit, detail):
    monkeypatch.setattr(far_rows, "MAX_INSTANCES", limit)
    meshes = rows([coarse, coarse])
    plants = sum(len({item.plant for item in mesh.instances}) for mesh in meshes)
    count = sum(len(mesh.instances) for mesh in meshes)
    assert count <= limit
    classes = set(coarse.face_class.tolist())
    leaves, fruit = (
        len(set(coarse.face_instance[coarse.face_class == organ_class].tolist()))
        for organ_class in (OrganClass.LEAF, OrganClass.PEPPER)
    )
    others = len(classes) - 2
    expected = {
        FarDetail.ORGANS: plants * (leaves + fruit + others),
        FarDetail.FRUIT: plants * (fruit + 1 + others),
        FarDetail.PLANTS: plants * len(classes),
        FarDetail.ROWS: len(meshes) * len(classes),
    }
    assert count == expected[detail]
    for mesh in meshes:
        # Merging changes no class.
        assert set(mesh.face_class.tolist()) == classes
        assert {*mesh.face_instance.tolist()} == {*range(len(mesh.instances))}


def test_other_instances_of_the_scene_count():
    sizes = {FarDetail.ORGANS: [100], FarDetail.FRUIT: [10], FarDetail.PLANTS: [5], FarDetail.ROWS: [5]}
    plants = np.array([500])
    assert far_detail(sizes, plants, 10_000) == FarDetail.ORGANS
    assert far_detail(sizes, plants, 10_001) == FarDetail.FRUIT
    assert far_detail(sizes, plants, 57_500) == FarDetail.PLANTS
    assert far_detail(sizes, plants, 57_501) == FarDetail.ROWS

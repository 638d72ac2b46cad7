"""Far rows: few triangles, background only, and plants at regular free positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.classes import Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import concatenate_meshes, mesh_plant, rectangle, sphere
from pepperscene.grammar import grow
from pepperscene.scene import DoubleRow, Greenhouse, coarsen_plant, far_row_meshes
from pepperscene.scene.greenhouse import row_lines

ROW = DoubleRow(front=3, back=2, spacing_m=0.25, gap_m=0.3, shift_m=0.125)
GREENHOUSE = Greenhouse(row_lean_rad=np.radians(5.0), far_rows=1, far_reach_m=2.0, aisle_m=1.2)


def rows(models, seed=1, greenhouse=GREENHOUSE):
    return far_row_meshes(models, ROW, greenhouse, np.random.default_rng(seed))


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


def test_coarsening_raises_if_no_organ_is_left():
    wire = rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0), "twine", OrganClass.WIRE)
    with pytest.raises(ValueError, match="no organ"):
        coarsen_plant(wire)


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


def test_each_row_is_one_background_instance(coarse):
    for mesh in rows([coarse, coarse]):
        (instance,) = mesh.instances
        assert (instance.organ_class, instance.kind, instance.plant) == (OrganClass.BACKGROUND, "far_row", -1)
        assert set(mesh.face_class) == {OrganClass.BACKGROUND}
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


def test_no_meshes_without_far_rows():
    assert rows([ball(0.01)], 0, replace(GREENHOUSE, far_rows=0)) == []


def test_rows_depend_on_the_seed_only(coarse):
    first, again, other = (concatenate_meshes(rows([coarse, ball(0.1)], seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    np.testing.assert_array_equal(first.faces, again.faces)
    assert first.vertices.shape != other.vertices.shape or (first.vertices != other.vertices).any()

"""Far rows are cheap, are background alone, and stand where rows stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.classes import Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import concatenate_meshes, mesh_plant, rectangle, sphere
from pepperscene.grammar import grow
from pepperscene.scene import DoubleRow, Greenhouse, coarsen_plant, far_rows
from pepperscene.scene.greenhouse import row_lines

ROW = DoubleRow(front=3, back=2, spacing_m=0.25, gap_m=0.3, shift_m=0.125)
HOUSE = Greenhouse(row_lean_rad=np.radians(5.0), far_rows=1, far_reach_m=2.0, aisle_m=1.2)


@pytest.fixture(scope="module")
def plant():
    return mesh_plant(grow(load_cultivar("kaite"), np.random.default_rng(5)), 0.3)


@pytest.fixture(scope="module")
def model(plant):
    return coarsen_plant(plant)


def extent(mesh, number):
    points = mesh.vertices[np.unique(mesh.faces[mesh.face_instance == number])]
    return points.min(axis=0), points.max(axis=0)


def test_a_coarse_plant_has_few_triangles(plant, model):
    assert len(model.faces) < 0.5 * len(plant.faces)
    assert len(model.faces) < 60 * len({*model.face_instance})
    # All vertices are the plant's own, and none is left over.
    own = {tuple(row) for row in np.column_stack([plant.vertices, plant.normals]).round(7)}
    assert {tuple(row) for row in np.column_stack([model.vertices, model.normals]).round(7)} <= own
    np.testing.assert_array_equal(np.unique(model.faces), np.arange(len(model.vertices)))
    corners = model.faces
    assert ((corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])).all()
    assert (corners[:, 2] != corners[:, 0]).all()
    assert len(np.unique(np.sort(corners, axis=1), axis=0)) == len(corners)


def test_every_organ_keeps_its_extent(plant, model):
    left = {*model.face_instance.tolist()}
    for number, one in enumerate(plant.instances):
        if one.kind == "calyx" or one.organ_class in (OrganClass.CUT, OrganClass.WIRE):
            assert number not in left
            continue
        assert number in left, one
        size = np.linalg.norm(np.subtract(*extent(plant, number)[::-1]))
        for found, true in zip(extent(model, number), extent(plant, number), strict=True):
            assert np.abs(found - true).max() < 0.3 * size, one


def test_nothing_left_is_refused():
    wire = rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0), "twine", OrganClass.WIRE)
    with pytest.raises(ValueError, match="nothing"):
        coarsen_plant(wire)


def ball(radius):
    """A plant whose places can be read off: a ball about its foot."""
    body = sphere((0, 0, 0), radius, subdivisions=1)
    return replace(body, instances=(Instance(OrganClass.PEPPER, "fruit"),))


def stands(mesh, count):
    """`(n, 3)` middles of the balls of a row."""
    return mesh.vertices.reshape(-1, count, 3).mean(axis=1)


def test_rows_stand_in_their_lines_and_leave_the_plants_places_free():
    balls = [ball(0.01)]
    made = far_rows(balls, ROW, HOUSE, np.random.default_rng(1))
    lines = row_lines(ROW, HOUSE)
    assert len(made) == len(lines)
    for mesh, line in zip(made, lines, strict=True):
        feet = stands(mesh, len(balls[0].vertices))
        np.testing.assert_allclose(feet[:, 1], line.y_m, atol=1e-6)
        np.testing.assert_allclose(feet[:, 2], HOUSE.foot_m, atol=1e-6)
        x = np.sort(feet[:, 0])
        assert np.abs(x).max() <= HOUSE.far_reach_m
        # As far as the row reaches, there is a plant at every place.
        steps = np.diff(x) / ROW.spacing_m
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-4)
        assert HOUSE.far_reach_m - np.abs([x[0], x[-1]]).min() < 2 * ROW.spacing_m
        if line.own:
            taken = [place[0] for place in ROW.places() if place[1] == line.y_m]
            assert np.abs(x[:, None] - taken).min() > 0.99 * ROW.spacing_m
            assert sorted(np.rint(steps))[-1] == len(taken) + 1
        else:
            np.testing.assert_allclose(steps, 1, atol=1e-4)


def test_each_row_is_one_instance_of_the_background(model):
    for mesh in far_rows([model, model], ROW, HOUSE, np.random.default_rng(1)):
        (one,) = mesh.instances
        assert (one.organ_class, one.kind, one.plant) == (OrganClass.BACKGROUND, "far_row", -1)
        assert set(mesh.face_class) == {OrganClass.BACKGROUND}
        assert mesh.faces.max() == len(mesh.vertices) - 1
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)


def test_rows_lean_to_their_own_aisle():
    # A plant that leans towards -y: a ball at its foot and one a metre up.
    leaning = concatenate_meshes([ball(0.01), ball(0.02).moved(np.eye(3), np.array([0.0, -0.1, 1.0]))])
    for mesh, line in zip(
        far_rows([leaning], ROW, HOUSE, np.random.default_rng(1)), row_lines(ROW, HOUSE), strict=True
    ):
        high = mesh.vertices[mesh.vertices[:, 2] > 0.5]
        away = line.aisle * (high[:, 1] - line.y_m)
        # Most are turned by less than 30 degrees either way.
        assert away.min() > 0.1 * np.cos(np.radians(30)) - 0.021
        assert away.max() <= 0.1 + 0.021


def test_nothing_stands_where_no_far_rows_are():
    assert far_rows([ball(0.01)], ROW, replace(HOUSE, far_rows=0), np.random.default_rng(0)) == []


def test_the_same_generator_makes_the_same_rows(model):
    models = [model, ball(0.1)]
    first, again, other = (
        concatenate_meshes(far_rows(models, ROW, HOUSE, np.random.default_rng(seed))) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first.vertices, again.vertices)
    np.testing.assert_array_equal(first.faces, again.faces)
    assert first.vertices.shape != other.vertices.shape or (first.vertices != other.vertices).any()

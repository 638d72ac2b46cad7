"""Plants of a double row stand where section 2.5 of Barth et al. 2018 puts them, each held by a twine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pepperscene.classes import Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import concatenate_meshes, mesh_plant, rectangle, stem_profile
from pepperscene.grammar import grow
from pepperscene.scene import Twine, add_twine, double_row, place_plants

SPACING, GAP, SHIFT = 0.2, 0.25, 0.1
CORD = Twine(diameter_m=0.003, turns_per_m=4.0)


def seedling(number):
    """Two organs, the second one growing out of the first; no two seedlings are of the same size."""
    stem = rectangle((0, 0, 1), (0.01 * (number + 1), 0, 0), (0, 0, 1), surface="stem")
    leaf = rectangle((0, 0, 2), (0.02 * (number + 1), 0, 0), (0, 0.1, 0), surface="leaf")
    mesh = concatenate_meshes([stem, leaf])
    instances = (Instance(OrganClass.STEM, "internode"), Instance(OrganClass.LEAF, "lamina", parent=0))
    return replace(mesh, instances=instances)


def rows(front, back):
    return [seedling(n) for n in range(front)], [seedling(front + n) for n in range(back)]


def all_of(front, back):
    first, second = rows(front, back)
    return first + second


def placed(front, back):
    return double_row(*rows(front, back), spacing_m=SPACING, gap_m=GAP, shift_m=SHIFT)


def offsets(row, plants):
    """`(n, 3)` by how much each plant was moved; the same for all of its vertices."""
    bounds = np.cumsum([0, *(len(plant.vertices) for plant in plants)])
    moves = []
    for plant, first, last in zip(plants, bounds[:-1], bounds[1:], strict=True):
        away = row.vertices[first:last] - plant.vertices
        np.testing.assert_allclose(away, np.broadcast_to(away[0], away.shape), atol=1e-6)
        moves.append(away[0])
    return np.array(moves)


@pytest.mark.parametrize(("front", "back"), [(7, 6), (1, 0), (2, 3), (4, 4)])
def test_the_rows_stand_evenly_around_the_front_rows_middle_plant(front, back):
    moves = offsets(placed(front, back), all_of(front, back))
    # The middle plant, the fourth of seven, is the origin that the camera's path goes around.
    np.testing.assert_allclose(moves[front // 2], 0.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(moves[:front, 0]), SPACING, atol=1e-6)
    np.testing.assert_allclose(np.diff(moves[front:, 0]), SPACING, atol=1e-6)
    np.testing.assert_allclose(moves[:front, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(moves[front:, 1], GAP, atol=1e-6)
    np.testing.assert_allclose(moves[:, 2], 0.0, atol=1e-6)
    if back:
        np.testing.assert_allclose(moves[front + back // 2, 0], SHIFT, atol=1e-6)


def test_half_a_spacing_of_shift_fills_the_gaps_of_seven_by_six():
    x = offsets(placed(7, 6), all_of(7, 6))[:, 0]
    np.testing.assert_allclose(x[7:], (x[:6] + x[1:7]) / 2, atol=1e-6)


def test_nothing_but_the_place_of_a_plant_changes():
    plants = all_of(2, 1)
    row = placed(2, 1)
    for name in ("normals", "uv", "state"):
        together = np.concatenate([getattr(plant, name) for plant in plants])
        np.testing.assert_array_equal(getattr(row, name), together)
    assert row.surfaces == ("stem", "leaf")
    np.testing.assert_array_equal(row.face_class, np.concatenate([plant.face_class for plant in plants]))
    first_corner = np.concatenate([plant.faces + 8 * number for number, plant in enumerate(plants)])
    np.testing.assert_array_equal(row.faces, first_corner)


def test_instances_are_numbered_on_and_know_their_plant():
    row = placed(2, 2)
    assert [item.plant for item in row.instances] == [0, 0, 1, 1, 2, 2, 3, 3]
    assert [item.parent for item in row.instances] == [-1, 0, -1, 2, -1, 4, -1, 6]
    # Two faces to a rectangle, in the plants' order.
    np.testing.assert_array_equal(row.face_instance, np.repeat(np.arange(8), 2))


def test_the_plants_given_are_left_alone():
    front, back = rows(2, 1)
    before = front[0].vertices.copy()
    double_row(front, back, spacing_m=SPACING, gap_m=GAP, shift_m=SHIFT)
    np.testing.assert_array_equal(front[0].vertices, before)
    assert {item.plant for item in front[0].instances} == {-1}


def test_a_row_without_plants_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        double_row([], [], spacing_m=SPACING, gap_m=GAP, shift_m=SHIFT)


# --- twine ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plant():
    return grow(load_cultivar("kaite"), np.random.default_rng(3))


@pytest.fixture(scope="module")
def leafy(plant):
    return mesh_plant(plant, 0.3)


def cord_of(mesh):
    """`(n, 3)` vertices of the last instance."""
    return mesh.vertices[np.unique(mesh.faces[mesh.face_instance == len(mesh.instances) - 1])]


def stem_of(plant):
    """Points of the stem's axis, `(n, 3)`, a millimetre or less apart, and the radius there, `(n,)`."""
    points, radii = [], []
    for organ in plant.of_form("internode"):
        length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(organ.curve, axis=0), axis=1))])
        along = np.linspace(0, length[-1], int(length[-1] * 1000) + 2)
        points.append(np.stack([np.interp(along, length, column) for column in organ.curve.T], axis=-1))
        ends = organ.measures["radius_m"], organ.measures["radius_tip_m"]
        radii.append(np.interp(along, [0, length[-1]], ends))
    return np.concatenate(points), np.concatenate(radii)


def test_the_twine_is_one_wire_behind_the_plants_own_organs(plant, leafy):
    tied = add_twine(plant, leafy, CORD, np.random.default_rng(0))
    assert tied.instances[:-1] == leafy.instances
    assert tied.instances[-1].organ_class == OrganClass.WIRE
    assert tied.instances[-1].kind == "twine"
    assert tied.surfaces == (*leafy.surfaces, "twine")
    assert set(tied.face_class[tied.face_instance == len(leafy.instances)]) == {OrganClass.WIRE}
    assert (tied.face_instance == len(leafy.instances)).sum() == len(tied.faces) - len(leafy.faces)
    np.testing.assert_array_equal(tied.vertices[: len(leafy.vertices)], leafy.vertices)


def test_the_twine_keeps_to_the_stem(plant, leafy):
    # The gap between the surfaces of cord and stem, in bands of 5 cm of height, a fifth of a turn. Off the
    # widest of a node's sides, or where the stem bends, it may sink in or stand off by a millimetre.
    cord = cord_of(add_twine(plant, leafy, CORD, np.random.default_rng(0)))
    axis, radius = stem_profile(plant)
    walked = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))])
    along = np.linspace(0, walked[-1], 4000)
    axis = np.stack([np.interp(along, walked, column) for column in axis.T], axis=-1)
    away, nearest = cKDTree(axis).query(cord)
    # How far from the outline, in the plane of height and distance from the axis; inside it counts below 0.
    radius = np.interp(along, walked, radius)
    near = np.clip(nearest[:, None] + np.arange(-12, 13), 0, len(along) - 1)
    gap = np.hypot(away[:, None] - radius[near], along[near] - along[nearest][:, None]).min(axis=1)
    gap *= np.sign(away - radius[nearest])
    top = axis[-1, 2]
    for low in np.arange(0.02, top - 0.07, 0.05):
        here = gap[(cord[:, 2] >= low) & (cord[:, 2] < low + 0.05)]
        assert abs(here.min()) < 1e-3
        # No hiding inside the stem, and no bridging of its kinks.
        assert 0.5 * CORD.diameter_m < here.max() < CORD.diameter_m + 1e-3


def test_the_twine_leads_on_straight_up(plant, leafy):
    cord = cord_of(add_twine(plant, leafy, CORD, np.random.default_rng(0)))
    top = stem_of(plant)[0][-1]
    above = cord[cord[:, 2] > top[2] + 0.1]
    assert cord[:, 2].max() > top[2] + 0.4
    assert np.linalg.norm(above[:, :2] - top[:2], axis=1).max() < CORD.diameter_m


@pytest.mark.parametrize("height", [4.5, 2.0])
def test_the_twine_is_tied_to_the_wire(plant, leafy, height):
    knot = np.array([0.03, -0.06, height])
    tied = add_twine(plant, leafy, CORD, np.random.default_rng(0), wire=knot)
    cord = cord_of(tied)
    axis, _ = stem_of(plant)
    end = cord[np.argmax(cord[:, 2])]
    np.testing.assert_allclose(end, knot, atol=CORD.diameter_m)
    # From the last turn it goes straight to the knot.
    last = axis[axis[:, 2] < height - 0.15][-1]
    free = cord[cord[:, 2] > last[2] + 0.06]
    share = (free[:, 2] - last[2]) / (height - last[2])
    straight = last[:2] + share[:, None] * (knot[:2] - last[:2])
    assert np.linalg.norm(free[:, :2] - straight, axis=1).max() < 1.5 * CORD.diameter_m
    # Lower down it is the twine of a plant without a wire.
    low = last[2] - 0.3
    loose = cord_of(add_twine(plant, leafy, CORD, np.random.default_rng(0)))
    gaps = cKDTree(loose[loose[:, 2] < low]).query(cord[cord[:, 2] < low - 0.1])[0]
    assert gaps.max() < 0.01


def test_a_wire_below_the_foot_is_refused(plant, leafy):
    with pytest.raises(ValueError, match="above the stem's foot"):
        add_twine(plant, leafy, CORD, np.random.default_rng(0), wire=(0.0, 0.0, 0.0))


def test_turned_plants_turn_about_their_own_axes():
    plants = all_of(2, 0)
    feet = np.array([[0.0, 0.0, 0.5], [1.0, 0.2, 0.5]])
    made = place_plants(plants, feet, np.array([np.pi, np.pi / 2]))
    first, second = plants
    np.testing.assert_allclose(made.vertices[:8], first.vertices * [-1, -1, 1] + feet[0], atol=1e-6)
    turned = np.stack([-second.vertices[:, 1], second.vertices[:, 0], second.vertices[:, 2]], axis=1)
    np.testing.assert_allclose(made.vertices[8:], turned + feet[1], atol=1e-6)


def test_the_same_generator_winds_the_same_twine_and_another_starts_elsewhere(plant, leafy):
    first, again, other = (
        cord_of(add_twine(plant, leafy, CORD, np.random.default_rng(seed))) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first[:9] - other[:9]).max() > 1e-3

"""Double rows are placed as in section 2.5 of Barth et al. 2018, and twines follow their stems."""

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
TWINE = Twine(diameter_m=0.003, turns_per_m=4.0)


def seedling(number):
    """Two organs, the second growing on the first; every seedling has another size."""
    stem = rectangle((0, 0, 1), (0.01 * (number + 1), 0, 0), (0, 0, 1), surface="stem")
    leaf = rectangle((0, 0, 2), (0.02 * (number + 1), 0, 0), (0, 0.1, 0), surface="leaf")
    mesh = concatenate_meshes([stem, leaf])
    instances = (Instance(OrganClass.STEM, "internode"), Instance(OrganClass.LEAF, "lamina", parent=0))
    return replace(mesh, instances=instances)


def seedlings(count):
    return [seedling(number) for number in range(count)]


def placed(front, back):
    plants = seedlings(front + back)
    return double_row(plants[:front], plants[front:], spacing_m=SPACING, gap_m=GAP, shift_m=SHIFT)


def offsets(row, plants):
    """`(n, 3)` translation of each plant, the same for all its vertices."""
    bounds = np.cumsum([0, *(len(plant.vertices) for plant in plants)])
    moves = []
    for plant, first, last in zip(plants, bounds[:-1], bounds[1:], strict=True):
        move = row.vertices[first:last] - plant.vertices
        np.testing.assert_allclose(move, np.broadcast_to(move[0], move.shape), atol=1e-6)
        moves.append(move[0])
    return np.array(moves)


@pytest.mark.parametrize(("front", "back"), [(7, 6), (1, 0), (2, 3), (4, 4)])
def test_rows_are_even_and_centred_on_the_front_rows_middle_plant(front, back):
    moves = offsets(placed(front, back), seedlings(front + back))
    # The middle plant, the fourth of seven, is the origin that the camera's path goes around.
    np.testing.assert_allclose(moves[front // 2], 0.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(moves[:front, 0]), SPACING, atol=1e-6)
    np.testing.assert_allclose(np.diff(moves[front:, 0]), SPACING, atol=1e-6)
    np.testing.assert_allclose(moves[:front, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(moves[front:, 1], GAP, atol=1e-6)
    np.testing.assert_allclose(moves[:, 2], 0.0, atol=1e-6)
    if back:
        np.testing.assert_allclose(moves[front + back // 2, 0], SHIFT, atol=1e-6)


def test_placing_changes_only_positions_and_instance_numbers():
    plants, row = seedlings(3), placed(2, 1)
    for name in ("normals", "uv", "state"):
        together = np.concatenate([getattr(plant, name) for plant in plants])
        np.testing.assert_array_equal(getattr(row, name), together)
    assert row.surfaces == ("stem", "leaf")
    np.testing.assert_array_equal(row.face_class, np.concatenate([plant.face_class for plant in plants]))
    np.testing.assert_array_equal(row.faces, np.concatenate([p.faces + 8 * n for n, p in enumerate(plants)]))
    assert [item.plant for item in row.instances] == [0, 0, 1, 1, 2, 2]
    assert [item.parent for item in row.instances] == [-1, 0, -1, 2, -1, 4]
    # Two faces to a rectangle, in the plants' order.
    np.testing.assert_array_equal(row.face_instance, np.repeat(np.arange(6), 2))


def test_plants_rotate_about_their_own_axes():
    first, second = seedlings(2)
    bases = np.array([[0.0, 0.0, 0.5], [1.0, 0.2, 0.5]])
    row = place_plants([first, second], bases, np.array([np.pi, np.pi / 2]))
    np.testing.assert_allclose(row.vertices[:8], first.vertices * [-1, -1, 1] + bases[0], atol=1e-6)
    rotated = np.stack([-second.vertices[:, 1], second.vertices[:, 0], second.vertices[:, 2]], axis=1)
    np.testing.assert_allclose(row.vertices[8:], rotated + bases[1], atol=1e-6)


@pytest.fixture(scope="module")
def plant():
    return grow(load_cultivar("kaite"), np.random.default_rng(3))


@pytest.fixture(scope="module")
def mesh(plant):
    return mesh_plant(plant, 0.3)


@pytest.fixture(scope="module")
def stem(plant):
    """Points of the stem's axis, `(n, 3)`, under a millimetre apart; distance along it, and radius."""
    axis, radius = stem_profile(plant)
    walked = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))])
    along = np.linspace(0, walked[-1], 4000)
    axis = np.stack([np.interp(along, walked, column) for column in axis.T], axis=-1)
    return axis, along, np.interp(along, walked, radius)


@pytest.fixture(scope="module")
def internode_points(plant):
    """`(n, 3)` points on the centrelines of the plant's own internodes, a millimetre or less apart."""
    points = []
    for curve in (organ.curve for organ in plant.of_form("internode")):
        walked = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
        along = np.linspace(0, walked[-1], int(walked[-1] * 1000) + 2)
        points.append(np.stack([np.interp(along, walked, column) for column in curve.T], axis=-1))
    return np.concatenate(points)


@pytest.fixture(scope="module")
def tied(plant, mesh):
    return add_twine(plant, mesh, TWINE, np.random.default_rng(0))


def twine_vertices(mesh):
    """`(n, 3)` vertices of the last instance."""
    return mesh.vertices[np.unique(mesh.faces[mesh.face_instance == len(mesh.instances) - 1])]


def test_twine_is_one_wire_instance_after_the_plants_organs(mesh, tied):
    assert tied.instances[:-1] == mesh.instances
    assert tied.instances[-1].organ_class == OrganClass.WIRE
    assert tied.instances[-1].kind == "twine"
    assert tied.surfaces == (*mesh.surfaces, "twine")
    assert set(tied.face_class[tied.face_instance == len(mesh.instances)]) == {OrganClass.WIRE}
    assert (tied.face_instance == len(mesh.instances)).sum() == len(tied.faces) - len(mesh.faces)
    np.testing.assert_array_equal(tied.vertices[: len(mesh.vertices)], mesh.vertices)


def test_twine_touches_the_stem(stem, tied):
    # The gap between the surfaces of twine and stem, in bands of 5 cm of height, a fifth of a turn. Beside
    # the widest side of a node, or where the stem bends, it may sink in or be off by a millimetre.
    twine, (axis, along, radius) = twine_vertices(tied), stem
    distance, nearest = cKDTree(axis).query(twine)
    # Distance from the outline, in the plane of height and distance from the axis; negative inside.
    near = np.clip(nearest[:, None] + np.arange(-12, 13), 0, len(along) - 1)
    gap = np.hypot(distance[:, None] - radius[near], along[near] - along[nearest][:, None]).min(axis=1)
    gap *= np.sign(distance - radius[nearest])
    for low in np.arange(0.02, axis[-1, 2] - 0.07, 0.05):
        band = gap[(twine[:, 2] >= low) & (twine[:, 2] < low + 0.05)]
        assert abs(band.min()) < 1e-3
        # It neither hides inside the stem nor bridges its bends.
        assert 0.5 * TWINE.diameter_m < band.max() < TWINE.diameter_m + 1e-3


def test_twine_continues_straight_up_above_the_stem(internode_points, tied):
    twine, top = twine_vertices(tied), internode_points[-1]
    above = twine[twine[:, 2] > top[2] + 0.1]
    assert twine[:, 2].max() > top[2] + 0.4
    assert np.linalg.norm(above[:, :2] - top[:2], axis=1).max() < TWINE.diameter_m


@pytest.mark.parametrize("height", [4.5, 2.0])
def test_twine_is_tied_to_the_wire(plant, mesh, internode_points, tied, height):
    knot = np.array([0.03, -0.06, height])
    twine = twine_vertices(add_twine(plant, mesh, TWINE, np.random.default_rng(0), wire=knot))
    np.testing.assert_allclose(twine[np.argmax(twine[:, 2])], knot, atol=TWINE.diameter_m)
    # From the last turn it goes straight to the knot.
    last = internode_points[internode_points[:, 2] < height - 0.15][-1]
    free = twine[twine[:, 2] > last[2] + 0.06]
    fraction = (free[:, 2] - last[2]) / (height - last[2])
    straight = last[:2] + fraction[:, None] * (knot[:2] - last[:2])
    assert np.linalg.norm(free[:, :2] - straight, axis=1).max() < 1.5 * TWINE.diameter_m
    # Lower down it is the twine of a plant without a wire.
    faces = tied.faces[tied.face_instance == len(tied.instances) - 1]
    low, loose = last[2] - 0.3, np.concatenate([twine_vertices(tied), tied.vertices[faces].mean(axis=1)])
    gaps = cKDTree(loose[loose[:, 2] < low]).query(twine[twine[:, 2] < low - 0.1])[0]
    assert gaps.max() < 0.01


def test_twine_depends_on_the_seed(plant, mesh, tied):
    again, other = (
        twine_vertices(add_twine(plant, mesh, TWINE, np.random.default_rng(seed))) for seed in (0, 2)
    )
    np.testing.assert_array_equal(twine_vertices(tied), again)
    assert np.abs(again[:9] - other[:9]).max() > 1e-3

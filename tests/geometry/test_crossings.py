"""Crossings of organs: counts and costs agree with those from all pairs of triangles and all poses."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from contact_meshes import grown

from pepperscene.geometry import Mesh
from pepperscene.geometry.contacts import leaves
from pepperscene.geometry.contacts.crossings import (
    ALL,
    CLEARANCE,
    FINE,
    ROUGH,
    CoarseTriangles,
    Resolution,
    coarse_triangles,
)
from pepperscene.geometry.contacts.detect import ContactDetector
from pepperscene.geometry.contacts.joints import MovingUnits, rotations
from pepperscene.geometry.contacts.leaf_crossings import LeafCrossings
from pepperscene.geometry.contacts.organs import LEAF, SHOOT, STALK, STEM, Organs


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return grown("kaite", 1)[1]


def corners_of(organs: Organs, chosen: np.ndarray, resolution: Resolution) -> dict[int, np.ndarray]:
    """`(f, 3, 3)` coarse triangles of each organ."""
    rows, corners, counts = coarse_triangles(organs, chosen, resolution)
    vertices, faces = (
        np.split(part, np.cumsum(count)[:-1]) for part, count in zip((rows, corners.T), counts, strict=True)
    )
    parts = zip(chosen.tolist(), vertices, faces, strict=True)
    return {organ: organs.mesh.vertices[own][part].astype(float) for organ, own, part in parts}


def cross(one: np.ndarray, two: np.ndarray, clearance: float) -> bool:
    """Whether an edge of either of two triangles passes through the other, moved along its normal or not."""
    for first, second in ((one, two), (two, one)):
        normal = np.cross(second[1] - second[0], second[2] - second[0])
        length = np.linalg.norm(normal)
        if length < 1e-12:
            continue
        normal /= length
        height = (first - second[0]) @ normal
        if height.min() >= clearance or height.max() <= -clearance:
            return False
    for first, second in ((one, two), (two, one)):
        normal = np.cross(second[1] - second[0], second[2] - second[0])
        square = normal @ normal
        if square < 1e-24:
            continue
        for k, level in product(range(3), (-clearance, 0.0, clearance)):
            start, end = first[k], first[k - 2]
            low, high = ((p - second[0]) @ normal / np.sqrt(square) - level for p in (start, end))
            if low == high or low * high > 0.0:
                continue
            hit = start + low / (low - high) * (end - start) - second[0]
            s = np.cross(hit, second[2] - second[0]) @ normal / square
            t = np.cross(second[1] - second[0], hit) @ normal / square
            if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
                return True
    return False


def count_all(one: np.ndarray, two: np.ndarray, clearance: float) -> int:
    low, high = two.min(axis=1) - clearance, two.max(axis=1) + clearance
    return sum(
        cross(a, b, clearance)
        for a in one
        for b in two[np.all((low <= a.max(axis=0)) & (high >= a.min(axis=0)), axis=1)]
    )


@pytest.mark.parametrize("is_shuffled", [False, True])
def test_coarse_triangles_are_on_vertices_of_their_organ(mesh: Mesh, is_shuffled: bool) -> None:
    """In any order of organs and of vertices; all triangles are those of the mesh."""
    if is_shuffled:
        order = np.random.default_rng(0).permutation(len(mesh.vertices))
        faces = np.argsort(order)[mesh.faces].astype(np.uint32)
        mesh = replace(mesh, vertices=mesh.vertices[order], uv=mesh.uv[order], faces=faces)
    organs = Organs(mesh)
    chosen = organs.of_class(LEAF, SHOOT, STALK, STEM)[::-4]
    whole, fine = (corners_of(organs, chosen, resolution) for resolution in (ALL, FINE))
    for organ in chosen.tolist():
        own = mesh.vertices[mesh.faces[mesh.face_instance == organ]]
        np.testing.assert_array_equal(whole[organ], own)
        if len(own) <= FINE.few:
            np.testing.assert_array_equal(fine[organ], own)
        else:
            assert 10 < len(fine[organ]) < 0.5 * len(own)
            assert set(map(tuple, fine[organ].reshape(-1, 3))) <= set(map(tuple, own.reshape(-1, 3)))
            # They reach from one end of the organ to the other.
            extents = (np.ptp(part.reshape(-1, 3), axis=0).max() for part in (fine[organ], own))
            assert next(extents) > 0.7 * next(extents)


@pytest.mark.parametrize(
    ("resolution", "clearance"),
    [(FINE, CLEARANCE), pytest.param(ROUGH, 2.5e-3, marks=pytest.mark.long)],
)
def test_counts_equal_those_of_all_pairs_of_triangles(
    mesh: Mesh, resolution: Resolution, clearance: float
) -> None:
    organs, rng = Organs(mesh), np.random.default_rng(0)
    chosen = organs.of_class(LEAF, SHOOT)
    triangles = CoarseTriangles(organs, chosen, resolution)
    row, column = organs.close_pairs(organs.of_class(LEAF), chosen, 0.0)
    one, two = organs.of_class(LEAF)[row], chosen[column]
    kept = rng.choice(np.flatnonzero(one != two), 45, replace=False)
    one, two = one[kept], two[kept]
    # Every blade rotates about its centre by up to 20 degrees.
    axis = rng.normal(size=(len(one), 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    rotation = rotations(axis, rng.uniform(0.0, np.radians(20.0), (len(one), 1)))[:, 0]
    centre = organs.box_centres(one)
    shift = centre - np.einsum("nij,nj->ni", rotation, centre)
    ours = triangles.count(one, rotation, shift, np.arange(len(one)), two, clearance)
    corners = corners_of(organs, chosen, resolution)
    expected = [
        count_all(corners[a] @ rotation[row].T + shift[row], corners[b], clearance)
        for row, (a, b) in enumerate(zip(one.tolist(), two.tolist(), strict=True))
    ]
    assert np.count_nonzero(expected) >= 3
    boxes = triangles.count(one, rotation, shift, np.arange(len(one)), two, clearance, by_boxes=True)
    assert np.all(boxes >= ours)
    assert boxes.sum() > 2 * ours.sum()
    # Single precision decides otherwise where an edge just meets the border of a triangle.
    assert np.all(np.abs(ours - expected) <= 1 + 0.02 * np.array(expected))
    assert np.mean(ours == expected) > 0.95


def test_cheapest_poses_are_those_of_an_exhaustive_search(mesh: Mesh) -> None:
    detector = ContactDetector(mesh)
    organs = detector.organs
    solver = leaves.LeafSolver(detector, MovingUnits(organs))
    solver.crossings.update(np.arange(len(organs)))
    solver._rough.update()
    units = solver._select_units(0)
    poses = solver._candidate_poses(units, 6, np.zeros(len(organs)))
    cost = solver._crossing_cost(poses, 0)

    # All poses with all organs.
    full = leaves._PoseCosts(poses, *solver._near_poses(poses))
    full.examine(np.arange(len(full.other)), solver._early)
    better = full.cost[:, 1:].min(axis=1) < cost[:, 0] - leaves._MIN_GAIN
    assert better.sum() > 5
    assert not better.all()
    np.testing.assert_allclose(cost[better, 1:].min(axis=1), full.cost[better, 1:].min(axis=1))
    assert np.array_equal(cost[better, 1:].argmin(axis=1), full.cost[better, 1:].argmin(axis=1))
    assert np.all(cost[~better, 1:].min(axis=1) >= cost[~better, 0] - leaves._MIN_GAIN)
    # Some poses need no examination.
    assert np.isinf(cost).sum() > 0.1 * cost.size


def test_pairs_after_a_move_are_those_of_the_moved_mesh(mesh: Mesh) -> None:
    organs = Organs(mesh)
    crossings = LeafCrossings(organs)
    crossings.update(np.arange(len(organs)))
    chosen = organs.of_class(LEAF)[::3]
    shift = np.random.default_rng(0).uniform(-0.03, 0.03, (len(chosen), 3))
    organs.move(chosen, np.tile(np.eye(3), (len(chosen), 1, 1)), shift)
    crossings.update(chosen)
    again = LeafCrossings(Organs(organs.current_mesh()))
    again.update(np.arange(len(organs)))
    found, expected = (set(map(tuple, each.pairs.tolist())) for each in (crossings, again))
    assert len(expected) > 10
    # Single precision decides otherwise where organs just touch.
    assert len(found ^ expected) <= 1

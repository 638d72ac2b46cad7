"""Crossings of organs: counts and costs agree with those from all pairs of triangles and all poses."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from contact_meshes import grown

from pepperscene.geometry import Mesh, resolve_contacts
from pepperscene.geometry.contacts import leaves
from pepperscene.geometry.contacts.coarse import FINE, ROUGH, Resolution
from pepperscene.geometry.contacts.crossings import (
    CLEARANCE,
    CoarseTriangles,
    coarse_triangles,
    coarse_triangles_by_form,
)
from pepperscene.geometry.contacts.detect import ContactDetector
from pepperscene.geometry.contacts.joints import rotations, units_of
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


@pytest.mark.parametrize("resolution", [FINE, ROUGH])
@pytest.mark.parametrize("cultivar", ["kaite", "tomato"])
@pytest.mark.parametrize("step", [1, 3, -1, 10**6])
def test_coarse_triangles_of_a_form_equal_those_of_each_organ(
    cultivar: str, resolution: Resolution, step: int
) -> None:
    """In any order, for few organs and for many, with organs that keep all their triangles between others."""
    organs = Organs(grown(cultivar, 1)[1])
    assert organs.is_contiguous
    chosen = organs.of_class(LEAF, SHOOT, STALK, STEM)[::step]
    expected, found = (
        choose(organs, chosen, resolution) for choose in (coarse_triangles, coarse_triangles_by_form)
    )
    for one, two in zip((*expected[:2], *expected[2]), (*found[:2], *found[2]), strict=True):
        np.testing.assert_array_equal(two, one)
        assert two.dtype == one.dtype


@pytest.mark.parametrize(("resolution", "clearance"), [(FINE, CLEARANCE), (ROUGH, 2.5e-3)])
def test_counts_equal_those_of_all_pairs_of_triangles(
    mesh: Mesh, resolution: Resolution, clearance: float
) -> None:
    organs, rng = Organs(mesh), np.random.default_rng(0)
    chosen = organs.of_class(LEAF, SHOOT)
    triangles = CoarseTriangles(organs, chosen, resolution)
    row, column = organs.close_pairs(organs.of_class(LEAF), chosen, 0.0)
    one, two = organs.of_class(LEAF)[row], chosen[column]
    kept = rng.choice(np.flatnonzero(one != two), 60, replace=False)
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
    assert np.count_nonzero(expected) > 8
    # Single precision decides otherwise where an edge just meets the border of a triangle.
    assert np.all(np.abs(ours - expected) <= 1 + 0.02 * np.array(expected))
    assert np.mean(ours == expected) > 0.95


def test_cheapest_poses_are_those_of_an_exhaustive_search(mesh: Mesh) -> None:
    detector = ContactDetector(mesh)
    organs = detector.organs
    solver = leaves.LeafSolver(
        detector, np.zeros((len(organs), 2)), lambda *_: None, lambda organ: units_of(organs, organ)
    )
    solver._detect(np.arange(len(organs)))
    units = solver._select_units(0)
    poses = solver._candidate_poses(units, 12, np.zeros(len(organs)))
    cost = solver._crossing_cost(poses, 0)

    # All poses with all organs.
    inside = np.zeros((len(units), len(organs)), dtype=bool)
    inside[poses.owner, poses.members] = True
    entry, other = solver._near_poses(poses, inside)
    judge = solver._early
    number = judge.triangles.count(
        poses.members[entry // poses.count],
        poses.rotation[entry],
        poses.shift[entry],
        np.arange(len(entry)),
        other,
        judge.clearance,
    )
    effort = leaves._PER_DEGREE * leaves.weighted_effort(
        poses.angles, np.array([unit.weights for unit in units])[:, None]
    )
    full = effort.copy()
    each = np.where(number > 0, 1.0 + judge.per_crossing * number, 0.0)
    np.add.at(full, (poses.owner[entry // poses.count], entry % poses.count), each)
    better = full[:, 1:].min(axis=1) < cost[:, 0] - leaves._MIN_GAIN
    assert better.sum() > 5
    assert not better.all()
    np.testing.assert_allclose(cost[better, 1:].min(axis=1), full[better, 1:].min(axis=1))
    assert np.array_equal(cost[better, 1:].argmin(axis=1), full[better, 1:].argmin(axis=1))
    assert np.all(cost[~better, 1:].min(axis=1) >= cost[~better, 0] - leaves._MIN_GAIN)
    # Some poses need no examination.
    assert np.isinf(cost).sum() > 0.1 * cost.size


def test_few_organs_of_a_resolved_plant_cross(mesh: Mesh) -> None:
    def pairs(mesh: Mesh) -> int:
        detector = ContactDetector(mesh)
        angles = np.zeros((len(mesh.instances), 2))
        solver = leaves.LeafSolver(detector, angles, lambda *_: None, lambda _: [])
        solver._detect(np.arange(len(mesh.instances)))
        return len(solver._pairs)

    before = pairs(mesh)
    assert before >= 10
    assert pairs(resolve_contacts(mesh, np.random.default_rng(0)).mesh) <= 0.1 * before + 1

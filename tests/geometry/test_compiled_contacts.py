"""Compiled functions give the bits of those without Numba, which are their reference."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import Mesh, compilation, mesh_plant, resolve_contacts
from pepperscene.geometry.contacts import crossing_arrays
from pepperscene.geometry.contacts.coarse import ALL, FINE, ROUGH, Resolution
from pepperscene.geometry.contacts.crossings import CLEARANCE, CoarseTriangles
from pepperscene.geometry.contacts.detect import ContactDetector, ContactPairs
from pepperscene.geometry.contacts.joints import rotations
from pepperscene.geometry.contacts.organs import LEAF, SHOOT, STALK, STEM
from pepperscene.grammar import grow
from pepperscene.scene import double_row

pytest.importorskip("numba")


@cache
def row() -> Mesh:
    """Two plants so close to each other that many of their organs touch."""
    cultivar = load_cultivar("kaite")
    meshes = [mesh_plant(grow(cultivar, np.random.default_rng(seed)), 0.5) for seed in (1, 2)]
    return double_row(meshes, [], spacing_m=0.1, gap_m=1.0, shift_m=0.0)


def detected() -> tuple[ContactPairs, ContactPairs]:
    detector = ContactDetector(row())
    return detector.fruit_pairs(), detector.blade_pairs()


def test_depths_in_fruit_and_stems_are_equal(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = detected()
    monkeypatch.setattr(compilation, "AVAILABLE", False)
    for ours, reference in zip(compiled, detected(), strict=True):
        np.testing.assert_array_equal(ours.other, reference.other)
        np.testing.assert_array_equal(ours.depth, reference.depth)
        assert np.count_nonzero(ours.depth > 0.0) > 5


@pytest.mark.parametrize("resolution", [FINE, ROUGH, ALL], ids=["fine", "rough", "all"])
@pytest.mark.parametrize("by_boxes", [False, True])
@pytest.mark.parametrize("clearance", [0.0, CLEARANCE])
def test_counts_of_crossing_triangles_are_equal(
    resolution: Resolution, by_boxes: bool, clearance: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    detector = ContactDetector(row())
    organs, rng = detector.organs, np.random.default_rng(0)
    leaves, others = organs.of_class(LEAF, SHOOT), organs.of_class(LEAF, SHOOT, STALK, STEM)
    triangles = CoarseTriangles(organs, np.union1d(leaves, others), resolution)
    # Every leaf and shoot in three poses.
    organ = np.repeat(leaves, 3)
    axis = rng.normal(size=(len(organ), 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    rotation = rotations(axis, rng.uniform(0.0, 0.3, (len(organ), 1)))[:, 0]
    centre = organs.box_centres(organ)
    shift = centre - np.einsum("nij,nj->ni", rotation, centre)
    entry, column = organs.close_pairs(organ, others, 0.0)
    kept = organ[entry] != others[column]
    arguments = organ, rotation, shift, entry[kept], others[column[kept]], clearance
    ours = triangles.count(*arguments, by_boxes=by_boxes)
    monkeypatch.setattr(compilation, "AVAILABLE", False)
    monkeypatch.setattr(crossing_arrays, "_BLOCK", 5_000)
    np.testing.assert_array_equal(ours, triangles.count(*arguments, by_boxes=by_boxes))
    assert np.count_nonzero(ours) > 50


def test_resolved_rows_are_equal(monkeypatch: pytest.MonkeyPatch) -> None:
    def resolve() -> bytes:
        return resolve_contacts(row(), np.random.default_rng(3), rounds=3).mesh.vertices.tobytes()

    compiled = resolve()
    monkeypatch.setattr(compilation, "AVAILABLE", False)
    assert resolve() == compiled
    assert compiled != row().vertices.tobytes()

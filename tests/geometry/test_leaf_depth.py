"""Leaves that are deep in others, and those that are left out for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_meshes import scene, shifted

from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh, rectangle, resolve_contacts, sphere
from pepperscene.geometry.contacts.leaf_crossings import deep_pairs, superfluous_leaves
from pepperscene.geometry.contacts.leaves import LeafSolver
from pepperscene.geometry.contacts.organs import Organs

NODE, STALK, BLADE = OrganClass.STEM, OrganClass.SHOOT, OrganClass.LEAF


def sheet(width: float, x: float = 0.0, upright: bool = False) -> Mesh:
    across = [0.0, 0.0, width] if upright else [0.0, width, 0.0]
    return rectangle([x, 0.0, 1.0], [width, 0.0, 0.0], across)


def leaves(*blades: Mesh) -> Mesh:
    """A node, and one leaf stalk for each blade: instances 1, 3, 5 and 2, 4, 6."""
    parts = [(sphere([0.0, 0.0, 0.5], 0.01), NODE, "node", -1)]
    for number, blade in enumerate(blades):
        stalk = sphere([0.3 + number, 0.0, 0.5], 0.003)
        parts += [(stalk, STALK, "petiole", 0), (blade, BLADE, "lamina", 2 * number + 1)]
    return scene(*parts)


@pytest.mark.parametrize(("overlap", "is_deep"), [(0.001, False), (0.01, True)])
def test_depth_is_the_shortest_way_out(overlap: float, is_deep: bool) -> None:
    """An upright sheet that overlaps a level one at its edge: the way out is as long as the overlap."""
    mesh = leaves(sheet(0.1), shifted(sheet(0.1, upright=True), 0.1 - overlap))
    pairs = np.array([[2, 4]])
    assert len(deep_pairs(Organs(mesh), pairs)) == is_deep


def test_the_leaf_that_is_deep_in_most_others_goes_with_its_stalk() -> None:
    organs = Organs(leaves(sheet(0.1), sheet(0.12), sheet(0.08)))
    assert superfluous_leaves(organs, np.array([[2, 4], [4, 6]])).tolist() == [3, 4]
    assert superfluous_leaves(organs, np.empty((0, 2), dtype=np.intp)).tolist() == []


def test_of_two_leaves_the_smaller_one_goes() -> None:
    organs = Organs(leaves(sheet(0.1), sheet(0.12)))
    assert superfluous_leaves(organs, np.array([[2, 4]])).tolist() == [1, 2]


def test_stems_and_stalks_of_several_leaves_stay() -> None:
    mesh = leaves(sheet(0.1), sheet(0.12))
    shared = replace(mesh.instances[4], parent=1)
    mesh = replace(mesh, instances=(*mesh.instances[:4], shared))
    organs = Organs(mesh)
    assert superfluous_leaves(organs, np.array([[0, 2]])).tolist() == [2]
    assert superfluous_leaves(organs, np.array([[0, 1]])).tolist() == []


def test_organs_without_triangles_keep_their_numbers() -> None:
    mesh = leaves(sheet(0.1), sheet(0.12))
    part = mesh.without_triangles(np.array([1, 2]))
    assert part.instances == mesh.instances
    assert np.unique(part.face_instance).tolist() == [0, 3, 4]
    for organ in (0, 3, 4):
        before, after = (each.vertices[each.faces[each.face_instance == organ]] for each in (mesh, part))
        np.testing.assert_array_equal(before, after)
    assert np.array_equal(np.unique(part.faces), np.arange(len(part.vertices)))


def test_only_rows_lose_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two crossed sheets that nothing moves: a plant alone keeps both, a row loses the smaller one."""
    monkeypatch.setattr(LeafSolver, "_run_pass", lambda *_: np.empty(0, dtype=np.intp))
    alone = leaves(sheet(0.2), sheet(0.1, upright=True))
    owners = tuple(replace(item, plant=int(number > 2)) for number, item in enumerate(alone.instances))
    row = replace(alone, instances=owners)
    result, kept = (
        resolve_contacts(mesh, np.random.default_rng(0), between_plants=mesh is row) for mesh in (row, alone)
    )
    assert (result.left_out, kept.left_out) == ((3, 4), ())
    assert np.unique(result.mesh.face_instance).tolist() == [0, 1, 2]
    assert result.mesh.instances == row.instances
    assert (result.contacts.blades, kept.contacts.blades) == (1, 2)

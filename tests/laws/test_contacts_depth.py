"""Leaves of a settled row touch few others, and none by more than 3 mm, according to FCL.

Bodies and penetration depth are those of `test_contacts_fcl`. Blades are tested against blades and against
leaf stalks that they do not grow on, leaf stalks against stems other than the one that they grow on.
"""

from __future__ import annotations

import numpy as np
import pytest
from test_contacts_fcl import Pairs, leaf_pairs, manager, of_class, separates, unresolved

from pepperscene.classes import OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import Mesh, resolve_contacts
from pepperscene.scene import double_row

DEPTH_M = 3e-3


def settled_row(name: str) -> Mesh:
    """Four plants in a double row, 20 cm from plant to plant and from row to row; few leaves are left out."""
    plants = [
        resolve_contacts(
            unresolved(load_cultivar(name), seed), np.random.default_rng(seed), free_leaves=False
        ).mesh
        for seed in range(4)
    ]
    row = double_row(plants[:2], plants[2:], spacing_m=0.2, gap_m=0.2, shift_m=0.1)
    result = resolve_contacts(row, np.random.default_rng(0), between_plants=True)
    blades = len(of_class(row, OrganClass.LEAF))
    left_out = [index for index in result.left_out if row.instances[index].organ_class == OrganClass.LEAF]
    assert len(left_out) < 0.01 * blades
    assert not np.isin(result.mesh.face_instance, result.left_out).any()
    return result.mesh


def stalks_through_stems(mesh: Mesh) -> Pairs:
    """(leaf stalk, stem) whose triangles intersect, without the nodes and internodes next to its own."""
    stems = of_class(mesh, OrganClass.STEM)
    _, names = manager(mesh, of_class(mesh, OrganClass.SHOOT)).in_collision_other(
        manager(mesh, stems), return_names=True
    )
    pairs = {(int(a), int(b)) for a, b in names}
    return {(a, b) for a, b in pairs if not grows_beside(mesh, a, b)}


def grows_beside(mesh: Mesh, stalk: int, stem: int) -> bool:
    """Whether a stalk grows on a part of a stem, or on the part above or below."""
    near = {index for index in (stem, mesh.instances[stem].parent) if index >= 0}
    near |= {index for index, item in enumerate(mesh.instances) if item.parent == stem}
    return bool(near & {stalk, mesh.instances[stalk].parent})


LONG = [pytest.param(name, marks=pytest.mark.long) for name in ("red_blocky", "kaite_old", "orange_pointed")]


@pytest.mark.parametrize("name", ["kaite", *LONG])
def test_no_leaf_of_a_row_is_deep_in_another(name: str) -> None:
    mesh = settled_row(name)
    with_blades, with_stalks = leaf_pairs(mesh)
    touching = {blade for pair in with_blades for blade in pair}
    assert len(touching) < 0.05 * len(of_class(mesh, OrganClass.LEAF))
    pairs = with_blades | with_stalks | stalks_through_stems(mesh)
    assert [pair for pair in sorted(pairs) if not separates(mesh, *pair, DEPTH_M)] == []

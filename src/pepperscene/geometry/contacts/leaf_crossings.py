"""Penetration depth of leaves by all their triangles, and leaves to leave out where nothing frees them."""

from __future__ import annotations

from typing import Final

import numpy as np

from pepperscene.geometry.contacts.crossings import ALL, CoarseTriangles
from pepperscene.geometry.contacts.organs import LEAF, SHOOT, Organs
from pepperscene.geometry.mesh import FloatArray, IndexArray

_DEPTH: Final = 2.0e-3
"""Metres, chosen: hardly visible between leaves; well below 3 mm, as the directions tried are few."""

_DIRECTIONS: Final = 60  # chosen: 20 degrees apart
_BATCH: Final = 6  # directions tried at a time, chosen: most pairs are separated by one of the first


def deep_pairs(organs: Organs, pairs: IndexArray) -> IndexArray:
    """Those of `(p, 2)` pairs of touching organs that no short translation separates.

    The penetration depth is the length of the shortest translation that separates two bodies (Cameron &
    Culley 1986), here the shortest in some directions.
    """
    left = np.arange(len(pairs))
    directions = _sphere_points(_DIRECTIONS)
    triangles = CoarseTriangles(organs, np.unique(pairs), ALL)
    # Neighbouring directions in different batches.
    for start in range(_DIRECTIONS // _BATCH):
        if not len(left):
            break
        some = directions[start :: _DIRECTIONS // _BATCH]
        organ, other = np.repeat(pairs[left], len(some), axis=0).T
        shift = _DEPTH * np.tile(some, (len(left), 1))
        still = np.broadcast_to(np.eye(3), (len(organ), 3, 3))
        number = triangles.count(organ, still, shift, np.arange(len(organ)), other, 0.0)
        left = left[np.all(number.reshape(len(left), -1) > 0, axis=1)]
    return pairs[left]


def superfluous_leaves(organs: Organs, pairs: IndexArray) -> IndexArray:
    """Organs of so few leaves that without them none of the pairs `(p, 2)` of organs is left.

    Of a pair the leaf goes that is deep in more others, or else the smaller one; it goes with its stalk.
    Stems, and stalks that bear several leaves, stay.
    """
    leaves = {organ: _leaf_of(organs, organ) for organ in np.unique(pairs).tolist()}
    gone: set[int] = set()
    while True:
        open_pairs = [pair for pair in pairs.tolist() if gone.isdisjoint(pair)]
        partners = np.bincount(np.array(open_pairs, dtype=np.intp).ravel(), minlength=len(organs))
        removable = [organ for organ in {organ for pair in open_pairs for organ in pair} if leaves[organ]]
        if not removable:
            return np.array(sorted(gone), dtype=np.intp)
        gone |= leaves[max(removable, key=lambda organ: (partners[organ], -organs.extent(organ), organ))]


def _leaf_of(organs: Organs, organ: int) -> set[int]:
    """A blade with its stalk, or a stalk with its blade; empty if that is not one leaf."""
    chain = [organ, *organs.ancestors(organ)]
    result: set[int] = set()
    for root in chain:
        if organs.organ_class[root] not in (LEAF, SHOOT):
            break
        members = np.array(organs.subtree(root))
        kinds = organs.organ_class[members]
        if np.count_nonzero(kinds == LEAF) > 1 or not np.isin(kinds, [LEAF, SHOOT]).all():
            break
        result = set(members.tolist())
    return result


def _sphere_points(count: int) -> FloatArray:
    """`(count, 3)` unit vectors evenly over the sphere (Fibonacci lattice)."""
    number = np.arange(count) + 0.5
    height, angle = 1.0 - 2.0 * number / count, np.pi * (1.0 + np.sqrt(5.0)) * number
    out = np.sqrt(1.0 - height**2)
    return np.stack([out * np.cos(angle), out * np.sin(angle), height], axis=1)

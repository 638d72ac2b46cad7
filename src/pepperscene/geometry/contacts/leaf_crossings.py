"""Leaves that pass through other organs: which, how deep, and which to leave out where nothing frees them."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.crossings import ALL, CLEARANCE, CoarseTriangles
from pepperscene.geometry.contacts.organs import LEAF, SHOOT, STALK, STEM, Organs
from pepperscene.geometry.mesh import FloatArray, IndexArray

PER_CROSSING: Final = 0.06  # cost of a pair of fine triangles that cross, chosen; 1 more for the organs
_NEAR: Final = 1e-3  # m, chosen: all triangles are compared where boxes of fine ones are closer than this
_DEPTH: Final = 2.0e-3
"""Metres, chosen: hardly visible between leaves; well below 3 mm, as the directions tried are few."""

_DIRECTIONS: Final = 60  # chosen: 20 degrees apart
_BATCH: Final = 6  # directions tried at a time, chosen: most pairs are separated by one of the first


class LeafCrossings:
    """Pairs of a leaf or shoot and another organ that it passes through.

    Attributes:
        leafy: `(n,)` whether an organ is a blade, or a stalk that bears blades.
        examined: `(m,)` these, and the stalks and stems that they may cross.
        fine: triangles that decide which organs cross.
        pairs: `(p, 2)` organs, the lower index first.
        costs: `(p,)` of each pair.
    """

    def __init__(self, organs: Organs) -> None:
        self._organs = organs
        self.leafy = np.isin(organs.organ_class, [LEAF, SHOOT])
        self.examined = organs.of_class(LEAF, SHOOT, STALK, STEM)
        self.fine = CoarseTriangles(organs, self.examined)
        self.pairs = np.empty((0, 2), dtype=np.intp)
        self.costs = np.empty(0)

    def update(self, moved: IndexArray, *, exact: bool = False) -> None:
        """Update the pairs after some organs have moved; exactly by all triangles of the mesh."""
        organs = self._organs
        self.fine.update()
        changed = np.zeros(len(organs), dtype=bool)
        changed[moved] = True
        # Moved leaves with all organs; the other pairs have not changed, as nothing else moves.
        leaves = self.examined[self.leafy[self.examined]]
        leaves = leaves[changed[leaves]]
        row, column = organs.close_pairs(leaves, self.examined, CLEARANCE)
        one, two = leaves[row], self.examined[column]
        kept = must_not_cross(organs, one, two)
        one, two = one[kept], two[kept]
        # Each pair once, by the organ that comes first.
        key = np.unique(np.minimum(one, two) * len(organs) + np.maximum(one, two))
        one, two = key // len(organs), key % len(organs)
        if exact:
            # Only where fine triangles are close.
            near = np.flatnonzero(self.fine.count_at_rest(one, two, _NEAR, by_boxes=True))
            one, two = one[near], two[near]
            triangles = CoarseTriangles(organs, np.union1d(one, two), ALL)
            number = triangles.count_at_rest(one, two, 0.0)
        else:
            number = self.fine.count_at_rest(one, two, CLEARANCE)
        crosses = number > 0
        unchanged = ~changed[self.pairs].any(axis=1)
        self.pairs = np.concatenate([self.pairs[unchanged], np.stack([one, two], axis=1)[crosses]])
        self.costs = np.concatenate([self.costs[unchanged], pair_cost(number[crosses], PER_CROSSING)])

    def of_units(self, inside: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """`(u,)` costs of what units of organs `(u, n)` cross now, and `(u, n)` these organs."""
        cost, crossed = np.zeros(len(inside)), np.zeros_like(inside)
        for one, two in (self.pairs.T, self.pairs.T[::-1]):
            unit, pair = np.nonzero(inside[:, one] & ~inside[:, two])
            np.add.at(cost, unit, self.costs[pair])
            crossed[unit, two[pair]] = True
        return cost, crossed


def pair_cost(number: IndexArray, each: float) -> FloatArray:
    """`(n,)` costs of pairs of organs of which so many triangles cross."""
    return np.asarray(np.where(number > 0, 1.0 + each * number, 0.0))


def must_not_cross(organs: Organs, one: IndexArray, two: IndexArray) -> NDArray[np.bool_]:
    """`(n,)` whether two organs of different units are a blade and any other, or a leaf stalk and a stem.

    Organs that grow on one another are joined, and stalks that grow on the same organ may touch at their
    feet.
    """
    kind, parent = organs.organ_class, organs.parent
    kept = (one != two) & (parent[one] != two) & (parent[two] != one)
    blade = (kind[one] == LEAF) | (kind[two] == LEAF)
    siblings = (parent[one] == parent[two]) & (parent[one] >= 0)
    return np.asarray(kept & (blade | (~siblings & (kind[one] != STALK) & (kind[two] != STALK))))


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

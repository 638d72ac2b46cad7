"""Which organs run into which: fruit into anything, blades into stems and cords."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.fruit import Walls
from pepperscene.geometry.contacts.organs import CORD, FRUIT, LEAF, STALK, STEM, Indices, Organs
from pepperscene.geometry.contacts.stems import Chains, deepest
from pepperscene.geometry.mesh import Mesh

NEAR: Final = 3e-3
"""Metres; what is farther off a fruit than this is not looked at."""


@dataclass(frozen=True)
class ContactCounts:
    """How many organs of a mesh run into others.

    Attributes:
        fruit: how many fruits there are.
        fruit_touching: those that run into any organ but their own calyx and stalk.
        blades: how many leaf blades there are.
        blades_touching: those that run through a stem section, a node or a cord.
    """

    fruit: int
    fruit_touching: int
    blades: int
    blades_touching: int


@dataclass(frozen=True)
class Near:
    """What comes close to an organ.

    Attributes:
        others: `(n,)` the organs whose boxes do.
        depth: `(n,)` metres that one reaches into the other; negative apart, minus infinity far apart.
    """

    others: Indices
    depth: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Organs whose boxes meet, ascending, and how far one reaches into the other."""

    organ: Indices
    other: Indices
    depth: NDArray[np.float32]


class ContactBodies:
    """Organs with what tells whether they touch: the walls of fruit, the capsules of stems.

    Args:
        mesh: one plant or several.
        between_plants: look only at what touches organs of other plants.
    """

    def __init__(self, mesh: Mesh, *, between_plants: bool = False) -> None:
        self.organs = Organs(mesh)
        self.between_plants = between_plants
        self.fruit = self.organs.of_class(FRUIT)
        self.blades = self.organs.of_class(LEAF)
        self.is_stem = np.isin(self.organs.organ_class, [STEM, CORD])
        self.walls = Walls(self.organs, self.fruit)
        self.chains = Chains(self.organs)
        nothing = np.empty(0, dtype=np.intp)
        self._known = dict.fromkeys((FRUIT, LEAF), _Pairs(nothing, nothing, np.empty(0, dtype=np.float32)))
        self._as_of = dict.fromkeys((FRUIT, LEAF), -1)

    def own(self, organ: int) -> frozenset[int]:
        """What an organ may touch: a fruit its calyx and the stalks that carry it, any other its parent."""
        everything = np.arange(len(self.organs))
        return frozenset(np.flatnonzero(self.are_own(np.full(len(everything), organ), everything)).tolist())

    def are_own(self, organs: Indices, others: Indices) -> NDArray[np.bool_]:
        """`(n,)` whether organs may touch others, as `own` tells."""
        organ_class, parent = self.organs.organ_class, self.organs.parent
        above = parent[organs]
        own = (organs == others) | ((above == others) & (organ_class[organs] != FRUIT))
        # Up the stalk of each fruit.
        left = np.flatnonzero(organ_class[organs] == FRUIT)
        above = above[left]
        while len(left):
            kept = (above >= 0) & (organ_class[above] == STALK)
            left, above = left[kept], above[kept]
            own[left] |= above == others[left]
            above = parent[above]
        return np.asarray(own)

    def into_fruit(self, fruit: list[int]) -> dict[int, Near]:
        """What comes close to some fruit, and how far it reaches in; nothing for those that stand free."""
        return self._measured(FRUIT, fruit)

    def into_stems(self, blades: list[int]) -> dict[int, Near]:
        """The stems and cords that come close to some blades, and how far these reach in."""
        return self._measured(LEAF, blades)

    def depths(self, organs: Indices, others: Indices) -> NDArray[np.float32]:
        """`(n,)` metres that organs reach into fruit, or blades into stems; negative apart.

        Args:
            organs: `(n,)` fruit and blades.
            others: `(n,)` the organ that each fruit meets, the stem that each blade meets.
        """
        found = np.empty(len(organs), dtype=np.float32)
        is_fruit = self.organs.organ_class[organs] == FRUIT
        found[is_fruit] = self._into_fruit(organs[is_fruit], others[is_fruit])
        found[~is_fruit] = self._into_stems(organs[~is_fruit], others[~is_fruit])
        return found

    def _measured(self, kind: int, wanted: list[int]) -> dict[int, Near]:
        """What is known of organs' neighbours, measured anew only where one of two has turned since."""
        organs = self.organs
        turned = organs.stamp > self._as_of[kind]
        rows, columns = (self.fruit, organs.solid) if kind == FRUIT else (self.blades, self.is_stem)
        columns = np.flatnonzero(columns & organs.solid)
        # What has turned with all else, and what has not with what has.
        found = [self._meeting(rows[turned[rows]], columns)]
        found.append(self._meeting(rows[~turned[rows]], columns[turned[columns]]))
        organ, other = (np.concatenate(some) for some in zip(*found, strict=True))
        depth = (self._into_fruit if kind == FRUIT else self._into_stems)(organ, other)
        known = self._known[kind]
        kept = ~turned[known.organ] & ~turned[known.other]
        organ = np.concatenate([known.organ[kept], organ])
        other = np.concatenate([known.other[kept], other])
        depth = np.concatenate([known.depth[kept], depth])
        order = np.lexsort([other, organ])
        self._known[kind] = known = _Pairs(organ[order], other[order], depth[order])
        self._as_of[kind] = organs.turns
        first = np.flatnonzero(np.diff(known.organ, prepend=-1))
        ends = [*first.tolist(), len(known.organ)]
        near = {
            one: Near(known.other[start:stop], known.depth[start:stop])
            for one, (start, stop) in zip(known.organ[first].tolist(), pairwise(ends), strict=True)
        }
        return near if len(wanted) == len(rows) else {one: near[one] for one in wanted if one in near}

    def _meeting(self, organ: Indices, other: Indices) -> tuple[Indices, Indices]:
        """Pairs of organs whose boxes meet, without what is its own."""
        organs = self.organs
        row, column = organs.meeting(organ, other, NEAR)
        one, two = organ[row], other[column]
        kept = one != two
        if self.between_plants:
            kept &= organs.plant[one] != organs.plant[two]
        one, two = one[kept], two[kept]
        own = self.are_own(one, two)
        return one[~own], two[~own]

    def _into_fruit(self, fruit: Indices, other: Indices) -> NDArray[np.float32]:
        """`(n,)` how deep each organ reaches into a fruit."""
        found = np.full(len(fruit), -np.inf, dtype=np.float32)
        if not len(fruit):
            return found
        # No point is laid on what stays off the ball around the fruit.
        which, place = np.unique(fruit, return_inverse=True)
        balls, far = self.walls.bodies(which.tolist()), NEAR
        low, high = self.organs.low[other], self.organs.high[other]
        centre, reach = balls.centre[place], balls.reach[place] + far
        off = centre - np.clip(centre, low, high)
        pair = np.flatnonzero(np.einsum("ni,ni->n", off, off) < reach**2)
        laid, patch, entry = self.organs.patches(other[pair].tolist())
        pair = pair[entry]
        off = laid.centre[patch] - centre[pair]
        kept = np.flatnonzero(np.einsum("ni,ni->n", off, off) < np.square(reach[pair] + laid.radius[patch]))
        pair, patch = pair[kept], patch[kept]
        matrix = balls.turned.transpose(0, 2, 1)
        offset = -np.einsum("fij,fj->fi", matrix, balls.centre)
        body = place[pair]
        depth = self.walls.depth(
            balls.row[body],
            laid.coordinates(patch),
            matrix.transpose(1, 2, 0).astype(np.float32)[:, :, body],
            offset.T.astype(np.float32)[:, body],
            reach[pair].astype(np.float32),
        )
        np.maximum.at(found, pair, depth)
        return found

    def _into_stems(self, blade: Indices, stem: Indices) -> NDArray[np.float32]:
        """`(n,)` how deep each blade reaches into a stem or cord."""
        found = np.full(len(blade), -np.inf, dtype=np.float32)
        if not len(blade):
            return found
        chain, piece, pair = self.chains.pieces(stem)
        low, high = self.organs.low[blade] - NEAR, self.organs.high[blade] + NEAR
        kept = np.flatnonzero(
            np.all((chain.low[piece] < high[pair]) & (chain.high[piece] > low[pair]), axis=1)
        )
        piece, pair = piece[kept], pair[kept]
        laid, patch, entry = self.organs.patches(blade[pair].tolist())
        piece, pair = piece[entry], pair[entry]
        near = deepest(laid.centre[patch].T[:, None], chain, piece) + laid.radius[patch] > -NEAR
        hit = np.flatnonzero(near)
        depth = deepest(laid.coordinates(patch[hit]), chain, piece[hit])
        np.maximum.at(found, pair[hit], depth)
        return found


def count_contacts(mesh: Mesh) -> ContactCounts:
    """Count which organs of a mesh run into others.

    Raises:
        ValueError: two instances of the mesh share vertices.
    """
    return counted(ContactBodies(mesh))


def counted(bodies: ContactBodies) -> ContactCounts:
    """Count which organs run into others, as they stand now."""
    fruit, blades = bodies.fruit.tolist(), bodies.blades.tolist()
    touching: set[int] = set()
    for one, near in bodies.into_fruit(fruit).items():
        into = near.others[near.depth > 0.0].tolist()
        touching.update([one, *into] if into else [])
    through = sum(bool(np.any(near.depth > 0.0)) for near in bodies.into_stems(blades).values())
    return ContactCounts(len(fruit), len(touching.intersection(fruit)), len(blades), through)

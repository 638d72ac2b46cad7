"""Which organs run into which: fruit into anything, blades into stems and cords."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contact_fruit import Wall, walls
from pepperscene.geometry.contact_organs import (
    CORD,
    FRUIT,
    LEAF,
    STALK,
    STEM,
    Indices,
    Organs,
    Points,
    Vectors,
)
from pepperscene.geometry.contact_stems import Capsules, capsules
from pepperscene.geometry.mesh import Mesh

NEAR: Final = 3e-3
"""Metres; what is farther off a fruit than this is not looked at."""


@dataclass(frozen=True)
class Contacts:
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


class Bodies:
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
        self._walls: dict[int, Wall] = {}
        self._capsules: dict[int, Capsules] = {}
        self._own: dict[int, frozenset[int]] = {}
        self._known: dict[int, tuple[int, Near]] = {}

    def wall(self, fruit: int) -> Wall:
        """The wall of a fruit, made when first asked for."""
        if fruit not in self._walls:
            self._prepare([fruit], [])
        return self._walls[fruit]

    def capsules(self, tube: int) -> Capsules:
        """The capsules of a stem or cord, which never moves."""
        if tube not in self._capsules:
            self._capsules[tube] = capsules(self.organs, tube)
        return self._capsules[tube]

    def own(self, organ: int) -> frozenset[int]:
        """What an organ may touch: a fruit its calyx and the stalks that carry it, any other its parent."""
        if organ not in self._own:
            above = self.organs.ancestors(organ)
            if self.organs.organ_class[organ] == FRUIT:
                stalk = [self.organs.organ_class[one] == STALK for one in above]
                above = above[: stalk.index(False) if False in stalk else None]
            else:
                above = above[:1]
            self._own[organ] = frozenset([organ, *above])
        return self._own[organ]

    def around(self, organ: int, low: Vectors, high: Vectors) -> list[int]:
        """Organs whose boxes meet a box with the corners `(3,)` and `(3,)`, without what is its own."""
        near = np.flatnonzero(self.organs.in_box(low, high, NEAR)).tolist()
        own = self.own(organ)
        return [one for one in near if one not in own]

    def into_fruit(self, fruit: list[int]) -> dict[int, Near]:
        """What comes close to some fruit, and how far it reaches in; nothing for those that stand free."""
        return self._measured(fruit, self.organs.solid, self._into_fruit, self._prepare)

    def into_stems(self, blades: list[int]) -> dict[int, Near]:
        """The stems and cords that come close to some blades, and how far these reach in."""
        return self._measured(blades, self.is_stem, self._into_stems, lambda blades, stems: None)

    def depth(self, organ: int, other: int) -> float:
        """Metres that an organ reaches into a fruit, or a blade into a stem; negative apart.

        Args:
            organ: the fruit or the blade.
            other: the organ or the stem.
        """
        is_fruit = self.organs.organ_class[organ] == FRUIT
        return float((self._into_fruit if is_fruit else self._into_stems)(organ, [other])[0])

    def depths(
        self, fruit: int, points: Points, starts: Indices, rotation: Vectors, shift: Vectors
    ) -> NDArray[np.float32]:
        """How deep groups of points reach into a fruit when they are moved in several ways.

        Args:
            fruit: which, as it stands.
            points: `(p, 3)` metres, group after group.
            starts: `(n + 1,)` where each group starts.
            rotation: `(k, 3, 3)` and
            shift: `(k, 3)` metres: a point goes to rotation @ point + shift.

        Returns:
            `(n, k)` metres; minus infinity where no point of a group comes near.
        """
        wall = self.wall(fruit)
        turned, moved = self.organs.pose(fruit)
        # Into the fruit's own coordinates, from its centre; numbers are small there, as single ones must be.
        origin = turned @ wall.centre + moved
        matrix = turned.T @ rotation
        offset = (rotation @ origin + shift - moved) @ turned - wall.centre
        # Points that come near in none of the ways are left out.
        centre = -np.einsum("kji,kj->ki", matrix, offset)
        middle = centre.mean(axis=0)
        far = wall.reach + NEAR
        swept = far + float(np.sqrt(np.square(centre - middle).sum(axis=1).max()))
        x, y, z = (points[:, axis] - np.float32(origin[axis] + middle[axis]) for axis in range(3))
        kept = np.flatnonzero(x * x + y * y + z * z < swept**2)
        found = np.full((len(starts) - 1, len(rotation)), -np.inf, dtype=np.float32)
        if not len(kept):
            return found
        points = points[kept] - origin.astype(np.float32)
        # Coordinates, points, ways.
        local = points @ matrix.transpose(1, 2, 0).astype(np.float32)
        local += offset.T[:, None].astype(np.float32)
        local = local.reshape(3, -1)
        hit = np.flatnonzero(local[0] ** 2 + local[1] ** 2 + local[2] ** 2 < far**2)
        depth = np.full(local.shape[1], -np.inf, dtype=np.float32)
        depth[hit] = wall.depth(local[:, hit])
        # The deepest point of each group.
        first = np.searchsorted(kept, starts)
        some = np.flatnonzero(np.diff(first))
        found[some] = np.maximum.reduceat(depth.reshape(len(kept), -1), first[some], axis=0)
        return found

    def _measured(
        self,
        organs: list[int],
        others: NDArray[np.bool_],
        measure: Callable[[int, list[int]], Points],
        prepare: Callable[[list[int], list[int]], None],
    ) -> dict[int, Near]:
        """What is known of organs' neighbours, measured anew where one has turned since."""
        low, high, stamp = self.organs.low[organs], self.organs.high[organs], self.organs.stamp
        meet = self.organs.in_box(low, high, NEAR) & others
        if self.between_plants:
            meet &= self.organs.plant[organs][:, None] != self.organs.plant
        number, other = np.nonzero(meet)
        first = np.searchsorted(number, np.arange(len(organs) + 1))
        places = np.flatnonzero(np.diff(first)).tolist()
        prepare([organs[place] for place in places], np.unique(other).tolist())
        found = {}
        for place in places:
            organ, own = organs[place], self.own(organs[place])
            near = [one for one in other[first[place] : first[place + 1]].tolist() if one not in own]
            if not near:
                continue
            newest = int(max(stamp[organ], stamp[near].max()))
            known = self._known.get(organ)
            if known is None or known[0] < newest or not np.array_equal(known[1].others, near):
                known = newest, Near(np.array(near, dtype=np.intp), measure(organ, near))
                self._known[organ] = known
            found[organ] = known[1]
        return found

    def _prepare(self, fruit: list[int], others: list[int]) -> None:
        """Make walls and lay points at once, which is faster than one by one."""
        missing = [one for one in fruit if one not in self._walls]
        self._walls.update(zip(missing, walls(self.organs, missing), strict=True))
        self.organs.sample(others)

    def _into_fruit(self, fruit: int, others: list[int]) -> NDArray[np.float32]:
        points, starts = self.organs.points(others)
        return self.depths(fruit, points, starts, np.eye(3)[None], np.zeros((1, 3)))[:, 0]

    def _into_stems(self, blade: int, stems: list[int]) -> NDArray[np.float32]:
        depth = np.full(len(stems), -np.inf, dtype=np.float32)
        low, high = self.organs.low[blade] - NEAR, self.organs.high[blade] + NEAR
        for place, stem in enumerate(stems):
            near = self.capsules(stem).near(low, high)
            if len(near.start):
                depth[place] = near.depth(self.organs.points([blade])[0]).max()
        return depth


def contacts(mesh: Mesh) -> Contacts:
    """Count which organs of a mesh run into others.

    Raises:
        ValueError: two instances of the mesh share vertices.
    """
    return counted(Bodies(mesh))


def counted(bodies: Bodies) -> Contacts:
    """Count which organs run into others, as they stand now."""
    fruit, blades = bodies.fruit.tolist(), bodies.blades.tolist()
    touching: set[int] = set()
    for one, near in bodies.into_fruit(fruit).items():
        into = near.others[near.depth > 0.0].tolist()
        touching.update([one, *into] if into else [])
    through = sum(bool(np.any(near.depth > 0.0)) for near in bodies.into_stems(blades).values())
    return Contacts(len(fruit), len(touching.intersection(fruit)), len(blades), through)

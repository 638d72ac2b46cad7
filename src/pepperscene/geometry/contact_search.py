"""What a turn of a unit costs: how far it goes, and what its organs then run into."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contact import NEAR, Bodies
from pepperscene.geometry.contact_organs import FLOWER, FRUIT, LEAF, SHOOT, Vectors
from pepperscene.geometry.contact_stems import Capsules, joined
from pepperscene.geometry.contact_units import Unit

CLEAR: Final = 0.8e-3
"""Metres that what was moved keeps off, chosen: more than is missed between points, and not seen."""

# Chosen: running into something costs as much as turns that no unit can make, so that nothing stays in what
# it can leave; running into what can give way costs a fair turn, and each millimetre a little more.
_HARD: Final = 200.0
_SOFT: Final = 30.0
_PER_MM: Final = 0.1
_WITHIN: Final = 1e4  # what is settled within a plant stays so
_STALK: Final = 1e-3  # m, chosen: so much deeper may a stalk reach into the fruit that swings on it
_UNDERGROUND: Final = 1e5

Depths = Callable[[Vectors, Vectors, int], NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Some organs that a unit may run into.

    Attributes:
        depths: for turns `(k, 3, 3)` and `(k, 3)` of the unit, `(n, k)` metres of how deep it reaches into
            each, by every so-manieth point.
        weight: `(n,)` cost of running into each.
        allowed: `(n,)` metres that it may reach in (below zero: that it must keep off) at no cost.
    """

    depths: Depths
    weight: NDArray[np.float64]
    allowed: NDArray[np.float64]

    def cost(self, rotation: Vectors, shift: Vectors, every: int = 1) -> Vectors:
        """`(k,)` cost of some turns, judged by every so-manieth point: at most what it is by all."""
        over = self.depths(rotation, shift, every).astype(np.float64) - self.allowed[:, None]
        hit = over > 0.0
        graded = self.weight[:, None] * (1.0 + 1e3 * _PER_MM * np.where(hit, over, 0.0))
        return np.asarray((graded * hit).sum(axis=0))


class Surroundings:
    """What a unit may run into when it turns.

    Where bodies are looked at between plants, the unit may come as near to organs of its own plant as it is.

    Args:
        bodies: the organs as they stand.
        unit: what turns.
        hard: everything stays where it is; else leaves give way to fruit.
    """

    def __init__(self, bodies: Bodies, unit: Unit, *, hard: bool) -> None:
        self._bodies, self._organs = bodies, bodies.organs
        self._hard = hard
        self._members = np.array(unit.members)
        self._inside = np.zeros(len(self._organs), dtype=bool)
        self._inside[self._members] = True

    def pair(self, organ: int, other: int) -> Obstacle:
        """One organ as an obstacle to another: a fruit and what runs into it, a blade and a stem.

        Args:
            organ: the fruit or the blade; of the unit, or else the other is.
            other: what touches it.
        """
        if self._organs.organ_class[organ] != FRUIT:
            return self._stem_met(organ, [(other, self._bodies.capsules(other))])
        return self._fruit_moved(organ, [other]) if self._inside[organ] else self._fruit_met(organ, [other])

    def obstacles(self, rotation: Vectors, shift: Vectors) -> list[Obstacle]:
        """All that the unit may run into on the ways of some turns, `(k, 3, 3)` and `(k, 3)`."""
        # The boxes around all that each member sweeps.
        middle = 0.5 * (self._organs.low + self._organs.high)[self._members]
        half = 0.5 * (self._organs.high - self._organs.low)[self._members]
        gone = np.matmul(middle, rotation.transpose(0, 2, 1)) + shift[:, None]
        reach = np.matmul(half, np.abs(rotation).transpose(0, 2, 1))
        self._low, self._high = (gone - reach).min(axis=0), (gone + reach).max(axis=0)
        return [*self._of_own_fruit(), *self._other_fruit(), *self._stems(), *self._ground()]

    def _of_own_fruit(self) -> list[Obstacle]:
        """What the unit's own fruit may run into: everything."""
        found = []
        for place, fruit in enumerate(self._members.tolist()):
            if self._organs.organ_class[fruit] != FRUIT or not self._organs.solid[fruit]:
                continue
            others = self._bodies.around(fruit, self._low[place], self._high[place])
            others = [one for one in others if not self._inside[one]]
            if others:
                found.append(self._fruit_moved(fruit, others))
            # Its own stalk goes into its cavity, but not on through its shoulder.
            stalks = [one for one in self._bodies.own(fruit) if not self._inside[one]]
            if stalks:
                stalk = self._fruit_moved(fruit, sorted(stalks))
                now = stalk.depths(np.eye(3)[None], np.zeros((1, 3)), 1)[:, 0]
                found.append(replace(stalk, allowed=np.maximum(now, -CLEAR) + _STALK))
        return found

    def _fruit_moved(self, fruit: int, others: list[int]) -> Obstacle:
        points, starts = self._organs.points(others)

        def depths(rotation: Vectors, shift: Vectors, every: int) -> NDArray[np.float32]:
            # To turn the fruit is to turn all else back.
            back = rotation.transpose(0, 2, 1)
            gone = -np.einsum("kij,kj->ki", back, shift)
            return self._bodies.depths(fruit, points[::every], -(-starts // every), back, gone)

        kinds = self._organs.organ_class[others]
        gives_way = np.isin(kinds, [FLOWER, LEAF, SHOOT]) & (not self._hard)
        return self._obstacle(depths, np.where(gives_way, _SOFT, _HARD), fruit, np.array(others))

    def _other_fruit(self) -> list[Obstacle]:
        """Fruit that the unit's leaves and stalks may run into."""
        found = []
        low, high = self._low.min(axis=0), self._high.max(axis=0)
        for fruit in np.flatnonzero(self._organs.in_box(low, high, NEAR)).tolist():
            if self._organs.organ_class[fruit] != FRUIT or self._inside[fruit]:
                continue
            meets = np.all(self._low < self._organs.high[fruit] + NEAR, axis=1)
            meets &= np.all(self._high > self._organs.low[fruit] - NEAR, axis=1)
            meets &= self._organs.solid[self._members]
            meets &= self._organs.organ_class[self._members] != FRUIT
            own = self._bodies.own(fruit)
            movers = [one for one in self._members[meets].tolist() if one not in own]
            if movers:
                found.append(self._fruit_met(fruit, movers))
        return found

    def _fruit_met(self, fruit: int, movers: list[int]) -> Obstacle:
        points, starts = self._organs.points(movers)

        def depths(rotation: Vectors, shift: Vectors, every: int) -> NDArray[np.float32]:
            return self._bodies.depths(fruit, points[::every], -(-starts // every), rotation, shift)

        return self._obstacle(depths, np.full(len(movers), _HARD), fruit, np.array(movers))

    def _stems(self) -> list[Obstacle]:
        """Stems and cords that the unit's blades may run through."""
        found = []
        for place, blade in enumerate(self._members.tolist()):
            if self._organs.organ_class[blade] != LEAF or not self._organs.solid[blade]:
                continue
            low, high = self._low[place], self._high[place]
            stems = [one for one in self._bodies.around(blade, low, high) if self._bodies.is_stem[one]]
            # Plant by plant: the box around one plant's stem is slender.
            for _, some in groupby(stems, key=lambda one: int(self._organs.plant[one])):
                parts = [(one, self._bodies.capsules(one).near(low - NEAR, high + NEAR)) for one in some]
                parts = [(one, part) for one, part in parts if len(part.start)]
                if parts:
                    found.append(self._stem_met(blade, parts))
        return found

    def _stem_met(self, blade: int, parts: list[tuple[int, Capsules]]) -> Obstacle:
        points, _ = self._organs.points([blade])
        chain = joined([part for _, part in parts])
        first = np.cumsum([0, *(len(part.start) for _, part in parts[:-1])])

        low, high = chain.box()

        def depths(rotation: Vectors, shift: Vectors, every: int) -> NDArray[np.float32]:
            found = np.full((len(first), len(rotation)), -np.inf, dtype=np.float32)
            moved = np.matmul(points[::every], rotation.transpose(0, 2, 1).astype(np.float32))
            moved += shift[:, None].astype(np.float32)
            # Most of a blade is not near a stem.
            way, near = np.nonzero(np.all((moved > low) & (moved < high), axis=2))
            if len(way):
                deep = np.maximum.reduceat(chain.depth(moved[way, near]), first, axis=1)
                some, start = np.unique(way, return_index=True)
                found[:, some] = np.maximum.reduceat(deep, start, axis=0).T
            return found

        stems = np.array([one for one, _ in parts])
        return self._obstacle(depths, np.full(len(parts), _HARD), blade, stems)

    def _ground(self) -> list[Obstacle]:
        """Nothing goes under the ground, or lower than it is if it is there already."""
        depth = np.minimum(self._organs.low[self._members, 2].min(), 0.0)
        if self._low[:, 2].min() >= depth:
            return []
        points, _ = self._organs.points(self._members[self._organs.solid[self._members]].tolist())

        def depths(rotation: Vectors, shift: Vectors, every: int) -> NDArray[np.float32]:
            lowest = (points @ rotation[:, 2].T).min(axis=0) + shift[:, 2]
            return np.asarray((depth - lowest)[None].astype(np.float32))

        return [Obstacle(depths, np.array([_UNDERGROUND]), np.array([1e-6]))]

    def _obstacle(self, depths: Depths, weight: Vectors, organ: int, others: NDArray[np.intp]) -> Obstacle:
        allowed = np.full(len(others), -CLEAR)
        within = self._organs.plant[others] == self._organs.plant[organ]
        if self._bodies.between_plants and np.any(within):
            now = depths(np.eye(3)[None], np.zeros((1, 3)), 1)[:, 0]
            allowed = np.where(within, np.maximum(now, allowed) + 1e-6, allowed)
            weight = np.where(within, _WITHIN, weight)
        return Obstacle(depths, weight, allowed)

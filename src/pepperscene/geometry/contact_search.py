"""What a turn of a unit costs: how far it goes, and what its organs then run into."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contact import NEAR, Bodies
from pepperscene.geometry.contact_organs import FLOWER, FRUIT, LEAF, SHOOT, Indices, Organs, Vectors
from pepperscene.geometry.contact_tables import FruitTable, StemTable
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
_BETWEEN: Final = 5e-3  # m, chosen: parts of a turn may stray so far from those that are looked at
_UNDERGROUND: Final = 1e5

Depths = Callable[[Vectors, Vectors, int], NDArray[np.float32]]


class Obstacle(Protocol):
    """Something that a unit may run into."""

    def cost(self, rotation: Vectors, shift: Vectors, every: int) -> Vectors:
        """`(k,)` cost of turns `(k, 3, 3)` and `(k, 3)`, of which the first is none.

        Args:
            rotation: and
            shift: of the unit.
            every: judge by every so-manieth point: at most what it is by all.
        """
        ...


@dataclass(frozen=True, eq=False)
class DepthObstacle:
    """Some organs that others run into.

    Attributes:
        depths: for turns of the unit, `(n, m, k)` metres that each reaches into each.
        weight: `(n, m)` cost of running into each.
        slack: `(n, m)` metres that it may reach in deeper than it does; not a number where it must keep off.
    """

    depths: Depths
    weight: NDArray[np.float64]
    slack: NDArray[np.float64]

    def cost(self, rotation: Vectors, shift: Vectors, every: int) -> Vectors:
        """`(k,)` cost of some turns."""
        depth = self.depths(rotation, shift, every)
        now = np.maximum(depth[:, :, 0], -CLEAR)
        allowed = np.where(np.isnan(self.slack), -CLEAR, now + self.slack)
        over = depth - allowed[:, :, None]
        if not (over > 0.0).any():
            return np.zeros(len(rotation))
        graded = self.weight[:, :, None] * (1.0 + 1e3 * _PER_MM * np.maximum(over, 0.0))
        return np.asarray(np.where(over > 0.0, graded, 0.0).sum(axis=(0, 1)))


@dataclass(frozen=True, eq=False)
class Ground:
    """Nothing goes under the ground, or lower than it is if it is there already.

    Attributes:
        organs: of which
        members: belong to the unit.
        lowest: metres that they may reach down to.
    """

    organs: Organs
    members: Indices
    lowest: float

    def cost(self, rotation: Vectors, shift: Vectors, every: int) -> Vectors:
        """`(k,)` cost of some turns."""
        laid, patch, _ = self.organs.patches(self.members.tolist())
        points = laid.points[patch].reshape(-1, 3)
        over = self.lowest - ((points @ rotation[:, 2].T).min(axis=0) + shift[:, 2]) - 1e-6
        return np.asarray(np.where(over > 0.0, _UNDERGROUND * (1.0 + 1e3 * _PER_MM * over), 0.0))


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

    def pair(self, organ: int, other: int, rotation: Vectors, shift: Vectors, every: int) -> Vectors:
        """`(k,)` cost of what is left of one contact after some turns; there is one before.

        Args:
            organ: a fruit or blade; of the unit, or else the other is.
            other: what touches it: any organ, or a stem.
            rotation: `(k, 3, 3)` and
            shift: `(k, 3)` metres; the first of the turns is none.
            every: judge by every so-manieth point.
        """
        one, two = np.array([organ]), np.array([other])
        meets = np.ones((1, 1), dtype=bool)
        if self._organs.organ_class[organ] != FRUIT:
            met = self._stems_met(one, two, meets)
        elif self._inside[organ]:
            met = self._fruit_moved(one, two, meets)
        else:
            met = self._fruit_met(two, one, meets)
        cost = met.cost(rotation, shift, every)
        # Too shallow a contact for so few points is one nevertheless.
        cost[0] = max(cost[0], float(met.weight.max()))
        return cost

    def obstacles(self, rotation: Vectors, shift: Vectors) -> list[Obstacle]:
        """All that the unit may run into on the ways of some turns, `(k, 3, 3)` and `(k, 3)`."""
        organs, members = self._organs, self._members[self._organs.solid[self._members]]
        # The boxes around all that each member sweeps.
        middle, half = 0.5 * (organs.low + organs.high)[members], 0.5 * (organs.high - organs.low)[members]
        gone = np.matmul(middle, rotation.transpose(0, 2, 1)) + shift[:, None]
        reach = np.matmul(half, np.abs(rotation).transpose(0, 2, 1))
        low, high = (gone - reach).min(axis=0) - NEAR, (gone + reach).max(axis=0) + NEAR
        near = np.flatnonzero(organs.in_box(low.min(axis=0), high.max(axis=0)) & ~self._inside)
        meets = np.all(organs.low[near] < high[:, None], axis=2)
        meets &= np.all(organs.high[near] > low[:, None], axis=2)
        is_fruit, other_is_fruit = (organs.organ_class[some] == FRUIT for some in (members, near))
        found: list[Obstacle] = []
        for rows, columns, met in (
            # Its own fruit may run into everything,
            (is_fruit, np.ones(len(near), dtype=bool), self._fruit_moved),
            # its leaves and stalks into fruit,
            (~is_fruit, other_is_fruit, self._fruit_met),
            # its blades into stems and cords.
            (organs.organ_class[members] == LEAF, self._bodies.is_stem[near], self._stems_met),
        ):
            part = meets & rows[:, None] & columns
            if met == self._fruit_moved and part.any():
                part[rows] &= self._swept(members[rows], near, rotation, shift)
            if part.any():
                rows, columns = part.any(axis=1), part.any(axis=0)
                found.append(met(members[rows], near[columns], part[rows][:, columns]))
        lowest = min(float(organs.low[members, 2].min()), 0.0)
        return [*found, Ground(organs, members, lowest)] if low[:, 2].min() < lowest else found

    def _swept(self, fruit: Indices, others: Indices, rotation: Vectors, shift: Vectors) -> NDArray[np.bool_]:
        """`(f, n)` whose boxes the balls around some fruit meet on the ways of some turns."""
        balls = self._bodies.walls.bodies(fruit.tolist())
        centre = (balls.centre @ rotation.transpose(0, 2, 1) + shift[:, None]).transpose(1, 0, 2)
        low, high = self._organs.low[others], self._organs.high[others]
        off = np.maximum(np.maximum(low - centre[:, :, None], centre[:, :, None] - high), 0.0)
        nearest = np.einsum("fkni,fkni->fkn", off, off).min(axis=1)
        # Some more for what is between the turns that are looked at.
        return np.asarray(nearest < np.square(balls.reach + NEAR + _BETWEEN)[:, None])

    def _fruit_moved(self, fruit: Indices, others: Indices, meets: NDArray[np.bool_]) -> DepthObstacle:
        """What the unit's own fruit runs into; its own stalk may reach a little deeper, and no more."""
        gives_way = np.isin(self._organs.organ_class[others], [FLOWER, LEAF, SHOOT]) & (not self._hard)
        own = self._own(fruit, others)
        weight = np.where(meets, np.where(gives_way & ~own, _SOFT, _HARD), 0.0)
        table = FruitTable(self._bodies, others, fruit, meets.T)

        def depths(rotation: Vectors, shift: Vectors, every: int) -> NDArray[np.float32]:
            # To turn the fruit is to turn all else back.
            back = rotation.transpose(0, 2, 1)
            return table.depths(back, -np.einsum("kij,kj->ki", back, shift), every).transpose(1, 0, 2)

        return self._obstacle(depths, weight, fruit, others, own)

    def _fruit_met(self, movers: Indices, fruit: Indices, meets: NDArray[np.bool_]) -> DepthObstacle:
        """What the unit's leaves and stalks run into: fruit."""
        meets = meets & ~self._own(fruit, movers).T
        table = FruitTable(self._bodies, movers, fruit, meets)
        return self._obstacle(table.depths, np.where(meets, _HARD, 0.0), movers, fruit)

    def _stems_met(self, blades: Indices, stems: Indices, meets: NDArray[np.bool_]) -> DepthObstacle:
        """What the unit's blades run through: stems and cords."""
        meets = meets & ~self._own(blades, stems)
        table = StemTable(self._bodies, blades, stems, meets)
        return self._obstacle(table.depths, np.where(meets, _HARD, 0.0), blades, stems)

    def _own(self, organs: Indices, others: Indices) -> NDArray[np.bool_]:
        """`(n, m)` what organs may touch."""
        columns = others.tolist()
        return np.array(
            [[other in own for other in columns] for own in map(self._bodies.own, organs.tolist())]
        )

    def _obstacle(
        self,
        depths: Depths,
        weight: Vectors,
        organs: Indices,
        others: Indices,
        own: NDArray[np.bool_] | None = None,
    ) -> DepthObstacle:
        """Obstacles of such weight; what is the unit's own may reach in a little, its own plant no deeper."""
        slack = np.full(weight.shape, np.nan)
        if self._bodies.between_plants:
            within = self._organs.plant[organs][:, None] == self._organs.plant[others]
            slack[within] = 1e-6
            weight = np.where(within & (weight > 0.0), _WITHIN, weight)
        if own is not None:
            slack[own] = _STALK
        return DepthObstacle(depths, weight, slack)

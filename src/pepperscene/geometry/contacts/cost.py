"""What turns of units cost in what their organs then run into, for many units in one go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.detect import NEAR, ContactBodies
from pepperscene.geometry.contacts.joints import TurningUnit
from pepperscene.geometry.contacts.organs import FLOWER, FRUIT, LEAF, SHOOT, STALK, Indices, Organs, Vectors
from pepperscene.geometry.contacts.pairs import FruitPairs, StemPairs, Turns
from pepperscene.geometry.contacts.samples import counted

CLEAR: Final = 0.8e-3
"""Metres that what was moved keeps off, chosen: more than is missed between points, and not seen."""

# Chosen: running into something costs as much as turns that no unit can make, so that nothing stays in what
# it can leave; running into what can give way costs a fair turn, and each millimetre a little more.
_HARD: Final = 200.0
_SOFT: Final = 30.0
_FRUIT: Final = 90.0  # what can give way as well, but less readily
_PER_MM: Final = 0.1
_WITHIN: Final = 1e4  # what is settled within a plant stays so
_STALK: Final = 1e-3  # m, chosen: so much deeper may a stalk reach into the fruit that swings on it
_UNDERGROUND: Final = 1e5


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Organs of units and what they may run into.

    Attributes:
        table: of `n` pairs.
        unit: `(n,)` the place of each one's unit.
        undone: whether all else is turned back rather than the units turned.
        weight: `(n,)` cost of running into each.
        slack: `(n,)` metres that it may reach in deeper than it does; not a number where it must keep off.
    """

    table: FruitPairs | StemPairs
    unit: Indices
    undone: bool
    weight: NDArray[np.float64]
    slack: NDArray[np.float64]

    def cost(self, rows: Indices, unit: Indices, turns: Turns, every: int) -> Vectors:
        """`(r, k)` cost of some pairs.

        Args:
            rows: `(r,)` ascending.
            unit: `(r,)` by which turns each moves.
            turns: `(2 u, k)`, of which the first is none, with their inverses.
            every: judge by every so-manieth point: at most what it is by all.
        """
        turn = unit + len(turns.shift) // 2 if self.undone else unit
        depth = self.table.depths(rows, turn, turns, every)
        slack = self.slack[rows]
        now = np.maximum(depth[:, 0], -CLEAR)
        over = depth - np.where(np.isnan(slack), -CLEAR, now + slack)[:, None]
        graded = self.weight[rows, None] * (1.0 + 1e3 * _PER_MM * np.maximum(over, 0.0))
        return np.asarray(np.where(over > 0.0, graded, 0.0))


class _Kinds:
    """How organs of units may meet others.

    Where bodies are looked at between plants, a unit may come as near to organs of its own plant as it is.

    Args:
        bodies: the organs as they stand.
        hard: everything stays where it is; else leaves give way to fruit.
    """

    def __init__(self, bodies: ContactBodies, *, hard: bool) -> None:
        self._bodies, self._organs, self._hard = bodies, bodies.organs, hard

    def fruit_moved(self, unit: Indices, fruit: Indices, others: Indices) -> _Pairs:
        """Fruit of units runs into others; its own stalk may reach a little deeper, and no more."""
        own = self._bodies.are_own(fruit, others)
        soft = np.isin(self._organs.organ_class[others], [FLOWER, LEAF, SHOOT]) & ~own & (not self._hard)
        weight = np.full(len(unit), _HARD)
        if not self._hard:
            weight[np.isin(self._organs.organ_class[others], [FRUIT, STALK]) & ~own] = _FRUIT
        weight[soft] = _SOFT
        table = FruitPairs(self._bodies, others, fruit)
        return self._pairs(table, unit, True, weight, fruit, others, own)

    def fruit_met(self, unit: Indices, movers: Indices, fruit: Indices) -> _Pairs:
        """Leaves and stalks of units run into fruit."""
        table = FruitPairs(self._bodies, movers, fruit)
        return self._pairs(table, unit, False, np.full(len(unit), _HARD), movers, fruit)

    def stems_met(
        self,
        unit: Indices,
        blades: Indices,
        stems: Indices,
        low: Vectors,
        high: Vectors,
    ) -> _Pairs:
        """Blades of units, which stay in boxes, run through stems and cords."""
        table = StemPairs(self._bodies, blades, stems, low, high)
        return self._pairs(table, unit, False, np.full(len(unit), _HARD), blades, stems)

    def _pairs(
        self,
        table: FruitPairs | StemPairs,
        unit: Indices,
        undone: bool,
        weight: Vectors,
        organs: Indices,
        others: Indices,
        own: NDArray[np.bool_] | None = None,
    ) -> _Pairs:
        """Pairs of such weight; what is the unit's own may reach in a little, its own plant no deeper."""
        slack = np.full(len(unit), np.nan)
        if self._bodies.between_plants:
            within = self._organs.plant[organs] == self._organs.plant[others]
            slack[within] = 1e-6
            weight = np.where(within, _WITHIN, weight)
        if own is not None:
            slack[own] = _STALK
        return _Pairs(table, unit, undone, weight, slack)


def left_of(
    bodies: ContactBodies,
    units: Sequence[TurningUnit],
    unit: Indices,
    contacts: Indices,
    turns: Turns,
    every: int,
    *,
    hard: bool,
) -> Vectors:
    """`(c, k)` cost of what is left of some contacts after turns of one side; there is one before.

    Args:
        bodies: the organs as they stand.
        units: what turns.
        unit: `(c,)` which of these for each contact.
        contacts: `(c, 2)` fruit or blade, and what touches it: any organ, or a stem. One is of the unit.
        turns: `(u, k)` of the units, the first of each none.
        every: judge by every so-manieth point.
        hard: everything stays where it is; else leaves give way to fruit.
    """
    organs, others = contacts.T
    kinds, both = _Kinds(bodies, hard=hard), turns.with_their_inverses()
    cost = np.zeros((len(unit), turns.shift.shape[1]))
    is_fruit = bodies.organs.organ_class[organs] == FRUIT
    inside = np.array(
        [one in units[row].members for row, one in zip(unit.tolist(), organs.tolist(), strict=True)]
    )
    moved, met, stems = (np.flatnonzero(some) for some in (is_fruit & inside, is_fruit & ~inside, ~is_fruit))
    low, high = boxes(bodies.organs, organs[stems], unit[stems], turns)
    for rows, pairs in (
        (moved, kinds.fruit_moved(unit[moved], organs[moved], others[moved])),
        (met, kinds.fruit_met(unit[met], others[met], organs[met])),
        (stems, kinds.stems_met(unit[stems], organs[stems], others[stems], low - NEAR, high + NEAR)),
    ):
        if not len(rows):
            continue
        cost[rows] = pairs.cost(np.arange(len(rows)), pairs.unit, both, every)
        # Too shallow a contact for so few points is one nevertheless.
        cost[rows, 0] = np.maximum(cost[rows, 0], pairs.weight)
    return cost


class ContactCosts:
    """All that some units may run into when they turn, each alone.

    Args:
        bodies: the organs as they stand.
        units: what turns.
        turns: `(u, k)`, the ways on which they may run into something.
        hard: everything stays where it is; else leaves give way to fruit.
    """

    def __init__(
        self, bodies: ContactBodies, units: Sequence[TurningUnit], turns: Turns, *, hard: bool
    ) -> None:
        organs = self._organs = bodies.organs
        self._units = units
        count = [len(one.members) for one in units]
        members = np.fromiter((member for one in units for member in one.members), np.intp, sum(count))
        unit = np.repeat(np.arange(len(units)), count)
        inside = np.zeros((len(units), len(organs)), dtype=bool)
        inside[unit, members] = True
        kept = organs.solid[members]
        members, unit = members[kept], unit[kept]
        low, high = boxes(organs, members, unit, turns)
        low, high = low - NEAR, high + NEAR
        # What comes near to any of a unit's organs.
        lowest, highest = np.full((len(units), 3), np.inf), np.full((len(units), 3), -np.inf)
        np.minimum.at(lowest, unit, low)
        np.maximum.at(highest, unit, high)
        met, near = np.nonzero(organs.in_box(lowest, highest) & ~inside)
        is_fruit, organ_class = organs.organ_class[members] == FRUIT, organs.organ_class
        kinds, self._pairs = _Kinds(bodies, hard=hard), []
        for rows, columns, kind in (
            # Their own fruit may run into everything,
            (is_fruit, np.ones(len(near), dtype=bool), "fruit moved"),
            # their leaves and stalks into fruit,
            (~is_fruit, organ_class[near] == FRUIT, "fruit met"),
            # their blades into stems and cords.
            (organ_class[members] == LEAF, bodies.is_stem[near], "stems met"),
        ):
            row, column = _crossed(unit, rows, met, columns, len(units))
            other = near[column]
            meet = np.ones(len(row), dtype=bool)
            for axis in range(3):
                meet &= organs.low[other, axis] < high[row, axis]
                meet &= organs.high[other, axis] > low[row, axis]
            row, other = row[meet], other[meet]
            one = members[row]
            if kind == "fruit moved":
                self._pairs.append(kinds.fruit_moved(unit[row], one, other))
                continue
            free = ~(bodies.are_own(other, one) if kind == "fruit met" else bodies.are_own(one, other))
            row, one, other = row[free], one[free], other[free]
            if kind == "fruit met":
                self._pairs.append(kinds.fruit_met(unit[row], one, other))
            else:
                self._pairs.append(kinds.stems_met(unit[row], one, other, low[row], high[row]))
        # Nothing goes under the ground, or lower than it is if it is there already.
        floor = np.zeros(len(units))
        np.minimum.at(floor, unit, organs.low[members, 2])
        self._floor = floor
        self._over_ground = lowest[:, 2] < floor

    def cost(self, some: Indices, turns: Turns, every: int) -> Vectors:
        """`(u, k)` cost of turns of some units, the first of each none, judged by every so-manieth point."""
        total, both = np.zeros(turns.shift.shape[:2]), turns.with_their_inverses()
        place = np.full(len(self._units), -1)
        place[some] = np.arange(len(some))
        for pairs in self._pairs:
            rows = np.flatnonzero(place[pairs.unit] >= 0)
            if not len(rows):
                continue
            unit = place[pairs.unit[rows]]
            np.add.at(total, unit, pairs.cost(rows, unit, both, every))
        for row in np.flatnonzero(self._over_ground[some]).tolist():
            total[row] += self._underground(int(some[row]), turns.rotation[row], turns.shift[row])
        return total

    def _underground(self, unit: int, rotation: Vectors, shift: Vectors) -> Vectors:
        """`(k,)` cost of what goes too low."""
        members = [one for one in self._units[unit].members if self._organs.solid[one]]
        laid, patch, _ = self._organs.patches(members)
        points = laid.points[patch].reshape(-1, 3)
        over = self._floor[unit] - ((points @ rotation[:, 2].T).min(axis=0) + shift[:, 2]) - 1e-6
        return np.asarray(np.where(over > 0.0, _UNDERGROUND * (1.0 + 1e3 * _PER_MM * over), 0.0))


def boxes(
    organs: Organs, members: Indices, unit: Indices, turns: Turns
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`(m, 3)` the corners of the boxes around all that organs of units sweep on some turns `(u, k)`."""
    low, high = organs.low[members], organs.high[members]
    middle, half = 0.5 * (low + high)[:, :, None], 0.5 * (high - low)[:, :, None]
    # All ways of a unit below each other, so that an organ's box is turned by one product.
    ways = turns.shift.shape[1]
    matrix = turns.rotation.reshape(-1, 3 * ways, 3)
    gone = np.matmul(matrix[unit], middle).reshape(-1, ways, 3) + turns.shift[unit]
    reach = np.matmul(np.abs(matrix)[unit], half).reshape(-1, ways, 3)
    return (gone - reach).min(axis=1), (gone + reach).max(axis=1)


def _crossed(
    unit: Indices, rows: NDArray[np.bool_], met: Indices, columns: NDArray[np.bool_], units: int
) -> tuple[Indices, Indices]:
    """Every one of some rows of a unit with every one of some columns of it; both are in order of units."""
    one, other = np.flatnonzero(rows), np.flatnonzero(columns)
    number = np.bincount(met[other], minlength=units)
    first = np.cumsum(number) - number
    place, step = counted(number[unit[one]])
    return one[place], other[first[unit[one]][place] + step]

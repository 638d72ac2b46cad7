"""The cost of poses of units: the effort to get there, and the contacts that their organs then have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.detect import NEAR
from pepperscene.geometry.contacts.joints import Joints, MovableUnit, RigidTransforms, solid_members
from pepperscene.geometry.contacts.organs import FRUIT, LEAF, Organs, boxes_overlap, overlapping_boxes
from pepperscene.geometry.contacts.pairs import PER_MM, PairRules
from pepperscene.geometry.mesh import FloatArray, IndexArray, expand_counts

_UNDERGROUND: Final = 1e5
_STRIDE: Final = 4  # chosen: with all contacts, poses are compared by every 4th point only
_FIRST: Final = 4  # chosen: number of the cheapest poses that are examined first
_SMALL: Final = 20.0  # weighted degrees, chosen: a rotation that is accepted without trying other units
_FRACTIONS: Final = np.array([0.0, 0.2, 0.4, 0.55, 0.7, 0.8, 0.9, 1.0])  # chosen: of a rotation


def remaining_cost(
    rules: PairRules,
    units: Sequence[MovableUnit],
    unit: IndexArray,
    contacts: IndexArray,
    transforms: RigidTransforms,
    stride: int,
) -> FloatArray:
    """Compute `(c, k)` costs of what remains of some contacts when one side moves.

    Args:
        rules: costs of contacts between the current organs.
        units: that move.
        unit: `(c,)` index of the unit that moves in each contact.
        contacts: `(c, 2)` a fruit and any other organ, or a blade and a stem; one of them is of the unit.
        transforms: `(u, k)` of the units, the first of each the identity.
        stride: use every `stride`-th sample point.
    """
    organs, others = contacts.T
    bodies, both = rules.detector.organs, transforms.with_inverses()
    cost = np.zeros((len(unit), transforms.shift.shape[1]))
    is_fruit = bodies.organ_class[organs] == FRUIT
    moves = np.array(
        [organ in units[row].members for row, organ in zip(unit.tolist(), organs.tolist(), strict=True)]
    )
    moving, resting, stems = (np.flatnonzero(x) for x in (is_fruit & moves, is_fruit & ~moves, ~is_fruit))
    low, high = swept_boxes(bodies, organs[stems], unit[stems], transforms)
    for rows, pairs in (
        (moving, rules.fruit(unit[moving], organs[moving], others[moving], moves=True)),
        (resting, rules.fruit(unit[resting], organs[resting], others[resting], moves=False)),
        (stems, rules.stems(unit[stems], organs[stems], others[stems], low - NEAR, high + NEAR)),
    ):
        if not len(rows):
            continue
        cost[rows] = pairs.cost(np.arange(len(rows)), pairs.unit, both, stride)
        # A contact counts even if it is too shallow for so few points.
        cost[rows, 0] = np.maximum(cost[rows, 0], pairs.weight)
    return cost


class ContactCosts:
    """All contacts that some units may have, each moved alone within the range of its transforms `(u, k)`."""

    def __init__(self, rules: PairRules, units: Sequence[MovableUnit], transforms: RigidTransforms) -> None:
        detector, organs = rules.detector, rules.detector.organs
        self._organs, self._units = organs, units
        members, unit = solid_members(organs, units)
        inside = np.zeros((len(units), len(organs)), dtype=bool)
        inside[unit, members] = True
        low, high = swept_boxes(organs, members, unit, transforms)
        low, high = low - NEAR, high + NEAR
        # Other organs close to any organ of a unit.
        lowest, highest = np.full((len(units), 3), np.inf), np.full((len(units), 3), -np.inf)
        np.minimum.at(lowest, unit, low)
        np.maximum.at(highest, unit, high)
        near_unit, near = overlapping_boxes(lowest, highest, organs.low, organs.high)
        kept = organs.solid[near] & ~inside[near_unit, near]
        near_unit, near = near_unit[kept], near[kept]

        def overlapping(
            rows: NDArray[np.bool_], columns: NDArray[np.bool_]
        ) -> tuple[IndexArray, IndexArray, IndexArray]:
            """Pairs of a chosen member and a chosen organ near its unit: row, member, other organ."""
            row, column = np.flatnonzero(rows), np.flatnonzero(columns)
            # Both are in order of units: every row meets the run of columns of its unit.
            first, stop = (np.searchsorted(near_unit[column], unit[row], side) for side in ("left", "right"))
            pair, step = expand_counts(stop - first)
            row, other = row[pair], near[column[first[pair] + step]]
            overlap = boxes_overlap(organs.low[other], organs.high[other], low[row], high[row])
            return row[overlap], members[row[overlap]], other[overlap]

        is_fruit = organs.organ_class[members] == FRUIT
        # Fruit of the units against everything, their leaves and stalks against fruit, their blades against
        # stems and twine.
        row, organ, other = overlapping(is_fruit, np.ones(len(near), dtype=bool))
        moving_fruit = rules.fruit(unit[row], organ, other, moves=True)
        row, organ, other = overlapping(~is_fruit, organs.organ_class[near] == FRUIT)
        apart = ~detector.are_joined(other, organ)
        resting_fruit = rules.fruit(unit[row[apart]], other[apart], organ[apart], moves=False)
        row, organ, other = overlapping(organs.organ_class[members] == LEAF, detector.is_stem[near])
        apart = ~detector.are_joined(organ, other)
        row, organ, other = row[apart], organ[apart], other[apart]
        self._pairs = [moving_fruit, resting_fruit, rules.stems(unit[row], organ, other, low[row], high[row])]
        # Nothing may go below the ground, or lower than it is if it is below already.
        floor = np.zeros(len(units))
        np.minimum.at(floor, unit, organs.low[members, 2])
        self._floor = floor
        self._reaches_floor = lowest[:, 2] < floor

    def cost(self, rows: IndexArray, transforms: RigidTransforms, stride: int) -> FloatArray:
        """Compute `(r, k)` costs of some units, with every `stride`-th point; the first is the identity."""
        total, both = np.zeros(transforms.shift.shape[:2]), transforms.with_inverses()
        row_of_unit = np.full(len(self._units), -1)
        row_of_unit[rows] = np.arange(len(rows))
        for pairs in self._pairs:
            selected = np.flatnonzero(row_of_unit[pairs.unit] >= 0)
            if not len(selected):
                continue
            unit = row_of_unit[pairs.unit[selected]]
            np.add.at(total, unit, pairs.cost(selected, unit, both, stride))
        for row in np.flatnonzero(self._reaches_floor[rows]).tolist():
            total[row] += self._underground(int(rows[row]), transforms.rotation[row], transforms.shift[row])
        return total

    def _underground(self, unit: int, rotation: FloatArray, shift: FloatArray) -> FloatArray:
        """`(k,)` cost of organs below the floor."""
        members = np.array([member for member in self._units[unit].members if self._organs.solid[member]])
        patches, patch, _ = self._organs.patches(members)
        points = patches.points[patch].reshape(-1, 3)
        excess = self._floor[unit] - ((points @ rotation[:, 2].T).min(axis=0) + shift[:, 2]) - 1e-6
        return np.asarray(np.where(excess > 0.0, _UNDERGROUND * (1.0 + 1e3 * PER_MM * excess), 0.0))


def swept_boxes(
    organs: Organs, members: IndexArray, unit: IndexArray, transforms: RigidTransforms
) -> tuple[FloatArray, FloatArray]:
    """Compute `(m, 3)` corners of the boxes around all that organs of units sweep in transforms `(u, k)`."""
    low, high = organs.low[members], organs.high[members]
    middle, half = 0.5 * (low + high)[:, :, None], 0.5 * (high - low)[:, :, None]
    # All rotations of a unit stacked, so that an organ's box is rotated by one product.
    steps = transforms.shift.shape[1]
    matrix = transforms.rotation.reshape(-1, 3 * steps, 3)
    centre = np.matmul(matrix[unit], middle).reshape(-1, steps, 3) + transforms.shift[unit]
    extent = np.matmul(np.abs(matrix)[unit], half).reshape(-1, steps, 3)
    return (centre - extent).min(axis=1), (centre + extent).max(axis=1)


@dataclass(frozen=True, eq=False)
class Poses:
    """Candidate poses of some units, each moved alone; the first of each is the current one."""

    angles: FloatArray  # `(u, k, 2)` radians
    current: FloatArray  # `(u, 1, 2)` radians, the current angles
    weights: FloatArray  # `(u, 1, 2)` weight of a degree of either rotation
    effort: FloatArray  # `(u, k)` in weighted degrees
    remaining: FloatArray  # `(u, k)` cost of what remains of the contacts to resolve
    joints: Joints  # of the units

    def transforms(self, angles: FloatArray) -> RigidTransforms:
        """The transforms that lead to angles `(u, k, 2)`."""
        return self.joints.transforms(angles - self.current)

    def cheapest(self, rows: IndexArray, count: int) -> Poses:
        """Of some units the current pose and `count` others with the lowest lower bound, cheapest first."""
        bound = (self.effort + self.remaining)[rows]
        order = 1 + np.argsort(bound[:, 1:], axis=1, kind="stable")[:, :count]
        order = np.concatenate([np.zeros((len(rows), 1), dtype=np.intp), order], axis=1)
        return Poses(
            np.take_along_axis(self.angles[rows], order[:, :, None], axis=1),
            self.current[rows],
            self.weights[rows],
            np.take_along_axis(self.effort[rows], order, axis=1),
            np.take_along_axis(self.remaining[rows], order, axis=1),
            self.joints.select(rows),
        )

    def cost(self, costs: ContactCosts) -> FloatArray:
        """Compute `(u, k)` costs with all contacts; infinite for poses that cannot be the cheapest."""
        transforms, cost = self.transforms(self.angles), self.effort + self.remaining
        # Examine a few first, as one of these may be free.
        first = np.arange(min(1 + _FIRST, cost.shape[1]))
        remaining = np.append(0, np.arange(len(first), cost.shape[1]))
        open_units = np.arange(len(cost))
        for columns in (first, remaining):
            block = np.ix_(open_units, columns)
            contact = costs.cost(open_units, transforms.select(block), _STRIDE)
            cost[block] = self.effort[block] + np.maximum(self.remaining[block], contact)
            if columns is first and len(remaining) > 1:
                # Poses with a lower bound above the best cost so far need no examination.
                is_decided = cost[:, first].min(axis=1) <= cost[:, len(first)]
                cost[np.ix_(is_decided, remaining[1:])] = np.inf
                open_units = np.flatnonzero(~is_decided)
        return np.asarray(cost)

    def shorten(
        self, costs: ContactCosts, rows: IndexArray, selected: IndexArray
    ) -> Iterator[tuple[int, float, FloatArray, bool]]:
        """Choose the best fraction of the way to the selected pose of each of some units, with all points.

        Yields:
            The unit's row, its gain, its angles, and whether it is small and free of contacts.
        """
        current, weights = self.current[rows], self.weights[rows]
        angles = current + _FRACTIONS[:, None] * (self.angles[rows, selected][:, None] - current)
        effort = weighted_effort(angles, weights)
        transforms = self.joints.select(rows).transforms(angles - current)
        cost = effort + costs.cost(rows, transforms, 1)
        for row, (unit, best) in enumerate(zip(rows.tolist(), cost.argmin(axis=1).tolist(), strict=True)):
            small = cost[row, best] == effort[row, best] < _SMALL
            yield unit, float(cost[row, 0] - cost[row, best]), angles[row, best], bool(small)


def weighted_effort(angles: FloatArray, weights: FloatArray) -> FloatArray:
    """`(u, k)` weighted degrees of angles `(u, k, 2)` radians."""
    return np.asarray(np.sqrt(np.square(np.degrees(angles) * weights).sum(axis=-1)))

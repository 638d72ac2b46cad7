"""Leaves that pass through other leaves and stalks: the smallest of some rotations that frees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.cost import ContactCosts, swept_boxes, weighted_effort
from pepperscene.geometry.contacts.crossings import ALL, CLEARANCE, ROUGH, CoarseTriangles
from pepperscene.geometry.contacts.detect import ContactDetector
from pepperscene.geometry.contacts.joints import (
    MovableUnit,
    MovingUnits,
    RigidTransforms,
    disc_points,
    find_joints,
    solid_members,
)
from pepperscene.geometry.contacts.leaf_crossings import (
    PER_CROSSING,
    LeafCrossings,
    must_not_cross,
    pair_cost,
)
from pepperscene.geometry.contacts.organs import LEAF, boxes_overlap, overlapping_boxes
from pepperscene.geometry.contacts.pairs import CROWDED, PairRules
from pepperscene.geometry.mesh import FloatArray, IndexArray

PASSES: Final = 8
"""Chosen: later passes free few leaves."""

_POSES: Final = (4, 4, 5, 6, 8, 10, 12, 16)  # chosen: poses tried in each pass, then as in the last
_EXAMINED: Final = 3  # chosen: the best of these, examined with fruit, stems and the ground
_PER_ROUGH_CROSSING: Final = 4.0 * PER_CROSSING  # chosen: there are fewer rough triangles, in every way
_LARGE_CLEARANCE: Final = 2.5e-3  # m, chosen: of rough triangles, which are farther from the surface
_ROUGH_CLEARANCE: Final = 2.0e-3  # m, chosen: in later passes, as little space is left
_PER_DEGREE: Final = 0.004  # cost of a weighted degree, chosen: of equally free poses the smallest is used
_MIN_GAIN: Final = 0.2  # chosen
_LARGE_UNITS: Final = 3  # chosen: from this pass on both organs are tried, and shoots with several leaves
_LAST_PASSES: Final = 4  # chosen: with all triangles
_LAST_POSES: Final = 10  # chosen
_LAST_REACH: Final = 1.6  # chosen: of the limits of rotations, where a leaf is not free within these
_LAST: Final = 99  # number of the first of these passes
_IDLE: Final = 3  # chosen: after so many passes in a row without any motion, others rarely find one


@dataclass(frozen=True, eq=False)
class _LeafPoses:
    """Candidate poses of some units, each moved alone; the first of each is the current one."""

    units: Sequence[MovableUnit]
    angles: FloatArray  # `(u, k, 2)` radians
    transforms: RigidTransforms  # `(u, k)`
    members: IndexArray  # `(m,)` organs of the units, unit after unit
    owner: IndexArray  # `(m,)` index of the unit of each
    inside: NDArray[np.bool_]  # `(u, n)` whether an organ belongs to a unit
    # `(m * k, ...)` of each member in each pose: the motion, and the corners of the box after it
    rotation: FloatArray
    shift: FloatArray
    low: FloatArray
    high: FloatArray

    @property
    def count(self) -> int:
        """Number of poses of a unit."""
        return int(self.angles.shape[1])


@dataclass(frozen=True, eq=False)
class _Judge:
    """How crossings in a pose are counted."""

    triangles: CoarseTriangles
    clearance: float  # metres
    per_crossing: float  # cost of a pair of triangles


class _PoseCosts:
    """Costs of poses, which grow as the organs near them are examined.

    Args:
        poses: of some units.
        entry: `(n,)` a member in a pose, as an index of its box, and
        other: `(n,)` an organ near it.
    """

    def __init__(self, poses: _LeafPoses, entry: IndexArray, other: IndexArray) -> None:
        weights = np.array([unit.weights for unit in poses.units])[:, None]
        self.effort = _PER_DEGREE * weighted_effort(poses.angles, weights)
        self.cost = self.effort.copy()
        self.unit, self.step = poses.owner[entry // poses.count], entry % poses.count
        self.other = other
        self._poses, self._entry = poses, entry

    @property
    def is_free(self) -> NDArray[np.bool_]:
        """`(u, k)` poses in which nothing has been found to cross."""
        return np.asarray(self.cost <= self.effort)

    def examine(self, rows: IndexArray, judge: _Judge) -> None:
        """Add the costs of what crosses in some of the pairs of a member and an organ."""
        moving, place = np.unique(self._entry[rows], return_inverse=True)
        poses = self._poses
        crossing = judge.triangles.count(
            poses.members[moving // poses.count],
            poses.rotation[moving],
            poses.shift[moving],
            place,
            self.other[rows],
            judge.clearance,
        )
        np.add.at(self.cost, (self.unit[rows], self.step[rows]), pair_cost(crossing, judge.per_crossing))


class LeafSolver:
    """Moves leaves and shoots that cross each other, other stalks, or stems they do not grow on.

    Fine triangles decide which organs cross, rough ones compare poses.

    All units that may free a pair are tried from the current poses. Then the best pose of each is taken, the
    largest gain first, unless it crosses one that has been taken already.

    Args:
        detector: of the organs.
        moving: the units of the same organs.
    """

    def __init__(self, detector: ContactDetector, moving: MovingUnits) -> None:
        self._detector, self._organs, self._moving = detector, detector.organs, moving
        self.crossings = LeafCrossings(self._organs)
        self._rough = CoarseTriangles(self._organs, self.crossings.examined, ROUGH)
        self._exact = _Judge(self.crossings.fine, CLEARANCE, PER_CROSSING)
        self._certain = _Judge(self._rough, 0.0, _PER_ROUGH_CROSSING)
        self._early = _Judge(self._rough, _LARGE_CLEARANCE, _PER_ROUGH_CROSSING)
        self._late = _Judge(self._rough, _ROUGH_CLEARANCE, _PER_ROUGH_CROSSING)

    def run(self, passes: int, rng: np.random.Generator) -> None:
        """Try to free all leaves, at most so many times; `rng` decides the candidate poses."""
        moved, idle = np.arange(len(self._organs)), 0
        for number in range(passes):
            self.crossings.update(moved)
            if not len(self.crossings.pairs):
                return
            moved = self._run_pass(number, rng)
            idle = 0 if len(moved) else idle + 1
            if number > _LARGE_UNITS and idle == _IDLE:
                return

    def run_last(self, rng: np.random.Generator) -> IndexArray:
        """Try to free leaves that touch others by any of their triangles; return the `(t, 2)` pairs left."""
        moved = np.arange(len(self._organs))
        for number in range(_LAST_PASSES + 1):
            self.crossings.update(moved, exact=True)
            pairs = self.crossings.pairs
            if not len(pairs) or number == _LAST_PASSES:
                break
            # All triangles of whatever may move, and of what it touches.
            touching = [
                unit.members for organ in np.unique(pairs) for unit in self._moving.of_organ(int(organ))
            ]
            members = np.unique(np.concatenate([*map(np.array, touching), pairs.ravel()]))
            self._exact = _Judge(CoarseTriangles(self._organs, members, ALL), 0.0, PER_CROSSING)
            moved = self._run_pass(_LAST + number, rng)
        return pairs

    def _run_pass(self, number: int, rng: np.random.Generator) -> IndexArray:
        """Try some units once, and move those that gain; return the organs that have moved."""
        before, phase = self._organs.moves, rng.uniform(0.0, 2.0 * np.pi, len(self._organs))
        self._rough.update()
        units = self._select_units(number)
        if units:
            poses = self._candidate_poses(units, number, phase)
            unit, pose, gain = self._best_poses(poses, self._crossing_cost(poses, number))
            if len(unit):
                chosen = self._take_compatible(poses, unit, pose, gain)
                angles = poses.angles[unit[chosen], pose[chosen]]
                self._moving.move([units[row] for row in unit[chosen].tolist()], angles)
        return np.flatnonzero(self._organs.moved_at > before)

    def _select_units(self, number: int) -> list[MovableUnit]:
        """The units to try: of every pair of one organ, in later passes of both."""
        pairs, leafy = self.crossings.pairs, self.crossings.leafy
        crossings = np.bincount(pairs.ravel(), minlength=len(self._organs))
        if number >= _LARGE_UNITS:
            chosen = np.unique(pairs)
        else:
            # The organ that crosses more others moves, or the blade; another choice in every other pass.
            rank = crossings + 0.5 * (self._organs.organ_class == LEAF)
            if number % 2:
                rank += np.arange(len(rank)) % 7 / 3.0  # chosen
            rank[~leafy] = -1.0
            one, two = pairs.T
            chosen = np.unique(np.where(rank[one] >= rank[two], one, two))
        units = {}
        # No rotation frees an organ that crosses very many others.
        for organ in chosen[(leafy & (crossings <= CROWDED))[chosen]].tolist():
            # Units that bear fruit stay.
            group = [unit for unit in self._moving.of_organ(organ) if unit.is_leafy]
            if group:
                # The blade alone and the leaf with its stalk in turns, later the shoot too.
                unit = group[number % min(len(group), 2 if number < _LARGE_UNITS else 3)]
                units[unit.root] = unit
        return list(units.values())

    def _candidate_poses(self, units: list[MovableUnit], number: int, phase: FloatArray) -> _LeafPoses:
        """The current pose of each unit, and others within the limits of its rotations."""
        is_last = number >= _LAST
        count = _LAST_POSES if is_last else _POSES[min(number, len(_POSES) - 1)]
        roots = np.array([unit.root for unit in units])
        current = self._moving.angles[roots][:, None]
        limits = (_LAST_REACH if is_last else 1.0) * np.array([unit.limits for unit in units])[:, None]
        angles = np.concatenate([current, limits * disc_points(count, phase[roots])], axis=1)
        transforms = find_joints(self._organs, units).transforms(angles - current)
        # Every member in every pose.
        members, owner = solid_members(self._organs, units)
        inside = np.zeros((len(units), len(self._organs)), dtype=bool)
        inside[owner, members] = True
        steps = angles.shape[1]
        entry = np.repeat(np.arange(len(members)), steps)
        part = transforms.select((owner[entry], np.tile(np.arange(steps), len(members))))
        boxes = self._rough.boxes(members[entry], part.rotation, part.shift)
        return _LeafPoses(
            units, angles, transforms, members, owner, inside, part.rotation, part.shift, *boxes
        )

    def _crossing_cost(self, poses: _LeafPoses, number: int) -> FloatArray:
        """`(u, k)` costs of what crosses in each pose; infinite for those that are not examined.

        Poses in which a unit still crosses what it crosses now are ruled out first. The others are compared
        with all organs in the order of their effort, until one is free.
        """
        costs = _PoseCosts(poses, *self._near_poses(poses))
        cost, unit, step = costs.cost, costs.unit, costs.step
        current, crossed = self.crossings.of_units(poses.inside)
        cost[:, 0] += current
        limit = cost[:, :1] - _MIN_GAIN
        # What a unit crosses now.
        is_present = crossed[unit, costs.other]
        present, waiting = np.flatnonzero(is_present), np.flatnonzero(~is_present)
        if number < _LARGE_UNITS:
            costs.examine(present, self._early)
        else:
            # Where even rough triangles cross, fine ones need not be compared.
            costs.examine(present, self._certain)
            costs.examine(present[costs.is_free[unit[present], step[present]]], self._exact)
        # Poses that may gain enough, by rank: the cheapest of each unit first, then twice as many.
        promising = cost < limit
        promising[:, 0] = False
        order = np.argsort(np.where(promising, cost, np.inf), axis=1, kind="stable")
        rank = np.argsort(order, axis=1, kind="stable")
        found, examined = np.zeros(len(cost), dtype=bool), ~promising
        start = 0
        while start < poses.count and len(waiting):
            stop = 2 * start + 1
            batch = promising & (rank >= start) & (rank < stop) & ~found[:, None]
            rows = batch[unit[waiting], step[waiting]]
            costs.examine(waiting[rows], self._early if number < _LARGE_UNITS else self._late)
            examined |= batch
            # A unit with a free pose needs no dearer one.
            found |= np.any(batch & costs.is_free, axis=1)
            waiting = waiting[~rows & ~found[unit[waiting]]]
            start = stop
        if not len(waiting):
            examined |= ~found[:, None]
        cost[~examined] = np.inf
        return cost

    def _near_poses(self, poses: _LeafPoses) -> tuple[IndexArray, IndexArray]:
        """Members in new poses, as indices of their boxes, and other organs with overlapping boxes."""
        organs, others = self._organs, self.crossings.examined
        members, owner, steps = poses.members, poses.owner, poses.count
        # Boxes around all poses of a member first.
        low, high = swept_boxes(organs, members, owner, poses.transforms)
        row, column = overlapping_boxes(
            low - _LARGE_CLEARANCE, high + _LARGE_CLEARANCE, organs.low[others], organs.high[others]
        )
        other = others[column]
        kept = must_not_cross(organs, members[row], other) & ~poses.inside[owner[row], other]
        # Then the box of each pose.
        entry = (row[kept, None] * steps + np.arange(1, steps)).ravel()
        other = np.repeat(other[kept], steps - 1)
        near = boxes_overlap(poses.low[entry], poses.high[entry], organs.low[other], organs.high[other])
        return entry[near], other[near]

    def _best_poses(self, poses: _LeafPoses, cost: FloatArray) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Units with a better pose that is not nearer to fruit, stems or the ground: unit, pose and gain."""
        order = np.argsort(cost, axis=1, kind="stable")[:, :_EXAMINED]
        gain = cost[:, :1] - np.take_along_axis(cost, order, axis=1)
        better = gain > _MIN_GAIN
        rules = PairRules(self._detector, hard=True)
        found = np.full(len(poses.units), -1)
        # The best pose of each unit first, the next only where that is not free.
        for place in range(order.shape[1]):
            rows = np.flatnonzero(better[:, place] & (found < 0))
            if not len(rows):
                break
            steps = np.stack([np.zeros(len(rows), dtype=np.intp), order[rows, place]], axis=1)
            transforms = poses.transforms.select((rows[:, None], steps))
            units = [poses.units[row] for row in rows.tolist()]
            contact = ContactCosts(rules, units, transforms).cost(np.arange(len(rows)), transforms, 1)
            found[rows[contact[:, 1] <= contact[:, 0]]] = place
        rows = np.flatnonzero(found >= 0)
        return rows, order[rows, found[rows]], gain[rows, found[rows]]

    def _take_compatible(
        self, poses: _LeafPoses, unit: IndexArray, pose: IndexArray, gain: FloatArray
    ) -> IndexArray:
        """Positions of the units to move, ascending: those of the largest gains that do not clash."""
        clashes = self._clashes(poses, unit, pose)
        taken: set[int] = set()
        for place in np.argsort(-gain, kind="stable").tolist():
            if taken.isdisjoint(clashes.get(place, ())):
                taken.add(place)
        return np.array(sorted(taken))

    def _clashes(self, poses: _LeafPoses, unit: IndexArray, pose: IndexArray) -> dict[int, list[int]]:
        """For some units in new poses, by position, those that cross each other there or share organs."""
        place = np.full(len(poses.units), -1)
        place[unit] = np.arange(len(unit))
        rows = np.flatnonzero(place[poses.owner] >= 0)
        organ, number = poses.members[rows], place[poses.owner[rows]]
        entry = rows * poses.count + pose[number]
        # Pairs of members of different units whose boxes overlap after both moves.
        low, high = poses.low[entry], poses.high[entry]
        i, j = overlapping_boxes(low, high, low, high)
        different = number[i] < number[j]
        i, j = i[different], j[different]
        kept = must_not_cross(self._organs, organ[i], organ[j])
        i, j = i[kept], j[kept]
        # Instead of moving both, move the first relative to the second.
        back = poses.rotation[entry[j]].swapaxes(1, 2)
        rotation = np.matmul(back, poses.rotation[entry[i]])
        shift = np.matmul(back, (poses.shift[entry[i]] - poses.shift[entry[j]])[:, :, None])[:, :, 0]
        crosses = self.crossings.fine.count(organ[i], rotation, shift, np.arange(len(i)), organ[j]) > 0
        # Units of the same organs clash wherever they are: each was tried with the other at its old pose.
        shared = nested_units([poses.units[row] for row in unit.tolist()])
        crossing = zip(number[i[crosses]].tolist(), number[j[crosses]].tolist(), strict=True)
        clashes: dict[int, list[int]] = {}
        for first, second in (*shared, *crossing):
            clashes.setdefault(first, []).append(second)
            clashes.setdefault(second, []).append(first)
        return clashes


def nested_units(units: Sequence[MovableUnit]) -> list[tuple[int, int]]:
    """Indices of units that have organs in common: the root of one is an organ of the other, named second."""
    unit_of_root = {unit.root: number for number, unit in enumerate(units)}
    return [
        (unit_of_root[member], number)
        for number, unit in enumerate(units)
        for member in unit.members
        if member in unit_of_root and member != unit.root
    ]

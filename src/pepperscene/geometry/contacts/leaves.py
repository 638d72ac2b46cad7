"""Leaves that pass through other leaves and stalks: the smallest of some rotations that frees them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.cost import ContactCosts, swept_boxes, weighted_effort
from pepperscene.geometry.contacts.crossings import ALL, CLEARANCE, ROUGH, CoarseTriangles
from pepperscene.geometry.contacts.detect import ContactDetector
from pepperscene.geometry.contacts.joints import MovableUnit, RigidTransforms, disc_points, find_joints
from pepperscene.geometry.contacts.organs import (
    LEAF,
    SHOOT,
    STALK,
    STEM,
    Organs,
    boxes_overlap,
    overlapping_boxes,
)
from pepperscene.geometry.contacts.pairs import CROWDED, PairRules
from pepperscene.geometry.mesh import FloatArray, IndexArray

PASSES: Final = 8
"""Chosen: later passes free few leaves."""

_POSES: Final = (4, 4, 5, 6, 8, 10, 12, 16)  # chosen: poses tried in each pass, then as in the last
_EXAMINED: Final = 3  # chosen: the best of these, examined with fruit, stems and the ground
_PER_CROSSING: Final = 0.06  # cost of a pair of fine triangles that cross, chosen, beside 1 for the organs
_PER_ROUGH_CROSSING: Final = 4.0 * _PER_CROSSING  # chosen: there are fewer rough triangles, in every way
_LARGE_CLEARANCE: Final = 2.5e-3  # m, chosen: of rough triangles, which are farther from the surface
_ROUGH_CLEARANCE: Final = 2.0e-3  # m, chosen: in later passes, as little space is left
_PER_DEGREE: Final = 0.004  # cost of a weighted degree, chosen: of equally free poses the smallest is used
_MIN_GAIN: Final = 0.2  # chosen
_LARGE_UNITS: Final = 3  # chosen: from this pass on both organs are tried, and shoots with several leaves
_LAST_PASSES: Final = 4  # chosen: with all triangles
_LAST_POSES: Final = 10  # chosen
_LAST_REACH: Final = 1.6  # chosen: of the limits of rotations, where a leaf is not free within these
_LAST: Final = 99  # number of the first of these passes
_NEAR: Final = 1e-3  # m, chosen: all triangles are compared where boxes of fine ones are closer than this
_IDLE: Final = 3  # chosen: after so many passes in a row without any motion, others rarely find one


@dataclass(frozen=True, eq=False)
class _Poses:
    """Candidate poses of the organs of some units, the current pose first."""

    units: Sequence[MovableUnit]
    angles: FloatArray  # `(u, k, 2)` radians
    transforms: RigidTransforms  # `(u, k)`
    members: IndexArray  # `(m,)` organs of the units, unit after unit
    owner: IndexArray  # `(m,)` index of the unit of each
    # `(m * k, ...)` of each member in each pose
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


class LeafSolver:
    """Moves leaves and shoots that cross each other, other stalks, or stems they do not grow on.

    Fine triangles decide which organs cross, rough ones compare poses.

    All units that may free a pair are tried from the current poses. Then the best pose of each is taken, the
    largest gain first, unless it crosses one that has been taken already.

    Args:
        detector: of the organs.
        angles: `(n, 2)` current angles of the units by their first organ; `move` changes them.
        move: moves units to some angles, `(u, 2)`.
        units_of: the units that an organ belongs to, smallest first.
    """

    def __init__(
        self,
        detector: ContactDetector,
        angles: FloatArray,
        move: Callable[[Sequence[MovableUnit], FloatArray], None],
        units_of: Callable[[int], list[MovableUnit]],
    ) -> None:
        self._detector, self._organs = detector, detector.organs
        self._angles, self._move, self._units_of = angles, move, units_of
        self._leafy = np.isin(self._organs.organ_class, [LEAF, SHOOT])
        self._leafy_units: dict[int, list[MovableUnit]] = {}
        self._examined = self._organs.of_class(LEAF, SHOOT, STALK, STEM)
        self._fine = CoarseTriangles(self._organs, self._examined)
        self._rough = CoarseTriangles(self._organs, self._examined, ROUGH)
        self._exact = _Judge(self._fine, CLEARANCE, _PER_CROSSING)
        self._certain = _Judge(self._rough, 0.0, _PER_ROUGH_CROSSING)
        self._early = _Judge(self._rough, _LARGE_CLEARANCE, _PER_ROUGH_CROSSING)
        self._late = _Judge(self._rough, _ROUGH_CLEARANCE, _PER_ROUGH_CROSSING)
        self._pairs = np.empty((0, 2), dtype=np.intp)
        self._costs = np.empty(0)  # of each pair

    def run(self, passes: int, rng: np.random.Generator) -> None:
        """Try to free all leaves, at most so many times; `rng` decides the candidate poses."""
        moved, idle = np.arange(len(self._organs)), 0
        for number in range(passes):
            self._detect(moved)
            if not len(self._pairs):
                return
            before = self._organs.moves
            self._run_pass(number, rng.uniform(0.0, 2.0 * np.pi, len(self._organs)))
            moved = np.flatnonzero(self._organs.moved_at > before)
            idle = 0 if len(moved) else idle + 1
            if number > _LARGE_UNITS and idle == _IDLE:
                return

    def run_last(self, rng: np.random.Generator) -> IndexArray:
        """Try to free leaves that touch others by any of their triangles; return the `(t, 2)` pairs left."""
        moved = np.arange(len(self._organs))
        for number in range(_LAST_PASSES + 1):
            self._detect(moved, last=True)
            if not len(self._pairs) or number == _LAST_PASSES:
                break
            touching = [unit.members for organ in np.unique(self._pairs) for unit in self._units_of(organ)]
            members = np.unique(np.concatenate([*map(np.array, touching), self._pairs.ravel()]))
            self._exact = _Judge(CoarseTriangles(self._organs, members, ALL), 0.0, _PER_CROSSING)
            before = self._organs.moves
            self._run_pass(_LAST + number, rng.uniform(0.0, 2.0 * np.pi, len(self._organs)))
            moved = np.flatnonzero(self._organs.moved_at > before)
        return self._pairs

    def _detect(self, moved: IndexArray, *, last: bool = False) -> None:
        """Update the pairs of organs that cross after some have moved; at last by all triangles."""
        organs = self._organs
        self._fine.update()
        self._rough.update()
        changed = np.zeros(len(organs), dtype=bool)
        changed[moved] = True
        leaves = self._examined[self._leafy[self._examined]]
        # Moved leaves with all organs; the other pairs have not changed, as nothing else moves here.
        row, column = organs.close_pairs(leaves[changed[leaves]], self._examined, CLEARANCE)
        one, two = leaves[changed[leaves]][row], self._examined[column]
        kept = _must_not_cross(organs, one, two)
        one, two = one[kept], two[kept]
        # Each pair once, by the organ that comes first.
        key = np.unique(np.minimum(one, two) * len(organs) + np.maximum(one, two))
        one, two = key // len(organs), key % len(organs)
        distinct, entry = np.unique(one, return_inverse=True)
        still = np.tile(np.eye(3), (len(distinct), 1, 1)), np.zeros((len(distinct), 3))
        number = self._fine.count(distinct, *still, entry, two, _NEAR if last else CLEARANCE, by_boxes=last)
        if last:
            near = np.flatnonzero(number)
            one, two = one[near], two[near]
            distinct, entry = np.unique(one, return_inverse=True)
            still = np.tile(np.eye(3), (len(distinct), 1, 1)), np.zeros((len(distinct), 3))
            triangles = CoarseTriangles(organs, np.union1d(one, two), ALL)
            number = triangles.count(distinct, *still, entry, two, 0.0)
        crosses = number > 0
        unchanged = ~changed[self._pairs].any(axis=1)
        self._pairs = np.concatenate([self._pairs[unchanged], np.stack([one, two], axis=1)[crosses]])
        self._costs = np.concatenate([self._costs[unchanged], _pair_cost(number[crosses], _PER_CROSSING)])

    def _run_pass(self, number: int, phase: FloatArray) -> None:
        """Try some units once, and move those that gain."""
        units = self._select_units(number)
        if not units:
            return
        count = _POSES[min(number, len(_POSES) - 1)] if number < _LAST else _LAST_POSES
        poses = self._candidate_poses(units, count, phase, _LAST_REACH if number >= _LAST else 1.0)
        unit, pose, gain = self._best_poses(poses, self._crossing_cost(poses, number))
        if not len(unit):
            return
        clashes = self._clashes(poses, unit, pose)
        taken: set[int] = set()
        for place in np.argsort(-gain, kind="stable").tolist():
            if taken.isdisjoint(clashes.get(place, ())):
                taken.add(place)
        chosen = np.array(sorted(taken))
        self._move([units[row] for row in unit[chosen].tolist()], poses.angles[unit[chosen], pose[chosen]])

    def _select_units(self, number: int) -> list[MovableUnit]:
        """The units to try: of every pair of one organ, in later passes of both."""
        one, two = self._pairs.T
        if number >= _LARGE_UNITS:
            chosen = np.unique(self._pairs)
        else:
            # The organ that crosses more others moves, or the blade.
            rank = np.bincount(self._pairs.ravel(), minlength=len(self._organs)).astype(np.float64)
            rank += 0.5 * (self._organs.organ_class == LEAF)
            if number % 2:
                rank += np.arange(len(rank)) % 7 / 3.0  # chosen: another choice in other passes
            rank[~self._leafy] = -1.0
            chosen = np.unique(np.where(rank[one] >= rank[two], one, two))
        units = {}
        # No rotation frees an organ that crosses very many others.
        crowded = np.bincount(self._pairs.ravel(), minlength=len(self._organs)) > CROWDED
        for organ in chosen[(self._leafy & ~crowded)[chosen]].tolist():
            # Units that bear fruit stay.
            group = self._leafy_units_of(organ)
            if group:
                # The blade alone and the leaf with its stalk in turns, later the shoot too.
                unit = group[number % min(len(group), 2 if number < _LARGE_UNITS else 3)]
                units[unit.root] = unit
        return list(units.values())

    def _leafy_units_of(self, organ: int) -> list[MovableUnit]:
        """The units of an organ that consist of leaves and shoots."""
        if organ not in self._leafy_units:
            self._leafy_units[organ] = [
                unit for unit in self._units_of(organ) if self._leafy[list(unit.members)].all()
            ]
        return self._leafy_units[organ]

    def _candidate_poses(
        self, units: list[MovableUnit], count: int, phase: FloatArray, reach: float = 1.0
    ) -> _Poses:
        roots = np.array([unit.root for unit in units])
        current, limits = self._angles[roots][:, None], np.array([unit.limits for unit in units])[:, None]
        angles = np.concatenate([current, reach * limits * disc_points(count, phase[roots])], axis=1)
        transforms = find_joints(self._organs, units).transforms(angles - current)
        members = np.concatenate([np.array(unit.members) for unit in units])
        owner = np.repeat(np.arange(len(units)), [len(unit.members) for unit in units])
        solid = self._organs.solid[members]
        members, owner = members[solid], owner[solid]
        steps = angles.shape[1]
        entry = np.repeat(np.arange(len(members)), steps)
        part = transforms.select((owner[entry], np.tile(np.arange(steps), len(members))))
        boxes = self._rough.boxes(members[entry], part.rotation, part.shift)
        return _Poses(units, angles, transforms, members, owner, part.rotation, part.shift, *boxes)

    def _crossing_cost(self, poses: _Poses, number: int) -> FloatArray:
        """`(u, k)` costs of what crosses in each pose; infinite for those that are not examined.

        Poses in which a unit still crosses what it crosses now are ruled out first. The others are compared
        with all organs in the order of their effort, until one is free.
        """
        owner, steps = poses.owner, poses.count
        inside = np.zeros((len(poses.units), len(self._organs)), dtype=bool)
        inside[owner, poses.members] = True
        current, crossed = self._present_crossings(inside)
        weights = np.array([unit.weights for unit in poses.units])[:, None]
        effort = _PER_DEGREE * weighted_effort(poses.angles, weights)
        cost = effort.copy()
        cost[:, 0] += current
        limit = cost[:, :1] - _MIN_GAIN
        entry, other = self._near_poses(poses, inside)
        unit, step = owner[entry // steps], entry % steps

        def examine(rows: IndexArray, judge: _Judge) -> None:
            moving, place = np.unique(entry[rows], return_inverse=True)
            crossing = judge.triangles.count(
                poses.members[moving // steps],
                poses.rotation[moving],
                poses.shift[moving],
                place,
                other[rows],
                judge.clearance,
            )
            np.add.at(cost, (unit[rows], step[rows]), _pair_cost(crossing, judge.per_crossing))

        first = crossed[unit, other]
        present = np.flatnonzero(first)
        if number < _LARGE_UNITS:
            examine(present, self._early)
        else:
            # Where even rough triangles cross, fine ones need not be compared.
            examine(present, self._certain)
            examine(present[(cost <= effort)[unit[present], step[present]]], self._exact)
        waiting = np.flatnonzero(~first)
        promising = cost < limit
        promising[:, 0] = False
        order = np.argsort(np.where(promising, cost, np.inf), axis=1, kind="stable")
        rank = np.argsort(order, axis=1, kind="stable")
        found, examined = np.zeros(len(cost), dtype=bool), ~promising
        start = 0
        while start < steps and len(waiting):
            stop = 2 * start + 1
            batch = promising & (rank >= start) & (rank < stop) & ~found[:, None]
            rows = batch[unit[waiting], step[waiting]]
            examine(waiting[rows], self._early if number < _LARGE_UNITS else self._late)
            examined |= batch
            found |= np.any(batch & (cost <= effort), axis=1)
            waiting = waiting[~rows & ~found[unit[waiting]]]
            start = stop
        if not len(waiting):
            examined |= ~found[:, None]
        cost[~examined] = np.inf
        return cost

    def _present_crossings(self, inside: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """`(u,)` costs of what units cross now, and `(u, n)` these organs, from their own organs `(u, n)`."""
        cost, crossed = np.zeros(len(inside)), np.zeros_like(inside)
        for one, two in (self._pairs.T, self._pairs.T[::-1]):
            unit, pair = np.nonzero(inside[:, one] & ~inside[:, two])
            np.add.at(cost, unit, self._costs[pair])
            crossed[unit, two[pair]] = True
        return cost, crossed

    def _near_poses(self, poses: _Poses, inside: NDArray[np.bool_]) -> tuple[IndexArray, IndexArray]:
        """Members in new poses, as indices of their boxes, and other organs with overlapping boxes."""
        organs, others = self._organs, self._examined
        members, owner, steps = poses.members, poses.owner, poses.count
        low, high = swept_boxes(organs, members, owner, poses.transforms)
        row, column = overlapping_boxes(
            low - _LARGE_CLEARANCE, high + _LARGE_CLEARANCE, organs.low[others], organs.high[others]
        )
        other = others[column]
        kept = _must_not_cross(organs, members[row], other) & ~inside[owner[row], other]
        entry = (row[kept, None] * steps + np.arange(1, steps)).ravel()
        other = np.repeat(other[kept], steps - 1)
        near = boxes_overlap(poses.low[entry], poses.high[entry], organs.low[other], organs.high[other])
        return entry[near], other[near]

    def _best_poses(self, poses: _Poses, cost: FloatArray) -> tuple[IndexArray, IndexArray, FloatArray]:
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

    def _clashes(self, poses: _Poses, unit: IndexArray, pose: IndexArray) -> dict[int, list[int]]:
        """For some units in new poses, by position, those that cross each other there or share organs."""
        place = np.full(len(poses.units), -1)
        place[unit] = np.arange(len(unit))
        rows = np.flatnonzero(place[poses.owner] >= 0)
        organ, number = poses.members[rows], place[poses.owner[rows]]
        entry = rows * poses.count + pose[number]
        low, high = poses.low[entry], poses.high[entry]
        i, j = overlapping_boxes(low, high, low, high)
        different = number[i] < number[j]
        i, j = i[different], j[different]
        kept = _must_not_cross(self._organs, organ[i], organ[j])
        k, m = i[kept], j[kept]
        # Instead of moving both, move the first relative to the second.
        back = poses.rotation[entry[m]].swapaxes(1, 2)
        rotation = np.matmul(back, poses.rotation[entry[k]])
        shift = np.matmul(back, (poses.shift[entry[k]] - poses.shift[entry[m]])[:, :, None])[:, :, 0]
        crosses = self._fine.count(organ[k], rotation, shift, np.arange(len(k)), organ[m]) > 0
        # Units of the same organs clash wherever they are: each was tried with the other at its old pose.
        shared = _nested_units([poses.units[row] for row in unit.tolist()])
        crossing = zip(number[k[crosses]].tolist(), number[m[crosses]].tolist(), strict=True)
        clashes: dict[int, list[int]] = {}
        for first, second in (*shared, *crossing):
            clashes.setdefault(first, []).append(second)
            clashes.setdefault(second, []).append(first)
        return clashes


def _pair_cost(number: IndexArray, each: float) -> FloatArray:
    """`(n,)` costs of pairs of organs of which so many triangles cross."""
    return np.asarray(np.where(number > 0, 1.0 + each * number, 0.0))


def _nested_units(units: Sequence[MovableUnit]) -> list[tuple[int, int]]:
    """Indices of units that have organs in common: the root of one is an organ of the other, named second."""
    unit_of_root = {unit.root: number for number, unit in enumerate(units)}
    return [
        (unit_of_root[member], number)
        for number, unit in enumerate(units)
        for member in unit.members
        if member in unit_of_root and member != unit.root
    ]


def _must_not_cross(organs: Organs, one: IndexArray, two: IndexArray) -> NDArray[np.bool_]:
    """`(n,)` whether two organs of different units are a blade and any other, or a leaf stalk and a stem.

    Organs that grow on one another are joined, and stalks that grow on the same organ may touch at their
    feet.
    """
    kind, parent = organs.organ_class, organs.parent
    kept = (one != two) & (parent[one] != two) & (parent[two] != one)
    blade = (kind[one] == LEAF) | (kind[two] == LEAF)
    siblings = (parent[one] == parent[two]) & (parent[one] >= 0)
    return np.asarray(kept & (blade | (~siblings & (kind[one] != STALK) & (kind[two] != STALK))))

"""Resolution of contacts: candidate poses of all organs that touch, and the smallest rotation that helps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.contacts.cost import ContactCosts, Poses, remaining_cost, weighted_effort
from pepperscene.geometry.contacts.detect import NEAR, ContactCounts, ContactDetector
from pepperscene.geometry.contacts.joints import (
    JointRotation,
    MovableUnit,
    MovingUnits,
    disc_points,
    find_joints,
    solid_members,
)
from pepperscene.geometry.contacts.leaf_crossings import deep_pairs, superfluous_leaves
from pepperscene.geometry.contacts.leaves import PASSES, LeafSolver
from pepperscene.geometry.contacts.organs import FRUIT, boxes_overlap
from pepperscene.geometry.contacts.pairs import CLEARANCE, CROWDED, PairRules
from pepperscene.geometry.mesh import FloatArray, IndexArray, Mesh

_TOUCHING: Final = -0.75 * CLEARANCE  # m, chosen: organs closer than this may touch between the sample points
_POSES: Final = (30, 60, 60, 120)  # chosen: candidate poses of a unit in each round, then as in the last
_EXAMINED: Final = (10, 20, 20, 120)  # chosen: the cheapest of these, examined with all contacts
_COARSE_STRIDE: Final = 16  # chosen: poses are compared by what remains of a contact with every 16th point
_FEW: Final = 8  # contacts, chosen: decides when units are tried, not which ones
_ROUNDS: Final = 18  # chosen: later rounds hardly resolve anything


@dataclass(frozen=True, eq=False)
class _Round:
    """One attempt to resolve all contacts."""

    number: int  # from 0
    phase: FloatArray  # `(n,)` radians, rotation of the pattern of candidate poses for each organ's unit

    @property
    def hard(self) -> bool:
        """Whether nothing gives way; in two of three rounds leaves give way."""
        return self.number % 3 == 2

    def counts(self) -> tuple[int, int]:
        """Numbers of candidate poses and of those examined."""
        row = min(self.number, len(_POSES) - 1)
        return _POSES[row], _EXAMINED[row]


@dataclass(frozen=True, eq=False)
class _Trial:
    """The best rotation of a unit."""

    gain: float  # how much less it costs than the current pose
    angles: FloatArray  # `(2,)` radians of the unit after it
    small: bool  # the unit then has no contacts and has rotated little
    resolves: frozenset[int]  # indices of the contacts that some rotation of the unit resolves


class ContactSolver:
    """Moves the organs of a detector to poses without contacts; `rng` decides the candidate poses."""

    def __init__(self, detector: ContactDetector, rng: np.random.Generator) -> None:
        self.detector, self.organs = detector, detector.organs
        self.moving = MovingUnits(detector.organs)
        self.touching = np.empty((0, 2), dtype=np.intp)  # leaves and others, after `free_leaves`
        self._rng = rng

    def run_round(self, number: int) -> bool:
        """Try to resolve every contact once; return whether there was any."""
        contacts = self._find_contacts()
        if not len(contacts):
            return False
        phase = self._rng.uniform(0.0, 2.0 * np.pi, len(self.organs))
        while len(contacts):
            contacts = self._resolve_some(contacts, _Round(number, phase))
            # A motion may have resolved others, too.
            contacts = contacts[self.detector.depths(*contacts.T) > _TOUCHING]
        return True

    def free_leaves(self, passes: int) -> None:
        """Rotate leaves and shoots that cross each other."""
        solver = LeafSolver(self.detector, self.moving)
        solver.run(passes, self._rng)
        if passes:
            self.touching = solver.run_last(self._rng)

    def leave_out_leaves(self) -> IndexArray:
        """Leave out leaves that are still deep in others; return their organs."""
        organs = superfluous_leaves(self.organs, deep_pairs(self.organs, self.touching))
        self.detector.leave_out(organs)
        return organs

    def _find_contacts(self) -> IndexArray:
        """`(c, 2)` fruit and the organs that touch them, blades and the stems that they run through.

        Those of crowded fruit are left out.
        """
        pairs = self.detector.fruit_pairs(), self.detector.blade_pairs()
        contacts = np.concatenate([group.deeper_than(_TOUCHING) for group in pairs])
        number = np.bincount(contacts.ravel(), minlength=len(self.organs))
        crowded = (number > CROWDED) & (self.organs.organ_class == FRUIT)
        return contacts[~crowded[contacts].any(axis=1)]

    def _resolve_some(self, contacts: IndexArray, current_round: _Round) -> IndexArray:
        """Move a unit on either side of each contact: the first for which a small rotation is enough, or the
        one that gains most. All units are tried from the current poses before any is moved.

        Returns:
            The contacts that must wait because something near them has moved.
        """
        candidates = [self._candidate_units(organ, other) for organ, other in contacts.tolist()]
        contacts_of: dict[int, list[int]] = {}
        for place, units in enumerate(candidates):
            for unit in units:
                contacts_of.setdefault(unit.root, []).append(place)
        trials: dict[int, _Trial] = {}
        best: dict[int, MovableUnit] = {}
        unresolved = list(range(len(candidates)))
        # In each turn the next unit of every contact that no small rotation has resolved.
        for turn in range(max(map(len, candidates))):
            unresolved = [place for place in unresolved if turn < len(candidates[place])]
            # Trying a few units too many costs less than trying units separately.
            stop = turn + 1 if len(unresolved) > _FEW else None
            next_units = {unit.root: unit for place in unresolved for unit in candidates[place][turn:stop]}
            units = [unit for root, unit in next_units.items() if root not in trials]
            if units:
                places = [contacts_of[unit.root] for unit in units]
                trials |= self._try_units(units, places, contacts, current_round)
            for place in unresolved.copy():
                unit = candidates[place][turn]
                new, old = trials[unit.root], best.get(place)
                if place in new.resolves and new.gain > (trials[old.root].gain if old else 0.0):
                    best[place] = unit
                    if new.small:
                        unresolved.remove(place)
        return self._move_best(contacts, best, {root: trial.angles for root, trial in trials.items()})

    def _candidate_units(self, organ: int, other: int) -> list[MovableUnit]:
        """The units whose motion may resolve a contact, those of the other organ first."""
        both = (*self.moving.of_organ(other), *self.moving.of_organ(organ))
        return [unit for unit in both if not (organ in unit.members and other in unit.members)]

    def _try_units(
        self, units: list[MovableUnit], places: list[list[int]], contacts: IndexArray, current_round: _Round
    ) -> dict[int, _Trial]:
        """Find the best rotation of each unit alone from the current poses, by root.

        `places` are the indices of the contacts that each unit is to resolve.
        """
        rules = PairRules(self.detector, hard=current_round.hard)
        poses, resolves = self._candidate_poses(units, places, contacts, current_round, rules)
        trials = {
            unit.root: _Trial(0.0, self.moving.angles[unit.root], False, contacts_resolved)
            for unit, contacts_resolved in zip(units, resolves, strict=True)
        }
        useful = np.flatnonzero([len(group) > 0 for group in resolves])
        if not len(useful):
            return trials
        # Of the cheapest poses, all contacts.
        poses = poses.cheapest(useful, current_round.counts()[1])
        useful_units = [units[row] for row in useful.tolist()]
        swept = np.concatenate([poses.angles, 0.5 * (poses.angles + poses.current)], axis=1)
        costs = ContactCosts(rules, useful_units, poses.transforms(swept))
        cheapest = poses.cost(costs).argmin(axis=1)
        better = np.flatnonzero(cheapest)
        if len(better):
            for row, gain, angles, small in poses.shorten(costs, better, cheapest[better]):
                root = useful_units[row].root
                trials[root] = _Trial(gain, angles, small, trials[root].resolves)
        return trials

    def _candidate_poses(
        self,
        units: list[MovableUnit],
        places: list[list[int]],
        contacts: IndexArray,
        current_round: _Round,
        rules: PairRules,
    ) -> tuple[Poses, list[frozenset[int]]]:
        """Poses of each unit, and the contacts that some of its poses resolve, or may resolve.

        Effort and what remains of the contacts are a lower bound of the cost of a pose.
        """
        roots = np.array([unit.root for unit in units])
        current = self.moving.angles[roots][:, None]
        weights = np.array([unit.weights for unit in units])[:, None]
        limits = np.array([unit.limits for unit in units])[:, None]
        pattern = disc_points(current_round.counts()[0], current_round.phase[roots])
        angles = np.concatenate([current, limits * pattern], axis=1)
        # Fruit on a stem only moves up: bending down would break the stalk.
        upwards = np.array([unit.on_stem and unit.bears_fruit for unit in units])
        angles[upwards, 1:, 1] = np.abs(angles[upwards, 1:, 1])
        joints = find_joints(self.organs, units)
        transforms = joints.transforms(angles - current)
        # What remains of the contacts that each unit is to resolve.
        owner = np.repeat(np.arange(len(units)), [len(group) for group in places])
        rows = np.concatenate(places)
        each = remaining_cost(rules, units, owner, contacts[rows], transforms, _COARSE_STRIDE)
        ends = np.any(each <= 0.0, axis=1) | (current_round.number > 0)
        resolves = [frozenset(rows[(owner == unit) & ends].tolist()) for unit in range(len(units))]
        remaining = np.zeros(angles.shape[:2])
        np.add.at(remaining, owner, each)
        effort = weighted_effort(angles, weights)
        return Poses(angles, current, weights, effort, remaining, joints), resolves

    def _move_best(
        self, contacts: IndexArray, best: dict[int, MovableUnit], angles: dict[int, FloatArray]
    ) -> IndexArray:
        """Move the best unit of each contact, in order, unless something near it has just moved.

        Returns:
            The contacts that must wait.
        """
        if not best:
            return contacts[:0]
        organs, is_fruit = self.organs, self.organs.organ_class == FRUIT
        units = list({unit.root: unit for unit in best.values()}.values())
        row_of_root = {unit.root: row for row, unit in enumerate(units)}
        change = np.array([angles[unit.root] - self.moving.angles[unit.root] for unit in units])
        transforms = find_joints(organs, units).transforms(change[:, None])
        members, owner = solid_members(organs, units)
        low, high = organs.boxes_after(members, transforms.rotation[owner, 0], transforms.shift[owner, 0])
        first = np.searchsorted(owner, np.arange(len(units) + 1))
        # A contact waits if its organs or its unit have moved, or a fruit is involved in what is now near.
        has_moved, moved_rows = np.zeros(len(organs), dtype=bool), np.empty(0, dtype=np.intp)
        waiting: list[int] = []
        moved_units: list[MovableUnit] = []
        for place, unit in best.items():
            row = row_of_root[unit.root]
            rows = np.arange(first[row], first[row + 1])
            if moved_units:
                near = boxes_overlap(
                    low[moved_rows], high[moved_rows], low[rows][:, None] - NEAR, high[rows][:, None] + NEAR
                )
                near &= is_fruit[members[rows]][:, None] | is_fruit[members[moved_rows]]
                if near.any() or has_moved[[*contacts[place], *unit.members]].any():
                    waiting.append(place)
                    continue
            moved_rows = np.append(moved_rows, rows)
            has_moved[list(unit.members)] = True
            moved_units.append(unit)
        self.moving.move(moved_units, np.array([angles[unit.root] for unit in moved_units]))
        return contacts[waiting]


@dataclass(frozen=True, eq=False)
class ResolvedMesh:
    """A mesh after its contacts have been resolved.

    Attributes:
        mesh: the same triangles, some of them moved, without those of the organs left out.
        motions: the rotations made, in order; each pivot refers to the mesh before that rotation.
        contacts: those that remain.
        left_out: organs that have no triangles any more; they keep their numbers.
    """

    mesh: Mesh
    motions: tuple[JointRotation, ...]
    contacts: ContactCounts
    left_out: tuple[int, ...] = ()


def resolve_contacts(
    mesh: Mesh,
    rng: np.random.Generator,
    *,
    between_plants: bool = False,
    rounds: int = _ROUNDS,
    free_leaves: bool = True,
) -> ResolvedMesh:
    """Rotate parts of plants so that fruit touches nothing and leaves do not run through each other or stems.

    Only the classes and parents of the instances are used, so this works for any crop. Units on either side
    of a contact are tried in a number of poses, and the smallest rotation that resolves it is made; leaves
    give way before fruit does. The same mesh and state of the generator give the same mesh, bit for bit.

    Args:
        mesh: one or more plants, z up, with the ground at z = 0.
        rng: for the candidate poses.
        between_plants: resolve only contacts between different plants (`Instance.plant`), taking those within
            each plant as resolved; none of those gets worse. Leaves that cross others of their own plant are
            tried too. A leaf that stays millimetres deep in another is left out, as if a grower had cut it:
            less than one of a hundred.
        rounds: maximum number of attempts to resolve all that still touches.
        free_leaves: also rotate leaves that cross each other, after all other contacts.

    Raises:
        ValueError: two instances of the mesh share vertices.
    """
    solver = ContactSolver(ContactDetector(mesh, between_plants=between_plants), rng)
    for number in range(rounds):
        if not solver.run_round(number):
            break
    # Between plants, a single one has nothing to resolve: it stays the plant that is grown alone.
    if free_leaves and (not between_plants or len({item.plant for item in mesh.instances}) > 1):
        solver.free_leaves(min(rounds, PASSES))
    left_out = solver.leave_out_leaves() if between_plants else np.empty(0, dtype=np.intp)
    counts = solver.detector.counts()
    moved = solver.organs.current_mesh()
    result = moved.without_triangles(left_out) if len(left_out) else moved
    return ResolvedMesh(result, tuple(solver.moving.motions), counts, tuple(left_out.tolist()))

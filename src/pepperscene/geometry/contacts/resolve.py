"""Which part to turn, and how far: all that touches is tried in many poses, and the least turn is taken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.contacts.cost import CLEAR, ContactCosts, boxes, left_of
from pepperscene.geometry.contacts.detect import NEAR, ContactBodies, ContactCounts, counted
from pepperscene.geometry.contacts.joints import Motion, TurningUnit, joint, joints, rotations, units_of
from pepperscene.geometry.contacts.organs import FRUIT, Indices, Vectors
from pepperscene.geometry.contacts.pairs import Turns
from pepperscene.geometry.contacts.poses import Poses, disc, effort
from pepperscene.geometry.mesh import Mesh

_CLOSE: Final = -0.75 * CLEAR  # m, chosen; what comes nearer may touch between the points that are looked at
_POSES: Final = (30, 60, 60, 120)  # chosen: poses that a unit might take in each round, then as in the last
_TRIES: Final = (10, 20, 20, 120)  # chosen: the cheapest of these, which are looked at all around
_ROUGHLY: Final = 16  # chosen: of so many points one is looked at while poses are compared by the contact
_FEW: Final = 8  # contacts, chosen: what is tried does not depend on it, only when


@dataclass(frozen=True, eq=False)
class _Tried:
    """What the best turn of a unit brings.

    Attributes:
        gain: how much less it costs than no turn.
        angles: `(2,)` radians at which the unit stands then.
        small: it runs into nothing then and has turned little.
        helps: the contacts, by their places, that some turn of it ends.
    """

    gain: float
    angles: Vectors
    small: bool
    helps: frozenset[int]


class Search:
    """Organs on their way to poses in which they do not touch."""

    def __init__(self, bodies: ContactBodies, rng: np.random.Generator) -> None:
        self.bodies, self.organs = bodies, bodies.organs
        self.motions: list[Motion] = []
        self._rng = rng
        self._angles = np.zeros((len(self.organs), 2))
        self._units: dict[int, list[TurningUnit]] = {}

    def round(self, number: int) -> bool:
        """Try to part everything that touches, once; tells whether anything did."""
        found = self._touching()
        # How the poses of each unit lie in this round.
        phase = self._rng.uniform(0.0, 2.0 * np.pi, len(self.organs)) if len(found) else np.empty(0)
        left = found
        while len(left):
            left = self._part(left, phase, number)
            # An earlier turn may have parted them.
            left = left[self.bodies.depths(*left.T) > _CLOSE]
        return bool(len(found))

    def _touching(self) -> Indices:
        """`(c, 2)` fruit and what runs into it, blades and the stems that they run through."""
        bodies = self.bodies
        near = bodies.into_fruit(bodies.fruit.tolist()) | bodies.into_stems(bodies.blades.tolist())
        pairs = [
            (organ, other)
            for organ, some in near.items()
            for other in some.others[some.depth > _CLOSE].tolist()
        ]
        return np.array(pairs, dtype=np.intp).reshape(-1, 2)

    def _part(self, contacts: Indices, phase: Vectors, number: int) -> Indices:
        """Turn a unit of either side of each contact: the first that a small turn frees, else the one that
        gains most. All units are tried as all stands before any is turned.

        Returns:
            The contacts that wait because something near them was turned first.
        """
        sides = [self._sides(organ, other) for organ, other in contacts.tolist()]
        of_root: dict[int, list[int]] = {}
        for place, units in enumerate(sides):
            for unit in units:
                of_root.setdefault(unit.root, []).append(place)
        tried: dict[int, _Tried] = {}
        best: dict[int, TurningUnit] = {}
        left = list(range(len(sides)))
        for turn in range(max(map(len, sides))):
            left = [place for place in left if turn < len(sides[place])]
            # To try a few more than are needed costs less than to try them one after the other.
            ahead = turn + 1 if len(left) > _FEW else None
            wanted = {unit.root: unit for place in left for unit in sides[place][turn:ahead]}
            units = [unit for root, unit in wanted.items() if root not in tried]
            if units:
                places = [of_root[unit.root] for unit in units]
                tried |= self._tried(units, places, contacts, phase, number)
            for place in left.copy():
                unit = sides[place][turn]
                new, old = tried[unit.root], best.get(place)
                if place in new.helps and new.gain > (tried[old.root].gain if old else 0.0):
                    best[place] = unit
                    if new.small:
                        left.remove(place)
        return self._turned(contacts, best, {root: one.angles for root, one in tried.items()})

    def _sides(self, organ: int, other: int) -> list[TurningUnit]:
        """The units whose turns may end a contact, the other's first."""
        for one in (organ, other):
            if one not in self._units:
                self._units[one] = units_of(self.organs, one)
        both = (*self._units[other], *self._units[organ])
        return [unit for unit in both if not (organ in unit.members and other in unit.members)]

    def _tried(
        self,
        units: list[TurningUnit],
        places: list[list[int]],
        contacts: Indices,
        phase: Vectors,
        number: int,
    ) -> dict[int, _Tried]:
        """What the best turn of each unit brings, as all stands.

        Args:
            units: what to try, each alone.
            places: of the contacts that each is to end.
            contacts: `(c, 2)`.
            phase: `(n,)` radians, by which the poses of each organ's unit are turned.
            number: of the round.
        """
        # Leaves give way twice, then all is taken as it stands for once.
        hard = number % 3 == 2
        count, tries = (some[min(number, len(some) - 1)] for some in (_POSES, _TRIES))
        poses, helps = self._posed(units, places, contacts, phase, count, hard=hard, first=number == 0)
        found = {
            unit.root: _Tried(0.0, self._angles[unit.root], False, some)
            for unit, some in zip(units, helps, strict=True)
        }
        kept = np.flatnonzero([len(some) > 0 for some in helps])
        if not len(kept):
            return found
        # Of the cheapest ones, all that they run into.
        poses, some_units = poses.cheapest(kept, tries), [units[one] for one in kept.tolist()]
        swept = np.concatenate([poses.angles, 0.5 * (poses.angles + poses.spent)], axis=1)
        around = ContactCosts(self.bodies, some_units, poses.turns(swept), hard=hard)
        picked = poses.cost(around).argmin(axis=1)
        better = np.flatnonzero(picked)
        if not len(better):
            return found
        for row, (gain, stands, small) in poses.shortened(around, better, picked[better]):
            root = some_units[row].root
            found[root] = _Tried(gain, stands, small, found[root].helps)
        return found

    def _posed(
        self,
        units: list[TurningUnit],
        places: list[list[int]],
        contacts: Indices,
        phase: Vectors,
        count: int,
        *,
        hard: bool,
        first: bool,
    ) -> tuple[Poses, list[frozenset[int]]]:
        """So many poses of each unit, and the contacts that some of its poses end, or may end.

        What a pose costs at least is its effort, and what is left of the contacts at hand.
        """
        roots = np.array([unit.root for unit in units])
        spent, weights = self._angles[roots][:, None], np.array([unit.weights for unit in units])[:, None]
        limits = np.array([unit.limits for unit in units])[:, None]
        angles = np.concatenate([spent, limits * disc(count, phase[roots])], axis=1)
        # Fruit on a stem is lifted only: hanging lower would break the stalk.
        lifted = np.array([unit.on_stem and unit.bears_fruit for unit in units])
        angles[lifted, 1:, 1] = np.abs(angles[lifted, 1:, 1])
        way = joints(self.organs, units)
        owner, rows = np.repeat(np.arange(len(units)), [len(one) for one in places]), np.concatenate(places)
        turns = Turns(*way.turns(angles - spent))
        each = left_of(self.bodies, units, owner, contacts[rows], turns, _ROUGHLY, hard=hard)
        ends = np.any(each <= 0.0, axis=1) | (not first)
        helps = [frozenset(rows[(owner == one) & ends].tolist()) for one in range(len(units))]
        left = np.zeros(angles.shape[:2])
        np.add.at(left, owner, each)
        return Poses(angles, spent, weights, effort(angles, weights), left, way), helps

    def _turned(self, contacts: Indices, best: dict[int, TurningUnit], angles: dict[int, Vectors]) -> Indices:
        """Turn the best unit for each contact, in order, but not where something was turned just now.

        Returns:
            The contacts that wait.
        """
        organs, before = self.organs, self.organs.turns
        waiting = []
        for place, unit in best.items():
            members = np.array(unit.members)
            just = np.flatnonzero(organs.stamp > before)
            if len(just) and (
                np.any(organs.stamp[contacts[place]] > before)
                or np.any(organs.stamp[members] > before)
                or self._meets(unit, angles[unit.root], just)
            ):
                waiting.append(place)
            else:
                self._turn(unit, angles[unit.root])
        return contacts[waiting]

    def _meets(self, unit: TurningUnit, angles: Vectors, just: Indices) -> bool:
        """Whether a unit's organs would come near to others; of either one has to be fruit."""
        organs, members = self.organs, np.array(unit.members)
        members, just = members[organs.solid[members]], just[organs.solid[just]]
        way = joint(organs, unit).turns((angles - self._angles[unit.root])[None])
        turns = Turns(*(part[None] for part in way))
        low, high = boxes(organs, members, np.zeros(len(members), dtype=np.intp), turns)
        near = np.all(organs.low[just] < high[:, None] + NEAR, axis=2)
        near &= np.all(organs.high[just] > low[:, None] - NEAR, axis=2)
        fruit = organs.organ_class == FRUIT
        return bool(np.any(near & (fruit[members][:, None] | fruit[just])))

    def _turn(self, unit: TurningUnit, angles: Vectors) -> None:
        """Turn a unit to some angles."""
        spent = self._angles[unit.root].copy()
        way = joint(self.organs, unit)
        around, up = angles - spent
        for axis, angle, pivot in ((way.across, up, way.foot), (way.axis, around, way.middle)):
            if angle != 0.0:
                self.motions.append(Motion(unit.root, rotations(axis, np.array([angle]))[0], pivot))
        rotation, shift = (part[0] for part in way.turns(angles[None] - spent))
        self.organs.turn(unit.members, rotation, shift)
        self._angles[unit.root] = angles


_ROUNDS: Final = 18  # chosen: hardly anything is mended later


@dataclass(frozen=True, eq=False)
class ResolvedMesh:
    """A mesh whose parts run into each other no longer.

    Attributes:
        mesh: the same triangles, some of them moved.
        motions: what was turned, in order; each pivot is told in the mesh as it stood before that turn.
        contacts: what still touches.
    """

    mesh: Mesh
    motions: tuple[Motion, ...]
    contacts: ContactCounts


def resolve_contacts(
    mesh: Mesh, rng: np.random.Generator, *, between_plants: bool = False, rounds: int = _ROUNDS
) -> ResolvedMesh:
    """Turn parts of plants so that fruit runs into nothing and blades do not run through stems.

    Works on classes and parents of the instances alone, so for any crop. Whatever collides is tried in a
    number of poses, and the least turn of either side that frees both is taken; leaves give way before fruit
    does. The same mesh and state of the generator give the same mesh, bit for bit.

    Args:
        mesh: one plant or several, z up, with the ground at z = 0.
        rng: for the poses that are tried.
        between_plants: mend only what stands between different plants (`Instance.plant`), taking each plant
            as settled in itself; nothing within a plant gets worse.
        rounds: how often all that still touches is tried again, at most.

    Raises:
        ValueError: two instances of the mesh share vertices.
    """
    search = Search(ContactBodies(mesh, between_plants=between_plants), rng)
    for number in range(rounds):
        if not search.round(number):
            break
    return ResolvedMesh(search.organs.turned_mesh(), tuple(search.motions), counted(search.bodies))

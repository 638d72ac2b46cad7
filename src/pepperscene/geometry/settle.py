"""No impossible plants: what runs into a fruit or through a stem is turned where it joins the plant.

Barth et al. 2018 (section 2.3) looked for such plants by hand and replaced them. Here fruit swings on its
stalk or goes around its node, leaves turn and tilt at their joints; every part stays rigid and keeps its
length, and of the turns that free it the smallest is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contact import Bodies, Contacts, counted
from pepperscene.geometry.contact_organs import Vectors
from pepperscene.geometry.contact_search import CLEAR, Obstacle, Surroundings
from pepperscene.geometry.contact_units import Unit, joint, rotations, units_of
from pepperscene.geometry.mesh import Mesh
from pepperscene.grammar.plant import Plant

_ROUNDS: Final = 9  # chosen: hardly anything is mended later
_CLOSE: Final = -0.75 * CLEAR  # m, chosen; what comes nearer may touch between the points that are looked at
_POSES: Final = 30  # chosen: poses that a unit might take; twice, three times as many in later rounds
_EVERY: Final = 4  # of so many points one is looked at while a pose is sought
_TRIES: Final = 10  # chosen: those that are looked at all around
_FIRST: Final = 4  # chosen: of these, those that are looked at first
_SMALL: Final = 20.0  # weighted degrees, chosen: a turn that is taken without asking what else could turn
_PARTS: Final = np.array([0.0, 0.2, 0.4, 0.55, 0.7, 0.8, 0.9, 1.0])  # of a turn that helps: less may do


@dataclass(frozen=True, eq=False)
class Motion:
    """One turn of a part of a plant.

    Attributes:
        instance: the organ that turns, with all that grows on it.
        rotation: `(3, 3)`.
        pivot: `(3,)` metres, the point that stays.
    """

    instance: int
    rotation: NDArray[np.float64]
    pivot: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Settled:
    """A mesh whose parts run into each other no longer.

    Attributes:
        mesh: the same triangles, some of them moved.
        motions: what was turned, in order; each pivot is told in the mesh as it stood before that turn.
        contacts: what still touches.
    """

    mesh: Mesh
    motions: tuple[Motion, ...]
    contacts: Contacts


def settle(
    mesh: Mesh, rng: np.random.Generator, *, between_plants: bool = False, rounds: int = _ROUNDS
) -> Settled:
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
    search = _Search(Bodies(mesh, between_plants=between_plants), rng)
    for number in range(rounds):
        # Leaves give way twice, then all is taken as it stands for once.
        if not search.round(hard=number % 3 == 2, patience=1 + min(number, 1)):
            break
    return Settled(search.organs.turned_mesh(), tuple(search.motions), counted(search.bodies))


def moved_plant(plant: Plant, motions: Sequence[Motion]) -> Plant:
    """The plant whose mesh was settled, with its organs' curves and upper sides turned likewise.

    Args:
        plant: whose organ i is instance i of the mesh.
        motions: of that mesh.

    Raises:
        ValueError: a motion's instance is no organ of the plant.
    """
    organs = list(plant.organs)
    for motion in motions:
        if not 0 <= motion.instance < len(organs):
            raise ValueError(f"instance {motion.instance} is no organ of a plant of {len(organs)}")
        turned = np.zeros(len(organs), dtype=bool)
        turned[motion.instance] = True
        # A parent stands before its children.
        for index, organ in enumerate(organs):
            turned[index] |= organ.parent >= 0 and turned[organ.parent]
        for index in np.flatnonzero(turned).tolist():
            organ = organs[index]
            curve = (organ.curve - motion.pivot) @ motion.rotation.T + motion.pivot
            organs[index] = replace(organ, curve=curve, up=motion.rotation @ organ.up)
    return replace(plant, organs=tuple(organs))


class _Search:
    """Organs on their way to poses in which they do not touch."""

    def __init__(self, bodies: Bodies, rng: np.random.Generator) -> None:
        self.bodies, self.organs = bodies, bodies.organs
        self.motions: list[Motion] = []
        self._rng = rng
        self._angles: dict[int, Vectors] = {}

    def round(self, *, hard: bool, patience: int) -> bool:
        """Try to part everything that touches, once; tells whether anything did."""
        found = self._touching()
        for organ, other in found:
            # An earlier turn may have parted them.
            if self.bodies.depth(organ, other) > _CLOSE:
                self._part(organ, other, hard, patience)
        return bool(found)

    def _touching(self) -> list[tuple[int, int]]:
        """Fruit and what runs into it, blades and the stems that they run through."""
        bodies = self.bodies
        near = bodies.into_fruit(bodies.fruit.tolist()) | bodies.into_stems(bodies.blades.tolist())
        return [
            (organ, other)
            for organ, some in near.items()
            for other in some.others[some.depth > _CLOSE].tolist()
        ]

    def _part(self, organ: int, other: int, hard: bool, patience: int) -> None:
        """Turn a unit of either side: the first that a small turn frees, else the one that gains most."""
        best: tuple[float, Unit, Vectors] | None = None
        for unit in (*units_of(self.organs, other), *units_of(self.organs, organ)):
            if organ in unit.members and other in unit.members:
                continue
            gain, angles, free = self._tried(unit, organ, other, hard, patience)
            if gain > (best[0] if best else 0.0):
                best = gain, unit, angles
                if free and unit.effort(angles) < _SMALL:
                    break
        if best:
            self._turn(best[1], best[2])

    def _tried(
        self, unit: Unit, organ: int, other: int, hard: bool, patience: int
    ) -> tuple[float, Vectors, bool]:
        """How much the best turn of a unit gains, the angles that it stands at then, whether it is free."""
        way, spent = joint(self.organs, unit), self._angles.get(unit.root, np.zeros(2))
        angles = np.concatenate([spent[None], unit.limits * _disc(_POSES * patience, self._rng)])
        if unit.on_stem and unit.bears_fruit:
            # Lifted only: hanging lower would break the stalk.
            angles[1:, 1] = np.abs(angles[1:, 1])
        around = Surroundings(self.bodies, unit, hard=hard)
        # What each pose costs at least: its effort, and what is left of the contact at hand.
        rotation, shift = way.turns(angles - spent)
        effort = unit.effort(angles)
        left = around.pair(organ, other, rotation, shift, _EVERY)
        if patience == 1 and np.all(left > 0.0):
            return 0.0, spent, False
        least = effort + left
        order = 1 + np.argsort(least[1:], kind="stable")
        # Of the cheapest ones, all that they run into: a few at first, as one of these may be free.
        some = np.concatenate([[0], order[: _TRIES * patience]])
        halves = spent + 0.5 * (angles[some] - spent)
        met = around.obstacles(*way.turns(np.concatenate([angles[some], halves]) - spent))
        cost = least[some]
        for start in (1, 1 + _FIRST):
            rows = np.concatenate(
                [[0], np.arange(start, min(start + _FIRST, len(some)) if start == 1 else len(some))]
            )
            into = _total(met, rotation[some[rows]], shift[some[rows]], _EVERY)
            cost[rows] = effort[some[rows]] + np.maximum(left[some[rows]], into)
            rest = least[some[1 + _FIRST :]]
            if not len(rest) or cost[: 1 + _FIRST].min() <= rest[0]:
                cost = cost[: 1 + _FIRST]
                break
        if np.argmin(cost) == 0:
            return 0.0, spent, False
        # Part of the turn may do, and now every point counts.
        parts = spent + _PARTS[:, None] * (angles[some[np.argmin(cost)]] - spent)
        effort = unit.effort(parts)
        cost = effort + _total(met, *way.turns(parts - spent))
        chosen = int(np.argmin(cost))
        return float(cost[0] - cost[chosen]), parts[chosen], bool(cost[chosen] == effort[chosen])

    def _turn(self, unit: Unit, angles: Vectors) -> None:
        """Turn a unit to some angles."""
        spent = self._angles.get(unit.root, np.zeros(2))
        way = joint(self.organs, unit)
        around, up = angles - spent
        for axis, angle, pivot in ((way.across, up, way.foot), (way.axis, around, way.middle)):
            if angle != 0.0:
                self.motions.append(Motion(unit.root, rotations(axis, np.array([angle]))[0], pivot))
        rotation, shift = (part[0] for part in way.turns(angles[None] - spent))
        self.organs.turn(unit.members, rotation, shift)
        self._angles[unit.root] = angles


def _total(obstacles: list[Obstacle], rotation: Vectors, shift: Vectors, every: int = 1) -> Vectors:
    """`(k,)` cost of all that some turns run into."""
    return np.asarray(sum((one.cost(rotation, shift, every) for one in obstacles), np.zeros(len(rotation))))


def _disc(count: int, rng: np.random.Generator) -> Vectors:
    """`(count, 2)` points evenly over the unit disc, from its middle outwards, turned by a random angle."""
    step = np.arange(count) + 0.5
    angle = rng.uniform(0.0, 2.0 * np.pi) + np.pi * (3.0 - np.sqrt(5.0)) * step
    return np.asarray((step / count)[:, None] ** 0.7 * np.stack([np.cos(angle), np.sin(angle)], axis=1))

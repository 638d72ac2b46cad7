"""Turns of parts of a plant about their joints, and a plant whose organs follow them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.organs import (
    FLOWER,
    FRUIT,
    LEAF,
    SHOOT,
    STALK,
    STEM,
    Indices,
    Organs,
    Vectors,
)
from pepperscene.grammar.plant import Plant


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


def move_plant(plant: Plant, motions: Sequence[Motion]) -> Plant:
    """The plant whose mesh was settled, with its organs' curves and upper sides turned likewise.

    Args:
        plant: whose organ i is instance i of the mesh.
        motions: of that mesh.

    Raises:
        ValueError: a motion's instance is no organ of the plant.
    """
    organs = plant.organs
    curves, ups = [organ.curve for organ in organs], [organ.up for organ in organs]
    moved = set()
    for motion in motions:
        if not 0 <= motion.instance < len(organs):
            raise ValueError(f"instance {motion.instance} is no organ of a plant of {len(organs)}")
        turned = {motion.instance}
        # A parent stands before its children.
        for index in range(motion.instance + 1, len(organs)):
            if organs[index].parent in turned:
                turned.add(index)
        for index in turned:
            curves[index] = (curves[index] - motion.pivot) @ motion.rotation.T + motion.pivot
            ups[index] = motion.rotation @ ups[index]
        moved |= turned
    return replace(
        plant,
        organs=tuple(
            replace(organ, curve=curves[index], up=ups[index]) if index in moved else organ
            for index, organ in enumerate(organs)
        ),
    )


# Widest turns, radians, chosen so that parts still grow as they do: on a stem around it, elsewhere aside; and
# up or down. By (grows on a stem, bears fruit).
_LIMITS: Final = {
    (True, True): np.radians([60.0, 30.0]),
    (True, False): np.radians([60.0, 25.0]),
    (False, True): np.radians([35.0, 35.0]),
    (False, False): np.radians([35.0, 25.0]),
}
# How much a radian of either turn weighs. Fruit hangs: what tilts it weighs more than what takes it round.
_WEIGHTS: Final = {
    (True, True): np.array([1.0, 1.5]),
    (True, False): np.array([0.8, 1.0]),
    (False, True): np.array([1.6, 1.6]),
    (False, False): np.array([0.8, 0.8]),
}


@dataclass(frozen=True, eq=False)
class TurningUnit:
    """A subtree that turns as one body about where it joins the rest.

    Attributes:
        root: the organ that it starts with.
        members: all its organs.
        on_stem: it grows on a stem, around which it can go.
        bears_fruit: its root carries fruit rather than leaves.
    """

    root: int
    members: tuple[int, ...]
    on_stem: bool
    bears_fruit: bool

    @property
    def limits(self) -> Vectors:
        """`(2,)` radians, the widest turns."""
        return _LIMITS[self.on_stem, self.bears_fruit]

    @property
    def weights(self) -> Vectors:
        """`(2,)` how much a degree of either turn weighs."""
        return _WEIGHTS[self.on_stem, self.bears_fruit]


def units_of(organs: Organs, organ: int) -> list[TurningUnit]:
    """The units that an organ moves with, the smallest first; none for stems, cords and cuts."""
    found = []
    for root, above in pairwise([organ, *organs.ancestors(organ)]):
        kind = organs.organ_class[root]
        if kind not in (FLOWER, LEAF, SHOOT, FRUIT, STALK):
            break
        # A fruit does not turn within its calyx.
        if kind == FRUIT and organs.mesh.instances[above].kind == "calyx":
            continue
        on_stem = bool(organs.organ_class[above] == STEM)
        found.append(TurningUnit(root, tuple(organs.subtree(root)), on_stem, kind in (FRUIT, STALK)))
    return found


@dataclass(frozen=True, eq=False)
class Joint:
    """How a unit turns, as it stands: up or down about its foot, then around or aside; or many units.

    Attributes:
        foot: `(..., 3)` metres, where the unit starts.
        across: `(..., 3)` level axis through the foot; right-handed turns lift the unit.
        middle: `(..., 3)` metres, on the axis of the second turn.
        axis: `(..., 3)` that axis.
    """

    foot: Vectors
    across: Vectors
    middle: Vectors
    axis: Vectors

    def turns(self, angles: Vectors) -> tuple[Vectors, Vectors]:
        """Rotations `(..., k, 3, 3)`, shifts `(..., k, 3)` of turns by `(..., k, 2)` radians: around, up."""
        up, around = rotations(self.across, angles[..., 1]), rotations(self.axis, angles[..., 0])
        foot, middle = self.foot[..., None, :], self.middle[..., None, :]
        after_up = foot - _turned(up, foot)
        return around @ up, _turned(around, after_up - middle) + middle

    def some(self, rows: Indices) -> Joint:
        """Some of many."""
        return Joint(self.foot[rows], self.across[rows], self.middle[rows], self.axis[rows])


def joint(organs: Organs, unit: TurningUnit) -> Joint:
    """Where and how a unit turns.

    What grows on a stem goes around the vertical through the middle of its node; so it keeps its inclination,
    and its foot stays in the node. What grows on other parts turns about its foot, across its own direction.
    """
    foot, vertical = organs.foot(unit.root), np.array([0.0, 0.0, 1.0])
    if unit.on_stem:
        middle = organs.middle(int(organs.parent[unit.root]))
        out, axis = foot - middle, vertical
    else:
        middle, axis = foot, vertical
        out = organs.middle(unit.root) - foot
    level = np.hypot(out[0], out[1])
    across = np.array([out[1], -out[0], 0.0]) / level if level > 1e-9 else np.array([1.0, 0.0, 0.0])
    if not unit.on_stem and np.any(out):
        axis = _crossed(across, out)
        axis /= np.sqrt(axis @ axis)
    return Joint(foot, across, middle, axis)


def joints(organs: Organs, units: Sequence[TurningUnit]) -> Joint:
    """The joints of some units, `(u, 3)` each."""
    each = [joint(organs, unit) for unit in units]
    return Joint(
        np.array([one.foot for one in each]),
        np.array([one.across for one in each]),
        np.array([one.middle for one in each]),
        np.array([one.axis for one in each]),
    )


def rotations(axis: Vectors, angles: Vectors) -> Vectors:
    """`(..., k, 3, 3)` rotations by `(..., k)` radians about unit axes `(..., 3)` (Rodrigues)."""
    skew = np.zeros((*axis.shape[:-1], 1, 3, 3))
    for row, column, other in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        skew[..., 0, row, column], skew[..., 0, column, row] = axis[..., other], -axis[..., other]
    sine, cosine = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.asarray(np.eye(3) + sine * skew + (1.0 - cosine) * (skew @ skew))


def _crossed(one: Vectors, other: Vectors) -> Vectors:
    """`(3,)` the vector product of two; `numpy.cross` takes ten times as long for a single one."""
    (a, b, c), (x, y, z) = one.tolist(), other.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def _turned(rotation: Vectors, points: Vectors) -> Vectors:
    """`(..., 3)` points turned by `(..., 3, 3)` rotations."""
    return np.asarray(np.matmul(rotation, points[..., None])[..., 0])

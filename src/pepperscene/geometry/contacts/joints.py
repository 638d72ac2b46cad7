"""Joints of a plant: the parts that rotate about them, and a plant that follows the rotations of its mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import Final

import numpy as np

from pepperscene.geometry.contacts.organs import FLOWER, FRUIT, LEAF, SHOOT, STALK, STEM, Organs
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.grammar.frames import cross
from pepperscene.grammar.plant import Plant


@dataclass(frozen=True, eq=False)
class JointRotation:
    """One rotation of a part of a plant.

    Attributes:
        instance: the organ that rotates, with all that grows on it.
        rotation: `(3, 3)`.
        pivot: `(3,)` metres, the fixed point.
    """

    instance: int
    rotation: FloatArray
    pivot: FloatArray


def move_plant(plant: Plant, motions: Sequence[JointRotation]) -> Plant:
    """Apply the motions of a resolved mesh to the curves and upper sides of the plant's organs.

    Args:
        plant: organ i is instance i of the mesh.
        motions: of that mesh, in order.

    Raises:
        ValueError: the instance of a motion is not an organ of the plant.
    """
    organs = plant.organs
    curves, ups = [organ.curve for organ in organs], [organ.up for organ in organs]
    changed = set()
    for motion in motions:
        if not 0 <= motion.instance < len(organs):
            raise ValueError(f"instance {motion.instance} is not an organ of a plant of {len(organs)} organs")
        members = {motion.instance}
        # Parents precede their children.
        for index in range(motion.instance + 1, len(organs)):
            if organs[index].parent in members:
                members.add(index)
        for index in members:
            curves[index] = (curves[index] - motion.pivot) @ motion.rotation.T + motion.pivot
            ups[index] = motion.rotation @ ups[index]
        changed |= members
    return replace(
        plant,
        organs=tuple(
            replace(organ, curve=curves[index], up=ups[index]) if index in changed else organ
            for index, organ in enumerate(organs)
        ),
    )


# Maximum rotations around the stem (or else sideways) and up or down, radians, chosen so that parts still
# grow naturally; and the weight of a degree of either: fruit hangs, so tilting it weighs more than moving it
# around the stem. By (grows on a stem, bears fruit).
_LIMITS_AND_WEIGHTS: Final = {
    (True, True): (np.radians([60.0, 30.0]), np.array([1.0, 1.5])),
    (True, False): (np.radians([60.0, 25.0]), np.array([0.8, 1.0])),
    (False, True): (np.radians([35.0, 35.0]), np.array([1.6, 1.6])),
    (False, False): (np.radians([35.0, 25.0]), np.array([0.8, 0.8])),
}


@dataclass(frozen=True, eq=False)
class MovableUnit:
    """A subtree that rotates as one body about its joint."""

    root: int  # first organ of the subtree
    members: tuple[int, ...]  # all its organs
    on_stem: bool  # it grows on a stem, around which it can move
    bears_fruit: bool  # its root carries fruit rather than leaves
    is_leafy: bool  # all its organs are leaves and shoots
    limits: FloatArray  # `(2,)` radians, maximum rotations: around, up or down
    weights: FloatArray  # `(2,)` of a degree of either rotation


def units_of(organs: Organs, organ: int) -> list[MovableUnit]:
    """The units that an organ belongs to, smallest first; none for stems, twine and cuts."""
    units = []
    for root, above in pairwise(chain([organ], organs.ancestors(organ))):
        kind = organs.organ_class[root]
        if kind not in (FLOWER, LEAF, SHOOT, FRUIT, STALK):
            break
        # A fruit does not rotate within its calyx.
        if kind == FRUIT and organs.mesh.instances[above].kind == "calyx":
            continue
        key, members = (bool(organs.organ_class[above] == STEM), kind in (FRUIT, STALK)), organs.subtree(root)
        is_leafy = bool(np.isin(organs.organ_class[members], [LEAF, SHOOT]).all())
        units.append(MovableUnit(root, tuple(members), *key, is_leafy, *_LIMITS_AND_WEIGHTS[key]))
    return units


def unit_members(units: Sequence[MovableUnit]) -> tuple[IndexArray, IndexArray]:
    """`(m,)` organs of some units, unit after unit, and `(m,)` index of the unit of each."""
    owner = np.repeat(np.arange(len(units)), [len(unit.members) for unit in units])
    return np.concatenate([np.array(unit.members) for unit in units]), owner


def solid_members(organs: Organs, units: Sequence[MovableUnit]) -> tuple[IndexArray, IndexArray]:
    """As `unit_members`, only organs that can touch others."""
    members, owner = unit_members(units)
    solid = organs.solid[members]
    return members[solid], owner[solid]


def disc_points(count: int, phase: FloatArray) -> FloatArray:
    """`(u, count, 2)` points evenly over unit discs, from the centre outwards, rotated by `(u,)` radians."""
    step = np.arange(count) + 0.5
    angle = phase[:, None] + np.pi * (3.0 - np.sqrt(5.0)) * step
    return np.asarray((step / count)[:, None] ** 0.7 * np.stack([np.cos(angle), np.sin(angle)], axis=2))


@dataclass(frozen=True, eq=False)
class RigidTransforms:
    """Rigid transforms of some units: every point p moves to rotation @ p + shift."""

    rotation: FloatArray  # `(u, k, 3, 3)` k transforms of each unit
    shift: FloatArray  # `(u, k, 3)` metres

    def with_inverses(self) -> RigidTransforms:
        """`(2 u, k)` transforms: these, then their inverses; to move a fruit is to move all else back."""
        inverse = self.rotation.swapaxes(2, 3)
        shift = -np.einsum("ukij,ukj->uki", inverse, self.shift)
        return RigidTransforms(np.concatenate([self.rotation, inverse]), np.concatenate([self.shift, shift]))

    def select(self, index: tuple[IndexArray, ...]) -> RigidTransforms:
        """Some units and transforms."""
        return RigidTransforms(self.rotation[index], self.shift[index])


@dataclass(frozen=True, eq=False)
class Joints:
    """Current axes of units: each rotates up or down about its foot, then around the stem or sideways."""

    foot: FloatArray  # `(u, 3)` metres, where the unit starts
    across: FloatArray  # `(u, 3)` horizontal axis through the foot; right-handed rotations raise the unit
    pivot: FloatArray  # `(u, 3)` metres, on the axis of the second rotation
    axis: FloatArray  # `(u, 3)` that axis

    def transforms(self, angles: FloatArray) -> RigidTransforms:
        """The transforms for `(u, k, 2)` radians: around, up."""
        up, around = rotations(self.across, angles[..., 1]), rotations(self.axis, angles[..., 0])
        foot, pivot = self.foot[:, None], self.pivot[:, None]
        after_up = foot - _rotate(up, foot)
        return RigidTransforms(around @ up, _rotate(around, after_up - pivot) + pivot)

    def select(self, rows: IndexArray) -> Joints:
        """The joints of some of the units."""
        return Joints(self.foot[rows], self.across[rows], self.pivot[rows], self.axis[rows])


def find_joints(organs: Organs, units: Sequence[MovableUnit]) -> Joints:
    """Find the joints of some units at the current poses.

    A unit on a stem moves around the vertical through the centre of its node; so it keeps its inclination,
    and its foot stays in the node. Other units rotate about their foot, across their own direction.
    """
    roots = np.array([unit.root for unit in units], dtype=np.intp)
    on_stem = np.array([unit.on_stem for unit in units], dtype=bool)[:, None]
    foot = organs.feet(roots)
    pivot = np.where(on_stem, organs.box_centres(organs.parent[roots]), foot)
    out = np.where(on_stem, foot - pivot, organs.box_centres(roots) - foot)
    level = np.hypot(out[:, 0], out[:, 1])[:, None]
    across = np.stack([out[:, 1], -out[:, 0], np.zeros(len(out))], axis=1)
    across = np.where(level > 1e-9, across / np.maximum(level, 1e-9), [1.0, 0.0, 0.0])
    axis = cross(across, out)
    length = np.sqrt(np.einsum("ui,ui->u", axis, axis))[:, None]
    is_vertical = on_stem | (length == 0.0)
    axis = np.where(is_vertical, [0.0, 0.0, 1.0], axis / np.where(is_vertical, 1.0, length))
    return Joints(foot, across, pivot, axis)


class MovingUnits:
    """The units of all organs, their current angles, and the rotations that led there.

    Attributes:
        organs: of one or more plants.
        angles: `(n, 2)` radians, around and up, of the unit that starts with each organ.
        motions: all rotations so far.
    """

    def __init__(self, organs: Organs) -> None:
        self.organs = organs
        self.angles = np.zeros((len(organs), 2))
        self.motions: list[JointRotation] = []
        self._units: dict[int, list[MovableUnit]] = {}

    def of_organ(self, organ: int) -> list[MovableUnit]:
        """The units that an organ belongs to, smallest first."""
        if organ not in self._units:
            self._units[organ] = units_of(self.organs, organ)
        return self._units[organ]

    def move(self, units: Sequence[MovableUnit], angles: FloatArray) -> None:
        """Move units that have no organs in common to some angles, `(u, 2)`."""
        roots = np.array([unit.root for unit in units])
        change = angles - self.angles[roots]
        joints = find_joints(self.organs, units)
        around, up = change.T
        parts = (
            (up, rotations(joints.across, up[:, None]), joints.foot),
            (around, rotations(joints.axis, around[:, None]), joints.pivot),
        )
        for row, unit in enumerate(units):
            self.motions += [
                JointRotation(unit.root, rotation[row, 0], pivot[row])
                for angle, rotation, pivot in parts
                if angle[row] != 0.0
            ]
        transforms = joints.transforms(change[:, None])
        members, owner = unit_members(units)
        self.organs.move(members, transforms.rotation[owner, 0], transforms.shift[owner, 0])
        self.angles[roots] = angles


def rotations(axis: FloatArray, angles: FloatArray) -> FloatArray:
    """`(u, k, 3, 3)` rotations by `(u, k)` radians about unit axes `(u, 3)` (Rodrigues).

    `scipy.spatial.transform.Rotation` is as fast, but differs in the last bits of 57 % of the entries.
    """
    skew = np.zeros((len(axis), 1, 3, 3))
    for row, column, other in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        skew[:, 0, row, column], skew[:, 0, column, row] = axis[:, other], -axis[:, other]
    sine, cosine = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.asarray(np.eye(3) + sine * skew + (1.0 - cosine) * (skew @ skew))


def _rotate(rotation: FloatArray, points: FloatArray) -> FloatArray:
    """`(..., 3)` points rotated by `(..., 3, 3)` matrices."""
    return np.asarray(np.matmul(rotation, points[..., None])[..., 0])

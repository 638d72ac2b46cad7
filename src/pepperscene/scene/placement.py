"""The scene: everything that is placed for a render, and the plants' organs in world coordinates."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Lamp
from pepperscene.errors import ArgumentError
from pepperscene.geometry import JointRotation, Mesh
from pepperscene.grammar import Organ, OrganForm, OrganKind, Plant
from pepperscene.materials import Surface
from pepperscene.scene.row import rotation_about_z
from pepperscene.scene.sky import Sky

_MIXERS: Final = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB], np.uint64)
"""Odd factors of SplitMix64 (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators")."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """The plants of a scene and their placement, which gives every organ in world coordinates.

    Attributes:
        plants: in their own coordinates, as their meshes were before they were placed.
        sizes: number of instances in each plant's mesh: its organs in order, then its twine.
        bases: `(n, 3)` positions of the stem bases, metres.
        turns: `(n,)` radians about the vertical, counter-clockwise seen from above.
        motions: rotations that resolved the row's contacts, by instance numbers of the scene.
        starts: first instance of each plant in the scene, ascending; empty if the plants follow each other
            from instance 0 on.
        fingerprints: `(i,)` of the triangles of the scene's instances up to the last plant, as the poses
            describe them (see `instance_fingerprints`); None before a scene was assembled.
        edits: further motions, in their order: an instance, which moves with all that grows on it, and the
            `(4, 4)` motion in world metres.
    """

    plants: tuple[Plant, ...]
    sizes: tuple[int, ...]
    bases: NDArray[np.float64]
    turns: NDArray[np.float64]
    motions: tuple[JointRotation, ...] = ()
    starts: tuple[int, ...] = ()
    fingerprints: NDArray[np.uint64] | None = None
    edits: tuple[tuple[int, NDArray[np.float64]], ...] = ()

    def __post_init__(self) -> None:
        counts = {len(self.plants), len(self.sizes), len(self.bases), len(self.turns)}
        if len(counts | ({len(self.starts)} if self.starts else set())) > 1:
            raise ValueError(f"plants, sizes, bases and turns must be equally many, not {sorted(counts)}")
        for plant, size in zip(self.plants, self.sizes, strict=True):
            if size < len(plant.organs):
                raise ValueError(f"a mesh of {size} instances does not hold a plant of {len(plant.organs)}")

    def organ(self, instance: int) -> Organ:
        """The organ of an instance of the scene, in world metres; its parent is an instance of the scene too.

        Raises:
            ValueError: the instance is not an organ of the plants.
        """
        number, index = self._organ_index(instance)
        organ, first = self.plants[number].organs[index], self._first_instances[number]
        # Place the plant.
        rotation = rotation_about_z(float(self.turns[number]))
        curve, up = organ.curve @ rotation.T + self.bases[number], rotation @ organ.up
        # Apply the motions of the organ and of all organs that it grows on, in their order.
        lineage = self._lineage(instance)
        for motion in sorted(order for member in lineage for order in self._motions_of.get(member, ())):
            rotation, pivot = self.motions[motion].rotation, self.motions[motion].pivot
            curve = (curve - pivot) @ rotation.T + pivot
            up = rotation @ up
        for moved, edit in self.edits:
            if moved in lineage:
                curve, up = curve @ edit[:3, :3].T + edit[:3, 3], edit[:3, :3] @ up
        parent = first + organ.parent if organ.parent >= 0 else organ.parent
        return replace(organ, curve=curve, up=up, parent=parent)

    def branch(self, instance: int) -> tuple[int, ...]:
        """An organ and all that grows on it, ascending; raises `ValueError` as `organ` does."""
        number = self.plant_index(instance)
        first, members = self._first_instances[number], {instance}
        # Parents come before their children.
        for index, organ in enumerate(self.plants[number].organs[instance - first + 1 :], instance + 1):
            if organ.parent + first in members:
                members.add(index)
        return tuple(sorted(members))

    def plant_index(self, instance: int) -> int:
        """The position in `plants` of an organ's plant; raises `ValueError` as `organ` does."""
        return self._organ_index(instance)[0]

    def measures(self, instance: int) -> Mapping[str, float]:
        """The measures of an organ, as `Organ.measures`; raises `ValueError` as `organ` does."""
        number, index = self._organ_index(instance)
        return self.plants[number].organs[index].measures

    def instances(self) -> tuple[int, ...]:
        """All instances of the plants, with their twine, ascending."""
        runs = zip(self._first_instances, self.sizes, strict=True)
        return tuple(index for first, size in runs for index in range(first, first + size))

    def kind(self, instance: int) -> OrganKind | None:
        """The organ kind of an instance of the scene; None if it is not an organ of the plants."""
        location = self._locate(instance)
        if location is None:
            return None
        number, index = location
        return self.plants[number].kinds[self.plants[number].organs[index].kind]

    def of_form(self, *forms: OrganForm, plant: int | None = None) -> tuple[int, ...]:
        """The instances of organs of these forms, ascending; with `plant`, those of one plant only."""
        instances: list[int] = []
        for number in range(len(self.plants)) if plant is None else (plant,):
            kinds, first = self.plants[number].kinds, self._first_instances[number]
            names = {name for name, kind in kinds.items() if kind.form in forms}
            organs = enumerate(self.plants[number].organs, first)
            instances += [instance for instance, organ in organs if organ.kind in names]
        return tuple(instances)

    def _locate(self, instance: int) -> tuple[int, int] | None:
        """Plant number and organ index of an instance; None if it is not an organ of the plants."""
        number = bisect_right(self._first_instances, instance) - 1
        if number < 0:
            return None
        index = instance - self._first_instances[number]
        return (number, index) if index < len(self.plants[number].organs) else None

    def _organ_index(self, instance: int) -> tuple[int, int]:
        """As `_locate`; raises `ValueError` if the instance is not an organ of the plants."""
        if (location := self._locate(instance)) is None:
            raise ValueError(f"instance {instance} is not an organ of a plant")
        return location

    def _lineage(self, instance: int) -> set[int]:
        """The instances of an organ and of all organs that it grows on."""
        number, index = self._organ_index(instance)
        lineage = {instance}
        while (index := self.plants[number].organs[index].parent) >= 0:
            lineage.add(self._first_instances[number] + index)
        return lineage

    def check_mesh(self, mesh: Mesh) -> None:
        """Raise `ArgumentError` if triangles were moved since the scene was assembled; some may be missing.

        The poses of the organs, which do not move with triangles, would be those of another mesh.
        """
        if self.fingerprints is None:
            return
        found = instance_fingerprints(mesh, len(self.fingerprints))
        instances = np.array(self.instances(), np.intp)
        instances = instances[instances < len(found)]
        moved = instances[(found != self.fingerprints)[instances] & (found != 0)[instances]]
        if len(moved):
            index = int(moved[0])
            kind = mesh.instances[index].kind
            problem = f"has moved or changed triangles of {len(moved)} instances, first {index}, a {kind}"
            remedy = "assemble it with the skeleton of that mesh, or without harvest and visibility"
            raise ArgumentError("scene", f"{problem}, whose skeleton did not move with them; {remedy}")

    @cached_property
    def grown(self) -> Skeleton:
        """The skeleton without edits."""
        return replace(self, edits=()) if self.edits else self

    def edit(self, instance: int) -> NDArray[np.float64]:
        """`(4, 4)` motion of all edits that moved an organ; raises `ValueError` as `organ` does."""
        lineage, motion = self._lineage(instance), np.eye(4)
        for moved, edit in self.edits:
            if moved in lineage:
                motion = edit @ motion
        return motion

    @cached_property
    def _motions_of(self) -> dict[int, list[int]]:
        """Positions among the motions, by instance."""
        positions: dict[int, list[int]] = {}
        for position, motion in enumerate(self.motions):
            positions.setdefault(motion.instance, []).append(position)
        return positions

    @cached_property
    def _first_instances(self) -> tuple[int, ...]:
        return self.starts or tuple(accumulate(self.sizes, initial=0))[:-1]


def instance_fingerprints(mesh: Mesh, count: int) -> NDArray[np.uint64]:
    """`(count,)` sums over the triangles of the first instances, which differ if a corner does; 0 for none.

    They do not depend on the numbers and the order of vertices and triangles. 1 million triangles take 0.1 s.
    """
    x, y, z = np.ascontiguousarray(mesh.vertices, np.float32).view(np.uint32).T.astype(np.uint64)
    corner = (x * _MIXERS[0]) ^ (y * _MIXERS[1]) ^ (z * _MIXERS[2])
    corner ^= corner >> np.uint64(29)
    # The corners of a triangle count in their order.
    first, second, third = corner[mesh.faces].T
    triangle = (first * _MIXERS[1] + second * _MIXERS[2] + third) * _MIXERS[0]
    runs = mesh.face_runs
    triangle = triangle if runs.order is None else triangle[runs.order]
    sums = np.concatenate([np.zeros(1, np.uint64), np.cumsum(triangle, dtype=np.uint64)])
    stop, start = runs.stop[:count], runs.first[:count]
    return np.asarray(np.where(stop > start, (sums[stop] - sums[start]) | np.uint64(1), np.uint64(0)))


def build_skeleton(plants: Sequence[Plant]) -> Skeleton:
    """The skeleton of unsupported plants at the origin, whose meshes are concatenated in this order."""
    count = len(plants)
    sizes = tuple(len(plant.organs) for plant in plants)
    return Skeleton(tuple(plants), sizes, np.zeros((count, 3)), np.zeros(count))


@dataclass(frozen=True, eq=False)
class Scene:
    """The renderer's input.

    World axes: z up, +x along the plant row to the right as seen from the aisle, +y into the crop; metres.

    Attributes:
        mesh: all triangles.
        surfaces: one for each of `mesh.surfaces`, in that order; empty if only labels are rendered.
        sky: daylight, or None for a night scene.
        skeleton: plants whose organs are instances of the mesh; None without output "harvest".
        lamps: in world axes.
    """

    mesh: Mesh
    surfaces: tuple[Surface, ...] = ()
    sky: Sky | None = None
    skeleton: Skeleton | None = None
    lamps: tuple[Lamp, ...] = ()

    def __post_init__(self) -> None:
        names = tuple(surface.name for surface in self.surfaces)
        if names and names != self.mesh.surfaces:
            raise ValueError(f"surfaces {names} do not match the mesh's {self.mesh.surfaces}")


def assemble_scene(
    mesh: Mesh,
    surfaces: Mapping[str, Surface] | None = None,
    sky: Sky | None = None,
    skeleton: Skeleton | None = None,
    lamps: Sequence[Lamp] = (),
) -> Scene:
    """Assemble a scene from a mesh and surfaces by name; surfaces that the mesh does not use are left out.

    Args:
        mesh: all triangles.
        surfaces: by surface name; None if only labels are rendered.
        sky: daylight, or None.
        skeleton: of the plants in the mesh; the output "harvest" needs it. That of another scene belongs to
            the mesh that it was assembled with.
        lamps: in world axes.

    Raises:
        ValueError: a surface of the mesh is missing.
    """
    if skeleton is not None and skeleton.fingerprints is None:
        end = max(skeleton.instances(), default=-1) + 1
        fingerprints = instance_fingerprints(mesh, min(end, len(mesh.instances)))
        skeleton = replace(skeleton, fingerprints=fingerprints)
    if surfaces is None:
        return Scene(mesh, (), sky, skeleton, tuple(lamps))
    missing = [name for name in mesh.surfaces if name not in surfaces]
    if missing:
        raise ValueError(f"missing surfaces: {', '.join(missing)}")
    return Scene(mesh, tuple(surfaces[name] for name in mesh.surfaces), sky, skeleton, tuple(lamps))


def organ_poses(organs: Sequence[Organ]) -> NDArray[np.float64]:
    """`(n, 4, 4)` poses of organs: from the base, x to the upper side, y to the right, z towards the tip.

    Organs without a length stand upright.
    """
    from pepperscene.geometry.fruit.fruits import axis_frames

    poses = np.tile(np.eye(4), (len(organs), 1, 1))
    if organs:
        base = np.array([organ.curve[0] for organ in organs], dtype=float)
        axis = np.array([organ.curve[-1] for organ in organs], dtype=float) - base
        axis[np.linalg.norm(axis, axis=1) == 0.0] = [0.0, 0.0, 1.0]
        up = np.array([organ.up for organ in organs], dtype=float)
        poses[:, :3, :3] = axis_frames(axis, up).swapaxes(1, 2)
        poses[:, :3, 3] = base
    return poses

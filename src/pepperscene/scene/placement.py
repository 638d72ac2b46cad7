"""The plants of a scene as organs in world coordinates: where each centreline has come to lie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry import Mesh, Motion
from pepperscene.grammar import Organ, OrganForm, OrganKind, Plant
from pepperscene.materials import Surface
from pepperscene.scene.row import rotation_about_z
from pepperscene.scene.sky import Sky


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Plants that stand in a scene; an organ is placed when it is asked for.

    Attributes:
        plants: in their own coordinates, as their meshes were before they were put in their places.
        sizes: instances of each plant's mesh: its organs in their order, then what holds it.
        feet: `(n, 3)` metres, where the stems begin.
        turns: `(n,)` radians about the vertical, counter-clockwise seen from above.
        motions: of the row that they settled in, told in its instance numbers.
    """

    plants: tuple[Plant, ...]
    sizes: tuple[int, ...]
    feet: NDArray[np.float64]
    turns: NDArray[np.float64]
    motions: tuple[Motion, ...] = ()

    def __post_init__(self) -> None:
        counts = {len(self.plants), len(self.sizes), len(self.feet), len(self.turns)}
        if len(counts) > 1:
            raise ValueError(f"as many plants, sizes, feet and turns are needed, not {sorted(counts)}")
        for plant, size in zip(self.plants, self.sizes, strict=True):
            if size < len(plant.organs):
                raise ValueError(f"a mesh of {size} instances does not hold a plant of {len(plant.organs)}")

    def organ(self, instance: int) -> Organ:
        """An organ of the scene in world metres; its parent is told as an instance of the scene too.

        Raises:
            ValueError: the instance is no organ of the plants.
        """
        number, index = self._place(instance)
        organ, first = self.plants[number].organs[index], self._firsts[number]
        # The plant in its place.
        turn = rotation_about_z(float(self.turns[number]))
        curve, up = organ.curve @ turn.T + self.feet[number], turn @ organ.up
        # What turned it, or what it grows on, while the row settled; in order.
        line = {instance}
        while (parent := self.plants[number].organs[index].parent) >= 0:
            index = parent
            line.add(first + index)
        moved = sorted(step for one in line for step in self._steps.get(one, ()))
        for motion in (self.motions[step] for step in moved):
            curve = (curve - motion.pivot) @ motion.rotation.T + motion.pivot
            up = motion.rotation @ up
        return replace(
            organ, curve=curve, up=up, parent=first + organ.parent if organ.parent >= 0 else organ.parent
        )

    def kind(self, instance: int) -> OrganKind | None:
        """What an instance of the scene is; None for one that is no organ of the plants."""
        if not self.holds(instance):
            return None
        number, index = self._place(instance)
        return self.plants[number].kinds[self.plants[number].organs[index].kind]

    def holds(self, instance: int) -> bool:
        """Whether an instance of the scene is an organ of the plants."""
        number = self._owner(instance)
        return number >= 0 and instance - self._firsts[number] < len(self.plants[number].organs)

    def of_form(self, *forms: OrganForm, plant: int | None = None) -> tuple[int, ...]:
        """The instances whose bodies are of these forms, ascending; of one plant alone where it is told."""
        found: list[int] = []
        for number in range(len(self.plants)) if plant is None else (plant,):
            one = self.plants[number]
            names = {name for name, kind in one.kinds.items() if kind.form in forms}
            first = self._firsts[number]
            found += [first + index for index, organ in enumerate(one.organs) if organ.kind in names]
        return tuple(found)

    def _place(self, instance: int) -> tuple[int, int]:
        """Number of the plant and of its organ."""
        if not self.holds(instance):
            raise ValueError(f"instance {instance} is no organ of a plant")
        number = self._owner(instance)
        return number, instance - self._firsts[number]

    def _owner(self, instance: int) -> int:
        """Number of the plant that an instance belongs to; -1 for none."""
        if not 0 <= instance < sum(self.sizes):
            return -1
        return int(np.searchsorted(self._firsts, instance, side="right")) - 1

    @cached_property
    def _firsts(self) -> tuple[int, ...]:
        """The instance that each plant begins with."""
        return tuple(accumulate(self.sizes, initial=0))[:-1]

    @cached_property
    def _steps(self) -> dict[int, list[int]]:
        """Numbers of the motions by the instance that they turn."""
        found: dict[int, list[int]] = {}
        for step, motion in enumerate(self.motions):
            found.setdefault(motion.instance, []).append(step)
        return found


def build_skeleton(plants: Sequence[Plant]) -> Skeleton:
    """The skeleton of plants whose meshes follow each other as they are, each without anything that holds it.

    One plant alone stands at the origin.
    """
    count = len(plants)
    sizes = tuple(len(plant.organs) for plant in plants)
    return Skeleton(tuple(plants), sizes, np.zeros((count, 3)), np.zeros(count))


@dataclass(frozen=True, eq=False)
class Scene:
    """What the renderer is given.

    World axes: z up, +x along the plant row to the right as seen from the aisle, +y into the crop; metres.

    Attributes:
        mesh: all triangles.
        surfaces: one for each of `mesh.surfaces`, in that order; empty when only ground truth is wanted.
        sky: daylight, or None for a night scene.
        skeleton: the plants whose organs are the first of the mesh's instances; None where nobody can tell
            where a fruit is to be cut.
    """

    mesh: Mesh
    surfaces: tuple[Surface, ...] = ()
    sky: Sky | None = None
    skeleton: Skeleton | None = None

    def __post_init__(self) -> None:
        names = tuple(surface.name for surface in self.surfaces)
        if names and names != self.mesh.surfaces:
            raise ValueError(f"surfaces {names} do not match the mesh's {self.mesh.surfaces}")


def assemble_scene(
    mesh: Mesh,
    surfaces: Mapping[str, Surface] | None = None,
    sky: Sky | None = None,
    skeleton: Skeleton | None = None,
) -> Scene:
    """A scene out of a mesh and the surfaces by name; those that the mesh lacks are left out.

    Args:
        mesh: everything placed.
        surfaces: by surface name; None when only ground truth will be asked for.
        sky: daylight, or None.
        skeleton: of the plants in it, which the output "harvest" needs.

    Raises:
        ValueError: the mesh names a surface that is not given.
    """
    if surfaces is None:
        return Scene(mesh, (), sky, skeleton)
    missing = [name for name in mesh.surfaces if name not in surfaces]
    if missing:
        raise ValueError(f"no surface is given for {', '.join(missing)}")
    return Scene(mesh, tuple(surfaces[name] for name in mesh.surfaces), sky, skeleton)

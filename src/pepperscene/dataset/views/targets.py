"""What a random view looks at: an organ of the labelled plants, or a point."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.errors import InputError

if TYPE_CHECKING:
    from pepperscene.dataset.views.free_space import FreeSpace
    from pepperscene.geometry import Mesh
    from pepperscene.scene import Scene

FloatArray = NDArray[np.float64]

FRUIT_TARGETS: Final = ("fruit", "ripe fruit", "unripe fruit")
"""Targets that work with every cultivar; others are names of its organ kinds, and of classes."""

RIPE_FROM: Final = 0.5
"""Mean ripeness from which a fruit counts as ripe, chosen: half of its colour has changed."""

_SAMPLES: Final = 256
"""Points on an organ. Chosen: its visible fraction is known to about 0.02, and tracing so few rays takes
hardly longer than starting the kernel."""
_GOLDEN: Final = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps of the most even sequence of points in a square (M. Roberts, "The unreasonable effectiveness of
quasirandom sequences", 2018): powers of the inverse of the real root of x^3 = x + 1."""


@dataclass(frozen=True, eq=False)
class Target:
    """What a view looks at.

    Attributes:
        instance: index among the scene's instances; None for a point.
        point: `(3,)` world metres: the centroid of its surface, or the point.
        samples: `(n, 3)` points on its surface, evenly distributed; or the point.
        normals: `(n, 3)` unit normals of the surface there; None for a point.
        closed: whether the surface has no border, so that only its outer side can be seen.
    """

    instance: int | None
    point: FloatArray
    samples: FloatArray
    normals: FloatArray | None
    closed: bool


def target_instances(scene: Scene, name: str, where: str | Path, key: str = "target") -> NDArray[np.intp]:
    """`(n,)` instances with triangles of the labelled plants that a target's name means, ascending.

    Args:
        scene: with its skeleton for ripe and unripe fruit.
        name: one of `FRUIT_TARGETS`, an organ kind, or a class in lower case.
        where: file or argument of the name, for errors.
        key: of the name, for errors.

    Raises:
        InputError: no organ of the plants has this name, or none of them is in the scene.
    """
    mesh, runs = scene.mesh, scene.mesh.face_runs
    plants = range(len(mesh.instances)) if scene.skeleton is None else range(sum(scene.skeleton.sizes))
    labelled = [index for index in plants if mesh.instances[index].plant >= 0]
    classes = _classes()
    kinds = {mesh.instances[index].kind for index in labelled}
    if scene.skeleton is not None:
        kinds.update(kind for plant in scene.skeleton.plants for kind in plant.kinds)
    if name in FRUIT_TARGETS:
        ripeness = _fruit_ripeness(scene, labelled)
        # In a scene without plants, fruit are known by the name of their class alone.
        found = [
            index
            for index, value in ripeness.items()
            if name == "fruit" or (value >= RIPE_FROM) == (name == "ripe fruit")
        ]
    elif name in kinds:
        found = [index for index in labelled if mesh.instances[index].kind == name]
    elif name in classes:
        found = [index for index in labelled if mesh.instances[index].organ_class == classes[name]]
    else:
        names = ", ".join(target_names(kinds))
        raise InputError(where, f"must be a point or one of {names}", key=key, value=name)
    present = np.array([index for index in found if runs.stop[index] > runs.first[index]], dtype=np.intp)
    if not len(present):
        raise InputError(
            where, "must be something that a plant of the scene has; none does", key=key, value=name
        )
    return present


def target_names(kinds: Iterable[str]) -> list[str]:
    """All names of targets on plants with these kinds of organs, sorted."""
    return sorted({*FRUIT_TARGETS, *kinds, *_classes()})


def _classes() -> dict[str, OrganClass]:
    return {item.name.lower(): item for item in OrganClass if item}


def organ_target(mesh: Mesh, instance: int, space: FreeSpace) -> Target:
    """An organ with triangles as a target."""
    triangles = mesh.vertices[mesh.faces[mesh.face_runs.rows(instance)]].astype(float)
    first, second, third = triangles.transpose(1, 0, 2)
    normals = 0.5 * np.cross(second - first, third - first)
    areas = np.linalg.norm(normals, axis=1)
    ends = np.cumsum(areas)
    if not ends[-1] > 0.0:
        point = triangles.mean(axis=(0, 1))
        return Target(instance, point, point[None], None, False)
    centroid = areas @ (first + second + third) / (3.0 * ends[-1])

    # Equal steps of area, each with another place in its triangle.
    number = np.arange(_SAMPLES)
    rows = np.minimum(np.searchsorted(ends, (number + 0.5) / _SAMPLES * ends[-1]), len(ends) - 1)
    u, v = ((number[:, None] * _GOLDEN) % 1.0).T
    outside = u + v > 1.0
    u, v = np.where(outside, 1.0 - u, u), np.where(outside, 1.0 - v, v)
    samples = first[rows] + u[:, None] * (second - first)[rows] + v[:, None] * (third - first)[rows]
    unit_normals = normals[rows] / np.maximum(areas[rows], np.finfo(float).tiny)[:, None]
    return Target(instance, centroid, samples, unit_normals, space.is_closed(instance))


def point_target(point: tuple[float, float, float]) -> Target:
    """A point of the world as a target."""
    position = np.array(point, dtype=float)
    return Target(None, position, position[None], None, False)


def _fruit_ripeness(scene: Scene, labelled: list[int]) -> dict[int, float]:
    """Mean ripeness of each fruit by instance, from 0 green to 1 ripe."""
    if scene.skeleton is None:
        # Every vertex of a fruit has the ripeness there as its state.
        mesh = scene.mesh
        fruit = [index for index in labelled if mesh.instances[index].organ_class == OrganClass.PEPPER]
        rows = {index: mesh.faces[mesh.face_runs.rows(index)] for index in fruit}
        return {index: float(mesh.state[faces].mean()) for index, faces in rows.items() if len(faces)}
    ripeness, first = {}, 0
    for plant, size in zip(scene.skeleton.plants, scene.skeleton.sizes, strict=True):
        for index, organ in enumerate(plant.organs, first):
            if plant.kinds[organ.kind].form == "fruit":
                ripeness[index] = float(organ.measures.get("ripeness", 0.0))
        first += size
    return ripeness

"""What a random view looks at: an organ of the labelled plants, or a point."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import RIPE_FROM, OrganClass
from pepperscene.errors import InputError
from pepperscene.geometry.surface_samples import area_normals, sample_surface

if TYPE_CHECKING:
    from pepperscene.geometry import Mesh
    from pepperscene.recipe.views.free_space import FreeSpace
    from pepperscene.scene import Scene

FloatArray = NDArray[np.float64]

FRUIT_TARGETS: Final = ("fruit", "ripe fruit", "unripe fruit")
"""Targets that work with every cultivar; others are names of its organ kinds, and of classes."""

_SAMPLES: Final = 256
"""Points on an organ. Chosen: its visible fraction is known to about 0.02, and tracing so few rays takes
hardly longer than starting the kernel."""
_KEY: Final = "views.target"  # of a recipe


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


def target_instances(scene: Scene, name: str, where: str | Path) -> NDArray[np.intp]:
    """`(n,)` indices of the instances that a target's name refers to, ascending.

    Only instances of the recipe's own plants that have triangles count, not those of far rows. The name is
    one of `FRUIT_TARGETS`, an organ kind, or a class in lower case. A skeleton of the scene holds the kinds
    of organs and the ripeness of fruit.

    Raises:
        InputError: no organ of the plants has this name, or none of them is in the scene.
    """
    mesh, runs = scene.mesh, scene.mesh.face_runs
    items = mesh.instances
    plants = range(len(items)) if scene.skeleton is None else scene.skeleton.instances()
    labelled = [index for index in plants if items[index].plant >= 0 and items[index].far_row < 0]
    classes = _classes()
    kinds = {mesh.instances[index].kind for index in labelled}
    if scene.skeleton is not None:
        kinds.update(kind for plant in scene.skeleton.plants for kind in plant.kinds)
    if name in FRUIT_TARGETS:
        ripeness = _fruit_ripeness(scene, labelled)
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
        raise InputError(where, f"must be a point or one of {names}", key=_KEY, value=name)
    present = np.array([index for index in found if runs.stop[index] > runs.first[index]], dtype=np.intp)
    if not len(present):
        raise InputError(where, "must be an organ that the plants of the scene have", key=_KEY, value=name)
    return present


def target_names(kinds: Iterable[str]) -> list[str]:
    """All names of targets on plants with these kinds of organs, sorted."""
    return sorted({*FRUIT_TARGETS, *kinds, *_classes()})


def _classes() -> dict[str, OrganClass]:
    return {item.name.lower(): item for item in OrganClass if item}


def organ_target(mesh: Mesh, instance: int, space: FreeSpace) -> Target:
    """An organ with triangles as a target."""
    centroid = organ_centroid(mesh, instance)
    samples = sample_surface(_triangles(mesh, instance), _SAMPLES)
    if samples is None:
        return Target(instance, centroid, centroid[None], None, False)
    return Target(instance, centroid, samples.points, samples.normals, space.is_closed(instance))


def organ_centroid(mesh: Mesh, instance: int) -> FloatArray:
    """`(3,)` centroid of the surface of an organ with triangles; the mean corner of one without area."""
    triangles = _triangles(mesh, instance)
    areas = np.linalg.norm(area_normals(triangles), axis=1)
    total = np.cumsum(areas)[-1]
    if not total > 0.0:
        return np.asarray(triangles.mean(axis=(0, 1)))
    first, second, third = triangles.transpose(1, 0, 2)
    return np.asarray(areas @ (first + second + third) / (3.0 * total))


def _triangles(mesh: Mesh, instance: int) -> FloatArray:
    """`(n, 3, 3)` corners of an instance's triangles."""
    return mesh.vertices[mesh.faces[mesh.face_runs.rows(instance)]].astype(float)


def point_target(point: tuple[float, float, float]) -> Target:
    """A point of the world as a target."""
    position = np.array(point, dtype=float)
    return Target(None, position, position[None], None, False)


def _fruit_ripeness(scene: Scene, labelled: list[int]) -> dict[int, float]:
    """Mean ripeness of each fruit by instance, from 0 green to 1 ripe."""
    if scene.skeleton is None:
        # The class identifies fruit, and the state of their vertices is the ripeness.
        mesh = scene.mesh
        fruit = [index for index in labelled if mesh.instances[index].organ_class == OrganClass.PEPPER]
        rows = {index: mesh.faces[mesh.face_runs.rows(index)] for index in fruit}
        return {index: float(mesh.state[faces].mean()) for index, faces in rows.items() if len(faces)}
    own = set(labelled)
    fruit = [index for index in scene.skeleton.of_form("fruit") if index in own]
    return {index: float(scene.skeleton.measures(index).get("ripeness", 0.0)) for index in fruit}

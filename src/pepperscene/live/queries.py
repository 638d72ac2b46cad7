"""Which instances a body touches, and the nearest surface: for the planning of motions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.poses.generators import as_points
from pepperscene.recipe.views.free_space import FreeSpace, closed_parts
from pepperscene.render.kernel.split_scene import GeometryPart

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ScenePart(GeometryPart):
    """Some triangles of a scene, and what is computed of them once."""

    @cached_property
    def space(self) -> FreeSpace:
        """Distances to the triangles."""
        return FreeSpace(self.mesh)

    @cached_property
    def boxes(self) -> tuple[IndexArray, NDArray[np.float32], NDArray[np.float32]]:
        """`(i,)` instances, and `(i, 3)` lowest and highest coordinates of each, metres."""
        mesh, runs = self.mesh, self.mesh.face_runs
        instances = np.flatnonzero(runs.stop > runs.first)
        instances = instances[np.argsort(runs.first[instances])]
        if not len(instances):
            return instances, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
        faces = mesh.faces if runs.order is None else mesh.faces[runs.order]
        starts = 3 * runs.first[instances]
        columns = [axis[faces].ravel() for axis in mesh.vertices.T]
        low, high = (
            np.stack([extreme.reduceat(column, starts) for column in columns], axis=1)
            for extreme in (np.minimum, np.maximum)
        )
        return instances, low, high

    def near(self, low: FloatArray, high: FloatArray) -> Iterator[tuple[int, FloatArray]]:
        """Yield the instances whose boxes overlap a box, with their triangles `(n, 3, 3)` whose boxes do."""
        instances, lowest, highest = self.boxes
        for index in instances[((lowest <= high) & (highest >= low)).all(axis=1)].tolist():
            triangles = self.triangles(index)
            overlaps = (triangles.min(axis=1) <= high) & (triangles.max(axis=1) >= low)
            yield index, triangles[overlaps.all(axis=1)]

    def around(self, low: FloatArray, high: FloatArray) -> Iterator[int]:
        """Yield the instances whose boxes contain a box."""
        instances, lowest, highest = self.boxes
        yield from instances[((lowest <= low) & (highest >= high)).all(axis=1)].tolist()

    def triangles(self, index: int) -> FloatArray:
        """`(n, 3, 3)` corners of the triangles of an instance."""
        faces = self.mesh.faces[self.mesh.face_runs.rows(index)]
        return np.asarray(self.mesh.vertices[faces], np.float64)


def nearest_surface(parts: Sequence[ScenePart], points: ArrayLike) -> tuple[FloatArray, IndexArray]:
    """`(n,)` distance from `(n, 3)` points to the nearest triangle, and `(n,)` the index of its instance."""
    points = as_points(points)
    distance, instance = np.full(len(points), np.inf), np.full(len(points), -1)
    for part in parts:
        if len(part.mesh.faces):
            found, face = part.space.nearest(points)
            nearer = found < distance
            distance[nearer], instance[nearer] = found[nearer], part.mesh.face_instance[face[nearer]]
    return distance, instance


def touched_instances(parts: Sequence[ScenePart], triangles: FloatArray) -> list[int]:
    """Instances that the triangles `(n, 3, 3)` of a body cross, or that are inside it or around it."""
    low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
    inside = closed_parts(triangles)
    touched = set()
    for part in parts:
        for index, others in part.near(low, high):
            if len(others) and (_cross(triangles, others) or inside.contain(others[0, 0])):
                touched.add(index)
        for index in set(part.around(low, high)) - touched:
            if closed_parts(part.triangles(index)).contain(triangles[0, 0]):
                touched.add(index)
    return sorted(touched)


def _cross(one: FloatArray, two: FloatArray) -> bool:
    """Whether triangles `(n, 3, 3)` and `(m, 3, 3)` cross; by the compiled test of contacts."""
    from pepperscene.geometry.contacts import crossing_kernel as kernel

    counts = np.array([len(one), len(two)])
    # Relative to the body, where single precision is finest.
    origin = one[0, 0]
    points = np.concatenate([one - origin, two - origin]).reshape(-1, 3).T
    box = np.concatenate([two.min(axis=(0, 1)), two.max(axis=(0, 1))]) - np.tile(origin, 2)
    starts = np.array([0, counts[0]])
    triangles = kernel.OrganTriangles(
        np.ascontiguousarray(points, np.float32),
        np.ascontiguousarray(np.arange(3 * counts.sum()).reshape(-1, 3).T),
        (3 * starts, 3 * counts),
        (starts, counts),
    )
    still = np.eye(3, dtype=np.float32)[None], np.zeros((1, 3), np.float32)
    motions = kernel.Motions(np.zeros(1, np.intp), *still)
    # Boxes touch where they overlap in exact numbers.
    margin: Any = np.float32(1e-6) * np.array([-1, -1, -1, 1, 1, 1], np.float32)
    pairs = kernel.OrganPairs(
        np.zeros(1, np.intp), np.ones(1, np.intp), box.astype(np.float32)[None] + margin
    )
    return bool(kernel.count_crossings(triangles, motions, pairs, np.float32(0.0), False)[0])

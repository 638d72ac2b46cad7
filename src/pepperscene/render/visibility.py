"""Visibility of points of a scene, and of an organ, from a camera that need not be rendered."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera
from pepperscene.camera.poses.generators import as_points
from pepperscene.render.aov.flow import is_unoccluded
from pepperscene.render.arrays import LocalCoordinates

FloatArray = NDArray[np.float64]

_NO_FACE = 0xFFFFFFFE
"""Not the number of any triangle; the next number is the sky's."""


class PointTest(Protocol):
    """A test of the visibility of points of a scene, such as `visible_points` of its `Renderer`."""

    def __call__(
        self, camera: Camera, points: FloatArray, normals: FloatArray | None = ..., *, alone: int | None = ...
    ) -> NDArray[np.bool_]:
        """`(n,)` for `(n, 3)` points and normals.

        With `alone`, whether they would be visible if there were nothing but this instance, and the image had
        no borders.
        """


def visible_points(
    scene: Any,
    coordinates: LocalCoordinates,
    camera: Camera,
    points: ArrayLike,
    normals: ArrayLike | None = None,
    *,
    has_borders: bool = True,
) -> NDArray[np.bool_]:
    """`(n,)` whether points of surfaces are in a camera's image and not hidden.

    A point is hidden by what is closer to the camera by more than `CLEARANCE` of its distance.

    Args:
        scene: Mitsuba's.
        coordinates: of that scene.
        camera: its pose is the view; a motion has no effect.
        points: `(n, 3)` world metres.
        normals: `(n, 3)` of any length, for closed surfaces: points whose normal points away from the camera
            are hidden. None for blades and for points in space.
        has_borders: whether points outside the image are hidden.
    """
    points = as_points(points)
    if camera.motion is not None:
        camera = replace(camera, motion=None)
    centre = camera.pose[:3, 3]
    candidate = np.ones(len(points), dtype=bool)
    if has_borders:
        # Comparisons with nan are false.
        u, v = camera.project(points).T
        candidate &= (u >= 0.0) & (u < camera.width) & (v >= 0.0) & (v < camera.height)
    if normals is not None:
        candidate &= np.einsum("ni,ni->n", np.asarray(normals, dtype=float), centre - points) > 0.0
    rows = np.flatnonzero(candidate)
    visible = np.zeros(len(points), dtype=bool)
    if len(rows):
        start, vectors = coordinates.from_world(centre), (points[rows] - centre) / coordinates.unit_m
        visible[rows] = is_unoccluded(scene, start, vectors, np.full(len(rows), _NO_FACE))
    return visible


def visible_fraction(
    visible: PointTest,
    camera: Camera,
    points: ArrayLike,
    normals: ArrayLike | None = None,
    *,
    closed: bool = True,
    instance: int | None = None,
) -> float:
    """Fraction of what a camera would see of an organ alone that is in the image and not hidden, 0 to 1.

    Each point is weighted with the solid angle of its part of the surface. For an organ that takes a small
    part of the field of view, this is nearly the fraction of its pixels.

    Args:
        visible: tests the points.
        camera: the camera.
        points: `(n, 3)` world metres, evenly distributed over the surface.
        normals: `(n, 3)` unit normals of the surface; None gives all points the same weight.
        closed: whether only the side that the normals point to can be seen.
        instance: of the organ, so that what it hides of itself does not count; None for a convex one.
    """
    points = as_points(points)
    if normals is None:
        return float(visible(camera, points).mean()) if len(points) else 0.0
    normals = as_points(normals, "normals")
    to_camera = camera.pose[:3, 3] - points
    cosine = np.einsum("ni,ni->n", normals, to_camera)
    weight = (np.maximum(cosine, 0.0) if closed else np.abs(cosine)) / np.linalg.norm(to_camera, axis=1) ** 3
    rows = np.flatnonzero(weight > 0.0)
    weight, points, facing = weight[rows], points[rows], normals[rows] if closed else None
    if not len(rows):
        return 0.0
    seen = visible(camera, points, facing)
    if seen.any() and instance is not None:
        # What is visible in the scene is visible of the organ alone, except for rounding.
        weight = weight * (seen | visible(camera, points, facing, alone=instance))
    return float(weight[seen].sum() / weight.sum())

"""The first surface that single rays meet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.poses.generators import as_points
from pepperscene.errors import ArgumentError
from pepperscene.render.arrays import LocalCoordinates, device_array
from pepperscene.render.variant import mitsuba_modules


def cast_rays(
    scene: Any, coordinates: LocalCoordinates, origins: ArrayLike, directions: ArrayLike
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """`(n,)` distance to the first surface of each ray, metres, and `(n,)` its triangle.

    Rays that meet nothing have an infinite distance and the triangle -1.

    Args:
        scene: Mitsuba's, or a `SplitScene`.
        coordinates: of that scene.
        origins: `(n, 3)` world metres, or one `(3,)` for all rays.
        directions: `(n, 3)` of any length above 0.

    Raises:
        ArgumentError: the shapes differ, a number is not finite, or a direction has no length.
    """
    starts, rays = as_points(origins, "origins"), as_points(directions, "directions")
    if len(starts) not in (1, len(rays)):
        raise ArgumentError(
            "origins", f"must be one or {len(rays)}, as many as directions, not {len(starts)}"
        )
    for name, values in (("origins", starts), ("directions", rays)):
        if not np.isfinite(values).all():
            raise ArgumentError(name, "must be finite numbers")
    lengths = np.linalg.norm(rays, axis=1, keepdims=True)
    if not np.all(lengths > 0.0):
        raise ArgumentError("directions", f"number {int(np.argmin(lengths))} has no length")
    if not len(rays):
        return np.zeros(0, np.float32), np.zeros(0, np.int64)
    mi, dr = mitsuba_modules()
    local = np.broadcast_to(coordinates.from_world(starts), rays.shape)
    origin, direction = (
        [device_array(axis) for axis in values.T.astype(np.float32)] for values in (local, rays / lengths)
    )
    lane = dr.arange(mi.UInt32, len(rays))
    start, along = (
        mi.Vector3f(*(dr.gather(mi.Float, x, lane) for x in axes)) for axes in (origin, direction)
    )
    hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(start), along), coherent=False)
    is_hit = hit.is_valid()
    distance, face = dr.select(is_hit, hit.t, dr.inf), dr.select(is_hit, mi.Int32(hit.prim_index), -1)
    dr.eval(distance, face)
    return np.array(distance) * np.float32(coordinates.unit_m), np.array(face).astype(np.int64)

"""Directions and bent centrelines in plant coordinates: metres, z up, -y towards the aisle."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def direction(azimuth: ArrayLike, inclination: ArrayLike, sway: ArrayLike = 0.0) -> FloatArray:
    """Unit vectors `(..., 3)`.

    Args:
        azimuth: around the vertical, radians counter-clockwise seen from above, 0 towards the aisle (-y).
        inclination: above the horizontal, within the vertical plane of the azimuth; beyond -pi / 2 it points
            back under its origin.
        sway: out of that plane, counter-clockwise.
    """
    sin_a, cos_a = np.sin(azimuth), np.cos(azimuth)
    within, aside = np.cos(sway), np.sin(sway)
    level = within * np.cos(inclination)
    found = np.empty((*np.broadcast_shapes(np.shape(level), np.shape(sin_a)), 3))
    found[..., 0] = level * sin_a + aside * cos_a
    found[..., 1] = aside * sin_a - level * cos_a
    found[..., 2] = within * np.sin(inclination)
    return found


def upper_side(
    azimuth: FloatArray, inclination: FloatArray, tangent: FloatArray, roll: ArrayLike = 0.0
) -> FloatArray:
    """`(n, 3)` unit vectors across the tangents: upwards in the azimuth's plane, then rolled.

    Args:
        azimuth: `(n,)`, as of `direction`.
        inclination: `(n,)` of the tangents; whatever their sway, the upper side is square to them.
        tangent: `(n, 3)` unit vectors of that azimuth and inclination.
        roll: about the tangents, radians.
    """
    up = direction(azimuth, inclination + 0.5 * np.pi)
    turn = np.asarray(roll)[..., None]
    return np.asarray(np.cos(turn) * up + np.sin(turn) * cross(tangent, up))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector products of `(n, 3)` vectors; `numpy.cross` takes several times as long."""
    found = np.empty(np.broadcast_shapes(a.shape, b.shape))
    found[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    found[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    found[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return found


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """`(n,)` scalar products of `(n, 3)` vectors."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def chains(base: FloatArray, steps: FloatArray, length: FloatArray) -> FloatArray:
    """`(n, k + 1, 3)` points from `(n, 3)` bases along `(n, k, 3)` unit steps, `(n,)` metres in all."""
    count = steps.shape[1]
    found = np.empty((len(steps), count + 1, 3))
    found[:, 0] = base
    np.cumsum(steps, axis=1, out=found[:, 1:])
    found[:, 1:] *= (length / count)[:, None, None]
    found[:, 1:] += base[:, None]
    return found


@cache
def middles(points: int) -> FloatArray:
    """Where the segments of a curve of `points` points have their middles, 0 at the base and 1 at the tip."""
    found = (np.arange(points - 1) + 0.5) / (points - 1)
    found.flags.writeable = False
    return found


def across(vector: FloatArray, axis: FloatArray) -> FloatArray:
    """`(n, 3)` unit vectors nearest to `(n, 3)` vectors that are square to the `(n, 3)` unit vectors `axis`.

    Where vector and axis are one, any unit vector across it.
    """
    found = vector - dot(vector, axis)[:, None] * axis
    square = dot(found, found)
    lost = square < 1e-24
    if lost.any():
        # The coordinate axis that is farthest from it.
        other = np.eye(3)[np.argmin(np.abs(axis[lost]), axis=1)]
        found[lost] = other - dot(other, axis[lost])[:, None] * axis[lost]
        square = dot(found, found)
    return np.asarray(found / np.sqrt(square)[:, None])

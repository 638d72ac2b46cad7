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


def upper_side(azimuth: float, inclination: float, tangent: FloatArray, roll: float = 0.0) -> FloatArray:
    """Unit vector across `tangent`: upwards in the azimuth's plane, turned by `roll` about the tangent."""
    up = direction(azimuth, inclination + 0.5 * np.pi)
    up = up - (up @ tangent) * tangent
    up = up / np.sqrt(up @ up)
    return np.cos(roll) * up + np.sin(roll) * cross(tangent, up)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector product of two `(3,)` vectors; `numpy.cross` takes ten times as long for a single pair."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def chain(base: FloatArray, steps: FloatArray, length: float) -> FloatArray:
    """`(k + 1, 3)` points from `base` along `k` unit steps, `length` in all."""
    curve = np.empty((len(steps) + 1, 3))
    curve[0] = base
    np.cumsum(steps, axis=0, out=curve[1:])
    curve[1:] *= length / len(steps)
    curve[1:] += base
    return curve


@cache
def middles(points: int) -> FloatArray:
    """Where the segments of a curve of `points` points have their middles, 0 at the base and 1 at the tip."""
    found = (np.arange(points - 1) + 0.5) / (points - 1)
    found.flags.writeable = False
    return found


def across(vector: FloatArray, axis: FloatArray) -> FloatArray:
    """The unit vector nearest to `vector` that is perpendicular to the unit vector `axis`."""
    found = vector - (vector @ axis) * axis
    return found / np.sqrt(found @ found)

"""The blossom end of a fruit: the point of its skin opposite the stalk."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def blossom_end(points: FloatArray, faces: NDArray[np.integer], v: NDArray[np.floating]) -> FloatArray:
    """Locate the blossom end on the triangles of a fruit.

    A modelled fruit has a vertex there, the only one with the surface coordinate v = 1; the axis of a bent
    fruit leaves it elsewhere. On a scan, it is the last point of the skin on the axis.

    Args:
        points: `(n, 3)` vertices in the fruit's axes, metres: the stalk end at 0, z along the axis.
        faces: `(f, 3)` their triangles.
        v: `(n,)` surface coordinate, from 0 at the stalk end to 1 at the blossom end.

    Returns:
        `(3,)` metres, in the same axes. If the axis misses the skin, the vertex farthest along it.
    """
    poles = np.flatnonzero(v == 1.0)
    if poles.size:
        return np.asarray(points[poles[0]], dtype=float)
    crossings = _axis_crossings(points[faces])
    if crossings.size:
        return np.array([0.0, 0.0, crossings.max()])
    return np.asarray(points[points[:, 2].argmax()], dtype=float)


def _axis_crossings(triangles: FloatArray) -> FloatArray:
    """`(k,)` z of the points where triangles `(f, 3, 3)` meet the z axis."""
    x, y = triangles[..., 0], triangles[..., 1]
    # Twice the areas of the triangles that the axis makes with each side, seen along the axis.
    following = np.roll(np.arange(3), -1)
    areas = x[:, following] * y[:, following[following]] - x[:, following[following]] * y[:, following]
    total = areas.sum(axis=1)
    inside = ((areas >= 0.0).all(axis=1) | (areas <= 0.0).all(axis=1)) & (total != 0.0)
    return np.einsum("fk,fk->f", areas[inside], triangles[inside, :, 2]) / total[inside]

"""Closed shells out of rings of points that lie where they may."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.body import Bodies, ring_faces
from pepperscene.geometry.spine import unit


def shells(
    rings: NDArray[np.float64],
    first: NDArray[np.float64],
    last: NDArray[np.float64],
    v: NDArray[np.float64],
    state: NDArray[np.float64],
) -> Bodies:
    """Closed bodies, each of r > 1 rings of c points between a first and a last point.

    Args:
        rings: `(n, r, c, 3)` metres; the columns run right-handed about the way from first to last.
        first: `(n, 3)` metres.
        last: `(n, 3)` metres.
        v: `(n, r)` surface coordinate of the rings; the first point has 0, the last one 1.
        state: `(n, 2 + r * c)` pigment state: first point, rings, last point.
    """
    n, r, c, _ = rings.shape
    normals = ring_normals(rings, first, last)
    v = np.repeat(np.pad(v, ((0, 0), (1, 1)), constant_values=((0, 0), (0.0, 1.0)))[..., None], c + 1, axis=2)
    u = np.broadcast_to(np.arange(c + 1) / c, v.shape)
    ends = state[:, :1], state[:, -1:]
    inner = state[:, 1:-1].reshape(n, r, c)
    uv = np.stack([u[:, 1:-1], v[:, 1:-1]], axis=-1).reshape(n, -1, 2)
    poles = np.broadcast_to(np.array([[0.5, 0.0], [0.5, 1.0]]), (n, 2, 2))
    return Bodies(
        np.concatenate([first[:, None], _seamed(rings), last[:, None]], axis=1),
        np.concatenate([normals[0][:, None], _seamed(normals[1]), normals[2][:, None]], axis=1),
        np.concatenate([poles[:, :1], uv, poles[:, 1:]], axis=1),
        np.clip(np.concatenate([ends[0], _seamed(inner[..., None])[..., 0], ends[1]], axis=1), 0.0, 1.0),
        ring_faces(r, c),
    )


def ring_normals(
    rings: NDArray[np.float64], first: NDArray[np.float64], last: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Unit normals `(n, 3)` of the first points, `(n, r, c, 3)` of the rings and `(n, 3)` of the last points.

    The mean of the faces around each point, all alike whatever their size, so that the edge of a plate looks
    rounded; two triangles between rings count as one face.
    """
    beside = np.concatenate([rings[:, :, 1:], rings[:, :, :1]], axis=2)
    between = _cross(beside[:, 1:] - rings[:, :-1], rings[:, 1:] - beside[:, :-1])
    start = _cross(beside[:, 0] - first[:, None], rings[:, 0] - first[:, None])
    end = _cross(rings[:, -1] - last[:, None], beside[:, -1] - last[:, None])
    strips = unit(np.concatenate([start[:, None], between, end[:, None]], axis=1))
    # Each point has a face to either side in the strip before its ring and in the one after.
    around = strips[:, :-1] + strips[:, 1:]
    around[:, :, 1:] += around[:, :, :-1].copy()
    around[:, :, 0] += strips[:, :-1, -1] + strips[:, 1:, -1]
    return unit(start.sum(axis=1)), unit(around), unit(end.sum(axis=1))


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross products along the last axis, without the copies that NumPy's makes."""
    result = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return result


def _seamed(rings: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n, r * (c + 1), d)` with column 0 repeated at the seam, where u jumps from 1 to 0."""
    return np.concatenate([rings, rings[:, :, :1]], axis=2).reshape(len(rings), -1, rings.shape[-1])

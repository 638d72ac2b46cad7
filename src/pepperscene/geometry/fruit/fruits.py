"""Closed shells out of rings of points that lie where they may."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.bodies import MeshBatch, ring_faces
from pepperscene.geometry.fruit.pericarp import Pericarps
from pepperscene.geometry.fruit.scan import Scan
from pepperscene.geometry.organ_arrays import hashed, organ_measure, size, smooth_field
from pepperscene.geometry.spine import unit
from pepperscene.grammar.plant import Organ


def shells(
    rings: NDArray[np.float64],
    first: NDArray[np.float64],
    last: NDArray[np.float64],
    v: NDArray[np.float64],
    state: NDArray[np.float64],
) -> MeshBatch:
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
    return MeshBatch(
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


FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FruitFrames:
    """Where n fruit hang.

    Attributes:
        foot: `(n, 3)` metres, where the stalk meets the fruit.
        axes: `(n, 3, 3)` unit rows: to the fruit's upper side, to its right, along its axis; right-handed.
    """

    foot: FloatArray
    axes: FloatArray

    def placed(self, points: FloatArray) -> FloatArray:
        """`(n, q, 3)` points `(n, q, 3)` that are given as metres up, to the right and along."""
        return points @ self.axes + self.foot[:, None]


def fruit_frames(organs: Sequence[Organ]) -> FruitFrames:
    """Frames of fruit whose axes run straight from the first to the last point of their curves.

    Raises:
        ValueError: these two points are the same.
    """
    foot = np.array([organ.curve[0] for organ in organs], dtype=float)
    axis = np.array([organ.curve[-1] for organ in organs], dtype=float) - foot
    if not np.all(np.linalg.norm(axis, axis=1) > 0.0):
        raise ValueError("a fruit's axis needs two distinct points")
    return FruitFrames(foot, axes_about(axis, np.array([organ.up for organ in organs], dtype=float)))


def axes_about(axis: FloatArray, up: FloatArray) -> FloatArray:
    """`(n, 3, 3)` unit rows across, to the right of and along each axis, the first as near `up` as may be."""
    along = unit(axis)
    side = up - np.sum(up * along, axis=1, keepdims=True) * along
    # An upper side along the axis tells nothing; then any perpendicular will do.
    other = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    side = unit(np.where(np.linalg.norm(side, axis=1, keepdims=True) > 1e-6, side, other))
    return np.stack([side, np.cross(along, side), along], axis=1)


def fruits(organs: Sequence[Organ], walls: Pericarps) -> MeshBatch:
    """Closed fruit out of their walls, with the ripeness of each point as its state.

    Measures: ripeness (mean, 0 unripe to 1 ripe), ripeness_spread (standard deviation over the fruit), seed.
    """
    n, rings, columns = walls.along.shape
    angle = 2.0 * np.pi * np.arange(columns) / columns
    up, right = walls.radius * np.cos(angle), walls.radius * np.sin(angle)
    straight = np.zeros((n, 2 + rings * columns, 3))
    straight[:, 1:-1] = np.stack([up, right, walls.along], axis=-1).reshape(n, -1, 3)
    straight[:, -1, 2] = walls.end
    state = ripeness(organs, straight / (0.5 * organ_measure(organs, "diameter_m"))[:, None, None])
    points = straight
    if np.any(walls.bend != 0.0):
        points = walls.bent(straight[..., 2], straight[..., 0], straight[..., 1])
    points = fruit_frames(organs).placed(points)
    return shells(points[:, 1:-1].reshape(n, rings, columns, 3), points[:, 0], points[:, -1], walls.v, state)


def ripeness(organs: Sequence[Organ], points: FloatArray) -> FloatArray:
    """`(n, q)` ripeness at `(n, q, 3)` points, in units of the fruit's radius; the last axis is the fruit's.

    Patches one and a half times wider than tall (chosen), and a trend from shoulder to tip, stronger in some
    fruit than in others.
    """
    seed, mean = organ_measure(organs, "seed", 0.0), organ_measure(organs, "ripeness", 0.0)
    spread = organ_measure(organs, "ripeness_spread", 0.0)
    points = points * [1.0, 1.0, 1.5]
    trend = points[..., 2] - points[..., 2].mean(axis=1, keepdims=True)
    trend /= trend.std(axis=1, keepdims=True)
    field = smooth_field(points, seed, 321, 2.2) + (0.3 + hashed(seed, 325, 1)) * trend
    field -= field.mean(axis=1, keepdims=True)
    field /= field.std(axis=1, keepdims=True)
    return mean[:, None] + spread[:, None] * field


def scanned_fruits(organs: Sequence[Organ], scan: Scan) -> MeshBatch:
    """Fruit that all wear one scan, each stretched to its own length and diameter.

    Measures: length_m (along the axis), diameter_m, ripeness, ripeness_spread, seed.
    """
    length, diameter = size(organs, "length_m"), size(organs, "diameter_m")
    stretch = np.stack([diameter, diameter, length], axis=1)[:, None]
    hung = fruit_frames(organs)
    local = scan.points * stretch
    return MeshBatch(
        hung.placed(local),
        # Normals go with the inverse of what stretches the points.
        unit(scan.normals / stretch) @ hung.axes,
        np.broadcast_to(scan.uv, (len(organs), *scan.uv.shape)),
        np.clip(ripeness(organs, local / (0.5 * diameter)[:, None, None]), 0.0, 1.0),
        scan.faces,
    )

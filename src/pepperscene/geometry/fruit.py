"""Fruit that hang from their stalks, modelled or scanned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.body import Bodies
from pepperscene.geometry.fruit_shell import shells
from pepperscene.geometry.measures import measure, size
from pepperscene.geometry.noise import hashed, smooth_field
from pepperscene.geometry.pericarp import Pericarps
from pepperscene.geometry.scan import Scan
from pepperscene.geometry.spine import unit
from pepperscene.grammar.plant import Organ

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frames:
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


def frames(organs: Sequence[Organ]) -> Frames:
    """Frames of fruit whose axes run straight from the first to the last point of their curves.

    Raises:
        ValueError: these two points are the same.
    """
    foot = np.array([organ.curve[0] for organ in organs], dtype=float)
    axis = np.array([organ.curve[-1] for organ in organs], dtype=float) - foot
    if not np.all(np.linalg.norm(axis, axis=1) > 0.0):
        raise ValueError("a fruit's axis needs two distinct points")
    return Frames(foot, axes_about(axis, np.array([organ.up for organ in organs], dtype=float)))


def axes_about(axis: FloatArray, up: FloatArray) -> FloatArray:
    """`(n, 3, 3)` unit rows across, to the right of and along each axis, the first as near `up` as may be."""
    along = unit(axis)
    side = up - np.sum(up * along, axis=1, keepdims=True) * along
    # An upper side along the axis tells nothing; then any perpendicular will do.
    other = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    side = unit(np.where(np.linalg.norm(side, axis=1, keepdims=True) > 1e-6, side, other))
    return np.stack([side, np.cross(along, side), along], axis=1)


def fruits(organs: Sequence[Organ], walls: Pericarps) -> Bodies:
    """Closed fruit out of their walls, with the ripeness of each point as its state.

    Measures: ripeness (mean, 0 unripe to 1 ripe), ripeness_spread (standard deviation over the fruit), seed.
    """
    n, rings, columns = walls.along.shape
    angle = 2.0 * np.pi * np.arange(columns) / columns
    up, right = walls.radius * np.cos(angle), walls.radius * np.sin(angle)
    straight = np.zeros((n, 2 + rings * columns, 3))
    straight[:, 1:-1] = np.stack([up, right, walls.along], axis=-1).reshape(n, -1, 3)
    straight[:, -1, 2] = walls.end
    state = ripeness(organs, straight / (0.5 * measure(organs, "diameter_m"))[:, None, None])
    points = straight
    if np.any(walls.bend != 0.0):
        points = walls.bent(straight[..., 2], straight[..., 0], straight[..., 1])
    points = frames(organs).placed(points)
    return shells(points[:, 1:-1].reshape(n, rings, columns, 3), points[:, 0], points[:, -1], walls.v, state)


def ripeness(organs: Sequence[Organ], points: FloatArray) -> FloatArray:
    """`(n, q)` ripeness at `(n, q, 3)` points, in units of the fruit's radius; the last axis is the fruit's.

    Patches one and a half times wider than tall (chosen), and a trend from shoulder to tip, stronger in some
    fruit than in others.
    """
    seed, mean = measure(organs, "seed", 0.0), measure(organs, "ripeness", 0.0)
    spread = measure(organs, "ripeness_spread", 0.0)
    points = points * [1.0, 1.0, 1.5]
    trend = points[..., 2] - points[..., 2].mean(axis=1, keepdims=True)
    trend /= trend.std(axis=1, keepdims=True)
    field = smooth_field(points, seed, 321, 2.2) + (0.3 + hashed(seed, 325, 1)) * trend
    field -= field.mean(axis=1, keepdims=True)
    field /= field.std(axis=1, keepdims=True)
    return mean[:, None] + spread[:, None] * field


def scanned_fruits(organs: Sequence[Organ], scan: Scan) -> Bodies:
    """Fruit that all wear one scan, each stretched to its own length and diameter.

    Measures: length_m (along the axis), diameter_m, ripeness, ripeness_spread, seed.
    """
    length, diameter = size(organs, "length_m"), size(organs, "diameter_m")
    stretch = np.stack([diameter, diameter, length], axis=1)[:, None]
    hung = frames(organs)
    local = scan.points * stretch
    return Bodies(
        hung.placed(local),
        # Normals go with the inverse of what stretches the points.
        unit(scan.normals / stretch) @ hung.axes,
        np.broadcast_to(scan.uv, (len(organs), *scan.uv.shape)),
        np.clip(ripeness(organs, local / (0.5 * diameter)[:, None, None]), 0.0, 1.0),
        scan.faces,
    )

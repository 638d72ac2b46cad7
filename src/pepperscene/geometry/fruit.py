"""Fruit that hang from their stalks, and the side of them that a calyx lies on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.body import Bodies
from pepperscene.geometry.fruit_shell import shells
from pepperscene.geometry.measures import measure
from pepperscene.geometry.noise import hashed, smooth_field
from pepperscene.geometry.pericarp import Pericarps
from pepperscene.geometry.spine import unit
from pepperscene.grammar.plant import Organ

FloatArray = NDArray[np.float64]

_CROWN_STEPS = 14  # chosen: heights of a crown are a few tenths of a millimetre right between them
_CROWN_COLUMNS = 40  # chosen: as many as a fruit has columns
_CROWN = (
    0.92  # part of the widest radius that a crown tells; chosen: beyond it the wall turns down too steeply
)
_STEEPEST = 1.2  # chosen: how steeply a sepal that is longer than its fruit is wide goes on downwards


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


@dataclass(frozen=True, eq=False)
class Crowns:
    """The sides of n fruit that face their stalks, as heights over the plane across each stalk's foot.

    Attributes:
        reach: `(n, c)` metres from the axis that the heights go, at c equal angles from the upper side.
        along: `(n, q, c)` metres towards the blossom end, at q equal steps of the radius from 0 to the reach.
    """

    reach: FloatArray
    along: FloatArray

    def height(self, which: NDArray[np.intp], radius: FloatArray, angle: FloatArray) -> FloatArray:
        """`(m, q, c)` metres along the axis of the fruit's surface; beyond the reach it goes straight on.

        Args:
            which: `(m,)` fruit.
            radius: `(m, q, c)` metres from the axis.
            angle: `(m, c)` radians from the upper side.
        """
        steps, columns = self.along.shape[1] - 1, self.along.shape[2]
        column = np.mod(angle / (2.0 * np.pi), 1.0) * columns
        left = np.floor(column).astype(np.intp) % columns
        share = (column - np.floor(column))[:, None]
        sides = []
        for side in (left, (left + 1) % columns):
            position = radius * (steps / self.reach[which[:, None], side])[:, None]
            index = np.clip(position.astype(np.intp), 0, steps - 1)
            low = self.along[which[:, None, None], index, side[:, None]]
            rise = self.along[which[:, None, None], index + 1, side[:, None]] - low
            limit = _STEEPEST * self.reach[which[:, None], side][:, None] / steps
            part = position - index
            beyond = np.clip(part - 1.0, 0.0, None)
            sides.append(low + np.minimum(part, 1.0) * rise + beyond * np.clip(rise, -limit, limit))
        return sides[0] + share * (sides[1] - sides[0])


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


def crowns(walls: Pericarps) -> Crowns:
    """The stalk sides of fruit, out of their walls."""
    n, _, columns = walls.radius.shape
    turn = np.arange(_CROWN_COLUMNS) * columns / _CROWN_COLUMNS
    left = np.floor(turn).astype(np.intp)
    share = turn - left
    radius, along = (
        np.pad(
            part[:, :, left] * (1.0 - share) + part[:, :, (left + 1) % columns] * share,
            ((0, 0), (1, 0), (0, 0)),
        )
        for part in (walls.radius, walls.along)
    )
    # Each column's wall rises outwards from the axis to the widest ring.
    rings = np.arange(radius.shape[1])[None, :, None]
    inner = rings <= 1 + walls.widest[:, None, None]
    reach = _CROWN * np.max(np.where(inner, radius, 0.0), axis=1)
    at = reach[:, None] * (np.arange(_CROWN_STEPS + 1) / _CROWN_STEPS)[None, :, None]
    knots = np.where(inner, radius, np.inf)
    index = np.clip((knots[:, None] <= at[:, :, None]).sum(axis=2) - 1, 0, None)
    row, column = np.arange(n)[:, None, None], np.arange(_CROWN_COLUMNS)
    start, stop = radius[row, index, column], radius[row, index + 1, column]
    part = (at - start) / (stop - start)
    low, high = along[row, index, column], along[row, index + 1, column]
    return Crowns(reach, low + part * (high - low))

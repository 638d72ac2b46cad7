"""Fruit in their place on the plant, and their shoulders, which the calyx rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.batch import MeshBatch, hash_uniform, read_measure, ring_shells, smooth_field
from pepperscene.geometry.fruit.pericarp import Pericarps
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.geometry.spine import normalize, perpendicular
from pepperscene.grammar.frames import cross
from pepperscene.grammar.plant import Organ

SHOULDER_STEPS: Final = 14  # chosen: heights are right to a few tenths of a millimetre between them
SHOULDER_COLUMNS: Final = 36  # chosen: as many as a fruit has columns
SHOULDER_EXTENT: Final = 0.92  # chosen: of the outline; beyond it the wall turns down too steeply
_STEEPEST: Final = 1.2  # chosen: slope at which a sepal continues downwards beyond the width of its fruit


@dataclass(frozen=True, eq=False)
class FruitFrames:
    """Coordinate systems of n fruit."""

    foot: FloatArray  # `(n, 3)` metres, where the stalk meets the fruit
    axes: FloatArray  # `(n, 3, 3)` unit rows, right-handed: to the upper side, to the right, along the axis

    def to_plant(self, points: FloatArray) -> FloatArray:
        """Convert `(n, q, 3)` points from metres up, right and along to plant coordinates."""
        return points @ self.axes + self.foot[:, None]


def fruit_frames(organs: Sequence[Organ]) -> FruitFrames:
    """Build the frames of fruit whose axes run straight from the first to the last point of their curves.

    Raises:
        ValueError: these two points are the same.
    """
    foot = np.array([organ.curve[0] for organ in organs], dtype=float)
    axis = np.array([organ.curve[-1] for organ in organs], dtype=float) - foot
    if not np.all(np.linalg.norm(axis, axis=1) > 0.0):
        raise ValueError("a fruit's axis needs two distinct points")
    return FruitFrames(foot, axis_frames(axis, np.array([organ.up for organ in organs], dtype=float)))


def axis_frames(axis: FloatArray, up: FloatArray) -> FloatArray:
    """`(n, 3, 3)` unit rows across (as near `up` as possible), to the right of and along each axis."""
    along = normalize(axis)
    side = perpendicular(along, up)
    return np.stack([side, cross(along, side), along], axis=1)


def mesh_fruits(organs: Sequence[Organ], pericarps: Pericarps) -> MeshBatch:
    """Build closed fruit from their pericarps, with the ripeness of each point as its state.

    Measures: ripeness (mean, 0 unripe to 1 ripe), ripeness_spread (standard deviation over the fruit), seed.
    """
    n, rings, columns = pericarps.along.shape
    angle = 2.0 * np.pi * np.arange(columns) / columns
    up, right = pericarps.radius * np.cos(angle), pericarps.radius * np.sin(angle)
    points = np.zeros((n, 2 + rings * columns, 3))
    points[:, 1:-1] = np.stack([up, right, pericarps.along], axis=-1).reshape(n, -1, 3)
    points[:, -1, 2] = pericarps.end
    state = ripeness(organs, points / (0.5 * read_measure(organs, "diameter_m"))[:, None, None])
    if np.any(pericarps.bend != 0.0):
        points = pericarps.bend_points(points[..., 2], points[..., 0], points[..., 1])
    points = fruit_frames(organs).to_plant(points)
    return ring_shells(points[:, 1:-1].reshape(n, rings, columns, 3), points[:, [0, -1]], pericarps.v, state)


def ripeness(organs: Sequence[Organ], points: FloatArray) -> FloatArray:
    """Compute `(n, q)` ripeness at `(n, q, 3)` points up, right and along, in units of the fruit's radius.

    Patches are one and a half times wider than tall (chosen), and there is a trend from shoulder to tip,
    stronger in some fruit than in others.
    """
    seed, mean = read_measure(organs, "seed", 0.0), read_measure(organs, "ripeness", 0.0)
    spread = read_measure(organs, "ripeness_spread", 0.0)
    points = points * [1.0, 1.0, 1.5]
    trend = points[..., 2] - points[..., 2].mean(axis=1, keepdims=True)
    trend /= trend.std(axis=1, keepdims=True)
    field = smooth_field(points, seed, 321, 2.2) + (0.3 + hash_uniform(seed, 325, 1)) * trend
    field -= field.mean(axis=1, keepdims=True)
    field /= field.std(axis=1, keepdims=True)
    return mean[:, None] + spread[:, None] * field


@dataclass(frozen=True, eq=False)
class Shoulders:
    """The stalk sides of n fruit, as depths below the plane through the stalk's foot and across the axis."""

    extent: FloatArray  # `(n, c)` metres from the axis, at c equal angles from the upper side
    along: FloatArray  # `(n, q, c)` metres towards the blossom end, at q equal radii from 0 to the extent

    def surface(self, fruit: IndexArray, radius: FloatArray, angle: FloatArray) -> FloatArray:
        """Interpolate `(m, q, c)` metres along the axis to the surface; beyond the extent it is straight.

        Args:
            fruit: `(m,)` indices.
            radius: `(m, q, c)` metres from the axis.
            angle: `(m, c)` radians from the upper side.
        """
        steps, columns = self.along.shape[1] - 1, self.along.shape[2]
        column = np.mod(angle / (2.0 * np.pi), 1.0) * columns
        left = np.floor(column).astype(np.intp) % columns
        fraction = (column - np.floor(column))[:, None]
        sides = []
        for side in (left, (left + 1) % columns):
            position = radius * (steps / self.extent[fruit[:, None], side])[:, None]
            index = np.clip(position.astype(np.intp), 0, steps - 1)
            low = self.along[fruit[:, None, None], index, side[:, None]]
            rise = self.along[fruit[:, None, None], index + 1, side[:, None]] - low
            limit = _STEEPEST * self.extent[fruit[:, None], side][:, None] / steps
            part = position - index
            excess = np.clip(part - 1.0, 0.0, None)
            sides.append(low + np.minimum(part, 1.0) * rise + excess * np.clip(rise, -limit, limit))
        return sides[0] + fraction * (sides[1] - sides[0])


def pericarp_shoulders(pericarps: Pericarps) -> Shoulders:
    """Sample the shoulders of modelled fruit."""
    n, _, columns = pericarps.radius.shape
    turn = np.arange(SHOULDER_COLUMNS) * columns / SHOULDER_COLUMNS
    left = np.floor(turn).astype(np.intp)
    fraction = turn - left
    radius, along = (
        np.pad(
            values[:, :, left] * (1.0 - fraction) + values[:, :, (left + 1) % columns] * fraction,
            ((0, 0), (1, 0), (0, 0)),
        )
        for values in (pericarps.radius, pericarps.along)
    )
    # The radius of each column increases from the axis to the widest ring.
    rings = np.arange(radius.shape[1])[None, :, None]
    inner = rings <= 1 + pericarps.widest[:, None, None]
    extent = SHOULDER_EXTENT * np.max(np.where(inner, radius, 0.0), axis=1)
    at = extent[:, None] * (np.arange(SHOULDER_STEPS + 1) / SHOULDER_STEPS)[None, :, None]
    knots = np.where(inner, radius, np.inf)
    index = np.clip((knots[:, None] <= at[:, :, None]).sum(axis=2) - 1, 0, None)
    row, column = np.arange(n)[:, None, None], np.arange(SHOULDER_COLUMNS)
    start, stop = radius[row, index, column], radius[row, index + 1, column]
    # Clipped, because the radius of a deep furrow may decrease in between.
    part = np.clip((at - start) / (stop - start), 0.0, 1.0)
    low, high = along[row, index, column], along[row, index + 1, column]
    return Shoulders(extent, low + part * (high - low))


def concatenate_shoulders(parts: Sequence[Shoulders], order: IndexArray) -> Shoulders:
    """Join shoulders and bring them into an order."""
    extent = np.concatenate([part.extent for part in parts])
    return Shoulders(extent[order], np.concatenate([part.along for part in parts])[order])

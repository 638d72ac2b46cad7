"""Directions, centrelines and start points of organs in plant coordinates: metres, z up, -y to the aisle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.grammar.hashing import FloatArray
from pepperscene.grammar.plant import Indices, KindParameters


def direction(azimuth: ArrayLike, inclination: ArrayLike, sway: ArrayLike = 0.0) -> FloatArray:
    """Unit vectors `(..., 3)`.

    Args:
        azimuth: around the vertical, radians counter-clockwise seen from above, 0 towards the aisle (-y).
        inclination: above the horizontal, within the vertical plane of the azimuth; below -pi / 2 it points
            back under its origin.
        sway: out of that plane, counter-clockwise.
    """
    sin_a, cos_a = np.sin(azimuth), np.cos(azimuth)
    cos_sway, sin_sway = np.cos(sway), np.sin(sway)
    level = cos_sway * np.cos(inclination)
    result = np.empty((*np.broadcast_shapes(np.shape(level), np.shape(sin_a)), 3))
    result[..., 0] = level * sin_a + sin_sway * cos_a
    result[..., 1] = sin_sway * sin_a - level * cos_a
    result[..., 2] = cos_sway * np.sin(inclination)
    return result


def upper_side(
    azimuth: FloatArray, inclination: FloatArray, tangent: FloatArray, roll: ArrayLike = 0.0
) -> FloatArray:
    """`(n, 3)` unit vectors orthogonal to the tangents: upwards in the azimuth's plane, then rolled.

    Args:
        azimuth: `(n,)`, as of `direction`.
        inclination: `(n,)` of the tangents; the upper side is orthogonal to them whatever their sway.
        tangent: `(n, 3)` unit vectors of that azimuth and inclination.
        roll: about the tangents, radians.
    """
    up = direction(azimuth, inclination + 0.5 * np.pi)
    angle = np.asarray(roll)[..., None]
    return np.asarray(np.cos(angle) * up + np.sin(angle) * cross(tangent, up))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products of `(n, 3)` vectors; `numpy.cross` takes several times as long."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    result[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    result[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    result[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return result


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """`(n,)` dot products of `(n, 3)` vectors."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def polylines(base: FloatArray, steps: FloatArray, length: FloatArray) -> FloatArray:
    """`(n, k + 1, 3)` points from `(n, 3)` bases along `(n, k, 3)` unit steps, `(n,)` metres in total."""
    count = steps.shape[1]
    points = np.empty((len(steps), count + 1, 3))
    points[:, 0] = base
    np.cumsum(steps, axis=1, out=points[:, 1:])
    points[:, 1:] *= (length / count)[:, None, None]
    points[:, 1:] += base[:, None]
    return points


@cache
def segment_midpoints(points: int) -> FloatArray:
    """Midpoints of the segments of a curve of `points` points, 0 at the base and 1 at the tip; read-only."""
    midpoints = (np.arange(points - 1) + 0.5) / (points - 1)
    midpoints.flags.writeable = False
    return midpoints


def orthogonal_units(vector: FloatArray, axis: FloatArray) -> FloatArray:
    """`(n, 3)` unit vectors orthogonal to the unit vectors `axis` and closest to `vector`, all `(n, 3)`.

    If vector and axis are parallel, any unit vector orthogonal to the axis.
    """
    result = vector - dot(vector, axis)[:, None] * axis
    square = dot(result, result)
    parallel = square < 1e-24
    if parallel.any():
        # The coordinate axis that is farthest from it.
        fallback = np.eye(3)[np.argmin(np.abs(axis[parallel]), axis=1)]
        result[parallel] = fallback - dot(fallback, axis[parallel])[:, None] * axis[parallel]
        square = dot(result, result)
    return np.asarray(result / np.sqrt(square)[:, None])


_START_RADIUS: Final = 0.8  # chosen: organs start at this fraction of the node's radius, so that no gap shows


@dataclass(frozen=True, eq=False)
class NodeFrames:
    """The nodes from the ground up: `(parts, 3)` centres and axes, `(parts,)` radii and half lengths."""

    centre: FloatArray
    axis: FloatArray
    radius: FloatArray
    half_length: FloatArray

    def sites(self, parts: KindParameters) -> Sites:
        """Start points of organs on the sides of the nodes."""
        azimuth, zeros, node = parts.values["azimuth"], np.zeros(len(parts)), parts.phytomer
        axis, radius = self.axis[node], self.radius[node]
        lift = (parts.values["lift"] * self.half_length[node])[:, None] * axis
        outward = orthogonal_units(direction(azimuth, zeros), axis)
        return Sites(
            start=self.centre[node] + lift + _START_RADIUS * radius[:, None] * outward,
            azimuth=azimuth,
            sway=zeros,
            slope=zeros,
            continues=np.zeros(len(parts), dtype=bool),
            inset=(1.0 - _START_RADIUS) * radius,
            parts=parts,
            stalks=None,
        )


class StalkFrames:
    """The stalks of a plant that can bear others, indexed by their numbers among its organs.

    A stalk's inclination at s, 0 base to 1 tip, is `base + bend s + more s^1.5`, its sway `sway s`; it is
    rolled about itself by `roll` relative to the vertical plane of its azimuth.
    """

    def __init__(self, count: int, points: int) -> None:
        self.azimuth, self.base, self.bend, self.more = np.zeros((4, count))
        self.sway, self.roll, self.radius = np.zeros((3, count))
        self.line = np.zeros((count, points, 3))

    def add(self, number: Indices, **columns: FloatArray) -> None:
        """Add `(n,)` stalks: values of each attribute, and their `(n, points, 3)` centrelines as `line`."""
        for name, values in columns.items():
            getattr(self, name)[number] = values

    def points(self, number: Indices, at: FloatArray) -> FloatArray:
        """`(n, 3)` points on the centrelines, at positions 0 to 1."""
        position = np.clip(at, 0.0, 1.0) * (self.line.shape[1] - 1)
        below = np.minimum(position.astype(np.intp), self.line.shape[1] - 2)
        part = (position - below)[:, None]
        return np.asarray((1.0 - part) * self.line[number, below] + part * self.line[number, below + 1])

    def inclination(self, number: Indices, at: FloatArray) -> FloatArray:
        """`(n,)` inclination at positions along them."""
        return np.asarray(self.base[number] + self.bend[number] * at + self.more[number] * at**1.5)

    def upper_side(self, number: Indices, at: FloatArray) -> FloatArray:
        """`(n, 3)` unit vectors towards their upper sides at positions along them."""
        inclination = self.inclination(number, at)
        tangent = direction(self.azimuth[number], inclination, self.sway[number] * at)
        return upper_side(self.azimuth[number], inclination, tangent, self.roll[number])

    def sites(self, parts: KindParameters) -> Sites:
        """Start points of organs on the centrelines; organs at a tip continue the stalk unless sideways."""
        at, parent = parts.values["at"], parts.parent
        continues = (at >= 1.0) & (parts.values["sideways"] == 0.0)
        sway = self.sway[parent] * at
        # An organ that continues a stalk continues its sway; all others grow in the plane of its direction.
        azimuth = self.azimuth[parent] + parts.values["azimuth"] + np.where(continues, 0.0, sway)
        return Sites(
            start=self.points(parent, at),
            azimuth=azimuth,
            sway=np.where(continues, sway, 0.0),
            slope=self.inclination(parent, at),
            continues=continues,
            inset=np.where(at >= 1.0, 0.0, self.radius[parent]),
            parts=parts,
            stalks=self,
        )


@dataclass(frozen=True, eq=False)
class Sites:
    """`(n,)` start points of organs of one kind."""

    start: FloatArray  # `(n, 3)` points
    azimuth: FloatArray  # of the vertical planes that they grow in
    sway: FloatArray  # out of those planes, at their start
    slope: FloatArray  # inclination of the stalk that they continue
    continues: NDArray[np.bool_]  # whether they continue a stalk from its tip
    inset: FloatArray  # depth of their start below the parent's surface, metres
    parts: KindParameters  # their parameters
    stalks: StalkFrames | None  # that bear them, or None on nodes

    @property
    def heading(self) -> FloatArray:
        """`(n,)` azimuth of their start."""
        return np.asarray(self.azimuth + self.sway)

    def roll(self, inclination: FloatArray, tangent: FloatArray) -> FloatArray:
        """`(n,)` roll relative to the vertical plane: of the stalk that they continue, or into its plane.

        Args:
            inclination: `(n,)` of their first segment.
            tangent: `(n, 3)` of their first segment.
        """
        if self.stalks is None:
            return np.zeros(len(self.parts))
        at, parent = self.parts.values["at"], self.parts.parent
        # Organs that leave the side of a stalk, such as leaflets, are in its plane.
        up, default = self.stalks.upper_side(parent, at), upper_side(self.azimuth, inclination, tangent)
        in_plane = np.arctan2(dot(up, cross(tangent, default)), dot(up, default))
        sideways = self.parts.values["sideways"] > 0.0
        return np.where(sideways, in_plane, np.where(self.continues, self.stalks.roll[parent], 0.0))

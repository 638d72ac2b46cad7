"""Directions and bent centrelines in plant coordinates: metres, z up, -y towards the aisle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.grammar.plant import KindParameters

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


Indices = NDArray[np.intp]

_SUNK: Final = 0.8  # chosen: parts start this share of the node's radius out, so that no gap shows


@dataclass(frozen=True, eq=False)
class NodeFrames:
    """The nodes from the ground up: `(parts, 3)` centres and axes, `(parts,)` radii and half lengths."""

    centre: FloatArray
    axis: FloatArray
    radius: FloatArray
    half_length: FloatArray

    def sides(self, phytomer: Indices, azimuth: FloatArray, lift: FloatArray) -> FloatArray:
        """`(n, 3)` points on the nodes' sides where parts start that grow towards `(n,)` azimuths."""
        axis = self.axis[phytomer]
        along = (lift * self.half_length[phytomer])[:, None] * axis
        outward = across(direction(azimuth, np.zeros_like(azimuth)), axis)
        return np.asarray(self.centre[phytomer] + along + _SUNK * self.radius[phytomer][:, None] * outward)

    def depth(self, phytomer: Indices) -> FloatArray:
        """`(n,)` how deep parts start below the nodes' surface."""
        return np.asarray((1.0 - _SUNK) * self.radius[phytomer])


class StalkFrames:
    """The stalks of a plant that others can grow on, by their numbers among its organs.

    A stalk's inclination at s, 0 base to 1 tip, is `base + bend s + more s^1.5`, its sway `sway s`; it is
    rolled about itself by `roll` against the vertical plane of its azimuth.
    """

    def __init__(self, count: int, points: int) -> None:
        self.azimuth, self.base, self.bend, self.more = np.zeros((4, count))
        self.sway, self.roll, self.radius = np.zeros((3, count))
        self.line = np.zeros((count, points, 3))

    def add(
        self,
        number: Indices,
        *,
        azimuth: FloatArray,
        base: FloatArray,
        bend: FloatArray,
        more: FloatArray,
        sway: FloatArray,
        roll: FloatArray,
        radius: FloatArray,
        line: FloatArray,
    ) -> None:
        """Take in `(n,)` stalks with their `(n, points, 3)` centrelines."""
        self.azimuth[number], self.base[number], self.bend[number] = azimuth, base, bend
        self.more[number], self.sway[number], self.roll[number] = more, sway, roll
        self.radius[number], self.line[number] = radius, line

    def points(self, number: Indices, at: FloatArray) -> FloatArray:
        """`(n, 3)` points on the centrelines, at places 0 to 1."""
        place = np.clip(at, 0.0, 1.0) * (self.line.shape[1] - 1)
        below = np.minimum(place.astype(np.intp), self.line.shape[1] - 2)
        part = (place - below)[:, None]
        return np.asarray((1.0 - part) * self.line[number, below] + part * self.line[number, below + 1])

    def inclination(self, number: Indices, at: FloatArray) -> FloatArray:
        """`(n,)` inclination at places along them."""
        return np.asarray(self.base[number] + self.bend[number] * at + self.more[number] * at**1.5)

    def roll_of_side(
        self,
        number: Indices,
        at: FloatArray,
        azimuth: FloatArray,
        inclination: FloatArray,
        tangent: FloatArray,
    ) -> FloatArray:
        """`(n,)` roll by which what leaves their side lies in their own plane, as leaflets do.

        Args:
            number: of the stalks.
            at: places along them.
            azimuth: `(n,)` of what grows there.
            inclination: `(n,)` of its first part.
            tangent: `(n, 3)` of its first part.
        """
        theirs = self.inclination(number, at)
        along = direction(self.azimuth[number], theirs, self.sway[number] * at)
        up = upper_side(self.azimuth[number], theirs, along, self.roll[number])
        own = upper_side(azimuth, inclination, tangent)
        return np.asarray(np.arctan2(dot(up, cross(tangent, own)), dot(up, own)))


@dataclass(frozen=True, eq=False)
class Sites:
    """`(n,)` places where organs of one kind start.

    Attributes:
        start: `(n, 3)` points.
        azimuth: of the vertical planes that they grow in.
        sway: out of those planes, at their start.
        slope: inclination of what they go on from, for those that continue a stalk.
        continues: which of them go on from a stalk's tip.
        inset: how deep they start below the surface of what bears them, metres.
        parts: their parameters.
        stalks: on which they stand, or None on nodes.
    """

    start: FloatArray
    azimuth: FloatArray
    sway: FloatArray
    slope: FloatArray
    continues: NDArray[np.bool_]
    inset: FloatArray
    parts: KindParameters
    stalks: StalkFrames | None

    @property
    def heading(self) -> FloatArray:
        """`(n,)` azimuth into which they start."""
        return np.asarray(self.azimuth + self.sway)

    def roll(self, inclination: FloatArray, tangent: FloatArray) -> FloatArray:
        """`(n,)` roll against the vertical plane: as what they continue, or into their bearer's plane.

        Args:
            inclination: `(n,)` of their first part.
            tangent: `(n, 3)` of their first part.
        """
        if self.stalks is None:
            return np.zeros(len(self.parts))
        at, parent = self.parts.values["at"], self.parts.parent
        flat = self.stalks.roll_of_side(parent, at, self.azimuth, inclination, tangent)
        sideways = self.parts.values["sideways"] > 0.0
        return np.where(sideways, flat, np.where(self.continues, self.stalks.roll[parent], 0.0))


def on_nodes(parts: KindParameters, nodes: NodeFrames) -> Sites:
    """Sites on the sides of the stem's nodes."""
    azimuth, nothing = parts.values["azimuth"], np.zeros(len(parts))
    return Sites(
        start=nodes.sides(parts.phytomer, azimuth, parts.values["lift"]),
        azimuth=azimuth,
        sway=nothing,
        slope=nothing,
        continues=np.zeros(len(parts), dtype=bool),
        inset=nodes.depth(parts.phytomer),
        parts=parts,
        stalks=None,
    )


def on_stalks(parts: KindParameters, stalks: StalkFrames) -> Sites:
    """Sites on the centrelines of stalks; what stands at a tip and not aside goes on from there."""
    at, parent = parts.values["at"], parts.parent
    continues = (at >= 1.0) & (parts.values["sideways"] == 0.0)
    bent = stalks.sway[parent] * at
    # What continues a stalk goes on in its sway; all else takes the direction there for its own plane.
    azimuth = stalks.azimuth[parent] + parts.values["azimuth"] + np.where(continues, 0.0, bent)
    return Sites(
        start=stalks.points(parent, at),
        azimuth=azimuth,
        sway=np.where(continues, bent, 0.0),
        slope=stalks.inclination(parent, at),
        continues=continues,
        inset=np.where(at >= 1.0, 0.0, stalks.radius[parent]),
        parts=parts,
        stalks=stalks,
    )

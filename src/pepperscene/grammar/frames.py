"""Where organs stand that others grow on: the nodes of the stem, and stalks along their centrelines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.grammar.curves import FloatArray, across, cross, direction, dot, upper_side

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

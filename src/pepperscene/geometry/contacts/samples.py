"""Points on triangles, so close together that no fruit slips between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

SPACING: Final = 4.5e-3
"""Metres between neighbouring points along an edge of two triangles at most, chosen.

What lies straight between two points s apart and dips into a ball of radius R is missed down to s^2 / 8R:
0.6 mm for the tip of a pointed fruit or of a lobe, R = 4 mm, nothing for the flank of a fruit.
"""


def filling(corners: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Points on triangles, beside their corners, so that none is far from the next.

    Args:
        corners: `(f, 3, 3)` metres.

    Returns:
        `(q, 3)` points and `(q,)` the triangle of each, ascending; none for a triangle without a long edge.
    """
    a, b, c = (np.ascontiguousarray(corners[:, corner]) for corner in range(3))
    square = np.stack([_squared(b - a), _squared(c - b), _squared(a - c)])
    longest = np.maximum.reduce(square)
    large = np.flatnonzero(longest > np.float32(SPACING**2))
    # The longest edge leads from a start along a base; across from it is the third corner.
    edge, row = square[:, large].argmax(axis=0), 3 * large
    flat = corners.reshape(-1, 3)
    start = flat[row + edge]
    base, side = flat[row + (edge + 1) % 3] - start, flat[row + (edge + 2) % 3] - start
    length = np.sqrt(longest[large])
    foot = np.einsum("fi,fi->f", base, side) / length
    height = np.sqrt(np.maximum(_squared(side) - foot * foot, 0.0))
    # A slender triangle needs points along its longest edge only, and its neighbour there lays half of them.
    part = np.where(height > 2.0 * SPACING, 1.0, 0.5)
    # Rows of points along the longest edge, ever shorter ones towards the corner across from it.
    rows = np.ceil(part * height / SPACING).astype(np.intp)
    triangle, row = counted(rows)
    up = (row / rows[triangle]).astype(np.float32)
    number = np.ceil(part[triangle] * (1.0 - up) * length[triangle] / SPACING).astype(np.intp)
    line, step = counted(number)
    triangle, up = triangle[line], up[line]
    # A quarter step in: the neighbour, who runs along the same edge the other way, fills the gaps.
    along = (1.0 - up) * ((step + 0.25) / number[line]).astype(np.float32)
    points = start[triangle] + along[:, None] * base[triangle] + up[:, None] * side[triangle]
    return points, large[triangle]


def _squared(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """`(f,)` squared lengths of vectors `(f, 3)`."""
    return np.asarray(np.einsum("fi,fi->f", vectors, vectors))


def counted(numbers: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """For numbers n of things, 0 to n - 1 in a row: which thing each entry is for, and its count."""
    owner = np.repeat(np.arange(len(numbers)), numbers)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(numbers) - numbers, numbers)


SIZE: Final = 16
"""Points in a patch, chosen: on a blade, a patch is about 3 cm wide."""

_BITS: Final = 5  # along either axis of an organ's box, so that all three fit into two bytes

Points = NDArray[np.float32]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Patches:
    """Groups of points.

    Attributes:
        points: `(n, SIZE, 3)` metres.
        centre: `(n, 3)` metres.
        radius: `(n,)` metres, of the ball around the centre that holds all points of a patch.
    """

    points: Points
    centre: Points
    radius: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.radius)

    @classmethod
    def room(cls, number: int) -> Patches:
        """Room for patches that are put in later."""
        points = np.empty((3, number, SIZE), dtype=np.float32).transpose(1, 2, 0)
        return cls(points, np.empty((3, number), dtype=np.float32).T, np.empty(number, dtype=np.float32))

    def coordinates(self, patch: Indices, every: int = 1) -> Points:
        """`(3, s, h)` metres: x, y and z of every so-manieth point of some patches."""
        place = SIZE * patch + np.arange(0, SIZE, every)[:, None]
        # They lie like this in memory, so that this is a view.
        return np.stack([axis.take(place) for axis in self.points.transpose(2, 0, 1).reshape(3, -1)])

    def part(self, rows: slice) -> Patches:
        """Some of them, seen."""
        return Patches(self.points[rows], self.centre[rows], self.radius[rows])

    def put(self, first: int, other: Patches) -> None:
        """Let others take the place of as many from a first one on."""
        rows = slice(first, first + len(other))
        self.points[rows], self.centre[rows], self.radius[rows] = other.points, other.centre, other.radius

    def moved(self, rotation: NDArray[np.float64], shift: NDArray[np.float64]) -> Patches:
        """With every point at rotation @ point + shift."""
        points = (self.points.reshape(-1, 3) @ rotation.T + shift).astype(np.float32)
        centre = (self.centre @ rotation.T + shift).astype(np.float32)
        return Patches(points.reshape(self.points.shape), centre, self.radius)


def patched(
    points: Points, owner: Indices, low: Points, extent: NDArray[np.float32]
) -> tuple[Patches, Indices]:
    """Points sorted into patches, owner by owner.

    Points are sorted along a Z-order curve (Morton 1966) through the box of each owner and cut into runs;
    the last run of an owner is filled up with its last point.

    Args:
        points: `(p, 3)` metres.
        owner: `(p,)`.
        low: `(owners, 3)` metres, lower corners of the boxes around the points of each; each has a point.
        extent: `(owners,)` metres, the longest sides of these boxes.

    Returns:
        Patches, and `(owners,)` how many each has.
    """
    owners = len(low)
    small = owner.astype(np.uint16) if owners < 2**16 else owner
    order = np.argsort(small, kind="stable")
    number = np.bincount(owner, minlength=owners)
    first = np.cumsum(number) - number
    sorted_points = points[order]
    scale = np.float32(2**_BITS - 0.01) / np.maximum(extent, np.float32(1e-9))
    who = small[order]
    cell = ((sorted_points - low[who]) * scale[who, None]).astype(np.uint8) & np.uint8(2**_BITS - 1)
    key = _SPREAD[cell[:, 0]] | _SPREAD[cell[:, 1]] << 1 | _SPREAD[cell[:, 2]] << 2
    # By place, then by owner: whole numbers of two bytes are sorted by their digits.
    along = np.argsort(key, kind="stable")
    along = along[np.argsort(who[along], kind="stable")]
    # Runs, the last of each owner filled up.
    count = -(-number // SIZE)
    place, run = counted(count)
    last = first[place] + number[place] - 1
    rows = np.minimum((first[place] + SIZE * run)[:, None] + np.arange(SIZE), last[:, None])
    laid = sorted_points[along[rows]]
    centre = np.matmul(_MEAN, laid)[:, 0]
    off = laid - centre[:, None]
    radius = np.sqrt(np.einsum("npi,npi->np", off, off).max(axis=1))
    # A micrometre for rounding.
    return Patches(laid, centre, radius + np.float32(1e-6)), count


def _spread() -> NDArray[np.uint16]:
    """Numbers with two empty bits between any two of theirs."""
    value = np.arange(2**_BITS, dtype=np.uint16)
    return np.bitwise_or.reduce([(value >> bit & 1) << 3 * bit for bit in range(_BITS)]).astype(np.uint16)


_SPREAD: Final = _spread()
_MEAN: Final = np.full((1, SIZE), 1.0 / SIZE, dtype=np.float32)

"""Sample points on the triangles of organs, in patches with bounding spheres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.mesh import IndexArray, SingleArray, expand_counts

SPACING: Final = 4.5e-3
"""Maximum distance in metres of neighbouring points along an edge of two triangles, chosen.

A straight line between points at distance s that dips into a sphere of radius R is missed down to a depth of
s^2 / 8R: 0.6 mm for the tip of a pointed fruit or of a lobe, R = 4 mm, nothing for the flank of a fruit.
"""

PATCH_SIZE: Final = 16
"""Points in a patch, chosen: on a blade, a patch is about 3 cm wide."""

_MAX_STEPS: Final = 32
"""Points along the base of a broad triangle at most. Chosen: 144 mm, which no triangle of a shipped plant
exceeds; a leaf of 2 m would otherwise have half a million points."""
_BITS: Final = 5  # along either axis of an organ's box, so that all three fit into two bytes


def fill_triangles(corners: SingleArray) -> tuple[SingleArray, IndexArray]:
    """Place points on triangles, in addition to their corners, so that none is far from the next.

    Args:
        corners: `(f, 3, 3)` metres.

    Returns:
        `(q, 3)` points and `(q,)` the triangle of each, ascending; none for a triangle without a long edge.
    """
    a, b, c = (np.ascontiguousarray(corners[:, corner]) for corner in range(3))
    square = np.stack([squared_lengths(b - a), squared_lengths(c - b), squared_lengths(a - c)])
    longest = np.maximum.reduce(square)
    large = np.flatnonzero(longest > np.float32(SPACING**2))
    # The longest edge is the base, from a start; the third corner is opposite to it.
    edge, row = square[:, large].argmax(axis=0), 3 * large
    flat = corners.reshape(-1, 3)
    start = flat[row + edge]
    base, side = flat[row + (edge + 1) % 3] - start, flat[row + (edge + 2) % 3] - start
    length = np.sqrt(longest[large])
    foot = np.einsum("fi,fi->f", base, side) / length
    height = np.sqrt(np.maximum(squared_lengths(side) - foot * foot, 0.0))
    # A slender triangle needs points along its longest edge only, half of them on its neighbour there.
    part = np.where(height > 2.0 * SPACING, 1.0, 0.5)
    # Triangles of very large organs have points that are farther apart.
    spacing = np.where(part == 1.0, np.maximum(length / _MAX_STEPS, np.float32(SPACING)), np.float32(SPACING))
    # Rows of points parallel to the base, shorter towards the opposite corner.
    rows = np.ceil(part * height / spacing).astype(np.intp)
    triangle, row = expand_counts(rows)
    up = (row / rows[triangle]).astype(np.float32)
    number = np.ceil(part[triangle] * (1.0 - up) * length[triangle] / spacing[triangle]).astype(np.intp)
    line, step = expand_counts(number)
    triangle, up = triangle[line], up[line]
    # Offset by a quarter step: the neighbour, which runs along the same edge the other way, fills the gaps.
    along = (1.0 - up) * ((step + 0.25) / number[line]).astype(np.float32)
    points = start[triangle] + along[:, None] * base[triangle] + up[:, None] * side[triangle]
    return points, large[triangle]


def squared_lengths(vectors: SingleArray) -> SingleArray:
    """`(n,)` squared lengths of `(n, 3)` vectors."""
    return np.asarray(np.einsum("fi,fi->f", vectors, vectors))


@dataclass(frozen=True, eq=False)
class Patches:
    """Groups of neighbouring points."""

    points: SingleArray  # `(n, PATCH_SIZE, 3)` metres
    centre: SingleArray  # `(n, 3)` metres, of the bounding spheres
    radius: SingleArray  # `(n,)` metres, of the bounding spheres

    def __len__(self) -> int:
        return len(self.radius)

    @classmethod
    def empty(cls, count: int) -> Patches:
        """Allocate patches without values."""
        # Coordinates come first in memory, as compiled functions read them.
        points = np.empty((3, count, PATCH_SIZE), dtype=np.float32).transpose(1, 2, 0)
        return cls(points, np.empty((3, count), dtype=np.float32).T, np.empty(count, dtype=np.float32))

    @property
    def coordinates(self) -> SingleArray:
        """`(3, n, PATCH_SIZE)` metres: x, y and z of all points, sharing memory."""
        return self.points.transpose(2, 0, 1)

    def write(self, first: int, other: Patches, count: int) -> None:
        """Overwrite patches, starting at index `first`, by the first `count` of others."""
        for ours, theirs in zip(
            (self.points, self.centre, self.radius), (other.points, other.centre, other.radius), strict=True
        ):
            ours[first : first + count] = theirs[:count]


def build_patches(
    points: SingleArray, owner: IndexArray, low: SingleArray, extent: SingleArray
) -> tuple[Patches, IndexArray]:
    """Group points into patches, owner by owner.

    Points are sorted along a Z-order curve (Morton 1966) through the box of each owner and cut into runs; the
    last run of an owner is padded with its last point.

    Args:
        points: `(p, 3)` metres.
        owner: `(p,)`.
        low: `(owners, 3)` metres, lower corners of the boxes around the points of each; each has a point.
        extent: `(owners,)` metres, the longest sides of these boxes.

    Returns:
        The patches, and `(owners,)` number of patches of each owner.
    """
    owners = len(low)
    small = owner.astype(np.uint16) if owners < 2**16 else owner
    order = np.argsort(small, kind="stable")
    number = np.bincount(owner, minlength=owners)
    first = np.cumsum(number) - number
    sorted_points, sorted_owner = points[order], small[order]
    scale = np.float32(2**_BITS - 0.01) / np.maximum(extent, np.float32(1e-9))
    cell = ((sorted_points - low[sorted_owner]) * scale[sorted_owner, None]).astype(np.uint8)
    cell &= np.uint8(2**_BITS - 1)
    key = _INTERLEAVED[cell[:, 0]] | _INTERLEAVED[cell[:, 1]] << 1 | _INTERLEAVED[cell[:, 2]] << 2
    # By key, then by owner: NumPy sorts two-byte integers by radix.
    along = np.argsort(key, kind="stable")
    along = along[np.argsort(sorted_owner[along], kind="stable")]
    count = -(-number // PATCH_SIZE)
    position, run = expand_counts(count)
    last = first[position] + number[position] - 1
    rows = np.minimum((first[position] + PATCH_SIZE * run)[:, None] + np.arange(PATCH_SIZE), last[:, None])
    grouped = sorted_points[along[rows]]
    centre = np.matmul(_MEAN, grouped)[:, 0]
    offset = grouped - centre[:, None]
    radius = np.sqrt(np.einsum("npi,npi->np", offset, offset).max(axis=1))
    # One micrometre for rounding.
    return Patches(grouped, centre, radius + np.float32(1e-6)), count


# Numbers of `_BITS` bits, with two zero bits between neighbouring bits.
_INTERLEAVED: Final = np.bitwise_or.reduce(
    [(np.arange(2**_BITS) >> bit & 1) << 3 * bit for bit in range(_BITS)]
).astype(np.uint16)
_MEAN: Final = np.full((1, PATCH_SIZE), 1.0 / PATCH_SIZE, dtype=np.float32)

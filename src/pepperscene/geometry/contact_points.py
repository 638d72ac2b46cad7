"""Points on triangles, so close together that no fruit slips between them."""

from __future__ import annotations

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

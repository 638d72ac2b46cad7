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
    square = np.empty((3, len(corners)), dtype=np.float32)
    for edge in range(3):
        along = corners[:, edge] - corners[:, edge - 2]
        square[edge] = np.einsum("fi,fi->f", along, along)
    longest = np.maximum.reduce(square)
    large = np.flatnonzero(longest > SPACING**2)
    # Turned so that the longest edge leads from a to b.
    turned = (square[:, large].argmax(axis=0)[:, None] + np.arange(3)) % 3
    a, b, c = corners[large[:, None], turned].swapaxes(0, 1)
    base, side, length = b - a, c - a, np.sqrt(longest[large])
    height = np.linalg.norm(np.cross(base, side), axis=1) / length
    # Rows of points along the longest edge, ever shorter ones towards the corner across from it.
    rows = np.ceil(0.5 * height / SPACING).astype(np.intp)
    triangle, row = _counted(rows)
    up = row / rows[triangle]
    number = np.ceil(0.5 * (1.0 - up) * length[triangle] / SPACING).astype(np.intp)
    line, step = _counted(number)
    triangle, up = triangle[line], up[line]
    # A quarter step in: the neighbour, who runs along the same edge the other way, fills the gaps.
    share = (1.0 - up) * (step + 0.25) / number[line]
    points = a[triangle] + share[:, None] * base[triangle] + up[:, None] * side[triangle]
    return points.astype(np.float32), large[triangle]


def _counted(numbers: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """For numbers n of things, 0 to n - 1 in a row: which thing each entry is for, and its count."""
    owner = np.repeat(np.arange(len(numbers)), numbers)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(numbers) - numbers, numbers)

"""Points on triangles, so close together that no fruit slips between them."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

SPACING: Final = 8e-3
"""Metres between neighbouring points at most, chosen. A flat piece that dips into a ball of radius R between
three points s apart is missed down to s^2 / 6R, here 0.3 mm for a fruit of R = 40 mm."""


def filling(
    corners: NDArray[np.float32], spacing: float = SPACING
) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Points on triangles, beside their corners, so that none is far from the next.

    Args:
        corners: `(f, 3, 3)` metres.
        spacing: metres, between neighbouring points at most.

    Returns:
        `(q, 3)` points and `(q,)` the triangle of each; none for a triangle without a long edge.
    """
    square = np.empty((3, len(corners)), dtype=np.float32)
    for edge in range(3):
        along = corners[:, edge] - corners[:, edge - 2]
        square[edge] = np.einsum("fi,fi->f", along, along)
    large = np.flatnonzero(square.max(axis=0) > spacing**2)
    # Turned so that the longest edge leads from a to b.
    turned = (square[:, large].argmax(axis=0)[:, None] + np.arange(3)) % 3
    a, b, c = corners[large[:, None], turned].swapaxes(0, 1)
    longest = np.sqrt(square[:, large].max(axis=0))
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / longest
    pieces, rows = np.ceil(longest / spacing).astype(int), np.ceil(height / spacing).astype(int)
    points, owner = [np.empty((0, 3), dtype=np.float32)], [np.empty(0, dtype=np.intp)]
    # Rows of points along the longest edge, ever shorter ones towards the corner across from it.
    for number in range(int(rows.max(initial=0))):
        up = number / np.maximum(rows, 1)
        across = np.ceil(pieces * (1.0 - up)).astype(int)
        for count in np.unique(across[number < rows]):
            here = (number < rows) & (across == count)
            share = np.arange(1 if number == 0 else 0, count if number == 0 else count + 1) / count
            lift = up[here, None, None]
            line = a[here, None] + share[:, None] * (b - a)[here, None] * (1.0 - lift)
            points.append((line + lift * (c - a)[here, None]).reshape(-1, 3).astype(np.float32))
            owner.append(np.repeat(large[here], len(share)))
    return np.concatenate(points), np.concatenate(owner)

"""Boxes around what is seen: half open, in pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Box = tuple[int, int, int, int]
"""Columns x0 to x1 - 1 and rows y0 to y1 - 1, as (x0, y0, x1, y1)."""


def mask_box(mask: NDArray[np.bool_], corner: tuple[int, int] = (0, 0)) -> Box | None:
    """The smallest box that holds all pixels of a mask; None where there are none.

    Args:
        mask: `(h, w)`, of a picture or of a part of one.
        corner: column and row of the part's first pixel in the picture.
    """
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not columns.size:
        return None
    x, y = corner
    return x + int(columns[0]), y + int(rows[0]), x + int(columns[-1]) + 1, y + int(rows[-1]) + 1


def touches_border(box: Box, shape: tuple[int, ...] | NDArray[Any]) -> bool:
    """Whether a box reaches the border of a picture of `(h, w, ...)` pixels: more may lie outside."""
    height, width = shape[:2]
    x0, y0, x1, y1 = box
    return bool(x0 <= 0 or y0 <= 0 or x1 >= width or y1 >= height)

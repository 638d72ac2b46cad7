"""Strips of whole rows in which large images are computed, so that they take little memory."""

from __future__ import annotations

from typing import Final

LARGEST_WHOLE: Final = 1 << 21
"""Pixels of the largest image that is computed as a whole. Chosen: images of 1920 x 1080 and 1600 x 1200 are.
In two strips, the latter takes 1.5 instead of 2.8 GB, and 1.2 to 1.5 times the CPU time."""
STRIP_PIXELS: Final = 1 << 20
"""Pixels of a strip, at most, if that is two rows or more. Chosen: the light of a strip of 6000 x 170 pixels
takes 0.3 GB while it is traced; with half as many, neighbours would share more rows than a strip has."""


def row_strips(width: int, height: int) -> tuple[slice, ...]:
    """The rows of each strip of an image, from top to bottom; a small image is a single strip.

    Strips have even heights, but for the last one, so that a Bayer mosaic divides into whole quads.
    """
    if width * height <= LARGEST_WHOLE:
        return (slice(0, height),)
    count = -(-height * width // STRIP_PIXELS)
    rows = max(-(-height // count) + 1 & ~1, 2)
    return tuple(slice(top, min(top + rows, height)) for top in range(0, height, rows))


def is_whole(width: int, height: int) -> bool:
    """Whether an image is a single strip."""
    return len(row_strips(width, height)) == 1

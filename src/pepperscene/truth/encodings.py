"""The published data set's 8-bit codes of class and distance, and their inverses.

Source: Barth et al. 2018, section 2.6, and the layout of their data set,
doi 10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS

_CM_PER_STEP: Final = 255.0 / (2.0 * 150.0)
"""Centimetres of distance from one grey value to the next: z = (255 - I) / (2 * 150 / 255)."""

FARTHEST_CODED_M: Final = 254.0 * _CM_PER_STEP / 100.0
"""Metres that grey value 1 stands for (2.159 m); 0 is the background."""

_PALETTE: Final = np.array(CLASS_COLOURS, dtype=np.uint8)
_CHUNK: Final = 65536  # chosen: pixels compared with the palette at a time, 4 MB of differences


def distance_code(distance_m: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Distance as the published 8-bit grey value, rounded to the nearest.

    Args:
        distance_m: any shape, metres >= 0; inf where there is nothing.

    Returns:
        The same shape; 255 at the camera, falling by one every 0.85 cm, 0 in the background. What lies
        beyond the code's reach (216.3 cm) cannot be told from the background; the float image holds it.

    Raises:
        ValueError: a distance is negative or not a number.
    """
    distance = np.asarray(distance_m)
    # A nan fails every comparison, so that it cannot slip through.
    if not (distance >= 0).all():
        raise ValueError("distances must be >= 0, inf for none")
    grey = 255.0 - distance * (100.0 / _CM_PER_STEP)
    return np.rint(np.maximum(grey, 0.0)).astype(np.uint8)


def distance_from_code(code: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Metres that a grey value stands for, inf for the background; off by at most 0.425 cm after coding."""
    grey = np.asarray(code)
    metres = ((255.0 - grey) * (_CM_PER_STEP / 100.0)).astype(np.float32)
    return np.where(grey == 0, np.float32(np.inf), metres)


def class_colour(class_id: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """Class ids `(...)` as the published colours `(..., 3)`.

    Raises:
        ValueError: an id is not one of the eight.
    """
    ids = np.asarray(class_id)
    if ids.size and (ids.min() < 0 or ids.max() >= len(_PALETTE)):
        raise ValueError(f"class ids must lie in 0 to {len(_PALETTE) - 1}")
    # Four times as fast as indexing, which copies pixel by pixel.
    return np.take(_PALETTE, ids, axis=0)


def class_from_colour(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Class ids `(...)` of 8-bit colours `(..., 3)`: the nearest of the published colours in RGB.

    The published colours are known from third-party readers only, which differ by a few grey values.

    Raises:
        ValueError: the last axis does not hold three channels.
    """
    colours = np.asarray(rgb)
    if colours.shape[-1:] != (3,):
        raise ValueError(f"colours must have three channels, not shape {colours.shape}")
    flat = colours.reshape(-1, 3).astype(np.int32)
    ids = np.empty(len(flat), np.uint8)
    for first in range(0, len(flat), _CHUNK):
        part = flat[first : first + _CHUNK, None, :] - _PALETTE.astype(np.int32)
        ids[first : first + _CHUNK] = np.square(part).sum(-1).argmin(-1)
    return ids.reshape(colours.shape[:-1])

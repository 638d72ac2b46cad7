"""Encodings of labels: the published data set's class colours and distance codes, boxes and run lengths.

Source of colours and codes: Barth et al. 2018, section 2.6, and the layout of their data set, doi
10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, IGNORE_CLASS, IGNORE_COLOUR, OrganClass

_CM_PER_STEP: Final = 255.0 / (2.0 * 150.0)
"""Centimetres of distance per grey value: z = (255 - I) / (2 * 150 / 255)."""

_PALETTE: Final = np.array(CLASS_COLOURS, dtype=np.uint8)
_BLOCK: Final = 65536  # chosen: pixels compared with the palette at a time, 4 MB of differences
_COUNTED: Final = 1 << 20  # chosen: pixels whose classes are counted at a time, in 8 MB

_UNKNOWN_ID: Final = f"class ids must be in 0 to {len(OrganClass) - 1}, or {IGNORE_CLASS}"


def is_class_id(ids: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
    """Where ids `(...)` are of the eight classes or `IGNORE_CLASS`."""
    return np.asarray(((ids >= 0) & (ids < len(OrganClass))) | (ids == IGNORE_CLASS))


def class_pixel_counts(class_id: NDArray[np.integer[Any]]) -> dict[str, int]:
    """Number of pixels of each of the eight classes, by lower-case class name, without ignored ones.

    Raises:
        ValueError: an id is neither one of the eight nor `IGNORE_CLASS`.
    """
    ids, counts = np.asarray(class_id).ravel(), np.zeros(IGNORE_CLASS + 1, np.int64)
    # In parts, because each id is converted to eight bytes.
    for start in range(0, ids.size, _COUNTED):
        part = np.bincount(ids[start : start + _COUNTED], minlength=len(counts))
        if len(part) > len(counts):
            raise ValueError(_UNKNOWN_ID)
        counts += part
    if counts[len(OrganClass) : IGNORE_CLASS].any():
        raise ValueError(_UNKNOWN_ID)
    return {organ_class.name.lower(): int(counts[organ_class]) for organ_class in OrganClass}


def distance_code(distance_m: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Distance as the published 8-bit grey value, rounded to the nearest.

    Args:
        distance_m: any shape, metres >= 0; inf for the background.

    Returns:
        The same shape; 255 at the camera, decreasing by one every 0.85 cm, 0 in the background. Distances
        beyond the range of the code (216.3 cm) look like the background; only the float image holds them.

    Raises:
        ValueError: a distance is negative or nan.
    """
    distance = np.asarray(distance_m)
    # Written so that nan fails too.
    if not (distance >= 0).all():
        raise ValueError("distances must be >= 0, inf for none")
    grey = 255.0 - distance * (100.0 / _CM_PER_STEP)
    return np.rint(np.maximum(grey, 0.0)).astype(np.uint8)


def distance_from_code(code: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Distance of grey values in metres, inf for the background; exact to 0.425 cm after coding."""
    grey = np.asarray(code)
    metres = ((255.0 - grey) * (_CM_PER_STEP / 100.0)).astype(np.float32)
    return np.where(grey == 0, np.float32(np.inf), metres)


def class_colour(class_id: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """The published colours `(..., 3)` of class ids `(...)`.

    Raises:
        ValueError: an id is neither one of the eight nor `IGNORE_CLASS`.
    """
    ids, palette = np.asarray(class_id), _PALETTE
    if ids.size and (ids.min() < 0 or ids.max() >= len(_PALETTE)):
        if not is_class_id(ids).all():
            raise ValueError(_UNKNOWN_ID)
        palette = np.array(class_palette(ignored=True), dtype=np.uint8)
    # Four times as fast as indexing, which copies pixel by pixel.
    return np.take(palette, ids, axis=0)


def class_from_colour(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Class ids `(...)` of 8-bit colours `(..., 3)`: the nearest of the published colours in RGB.

    Pixels of exactly `IGNORE_COLOUR` have `IGNORE_CLASS`.

    The published colours are only known from third-party readers, which differ by a few grey values.

    Raises:
        ValueError: the last axis does not have three channels.
    """
    colours = np.asarray(rgb)
    if colours.shape[-1:] != (3,):
        raise ValueError(f"colours must have three channels, not shape {colours.shape}")
    pixels = colours.reshape(-1, 3).astype(np.int32)
    ids = np.empty(len(pixels), np.uint8)
    for start in range(0, len(pixels), _BLOCK):
        difference = pixels[start : start + _BLOCK, None, :] - _PALETTE.astype(np.int32)
        ids[start : start + _BLOCK] = np.square(difference).sum(-1).argmin(-1)
    ids[(pixels == IGNORE_COLOUR).all(axis=1)] = IGNORE_CLASS
    return ids.reshape(colours.shape[:-1])


def class_palette(*, ignored: bool) -> tuple[tuple[int, int, int], ...]:
    """8-bit RGB of class ids for a PNG: of the eight, or also of `IGNORE_CLASS` (ids between are black)."""
    if not ignored:
        return CLASS_COLOURS
    return (*CLASS_COLOURS, *[(0, 0, 0)] * (IGNORE_CLASS - len(CLASS_COLOURS)), IGNORE_COLOUR)


Box = tuple[int, int, int, int]
"""Columns x0 to x1 - 1 and rows y0 to y1 - 1, as (x0, y0, x1, y1)."""


def mask_box(mask: NDArray[np.bool_], corner: tuple[int, int] = (0, 0)) -> Box | None:
    """The smallest box around all pixels of a mask; None for an empty mask.

    Args:
        mask: `(h, w)`, of an image or of a part of one.
        corner: column and row of the part's first pixel in the image.
    """
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not columns.size:
        return None
    x, y = corner
    return x + int(columns[0]), y + int(rows[0]), x + int(columns[-1]) + 1, y + int(rows[-1]) + 1


def touches_border(box: Box, shape: tuple[int, ...]) -> bool:
    """Whether a box touches the border of an image of `(h, w, ...)` pixels."""
    height, width = shape[:2]
    x0, y0, x1, y1 = box
    return x0 <= 0 or y0 <= 0 or x1 >= width or y1 >= height


def encode_rle(
    mask: NDArray[np.bool_], size: tuple[int, int] | None = None, corner: tuple[int, int] = (0, 0)
) -> dict[str, list[int]]:
    """Encode a mask as COCO's uncompressed run lengths, `{"size": [h, w], "counts": [...]}`.

    Pixels are counted column by column from the top left: runs outside (may be 0) and inside alternate (T.-Y.
    Lin et al. 2014, "Microsoft COCO"; the layout of `pycocotools.mask`).

    Args:
        mask: `(rows, columns)` of an image or of a part of one.
        size: `(h, w)` of the image; None if the mask is all of it.
        corner: column and row of the mask's first pixel in the image.

    Raises:
        ValueError: the mask is not inside the image.
    """
    height, width = size or mask.shape
    left, top = corner
    if min(left, top) < 0 or left + mask.shape[1] > width or top + mask.shape[0] > height:
        raise ValueError(f"a mask of {mask.shape} at {corner} is not inside an image of {(height, width)}")
    column, row = np.nonzero(mask.T)
    inside = (left + column) * height + top + row
    # A run ends where the next pixel inside is not the next pixel of the image.
    gap = np.flatnonzero(np.diff(inside) != 1)
    first, last = inside[np.append(0, gap + 1)[: inside.size]], inside[np.append(gap, -1)[: inside.size]]
    edges = np.concatenate([[0], np.stack([first, last + 1], axis=1).ravel(), [height * width]])
    counts = np.diff(edges).tolist()
    # Omit an empty run at the end.
    return {"size": [height, width], "counts": counts[:-1] if len(counts) > 1 and counts[-1] == 0 else counts}


def decode_rle(runs: Mapping[str, Sequence[Any]]) -> NDArray[np.bool_]:
    """Decode run lengths to a mask `(h, w)`; the inverse of `encode_rle`.

    Raises:
        ValueError: the runs do not fill the image.
    """
    height, width = runs["size"]
    counts = np.asarray(runs["counts"], dtype=np.intp)
    if (counts.size and counts.min() < 0) or counts.sum() != height * width:
        raise ValueError(f"runs of {counts.sum()} pixels do not fill an image of {height} x {width}")
    inside = np.repeat(np.arange(counts.size) % 2 == 1, counts)
    return inside.reshape(width, height).T

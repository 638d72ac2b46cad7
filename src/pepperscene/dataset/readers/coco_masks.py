"""Masks of COCO annotations: run lengths and polygons.

Run lengths are decoded here: pycocotools 2.0 writes past its memory if the text of a damaged file is longer
than its image.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.libraries import import_library
from pepperscene.truth.encodings import decode_rle

_FIRST_CODE: Final = 48
"""Code of the character that stands for 0; each character holds five bits of a number, lowest first."""
_MORE, _NEGATIVE, _BITS = 0x20, 0x10, 0x1F
_MOST_CHARACTERS: Final = 7  # of a number of 32 bits


def decode_segmentation(segmentation: Any, size: tuple[int, int]) -> NDArray[np.bool_]:
    """The mask `(h, w)` of an annotation.

    Args:
        segmentation: polygons, as lists of x and y in turn; or `size` and `counts`, run lengths down the
            columns as numbers or as COCO's text.
        size: height and width of the image.

    Raises:
        ValueError: it is neither, or does not fit the image; the message is the end of a sentence.
        SetupError: polygons need pycocotools, which is not installed.
    """
    if isinstance(segmentation, list):
        return _draw_polygons(segmentation, size)
    if not isinstance(segmentation, dict) or not {"size", "counts"} <= set(segmentation):
        raise ValueError("must be polygons, or run lengths with size and counts")
    if segmentation["size"] != list(size):
        raise ValueError(f"is of the size {segmentation['size']}, but its image is {list(size)}")
    counts = segmentation["counts"]
    if isinstance(counts, str):
        counts = decode_counts(counts)
    elif not isinstance(counts, list) or not all(type(count) is int for count in counts):
        raise ValueError("must have counts that are integers or text")
    try:
        return decode_rle({"size": size, "counts": counts})
    except (ValueError, OverflowError):
        raise ValueError("has run lengths that do not fill its image") from None


def decode_counts(text: str) -> list[int]:
    """Run lengths from COCO's text.

    From the fourth on, each is stored as its difference from the one before the last.

    Raises:
        ValueError: the text is damaged.
    """
    counts: list[int] = []
    value = shift = 0
    for character in text:
        code = ord(character) - _FIRST_CODE
        if not 0 <= code < 2 * _MORE or shift >= 5 * _MOST_CHARACTERS:
            raise ValueError("has damaged run lengths")
        value |= (code & _BITS) << shift
        shift += 5
        if code & _MORE:
            continue
        if code & _NEGATIVE:
            value -= 1 << shift
        counts.append(value + (counts[-2] if len(counts) > 2 else 0))
        value = shift = 0
    if shift:
        raise ValueError("has damaged run lengths")
    return counts


def _draw_polygons(polygons: Sequence[Any], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels inside any of the polygons, as pycocotools draws them."""
    height, width = size
    limit = 2 * max(size)  # chosen: far polygons would take memory, and are a mistake
    for polygon in polygons:
        is_list = isinstance(polygon, list) and len(polygon) >= 6 and len(polygon) % 2 == 0
        if not is_list or not all(type(value) in (int, float) for value in polygon):
            raise ValueError("must have polygons of three or more points, each as x, y")
        if not all(-limit <= value <= limit for value in polygon):
            raise ValueError("has a polygon far outside of its image")
    if not polygons:
        return np.zeros(size, bool)
    coder = import_library("pycocotools.mask")
    mask = coder.merge(coder.frPyObjects(list(polygons), height, width))
    return np.asarray(coder.decode(mask)).astype(bool)

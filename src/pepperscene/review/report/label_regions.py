"""The labels of an image for a page's script, which draws them beside and over the photograph.

A page holds the labels of an image once: the class and the instance of each region, and which region each
pixel belongs to, as run lengths. The page's script draws the class and instance images, masks and boxes from
them. Of frames of 800 x 600 pixels with 500 instances they take 40 kB, and PNG images of both labels 95 kB.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.review.report.colours import instance_colour, shortened
from pepperscene.truth.keypoints import fruit_keypoints


def packed_labels(image: LabelledImage, max_length: int | None = None) -> str | None:
    """The labels of an image for the page's script; None if it has neither classes nor instances.

    They are a JSON object:

    - `width`, `height`: of the image, pixels.
    - `step`: the runs hold every `step`-th row and column.
    - `lengths`, `regions`: runs of pixels of one region, row by row.
    - `classes`: id of each region, `IGNORE_CLASS` without a class; `instances`: its number, 0 without one.
    - `colours`: of the instance of each region, 0xRRGGBB.
    - `boxes`: first column, first row, column and row behind the last of each region with an instance,
      otherwise null.
    - `keypoints`: for each fruit in the harvest, `KEYPOINTS` as column, row and COCO's visibility.

    Args:
        image: with labels.
        max_length: characters; rows and columns of the runs are left out to keep it.
    """
    from scipy import ndimage

    if image.classes is None and image.instances is None:
        return None
    height, width = image.size
    classes = np.full((height, width), IGNORE_CLASS, np.uint8) if image.classes is None else image.classes
    instances = np.zeros((height, width), np.uint16) if image.instances is None else image.instances
    codes = classes.astype(np.uint32) << 16 | instances
    distinct, inverse = np.unique(codes, return_inverse=True)
    region = inverse.reshape(height, width).astype(np.int32)
    numbers = [int(code) & 0xFFFF for code in distinct]
    content: dict[str, Any] = {
        "width": width,
        "height": height,
        "classes": [int(code) >> 16 for code in distinct],
        "instances": numbers,
        "colours": [int.from_bytes(bytes(instance_colour(number)), "big") for number in numbers],
        "boxes": [
            _box(found) if number else None
            for number, found in zip(numbers, ndimage.find_objects(region + 1), strict=True)
        ],
        "keypoints": _keypoints(image.metadata),
    }
    return shortened(lambda step: pack({**content, **_runs(region, step)}), region.shape, max_length)


def _runs(region: NDArray[np.int32], step: int) -> dict[str, Any]:
    """The runs of every `step`-th row and column."""
    flat = region[::step, ::step].ravel()
    starts = np.flatnonzero(np.diff(flat, prepend=-1))
    lengths = np.diff(starts, append=flat.size)
    return {"step": step, "lengths": lengths.tolist(), "regions": flat[starts].tolist()}


def _box(found: tuple[slice, slice]) -> list[int]:
    rows, columns = found
    return [columns.start, rows.start, columns.stop, rows.stop]


def _keypoints(metadata: Mapping[str, Any]) -> list[list[list[float]]]:
    """The keypoints of the fruit in a frame's harvest that are in the image."""
    fruit = metadata["harvest"]["fruit"] if "harvest" in metadata else ()
    points = [fruit_keypoints(one) for one in fruit]
    return [
        [[round(x, 1), round(y, 1), visibility] for x, y, visibility in one]
        for one in points
        if any(visibility for *_, visibility in one)
    ]


def pack(value: Any) -> str:
    """A JSON value as base64 of its zlib stream; the page's function `unpack` reads it.

    Raises:
        ValueError: a number is not finite.
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def unpack(text: str) -> Any:
    """The value that `pack` was given, with lists for tuples."""
    return json.loads(zlib.decompress(base64.b64decode(text)))

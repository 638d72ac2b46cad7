"""Objects of an image for detectors: boxes, labels and masks from the class and the instance image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class DetectionObjects:
    """The n objects of an image of h x w pixels, by label and instance number.

    Attributes:
        boxes: `(n, 4)` float32: left, top, right and bottom edge, in pixels from the image's corner.
        labels: `(n,)` int64, from 1.
        masks: `(n, h, w)` uint8, 1 inside.
        pixels: `(n,)` int64, the number of pixels of each mask.
    """

    boxes: NDArray[np.float32]
    labels: NDArray[np.int64]
    masks: NDArray[np.uint8]
    pixels: NDArray[np.int64]


def find_objects(
    classes: NDArray[np.integer[Any]],
    instances: NDArray[np.integer[Any]],
    class_ids: Sequence[int],
    min_pixels: int,
) -> DetectionObjects:
    """The visible objects of some classes.

    An object is all pixels of one instance number and one class, so that labels agree with both images even
    where these do not agree with each other.

    Args:
        classes: `(h, w)` class ids.
        instances: `(h, w)` instance numbers, 0 for none.
        class_ids: the classes of the labels 1, 2, ...
        min_pixels: objects with fewer pixels are left out.
    """
    from scipy import ndimage

    numbered = np.zeros(instances.shape, np.int32)
    labels: list[int] = []
    pixels: list[int] = []
    for label, class_id in enumerate(class_ids, 1):
        inside = (classes == class_id) & (instances > 0)
        values = instances[inside]
        counts = np.bincount(values, minlength=1)
        found = np.flatnonzero(counts >= min_pixels)
        number_of = np.zeros(len(counts), np.int32)
        number_of[found] = np.arange(len(found)) + len(labels) + 1
        numbered[inside] = number_of[values]
        labels += [label] * len(found)
        pixels += counts[found].tolist()
    places = ndimage.find_objects(numbered, len(labels))
    masks = np.zeros((len(labels), *instances.shape), np.uint8)
    for number, place in enumerate(places, 1):
        masks[number - 1][place] = numbered[place] == number
    boxes = [(columns.start, rows.start, columns.stop, rows.stop) for rows, columns in places]
    return DetectionObjects(
        np.array(boxes, np.float32).reshape(-1, 4),
        np.array(labels, np.int64),
        masks,
        np.array(pixels, np.int64),
    )

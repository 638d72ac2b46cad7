"""The labelled objects of an image, and the pixels that count neither for nor against a detector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS
from pepperscene.dataset.readers.torch_data import DetectionObjects, find_objects
from pepperscene.learning.class_table import ClassTable


def object_indices(table: ClassTable, classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Index of each pixel's class, `len(table)` for those of no class, `IGNORE_CLASS` for void ones."""
    indices = table.indices(classes)
    indices[(indices == IGNORE_CLASS) & (classes != IGNORE_CLASS)] = len(table)
    return indices


def labelled_objects(
    indices: NDArray[np.uint8], instances: NDArray[np.integer], classes: int, least_area: float
) -> tuple[DetectionObjects, NDArray[np.bool_]]:
    """Objects of an image, with labels from 0, and its pixels that are ignored.

    Ignored are void pixels, pixels of a class without an instance, and objects that are too small: a person
    would not label them.

    Args:
        indices: `(h, w)` as of `object_indices`.
        instances: `(h, w)` numbers of instances, 0 for none.
        classes: number of classes.
        least_area: least number of pixels of an object.
    """
    found = find_objects(indices, instances, range(classes), max(1, int(np.ceil(least_area))))
    ignored = (indices == IGNORE_CLASS) | ((indices < classes) & ~found.masks.any(axis=0))
    return replace(found, labels=found.labels - 1), ignored

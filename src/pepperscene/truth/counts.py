"""How much of an image each class takes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass


def class_pixels(class_id: NDArray[np.integer[Any]]) -> dict[str, int]:
    """Number of pixels of each class by lower-case class name; all eight, their sum is the image's size.

    Raises:
        ValueError: an id is not one of the eight.
    """
    counts = np.bincount(np.asarray(class_id).ravel(), minlength=len(OrganClass))
    if len(counts) > len(OrganClass):
        raise ValueError(f"class ids must lie in 0 to {len(OrganClass) - 1}")
    return {organ_class.name.lower(): int(counts[organ_class]) for organ_class in OrganClass}

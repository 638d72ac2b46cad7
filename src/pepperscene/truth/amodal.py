"""Amodal masks as a JSON-ready object: whole organs of an image, and how much of each is visible.

Instances are given as values of the instance image: the index of the organ plus 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import Instance
from pepperscene.truth.encodings import encode_rle, mask_box, touches_border

AMODAL_FORMAT: Final = "pepperscene amodal 1"

_FRACTION_DIGITS: Final = 6


@dataclass(frozen=True, eq=False)
class AmodalMask:
    """The pixels that an organ would have if nothing occluded it."""

    corner: tuple[int, int]  # column and row of the first pixel of `mask` in the image
    mask: NDArray[np.bool_]  # `(h, w)`, for the part of the image that contains the organ

    def crop(self, image: NDArray[Any]) -> NDArray[Any]:
        """The part of an image that the mask covers; a view."""
        (x, y), (height, width) = self.corner, self.mask.shape
        return image[y : y + height, x : x + width]


def amodal_truth(
    organs: Iterable[tuple[int, AmodalMask]], instance: NDArray[np.uint16], instances: Sequence[Instance]
) -> dict[str, Any]:
    """The output `amodal` of an image.

    Args:
        organs: index of each organ and its mask, which has at least one pixel.
        instance: `(h, w)` the instance image.
        instances: of the scene.
    """
    entries = [
        {
            "instance": index + 1,
            "class": int(instances[index].organ_class),
            "kind": instances[index].kind,
            **visibility_entry(index, amodal, instance),
        }
        for index, amodal in organs
    ]
    return {"format": AMODAL_FORMAT, "organs": entries}


def visibility_entry(index: int, amodal: AmodalMask, instance: NDArray[np.uint16]) -> dict[str, Any]:
    """Visible and amodal boxes and pixels of an organ, its occluders and its mask.

    Args:
        index: of the organ's instance.
        amodal: its mask, which has at least one pixel and contains all that are visible.
        instance: `(h, w)` the instance image.
    """
    labels = amodal.crop(instance)
    visible = labels == index + 1
    amodal_box = mask_box(amodal.mask, amodal.corner)
    if amodal_box is None:
        raise ValueError("an organ without any pixel is not in the image")
    count, visible_count = int(amodal.mask.sum()), int(visible.sum())
    box = mask_box(visible, amodal.corner)
    occluded = np.bincount(labels[amodal.mask & ~visible])
    occluders = np.flatnonzero(occluded)
    # Most pixels first; for equal numbers, the lower instance first.
    occluders = occluders[np.argsort(-occluded[occluders], kind="stable")]
    return {
        "box": None if box is None else list(box),
        "amodal_box": list(amodal_box),
        "visible_pixels": visible_count,
        "amodal_pixels": count,
        "visible_fraction": round(visible_count / count, _FRACTION_DIGITS),
        "truncated": touches_border(amodal_box, instance.shape),
        "occluders": [
            {"instance": int(occluder), "pixels": int(occluded[occluder])}
            for occluder in occluders
            if occluder > 0
        ],
        "amodal": encode_rle(amodal.mask, instance.shape, amodal.corner),
    }

"""A rendered frame: its images and their description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS

TARGET_TOLERANCE: Final = 1.25
"""Chosen: ratio of an error to its target up to which the target counts as met. The error is an estimate."""


def is_target_met(error_to_noise: float, target: float) -> bool:
    """Whether the estimated error of a frame's light, over the sensor noise, is not far above its target."""
    return error_to_noise <= TARGET_TOLERANCE * target


@dataclass(frozen=True, eq=False)
class Frame:
    """One rendered view.

    Attributes:
        images: array by output name, as described in `OUTPUTS`; a JSON-ready object for "harvest" and
            "amodal".
        metadata: JSON-ready description: camera pose, intrinsics, distortion, exposure, variant, versions,
            and the instances in view.
    """

    images: Mapping[str, Any]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, output: str) -> Any:
        return self.images[output]

    def __repr__(self) -> str:
        sizes = (f"{i.shape[1]}x{i.shape[0]}" for i in self.images.values() if isinstance(i, np.ndarray))
        return f"Frame({', '.join([*self.images, *list(sizes)[:1]])})"

    def _repr_html_(self) -> str:
        """The images that can be seen as they are, small, for notebooks."""
        from pepperscene.notebook_view import object_html, picture_html

        shown = {name: image for name, image in self.images.items() if _is_viewable(image)}
        if "class" in shown:
            palette = np.zeros((256, 3), np.uint8)
            palette[: len(CLASS_COLOURS)] = CLASS_COLOURS
            shown["class"] = palette[shown["class"]]
        return object_html(repr(self), (picture_html(image, name) for name, image in shown.items()))

    @property
    def colour(self) -> NDArray[np.uint8]:
        """`(h, w, 3)` uint8, the developed photograph."""
        photograph: NDArray[np.uint8] = self.images["colour"]
        return photograph


def _is_viewable(image: Any) -> bool:
    """Whether an image has 8 bits, and one or three channels."""
    is_array = isinstance(image, np.ndarray) and image.dtype == np.uint8
    return is_array and (image.ndim == 2 or image.shape[2:] == (3,))

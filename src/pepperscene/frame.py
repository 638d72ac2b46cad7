"""A rendered frame: its images and their description, and how far frames miss their target error."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping
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


class RenderingErrors:
    """Accumulates the estimated errors of frames, and compares them with their targets."""

    def __init__(self) -> None:
        self._frames = 0
        self._target = math.nan  # of the last frame that misses its own; those of a build are equal
        self._missed: list[tuple[float, float]] = []  # error over noise, and error in codes

    def add(self, target: Any, error_codes: Any, noise_codes: Any) -> None:
        """Add a frame; one without a target or with unknown values is ignored.

        Args:
            target: error over noise at which sampling stops; None for a fixed number of samples.
            error_codes: estimated root mean square error of the traced light, 8-bit codes.
            noise_codes: that of the sensor noise.
        """
        if not all(_is_positive(value) for value in (target, error_codes, noise_codes)):
            return
        self._frames += 1
        if not is_target_met(ratio := error_codes / noise_codes, target):
            self._target = target
            self._missed.append((ratio, error_codes))

    def notes(self) -> Iterator[str]:
        """Yield at most one note."""
        if not self._missed:
            return
        ratios, codes = zip(*self._missed, strict=True)
        yield (
            f"in {len(self._missed)} of {self._frames} frames the rendering error is above its target of "
            f"{self._target:g} times the sensor noise: {statistics.median(ratios):.2g} times (median), "
            f"at most {max(codes):.1f} codes of 255; a smaller --target-error takes more samples"
        )


def _is_positive(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and value > 0.0

"""What is measured of the images of a set: the central square for colours, and the scale for textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pepperscene.colour.patches.patch import PatchSet
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.errors import ArgumentError
from pepperscene.truth import centre_side

WIDTH_PX: Final = 580
"""Width at which textures are compared by default. Chosen: photographs of public data sets are 590 to 800
pixels wide, and a pixel of one that shows 70 cm of a row is about as large as a secondary vein."""


@dataclass(frozen=True)
class Scale:
    """Central square and scale at which the images of a set are measured.

    Attributes:
        width_px: all images are reduced to this width before textures are measured, or
        factor: all are reduced by this factor, at most 1, if given.
        pixel_mm: size on the plants of a pixel of an image reduced by this factor, in millimetres.
        centre_px: side of the central square in which hues and CIELAB are measured; None for the same
            fraction of each image, `truth.centre_side`.
    """

    width_px: int = WIDTH_PX
    factor: float | None = None
    pixel_mm: float | None = None
    centre_px: int | None = None

    def width(self, width_px: int) -> int | None:
        """Width in pixels at which textures of an image of this width are measured; None if too narrow."""
        if self.factor is not None:
            return max(1, round(self.factor * width_px))
        return self.width_px if width_px >= self.width_px else None

    def centre(self, height_px: int, width_px: int) -> int:
        """Side in pixels of the central square of an image."""
        if self.centre_px is None:
            return centre_side(height_px, width_px)
        return min(self.centre_px, height_px, width_px)


def choose_scales(
    sets: Sequence[ImageSet | PatchSet], width_px: int, pixel_mm: tuple[float, float] | None
) -> tuple[Scale, Scale]:
    """Scales of two sets.

    Without sizes of pixels, images have one width, and central squares the same fraction of them. With sizes,
    pixels have one size on the plants, and so have central squares: the smaller of the two that are this
    fraction of the first image of each set.

    Args:
        sets: both sets.
        width_px: width to which images are reduced.
        pixel_mm: size of a pixel of each set on the plants in millimetres, or None.

    Raises:
        ArgumentError: a width or a size is not positive.
        InputError: the first image of a set is damaged.
    """
    if width_px < 1:
        raise ArgumentError("width_px", f"must be at least 1, not {width_px}")
    if pixel_mm is None:
        return Scale(width_px), Scale(width_px)
    if len(pixel_mm) != 2 or not all(0.0 < size < float("inf") for size in pixel_mm):
        raise ArgumentError("pixel_mm", f"must be two sizes above 0 in millimetres, not {pixel_mm}")
    coarsest = max(pixel_mm)
    sides_mm = [
        centre_side(*size) * pixel
        for images, pixel in zip(sets, pixel_mm, strict=True)
        if (size := _first_size(images)) is not None
    ]
    first, second = (
        Scale(
            width_px,
            pixel / coarsest,
            coarsest,
            max(1, round(min(sides_mm) / pixel)) if sides_mm else None,
        )
        for pixel in pixel_mm
    )
    return first, second


def _first_size(images: ImageSet | PatchSet) -> tuple[int, int] | None:
    """Height and width in pixels of the first image of a set; None for patches, and for an empty set."""
    if isinstance(images, PatchSet) or not len(images):
        return None
    picture = images.select("colour", "classes")[0]
    image = picture.classes if picture.colour is None else picture.colour
    return None if image is None else (image.shape[0], image.shape[1])

"""Hue spectra: which colours the pixels of a class have, whatever their brightness and saturation.

Barth et al. 2018, sections 3.1.1 and 4.1.2 (Fig. 12): the hue of HSV, on the middle 300 x 300 pixels only,
because the dark margins hold more of the last hues than what is shown there has; the percentage of a
class's pixels at each hue, averaged over the image set. How wide their bins were is not told: here they are
those of OpenCV's 8-bit hue, two degrees wide with 0, 2, 4 degrees in their middles, so that the hues which
few grey values can tell apart (60, 120 degrees and so on, in dark pixels) lie inside a bin and not on its
border.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass

HUE_BINS: Final = 180
CENTRE_PX: Final = 300
_PER_SECTOR: Final = HUE_BINS // 6


def hue_bins(colour: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Hue of 8-bit sRGB pixels as the number of its bin.

    Args:
        colour: `(..., 3)` uint8.

    Returns:
        `(...)`: 0 to 179, bin k holds hues of 2k - 1 to 2k + 1 degrees; -1 for grey pixels.

    Raises:
        ValueError: the last axis does not hold three 8-bit channels.
    """
    if colour.shape[-1:] != (3,) or colour.dtype != np.uint8:
        raise ValueError(f"colours must be uint8 with three channels, not {colour.dtype} {colour.shape}")
    red, green, blue = (colour[..., channel].astype(np.int16) for channel in range(3))
    greatest = np.maximum(np.maximum(red, green), blue)
    spread = greatest - np.minimum(np.minimum(red, green), blue)
    # The sector is that of the greatest channel; the other two tell the place in it (A. R. Smith 1978,
    # "Color gamut transform pairs", SIGGRAPH 12).
    is_red, is_green = greatest == red, greatest == green
    sector = np.where(is_red, np.int16(0), np.where(is_green, np.int16(2), np.int16(4)))
    difference = np.where(is_red, green - blue, np.where(is_green, blue - red, red - green))
    # Rounded to the nearest bin in whole numbers: 2 * 30 * 255 + 255 still fits 16 bits.
    divisor = 2 * np.maximum(spread, 1)
    place = (2 * _PER_SECTOR * difference + divisor // 2) // divisor
    return np.where(spread > 0, (sector * _PER_SECTOR + place) % HUE_BINS, np.int16(-1)).astype(np.int16)


def hue_counts(colour: NDArray[np.uint8], class_id: NDArray[np.unsignedinteger[Any]]) -> NDArray[np.int64]:
    """How many pixels of each class have which hue.

    Args:
        colour: `(h, w, 3)` uint8.
        class_id: `(h, w)` of an unsigned type; values above 7 count for none.

    Returns:
        `(8, 181)`: one row a class; the last column counts grey pixels.

    Raises:
        ValueError: the images differ in size.
    """
    if colour.shape[:2] != class_id.shape:
        raise ValueError(f"colour {colour.shape} and classes {class_id.shape} must have one size")
    width = HUE_BINS + 1
    # Minus one, the grey pixels' bin, is the last column of the row; unlabelled pixels go to a ninth row.
    bins = hue_bins(colour) % width
    rows = np.minimum(class_id, len(OrganClass)).astype(np.int32)
    counts = np.bincount((rows * width + bins).ravel(), minlength=(len(OrganClass) + 1) * width)
    return counts.reshape(-1, width)[: len(OrganClass)]


def centre(image: NDArray[Any], size_px: int = CENTRE_PX) -> NDArray[Any]:
    """The middle `size_px` x `size_px` pixels of an image `(h, w, ...)`, fewer if it is smaller; a view."""
    top, left = (max(0, (length - size_px) // 2) for length in image.shape[:2])
    return image[top : top + size_px, left : left + size_px]


def mean_hue(spectrum: NDArray[np.floating[Any]]) -> float:
    """Mean direction of a hue spectrum `(180,)` on the circle, degrees in [0, 360); nan if there is none."""
    angle = np.arange(HUE_BINS) * (2.0 * np.pi / HUE_BINS)
    total = np.sum(spectrum * np.exp(1j * angle))
    # A spectrum that is even all around has no direction; 1e-12 of its sum is what rounding leaves of it.
    if abs(total) <= 1e-12 * float(np.sum(spectrum)):
        return float("nan")
    return float(np.degrees(np.angle(total)) % 360.0)


def spectrum_correlation(one: NDArray[np.floating[Any]], other: NDArray[np.floating[Any]]) -> float:
    """Pearson's correlation coefficient of two hue spectra over their bins; nan when one is flat."""
    if np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return float("nan")
    return float(np.corrcoef(one, other)[0, 1])

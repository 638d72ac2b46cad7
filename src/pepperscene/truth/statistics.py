"""Statistics of a set of labelled images, accumulated image by image.

The measures by which Barth et al. 2018 compare their synthetic with their empirical images (section 3.1.1):
class fractions (Fig. 10), where in the image each class is (Fig. 11), hue spectra of the classes (Fig. 12)
and the mean intensity image (Fig. 13). Memory is that of a few images, however many are added.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass

HUE_BINS: Final = 180
CENTRE_AREA: Final = 3 / 16
"""Fraction of an image in the central square whose hues are counted: 300 x 300 of 800 x 600 pixels in Barth
et al. 2018, section 3.1.1. The same fraction of images of any size is about the same part of what they show.
"""
_BINS_PER_SECTOR: Final = HUE_BINS // 6
_CLASSES: Final = len(OrganClass)


def hue_bins(colour: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Bin numbers of the HSV hues of 8-bit sRGB pixels.

    The bins are those of OpenCV's 8-bit hue; Barth et al. 2018 do not give theirs. Hues that a few grey
    values can produce (60, 120 degrees and so on, in dark pixels) are inside a bin, not on its border.

    Args:
        colour: `(..., 3)` uint8.

    Returns:
        `(...)`: 0 to 179, bin k holds hues of 2k - 1 to 2k + 1 degrees; -1 for grey pixels.

    Raises:
        ValueError: the last axis does not have three 8-bit channels.
    """
    if colour.shape[-1:] != (3,) or colour.dtype != np.uint8:
        raise ValueError(f"colours must be uint8 with three channels, not {colour.dtype} {colour.shape}")
    red, green, blue = (colour[..., channel].astype(np.int16) for channel in range(3))
    greatest = np.maximum(np.maximum(red, green), blue)
    spread = greatest - np.minimum(np.minimum(red, green), blue)
    # The greatest channel gives the sector; the other two give the position in it (A. R. Smith 1978, "Color
    # gamut transform pairs", SIGGRAPH 12).
    is_red, is_green = greatest == red, greatest == green
    sector = np.where(is_red, np.int16(0), np.where(is_green, np.int16(2), np.int16(4)))
    difference = np.where(is_red, green - blue, np.where(is_green, blue - red, red - green))
    # Round to the nearest bin in integers: 2 * 30 * 255 + 255 still fits 16 bits.
    divisor = 2 * np.maximum(spread, 1)
    position = (2 * _BINS_PER_SECTOR * difference + divisor // 2) // divisor
    hue = (sector * _BINS_PER_SECTOR + position) % HUE_BINS
    return np.where(spread > 0, hue, np.int16(-1)).astype(np.int16)


def hue_counts(colour: NDArray[np.uint8], class_id: NDArray[np.unsignedinteger[Any]]) -> NDArray[np.int64]:
    """Count the pixels of each class and hue.

    Args:
        colour: `(h, w, 3)` uint8.
        class_id: `(h, w)` of an unsigned type; values above 7 are ignored.

    Returns:
        `(8, 181)`: one row a class; the last column counts grey pixels.

    Raises:
        ValueError: the images differ in size.
    """
    if colour.shape[:2] != class_id.shape:
        raise ValueError(f"colour {colour.shape} and classes {class_id.shape} must have one size")
    width = HUE_BINS + 1
    # -1, the bin of grey pixels, becomes the last column of the row; unlabelled pixels go to a ninth row.
    bins = hue_bins(colour) % width
    rows = np.minimum(class_id, _CLASSES).astype(np.int32)
    counts = np.bincount((rows * width + bins).ravel(), minlength=(_CLASSES + 1) * width)
    return counts.reshape(-1, width)[:_CLASSES]


def centre_side(height_px: int, width_px: int) -> int:
    """Side in pixels of the central square of an image: `CENTRE_AREA` of it, if that is no larger than it."""
    return max(1, min(height_px, width_px, round(math.sqrt(CENTRE_AREA * height_px * width_px))))


def centre_crop(image: NDArray[Any], size_px: int | None = None) -> NDArray[Any]:
    """The central square of an image `(h, w, ...)`; a view.

    Barth et al. 2018 (section 3.1.1) take hues from there, because the dark margins contain more of the last
    hues than the plants.

    Args:
        image: of any size.
        size_px: side of the square, which is cut to the image; None for `centre_side`.
    """
    size_px = centre_side(*image.shape[:2]) if size_px is None else size_px
    top, left = (max(0, (length - size_px) // 2) for length in image.shape[:2])
    return image[top : top + size_px, left : left + size_px]


def mean_hue(spectrum: NDArray[np.floating[Any]]) -> float:
    """Circular mean of a hue spectrum `(180,)`, degrees in [0, 360); nan if it has no direction."""
    angle = np.arange(HUE_BINS) * (2.0 * np.pi / HUE_BINS)
    total = np.sum(spectrum * np.exp(1j * angle))
    # A uniform spectrum has no direction; rounding leaves 1e-12 of its sum.
    if abs(total) <= 1e-12 * float(np.sum(spectrum)):
        return float("nan")
    return float(np.degrees(np.angle(total)) % 360.0)


def hue_spectrum_correlation(first: NDArray[np.floating[Any]], second: NDArray[np.floating[Any]]) -> float:
    """Pearson's correlation coefficient of two hue spectra over their bins; nan if one is flat."""
    if np.ptp(first) == 0.0 or np.ptp(second) == 0.0:
        return float("nan")
    return float(np.corrcoef(first, second)[0, 1])


def grey_values(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Intensity of sRGB pixels `(h, w, 3)` as grey values `(h, w)`: .299 R + .587 G + .114 B, rounded.

    The luma of Rec. ITU-R BT.601, which MATLAB, OpenCV and Pillow use to convert photographs to grey; the
    paper does not define its intensity.

    Raises:
        ValueError: the image is not `(h, w, 3)` uint8.
    """
    from PIL import Image

    if colour.ndim != 3 or colour.shape[2] != 3 or colour.dtype != np.uint8:
        raise ValueError(f"an image must be (h, w, 3) uint8, not {colour.shape} {colour.dtype}")
    return np.asarray(Image.fromarray(np.ascontiguousarray(colour)).convert("L"))


def saturated_fraction(colour: NDArray[np.uint8]) -> float:
    """Fraction of the pixels of `(h, w, 3)` uint8 that have a channel at 255."""
    red, green, blue = (colour[..., channel] == 255 for channel in range(3))
    return float(np.count_nonzero(red | green | blue)) / max(1, red.size)


class ImageStatistics:
    """Sums over images, and the measures derived from them.

    Where positions are compared, images of another size than the first are resized to it, by the nearest
    pixel; fractions, hues and intensities are counted in the original images. All sums are integers except
    for the hue spectra, which are summed in the order in which images are added: the same images in the same
    order give the same bytes.

    Attributes:
        image_count: number of images added.
        photograph_count: number of those with colour.
        labelled_count: number of those with classes.
        class_pixels: `(8,)`, labelled pixels of each class.
        unlabelled_pixels: pixels of label images whose value is no class id.
        hue_image_counts: `(8,)`, number of images whose centre shows a class, for mean hue spectra.
        intensities: mean grey value of each photograph, in the order added.
        saturated_fractions: fraction of pixels with a channel at 255 of each photograph.
    """

    def __init__(self) -> None:
        self.image_count = self.photograph_count = self.labelled_count = self.unlabelled_pixels = 0
        self.class_pixels = np.zeros(_CLASSES, np.int64)
        self.hue_image_counts = np.zeros(_CLASSES, np.int64)
        self.intensities: list[float] = []
        self.saturated_fractions: list[float] = []
        self._spectra = np.zeros((_CLASSES, HUE_BINS))
        self._grey_fractions = np.zeros(_CLASSES)
        self._grey_sum: NDArray[np.uint32] | None = None
        self._mask_sums: NDArray[np.uint32] | None = None

    def add(
        self,
        colour: NDArray[np.uint8] | None,
        class_id: NDArray[np.unsignedinteger[Any]] | None,
        centre_px: int | None = None,
    ) -> None:
        """Add an image.

        Args:
            colour: `(h, w, 3)` uint8 sRGB, or None.
            class_id: `(h, w)` class ids of an unsigned type, or None; values above 7 are unlabelled.
            centre_px: side of the central square whose hues are counted; None for `centre_side`.

        Raises:
            ValueError: a shape or type is wrong, or the two differ in size.
        """
        if colour is not None and class_id is not None:
            self._add_hues(hue_counts(centre_crop(colour, centre_px), centre_crop(class_id, centre_px)))
        if colour is not None:
            self._add_photograph(colour)
        if class_id is not None:
            self._add_labels(np.asarray(class_id))
        self.image_count += 1

    def class_fractions(self) -> NDArray[np.float64]:
        """Fraction of each class in all pixels of the label images `(8,)`; nan if there are none.

        All pixels include unlabelled ones, so that the fractions of a set in which only one class is labelled
        can be compared with another's.
        """
        total = int(self.class_pixels.sum()) + self.unlabelled_pixels
        return self.class_pixels / total if total else np.full(_CLASSES, np.nan)

    def hue_spectra(self) -> NDArray[np.float64]:
        """Percentage of a class's pixels at each hue `(8, 180)`, averaged over the images that show it.

        A row adds up to 100 less the class's grey pixels; nan if no image's centre shows the class.
        """
        with np.errstate(invalid="ignore"):
            return 100.0 * self._spectra / self.hue_image_counts[:, None]

    def grey_fractions(self) -> NDArray[np.float64]:
        """Fraction of a class's pixels that have no hue `(8,)`, averaged like the spectra."""
        with np.errstate(invalid="ignore"):
            return self._grey_fractions / self.hue_image_counts

    def mean_masks(self) -> NDArray[np.float64] | None:
        """Fraction of the labelled images in which a class is at a position `(8, h, w)`; None without labels.

        Fig. 11 shows these, each divided by its maximum.
        """
        return None if self._mask_sums is None else self._mask_sums / self.labelled_count

    def mean_intensity(self) -> NDArray[np.float64] | None:
        """Mean grey value at each position `(h, w)`, 0 to 255; None without photographs."""
        return None if self._grey_sum is None else self._grey_sum / self.photograph_count

    def _add_hues(self, counts: NDArray[np.int64]) -> None:
        """Give every image that shows a class the same weight, however many of its pixels it shows."""
        pixels = counts.sum(axis=1)
        is_shown = pixels > 0
        fractions = counts[is_shown] / pixels[is_shown, None]
        self._spectra[is_shown] += fractions[:, :HUE_BINS]
        self._grey_fractions[is_shown] += fractions[:, HUE_BINS]
        self.hue_image_counts += is_shown

    def _add_photograph(self, colour: NDArray[np.uint8]) -> None:
        grey = grey_values(colour)
        self.intensities.append(float(grey.mean(dtype=np.float64)))
        self.saturated_fractions.append(saturated_fraction(colour))
        if self._grey_sum is None:
            self._grey_sum = np.zeros(grey.shape, np.uint32)
        self._grey_sum += _resize_nearest(grey, self._grey_sum.shape)
        self.photograph_count += 1

    def _add_labels(self, class_id: NDArray[np.unsignedinteger[Any]]) -> None:
        counts = np.bincount(class_id.ravel(), minlength=_CLASSES)
        self.class_pixels += counts[:_CLASSES]
        self.unlabelled_pixels += int(counts[_CLASSES:].sum())
        if self._mask_sums is None:
            self._mask_sums = np.zeros((_CLASSES, *class_id.shape), np.uint32)
        ids = _resize_nearest(class_id, self._mask_sums.shape[1:])
        for organ_class, counter in zip(OrganClass, self._mask_sums, strict=True):
            counter += ids == organ_class
        self.labelled_count += 1


def _resize_nearest(image: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Resize an image `(h, w)` by the nearest pixel."""
    if image.shape == shape:
        return image
    # The middle of pixel k of n is at (2 k + 1) / (2 n) of the length.
    rows, columns = (
        (2 * np.arange(new) + 1) * old // (2 * new) for new, old in zip(shape, image.shape, strict=True)
    )
    return image[np.ix_(rows, columns)]


def centre_falloff(image: NDArray[np.floating[Any]], radii: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Mean of an image `(h, w)` in rings around its centre.

    Args:
        image: any values.
        radii: `(n + 1,)`, ascending borders of the rings; the image corners are at 1.

    Returns:
        `(n,)`; nan for a ring without pixel centres.
    """
    height, width = image.shape
    rows, columns = np.arange(height) - (height - 1) / 2.0, np.arange(width) - (width - 1) / 2.0
    distance = np.hypot(rows[:, None], columns[None, :]) / np.hypot(height / 2.0, width / 2.0)
    counts, _ = np.histogram(distance, radii)
    sums, _ = np.histogram(distance, radii, weights=image)
    with np.errstate(invalid="ignore"):
        return sums / counts

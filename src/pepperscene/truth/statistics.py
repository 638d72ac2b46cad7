"""What a set of labelled pictures looks like as a whole, gathered picture by picture.

The measures by which Barth et al. 2018 compare their synthetic with their empirical images (section 3.1.1):
class shares (Fig. 10), where in the picture each class lies (Fig. 11), hue spectra of the classes (Fig. 12)
and the mean intensity image (Fig. 13). Memory is that of a few pictures, however many are added.
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


def centre_crop(image: NDArray[Any], size_px: int = CENTRE_PX) -> NDArray[Any]:
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


def hue_spectrum_correlation(one: NDArray[np.floating[Any]], other: NDArray[np.floating[Any]]) -> float:
    """Pearson's correlation coefficient of two hue spectra over their bins; nan when one is flat."""
    if np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return float("nan")
    return float(np.corrcoef(one, other)[0, 1])


_CLASSES: Final = len(OrganClass)
_FLUSHED: Final = 255
"""Masks that an 8-bit counter can hold: adding bytes is ten times as fast as adding 32-bit numbers."""


def grey_values(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Intensity of sRGB pixels `(h, w, 3)` as grey values `(h, w)`: .299 R + .587 G + .114 B, rounded.

    The luma of Rec. ITU-R BT.601, which is what converting a photograph to grey means in MATLAB, OpenCV and
    Pillow; the paper does not tell which intensity it takes.

    Raises:
        ValueError: the picture is not `(h, w, 3)` uint8.
    """
    from PIL import Image

    if colour.ndim != 3 or colour.shape[2] != 3 or colour.dtype != np.uint8:
        raise ValueError(f"a picture must be (h, w, 3) uint8, not {colour.shape} {colour.dtype}")
    return np.asarray(Image.fromarray(np.ascontiguousarray(colour)).convert("L"))


def saturated_share(colour: NDArray[np.uint8]) -> float:
    """Share of the pixels of `(h, w, 3)` uint8 that have a channel at 255."""
    red, green, blue = (colour[..., channel] == 255 for channel in range(3))
    return float(np.count_nonzero(red | green | blue)) / max(1, red.size)


class ImageStatistics:
    """Sums over pictures, and the measures that they give.

    Pictures of another size than the first are brought to its size, by the nearest pixel, where places are
    compared; shares, hues and intensities are counted in the pictures as they are. Every sum is one of
    whole numbers but for the hue spectra, which are summed in the order in which pictures are added: the
    same pictures in the same order give the same bytes.

    Attributes:
        pictures: how many have been added.
        photographs: those among them with colour.
        labelled: those among them with classes.
        pixels: `(8,)`, labelled pixels of each class.
        unlabelled: pixels of label images whose value is no class's.
        hue_pictures: `(8,)`, pictures in whose middle a class is seen; the hue spectra are means over these.
        intensities: mean grey value of every photograph, in the order added.
        saturated: share of pixels with a channel at 255 of every photograph.
    """

    def __init__(self) -> None:
        self.pictures = self.photographs = self.labelled = self.unlabelled = 0
        self.pixels = np.zeros(_CLASSES, np.int64)
        self.hue_pictures = np.zeros(_CLASSES, np.int64)
        self.intensities: list[float] = []
        self.saturated: list[float] = []
        self._spectra = np.zeros((_CLASSES, HUE_BINS))
        self._grey_share = np.zeros(_CLASSES)
        self._light: NDArray[np.uint32] | None = None
        self._masks: NDArray[np.uint32] | None = None
        self._recent: NDArray[np.uint8] | None = None

    def add(
        self, colour: NDArray[np.uint8] | None, class_id: NDArray[np.unsignedinteger[Any]] | None
    ) -> None:
        """Count one picture in.

        Args:
            colour: `(h, w, 3)` uint8 sRGB, or None.
            class_id: `(h, w)` class ids of an unsigned type, or None; values above 7 are unlabelled.

        Raises:
            ValueError: a shape or type is another, or the two differ in size.
        """
        if colour is not None and class_id is not None:
            self._add_hues(hue_counts(centre_crop(colour), centre_crop(class_id)))
        if colour is not None:
            self._add_light(grey_values(colour), saturated_share(colour))
        if class_id is not None:
            self._add_masks(np.asarray(class_id))
        self.pictures += 1

    def shares(self) -> NDArray[np.float64]:
        """Share of each class in all pixels of the label images `(8,)`, in [0, 1]; nan when there are none.

        Pixels without a label are counted among all, so that the shares of a set in which but one class was
        labelled can be compared with another's.
        """
        total = int(self.pixels.sum()) + self.unlabelled
        return self.pixels / total if total else np.full(_CLASSES, np.nan)

    def hue_spectra(self) -> NDArray[np.float64]:
        """Percentage of a class's pixels at each hue `(8, 180)`, averaged over the pictures that show it.

        A row adds up to 100 less the class's grey pixels; nan where no picture's middle shows the class.
        """
        with np.errstate(invalid="ignore"):
            return 100.0 * self._spectra / self.hue_pictures[:, None]

    def grey_shares(self) -> NDArray[np.float64]:
        """Share of a class's pixels that have no hue `(8,)`, averaged like the spectra."""
        with np.errstate(invalid="ignore"):
            return self._grey_share / self.hue_pictures

    def mean_masks(self) -> NDArray[np.float64] | None:
        """Share of the labelled pictures in which a class lies at a place `(8, h, w)`; None without labels.

        Fig. 11 shows these, each divided by its maximum.
        """
        if self._masks is None:
            return None
        self._flush()
        return self._masks / self.labelled

    def mean_intensity(self) -> NDArray[np.float64] | None:
        """Mean grey value at each place `(h, w)`, 0 to 255; None without photographs."""
        return None if self._light is None else self._light / self.photographs

    def _add_hues(self, counts: NDArray[np.int64]) -> None:
        """Each picture counts the same for a class, however many of its pixels it shows."""
        pixels = counts.sum(axis=1)
        seen = pixels > 0
        shares = counts[seen] / pixels[seen, None]
        self._spectra[seen] += shares[:, :HUE_BINS]
        self._grey_share[seen] += shares[:, HUE_BINS]
        self.hue_pictures += seen

    def _add_light(self, grey: NDArray[np.uint8], saturated: float) -> None:
        self.intensities.append(float(grey.mean(dtype=np.float64)))
        self.saturated.append(saturated)
        if self._light is None:
            self._light = np.zeros(grey.shape, np.uint32)
        self._light += _fitted(grey, self._light.shape)
        self.photographs += 1

    def _add_masks(self, class_id: NDArray[np.unsignedinteger[Any]]) -> None:
        counts = np.bincount(class_id.ravel(), minlength=_CLASSES)
        self.pixels += counts[:_CLASSES]
        self.unlabelled += int(counts[_CLASSES:].sum())
        if self._masks is None or self._recent is None:
            self._masks = np.zeros((_CLASSES, *class_id.shape), np.uint32)
            self._recent = np.zeros((_CLASSES, *class_id.shape), np.uint8)
        ids = _fitted(class_id, self._recent.shape[1:])
        for organ_class, counter in zip(OrganClass, self._recent, strict=True):
            counter += (ids == organ_class).view(np.uint8)
        self.labelled += 1
        if self.labelled % _FLUSHED == 0:
            self._flush()

    def _flush(self) -> None:
        if self._masks is not None and self._recent is not None:
            self._masks += self._recent
            self._recent[:] = 0


def _fitted(image: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """An image `(h, w)` in another size: at each place the nearest pixel."""
    if image.shape == shape:
        return image
    # The middle of pixel k of n lies at (2 k + 1) / (2 n) of the length.
    rows, columns = (
        (2 * np.arange(new) + 1) * old // (2 * new) for new, old in zip(shape, image.shape, strict=True)
    )
    return image[np.ix_(rows, columns)]


def centre_falloff(image: NDArray[np.floating[Any]], radii: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Mean of an image `(h, w)` in rings around its middle.

    Args:
        image: any values.
        radii: `(n + 1,)`, ascending borders of the rings; the corners lie at 1.

    Returns:
        `(n,)`; nan in a ring that holds no pixel's centre.
    """
    height, width = image.shape
    rows, columns = np.arange(height) - (height - 1) / 2.0, np.arange(width) - (width - 1) / 2.0
    away = np.hypot(rows[:, None], columns[None, :]) / np.hypot(height / 2.0, width / 2.0)
    counts, _ = np.histogram(away, radii)
    sums, _ = np.histogram(away, radii, weights=image)
    with np.errstate(invalid="ignore"):
        return sums / counts

"""Statistics of saturation, texture and gloss of one image, from linear sRGB.

Saturation is S = C* / (L* + 16) in CIELAB under D65, by analogy with the CIE 1976 saturation C*uv / L*. Where
L* is above 8, L* + 16 and C* both scale with the cube root of the light, so that S does not depend on the
exposure.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])
"""Relative luminance of linear sRGB (IEC 61966-2-1)."""

BLUR_PX: Final = 1.0
"""Standard deviation of the Gaussian whose derivative is a gradient. Chosen: the least that is alike in all
directions on square pixels to 1 %."""

PATCH_PX: Final = 32
"""Side of a square patch. Chosen: a leaf in an image 600 pixels wide is 60 to 150 pixels wide."""

LEAST_GRADIENT: Final = 0.1
"""Root mean square gradient of L* per pixel below which a patch has no texture. Chosen: rounding to 8 bits
gives gradients of up to 0.1."""

GLOSS_FACTOR: Final = 1.5
"""Luminance of gloss over the median of its organ. Chosen: a matt surface lit at up to 45 degrees is at most
1.4 times as bright as one at its median tilt."""

GLOSS_SATURATION: Final = 0.8
"""Saturation of gloss over the median of its organ, at most. Chosen: reflection of white light that makes a
green leaf 1.5 times as bright lowers its S to about .7."""

LONGEST_PX, SHORTEST_PX = 64.0, 6.0
"""Wavelengths of the band of the power spectrum in pixels. Chosen: the longest fits five times into the
height of a photograph 600 pixels wide, the shortest is twice what resampling and demosaicing blur."""

SPECTRUM_BINS: Final = 16
"""Chosen: rings of the spectrum, evenly spaced in log frequency; the narrowest holds some 40 frequencies."""


# --- colour -------------------------------------------------------------------------------------------------


def saturation(lab: ArrayLike) -> Floats:
    """Saturation `(...)`, C* / (L* + 16), of CIELAB colours `(..., 3)`."""
    values = np.asarray(lab, float)
    return np.asarray(np.hypot(values[..., 1], values[..., 2]) / (values[..., 0] + 16.0))


def lab_hue_deg(lab: ArrayLike) -> Floats:
    """CIELAB hue `(...)` in degrees, [0, 360), of colours `(..., 3)`."""
    values = np.asarray(lab, float)
    return np.asarray(np.degrees(np.arctan2(values[..., 2], values[..., 1])) % 360.0)


def circular_median(angle_deg: ArrayLike, weight: ArrayLike) -> Floats:
    """Angle of a histogram whose mean arc to all angles is least, degrees (Fisher 1993, section 2.3.2).

    The angles are the centres `(bins,)` of equal bins around the circle, the weights `(..., bins)` at least
    0. The result `(...)` is one of the angles; nan if all weights are 0.
    """
    angles, weights = np.asarray(angle_deg, float), np.asarray(weight, float)
    arcs = 180.0 - np.abs(180.0 - np.abs(angles[:, None] - angles[None, :]))
    medians = angles[np.argmin(weights @ arcs, axis=-1)]
    return np.where(weights.sum(axis=-1) > 0.0, medians, np.nan)


def histogram_percentiles(counts: Floats, width: float, percent: ArrayLike) -> Floats:
    """Percentiles `(n, p)` of histograms `(n, bins)` by linear interpolation within the bins; nan if empty.

    The bins start at 0; `percent` `(p,)` is from 0 to 100.
    """
    fractions = np.asarray(percent, float) / 100.0
    edges = width * np.arange(counts.shape[1] + 1)
    result = np.full((len(counts), fractions.size), np.nan)
    for row, count in enumerate(counts):
        cumulative = np.concatenate([[0.0], np.cumsum(count)])
        if cumulative[-1] > 0.0:
            result[row] = np.interp(fractions * cumulative[-1], cumulative, edges)
    return result


# --- texture ------------------------------------------------------------------------------------------------


def patch_grid(regions: NDArray[Any]) -> NDArray[np.int64]:
    """`(n, 2)` row and column of the first pixels of square patches, side by side, each wholly in one region.

    Args:
        regions: `(h, w)` numbers of regions; 0 is none.
    """
    rows, columns = (side // PATCH_PX for side in regions.shape)
    if not rows or not columns:
        return np.zeros((0, 2), np.int64)
    blocks = regions[: rows * PATCH_PX, : columns * PATCH_PX].reshape(rows, PATCH_PX, columns, PATCH_PX)
    least, greatest = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))
    return PATCH_PX * np.argwhere((least == greatest) & (least > 0))


def patch_pixels(corners: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows `(n, PATCH_PX, 1)` and columns `(n, 1, PATCH_PX)` of the pixels of patches, to index an image."""
    offsets = np.arange(PATCH_PX)
    return corners[:, 0, None, None] + offsets[:, None], corners[:, 1, None, None] + offsets


def structure_tensors(lightness: Floats) -> Floats:
    """Products of the gradients of an image: `(h, w, 3)` of gx gx, gx gy and gy gy per pixel squared.

    Gradients are derivatives of a Gaussian (Bigün & Granlund 1987, "Optimal orientation detection of linear
    symmetry"); their mean over a patch is its structure tensor.
    """
    from scipy.ndimage import gaussian_filter

    across = gaussian_filter(lightness, BLUR_PX, order=(0, 1))
    down = gaussian_filter(lightness, BLUR_PX, order=(1, 0))
    return np.stack([across * across, across * down, down * down], axis=-1)


def principal_gradients(tensors: ArrayLike) -> tuple[Floats, Floats]:
    """Mean squares `(...)` of the gradient along the two principal directions, the greater first.

    The ratio of their roots is 1 if slopes are alike in all directions, and large for stripes. A random
    texture in a small patch has a ratio slightly above 1, since the directions are chosen from the same
    gradients.

    Args:
        tensors: `(..., 3)` structure tensors: xx, xy, yy.
    """
    xx, xy, yy = np.moveaxis(np.asarray(tensors, float), -1, 0)
    half, difference = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return half + difference, np.maximum(half - difference, 0.0)


def coherence(tensors: ArrayLike) -> Floats:
    """(l1 - l2) / (l1 + l2) of structure tensors `(..., 3)`: 0 for no direction, 1 for parallel stripes."""
    greater, lesser = principal_gradients(tensors)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((greater - lesser) / (greater + lesser))


def gloss_fraction(luminance: ArrayLike, saturations: ArrayLike) -> Floats:
    """Fraction of an organ's pixels that are both brighter and less saturated than its median.

    Brighter means by `GLOSS_FACTOR` in linear luminance, less saturated means at most `GLOSS_SATURATION`
    times its median. Limits: pale veins, residue and clipped pixels in a shaded organ count as gloss, sheen
    over more than half of an organ raises the median and does not. Linear luminance and saturation are those
    of its pixels, `(..., n)` with n at least 1; the result is `(...)`.
    """
    bright, weak = np.asarray(luminance, float), np.asarray(saturations, float)
    brighter = bright > GLOSS_FACTOR * np.median(bright, axis=-1, keepdims=True)
    weaker = weak < GLOSS_SATURATION * np.median(weak, axis=-1, keepdims=True)
    return np.asarray((brighter & weaker).mean(axis=-1))


# --- power spectrum -----------------------------------------------------------------------------------------


def spectrum_frequencies() -> Floats:
    """`(SPECTRUM_BINS,)` geometric centres of the rings of `radial_power_spectrum`, cycles per pixel."""
    edges = _ring_edges()
    return np.asarray(np.sqrt(edges[1:] * edges[:-1]))


def radial_power_spectrum(luminance: ArrayLike) -> Floats:
    """Mean power of an image in rings of spatial frequency.

    The mean is subtracted and a Hann window applied along both sides, so that the jump at the borders of the
    image adds no power. The image is divided by its mean: the exposure changes nothing. Power spectra of
    natural images fall with about the square of the frequency (Field 1987, J. Opt. Soc. Am. A 4:2379;
    Torralba & Oliva 2003, Network 14:391).

    Returns:
        `(SPECTRUM_BINS,)` at `spectrum_frequencies`, for a linear luminance `(h, w)`; nan for rings without a
        frequency, in small images, and zeros for a black image.
    """
    from scipy.fft import rfft2

    image = np.asarray(luminance, float)
    window = np.outer(*(np.hanning(side + 2)[1:-1] for side in image.shape))
    mean = float(np.sum(window * image) / window.sum())
    if mean <= 0.0:
        return np.zeros(SPECTRUM_BINS)
    power = np.abs(rfft2(window * (image / mean - 1.0))) ** 2 / np.sum(window**2)
    radius = np.hypot(np.fft.fftfreq(image.shape[0])[:, None], np.fft.rfftfreq(image.shape[1])[None])
    # Columns other than the first stand for two frequencies, f and -f.
    weight = np.where(np.arange(power.shape[1]) == 0, 1.0, 2.0)[None] * np.ones_like(power)
    # Mean power of each ring of frequencies.
    ring = np.digitize(radius.ravel(), _ring_edges()) - 1
    inside = (ring >= 0) & (ring < SPECTRUM_BINS)
    sums = [
        np.bincount(ring[inside], values.ravel()[inside], minlength=SPECTRUM_BINS)
        for values in (weight * power, weight)
    ]
    with np.errstate(invalid="ignore"):
        return np.asarray(sums[0] / sums[1])


def spectrum_slope(power: ArrayLike) -> float:
    """Slope of log power over log frequency of a `radial_power_spectrum`, by least squares over all rings.

    nan if a ring has no power.
    """
    values = np.asarray(power, float)
    if not (np.isfinite(values).all() and (values > 0.0).all()):
        return float("nan")
    return float(np.polyfit(np.log(spectrum_frequencies()), np.log(values), 1)[0])


def _ring_edges() -> Floats:
    return np.geomspace(1.0 / LONGEST_PX, 1.0 / SHORTEST_PX, SPECTRUM_BINS + 1)


# --- scale --------------------------------------------------------------------------------------------------


def resize_linear(linear: ArrayLike, width: int) -> Floats:
    """Resample an image `(h, w, 3)` of linear light to a width in pixels, keeping its shape.

    Lanczos filter, in linear light, so that a reduced image has the colours of a camera with larger pixels.
    """
    from PIL import Image

    image = np.asarray(linear, np.float32)
    if image.shape[1] == width:
        return image.astype(float)
    size = (width, max(1, round(image.shape[0] * width / image.shape[1])))
    channels = [
        np.asarray(
            Image.fromarray(np.ascontiguousarray(image[..., k])).resize(size, Image.Resampling.LANCZOS)
        )
        for k in range(3)
    ]
    return np.clip(np.stack(channels, axis=-1).astype(float), 0.0, 1.0)


def resize_labels(labels: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Labels `(h, w)` at the pixel centres of an image `(height, width)`; labels are not mixed."""
    rows, columns = (
        (2 * np.arange(new) + 1) * old // (2 * new) for new, old in zip(shape, labels.shape, strict=True)
    )
    return labels[rows[:, None], columns[None, :]]

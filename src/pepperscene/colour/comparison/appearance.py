"""Saturation, hue, texture, gloss and clipping of one image set, as sums that can be bootstrapped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import decode_tone
from pepperscene.classes import OrganClass
from pepperscene.colour.appearance import (
    LEAST_GRADIENT,
    LUMINANCE,
    PATCH_PX,
    SPECTRUM_BINS,
    circular_median,
    coherence,
    gloss_fraction,
    histogram_percentiles,
    lab_hue_deg,
    patch_grid,
    patch_pixels,
    principal_gradients,
    radial_power_spectrum,
    resize_labels,
    resize_linear,
    saturation,
    spectrum_slope,
    structure_tensors,
)
from pepperscene.colour.comparison.bootstrap import (
    BootstrapSums,
    Estimate,
    Floats,
    estimate_angles,
    estimate_values,
    unknown_estimate,
)
from pepperscene.colour.statistics import bin_angles, circular_sd, linear_srgb_to_lab
from pepperscene.truth import centre_side

WIDTH_PX: Final = 580
"""Width at which textures are compared by default. Chosen: photographs of public data sets are 590 to 800
pixels wide, and a pixel of one that shows 70 cm of a row is about as large as a secondary vein."""
WHOLE: Final = "image"
"""Name of the kind that contains all pixels."""
PERCENT: Final = (10.0, 50.0, 90.0)
SATURATION_BINS: Final = 200
SATURATION_WIDTH: Final = 0.01
"""Chosen: 200 bins reach to S = 2, beyond the most saturated colour of sRGB but for a few dark blues, which
the last bin counts as well."""
HUE_BINS: Final = 360
LEAST_REGION_PX: Final = 400
"""Pixels of the smallest organ that is measured. Chosen: 20 x 20, whose border is a fifth of it."""
DARK_CODE: Final = 6
"""Greatest code whose linear value, 0.0018, is below 0.002: a channel that holds no colour. Photographs hold
no exact zeros, because of noise and compression."""
# Columns of the sums of a kind.
SATURATIONS: Final = slice(0, SATURATION_BINS)
HUES: Final = slice(SATURATION_BINS, SATURATION_BINS + HUE_BINS)
_AFTER: Final = SATURATION_BINS + HUE_BINS
PIXELS, BLUE_DARK, ANY_FULL, CODES = range(_AFTER, _AFTER + 4)
REGIONS, REGION_SD, REGION_GLOSS = range(_AFTER + 4, _AFTER + 7)
PATCHES, PATCH_SD, TEXTURED, COHERENCE, GREATER, LESSER = range(_AFTER + 7, _AFTER + 13)
SPECTRA, SLOPE, SLOPE_SQUARED = range(_AFTER + 13, _AFTER + 16)
LOG_POWER: Final = slice(_AFTER + 16, _AFTER + 16 + SPECTRUM_BINS)
_WIDTH: Final = _AFTER + 16 + SPECTRUM_BINS


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


@dataclass(frozen=True)
class AppearanceMeasures:
    """Appearance of one kind of organ, or of whole images, in one set; shares are fractions of 1."""

    pictures: int  # number of images that show it
    pixels: int  # number of its pixels in them, at the scale of the comparison
    saturation: tuple[Estimate, Estimate, Estimate]  # 10th, 50th and 90th percentile of S = C* / (L* + 16)
    hue_median_deg: Estimate  # circular median of the CIELAB hues, weighted by chroma
    hue_spread_deg: Estimate  # their circular standard deviation, weighted by chroma
    blue_dark_share: Estimate  # pixels whose linear blue is below 0.002
    clipped_share: Estimate  # pixels with a channel at its maximum
    organ_lightness_sd: Estimate  # standard deviation of L* within an organ, averaged over organs
    gloss_share: Estimate  # share of gloss in an organ, averaged over organs
    patch_lightness_sd: Estimate  # standard deviation of L* within a square patch, averaged over patches
    coherence: Estimate  # of the structure tensors of the patches with texture, averaged
    gradient_ratio: Estimate  # rms gradient of L* across over along the direction of each patch
    spectrum_slope: Estimate  # of log power over log frequency, averaged over images; whole images only
    spectrum_slope_spread: Estimate  # its standard deviation between images


def add_appearance(
    kinds: dict[str, BootstrapSums],
    colour: NDArray[np.uint8],
    classes: NDArray[np.uint8] | None,
    instances: NDArray[np.uint16] | None,
    scale: Scale,
    weights: Floats,
) -> None:
    """Add the appearance of an image `(h, w, 3)` with its labels `(h, w)` to the sums of its kinds.

    Missing kinds are added. An image that is too narrow for the scale gives colours only, at its own scale.
    """
    linear = decode_tone(colour)
    width = scale.width(colour.shape[1])
    if width is not None:
        linear = resize_linear(linear, width)
    shape = (linear.shape[0], linear.shape[1])
    lab = linear_srgb_to_lab(linear)
    image = _Image(colour, lab, linear @ LUMINANCE, textured=width is not None)
    vectors = {WHOLE: image.vector(np.ones(colour.shape[:2], bool), np.ones(shape, bool), None)}
    if image.textured:
        power = radial_power_spectrum(image.luminance)
        if np.isfinite(slope := spectrum_slope(power)):
            vectors[WHOLE][[SPECTRA, SLOPE, SLOPE_SQUARED]] = 1.0, slope, slope**2
            vectors[WHOLE][LOG_POWER] = np.log(power)
    if classes is not None:
        small = resize_labels(classes, shape)
        organs = None if instances is None else resize_labels(instances, shape)
        for organ in OrganClass:
            if (mask := small == organ).any():
                regions = _regions(mask, organs)
                vectors[organ.name.lower()] = image.vector(classes == organ, mask, regions)
    for kind, vector in vectors.items():
        kinds.setdefault(kind, BootstrapSums(_WIDTH)).add(vector, weights)


class _Image:
    """An image at the scale of the comparison, with what its kinds share."""

    def __init__(self, codes: NDArray[np.uint8], lab: Floats, luminance: Floats, *, textured: bool) -> None:
        self.luminance, self.textured, self._lab = luminance, textured, lab
        self._blue_dark, self._full = codes[..., 2] <= DARK_CODE, (codes == 255).any(axis=-1)
        self._saturation = saturation(lab)
        bins = (self._saturation / SATURATION_WIDTH).astype(np.int64)
        self._saturation_bin = np.minimum(bins, SATURATION_BINS - 1)
        self._chroma = np.hypot(lab[..., 1], lab[..., 2])
        self._hue_bin = np.rint(lab_hue_deg(lab)).astype(np.int64) % HUE_BINS
        self._tensors = structure_tensors(lab[..., 0]) if textured else None

    def vector(
        self, native: NDArray[np.bool_], mask: NDArray[np.bool_], regions: NDArray[np.int64] | None
    ) -> Floats:
        """Sums `(width,)` over a kind.

        Args:
            native: `(h, w)` its pixels in the image as it is, whose codes are counted.
            mask: its pixels at the scale of the comparison.
            regions: its organs, numbered from 1; None for whole images, whose patches count as organs.
        """
        vector = np.zeros(_WIDTH)
        vector[SATURATIONS] = np.bincount(self._saturation_bin[mask], minlength=SATURATION_BINS)
        vector[HUES] = np.bincount(self._hue_bin[mask], self._chroma[mask], minlength=HUE_BINS)
        vector[PIXELS] = np.count_nonzero(mask)
        vector[CODES] = np.count_nonzero(native)
        vector[BLUE_DARK] = np.count_nonzero(self._blue_dark[native])
        vector[ANY_FULL] = np.count_nonzero(self._full[native])
        if self._tensors is None:
            return vector
        rows, columns = patch_pixels(patch_grid(mask.astype(np.uint8) if regions is None else regions))
        vector[PATCHES] = len(rows)
        vector[PATCH_SD] = self._lab[rows, columns, 0].std(axis=(1, 2)).sum()
        tensors = self._tensors[rows, columns].mean(axis=(1, 2))
        textured = tensors[tensors[:, 0] + tensors[:, 2] >= LEAST_GRADIENT**2]
        greater, lesser = principal_gradients(textured)
        vector[TEXTURED], vector[COHERENCE] = len(textured), coherence(textured).sum()
        vector[GREATER], vector[LESSER] = greater.sum(), lesser.sum()
        if regions is None:
            vector[REGIONS], vector[REGION_SD] = vector[PATCHES], vector[PATCH_SD]
            shape = (len(rows), PATCH_PX**2)
            luminance, saturations = self.luminance[rows, columns], self._saturation[rows, columns]
            vector[REGION_GLOSS] = gloss_fraction(luminance.reshape(shape), saturations.reshape(shape)).sum()
        else:
            self._add_regions(vector, regions)
        return vector

    def _add_regions(self, vector: Floats, regions: NDArray[np.int64]) -> None:
        order = np.argsort(regions, axis=None, kind="stable")
        numbers, starts = np.unique(regions.ravel()[order], return_index=True)
        for number, pixels in zip(numbers, np.split(order, starts[1:]), strict=True):
            if number > 0 and pixels.size >= LEAST_REGION_PX:
                vector[REGIONS] += 1.0
                vector[REGION_SD] += self._lab[..., 0].ravel()[pixels].std()
                vector[REGION_GLOSS] += gloss_fraction(
                    self.luminance.ravel()[pixels], self._saturation.ravel()[pixels]
                )


def _regions(mask: NDArray[np.bool_], instances: NDArray[Any] | None) -> NDArray[np.int64]:
    """Organs of a class, numbered from 1: instances if they are known, else connected areas."""
    from scipy.ndimage import label

    if instances is not None and instances[mask].any():
        return np.where(mask, instances, 0).astype(np.int64)
    return np.asarray(label(mask)[0], np.int64)


# --- estimates ----------------------------------------------------------------------------------------------


def measure_appearance(sums: BootstrapSums, scale: Scale, kind: str) -> AppearanceMeasures:
    """Estimate the appearance of a kind from its sums."""
    totals, resampled = sums.totals(), sums.count > 1
    percentiles = histogram_percentiles(totals[:, SATURATIONS], SATURATION_WIDTH, PERCENT)
    low, middle, high = (estimate_values(column, resampled) for column in percentiles.T)
    angles = bin_angles(HUE_BINS)
    medians = circular_median(angles, totals[:, HUES])
    spreads = np.array([circular_sd(angles, row) if row.any() else np.nan for row in totals[:, HUES]])
    grey, narrow = "all its pixels are grey", f"no image is {scale.width_px} pixels wide"
    textured = totals[0, PATCHES] or totals[0, REGIONS] or totals[0, SPECTRA]
    no_organ = f"no area of {LEAST_REGION_PX} pixels" if textured else narrow
    no_patch = f"no patch of {PATCH_PX} x {PATCH_PX} pixels" if textured else narrow
    flat = "no patch has a texture" if totals[0, PATCHES] else no_patch

    def ratio(part: int, whole: int, why: str = "it is not defined") -> Estimate:
        return estimate_values(_divide(totals[:, part], totals[:, whole]), resampled, why)

    slope = _divide(totals[:, SLOPE], totals[:, SPECTRA])
    variance = _divide(totals[:, SLOPE_SQUARED], totals[:, SPECTRA]) - slope**2
    no_slope = (no_patch if textured else narrow) if kind == WHOLE else "measured in whole images"
    return AppearanceMeasures(
        sums.count,
        int(totals[0, PIXELS]),
        (low, middle, high),
        estimate_angles(medians, resampled, grey),
        estimate_values(np.abs(spreads), resampled, grey),
        ratio(BLUE_DARK, CODES),
        ratio(ANY_FULL, CODES),
        ratio(REGION_SD, REGIONS, no_organ),
        ratio(REGION_GLOSS, REGIONS, no_organ),
        ratio(PATCH_SD, PATCHES, no_patch),
        ratio(COHERENCE, TEXTURED, flat),
        estimate_values(np.sqrt(_divide(totals[:, GREATER], totals[:, LESSER])), resampled, flat),
        estimate_values(slope, resampled, no_slope),
        estimate_values(np.sqrt(np.maximum(variance, 0.0)), resampled, no_slope),
    )


def unknown_appearance(why: str) -> AppearanceMeasures:
    """Appearance of a kind that a set does not show."""
    unknown = unknown_estimate(why)
    return AppearanceMeasures(0, 0, (unknown,) * 3, *(unknown,) * 11)


def mean_power_spectrum(sums: BootstrapSums) -> Floats | None:
    """`(SPECTRUM_BINS,)` geometric mean of the images' power spectra; None without any."""
    totals = sums.totals()[0]
    return np.exp(totals[LOG_POWER] / totals[SPECTRA]) if totals[SPECTRA] else None


def _divide(part: Floats, whole: Floats) -> Floats:
    """Quotient of two columns; nan without a whole."""
    return np.asarray(part / np.where(whole > 0.0, whole, np.nan))

"""Colour statistics of many pixels: CIELAB of the mean colour and its spread, circular statistics of hue.

Colours are averaged in linear sRGB and reported in CIELAB under D65. Hues are those of HSV, in the bins of
`pepperscene.truth`, as Barth et al. 2018 count them. Hue is an angle (359 and 1 degrees are neighbours, and
their mean is 0), so its mean and spread are those of unit vectors: Fisher 1993, "Statistical analysis of
circular data", chapters 2 and 3. SciPy's `circmean` and `circstd` take no weights, which histograms need.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import encode_tone
from pepperscene.camera.image.colorimetry import SRGB_TO_XYZ, xyz_to_lab
from pepperscene.spectra import colour_science
from pepperscene.truth.statistics import HUE_BINS, hue_bins

Floats = NDArray[np.float64]

_ROUNDING: Final = 1e-12
"""Chosen: resultant length, relative to the sum of the weights, below which only rounding errors are left."""


# --- circular statistics ------------------------------------------------------------------------------------


def bin_angles(bins: int) -> Floats:
    """`(bins,)` centres in degrees of equal bins around the circle; the first is 0, as in a hue spectrum."""
    return np.asarray(np.arange(bins) * (360.0 / bins), float)


def circular_mean(angle_deg: ArrayLike, weight: ArrayLike | None = None) -> float:
    """Mean direction in degrees, [0, 360); nan if the angles have no mean direction.

    Args:
        angle_deg: `(n,)`.
        weight: `(n,)`, at least 0; None weights all angles equally.
    """
    resultant, weight_sum = _resultant(angle_deg, weight)
    if abs(resultant) <= _ROUNDING * weight_sum:
        return float("nan")
    return float(np.degrees(np.angle(resultant)) % 360.0)


def resultant_length(angle_deg: ArrayLike, weight: ArrayLike | None = None) -> float:
    """Length of the mean unit vector: 1 if all angles are equal, 0 without direction; nan without angles."""
    resultant, weight_sum = _resultant(angle_deg, weight)
    return float(min(abs(resultant) / weight_sum, 1.0)) if weight_sum > 0.0 else float("nan")


def circular_sd(angle_deg: ArrayLike, weight: ArrayLike | None = None) -> float:
    """Circular standard deviation sqrt(-2 ln R) in degrees; infinite if the angles have no direction."""
    length = resultant_length(angle_deg, weight)
    with np.errstate(divide="ignore"):
        return float(np.degrees(np.sqrt(-2.0 * np.log(length))))


def von_mises_kappa(length: float) -> float:
    """Maximum-likelihood concentration of a von Mises distribution of this resultant length.

    It solves I1(kappa) / I0(kappa) = length; infinite for a length of 1.
    """
    from scipy.optimize import brentq
    from scipy.special import i0e, i1e

    if not 0.0 <= length < 1.0:
        return float("inf") if length == 1.0 else float("nan")
    # The approximation of Banerjee et al. 2005 (J. Mach. Learn. Res. 6:1345) is right within a factor of 2.
    approximation = length * (2.0 - length**2) / (1.0 - length**2)
    if length < 1e-6 or approximation > 1e6:  # it is exact at both ends, where rounding spoils the ratio
        return float(approximation)
    return float(
        brentq(lambda kappa: i1e(kappa) / i0e(kappa) - length, approximation / 2.0, 2.0 * approximation)
    )


def circular_emd(first: ArrayLike, second: ArrayLike) -> float:
    """Earth mover's distance in degrees between two histograms over the same equal bins of the circle.

    The mean angle by which the mass of one must move to make the other, along the shorter arcs: the sum of
    the distances of the cumulative difference from its median (Rabin, Delon & Gousseau 2011, "Transportation
    distances on the circle", J. Math. Imaging Vis. 41:147). At most 180; nan if a histogram is empty.

    Args:
        first: `(bins,)`, at least 0; normalised to a sum of 1.
        second: `(bins,)`, likewise.

    Raises:
        ValueError: the two differ in size, or a value is negative.
    """
    p, q = np.asarray(first, float), np.asarray(second, float)
    if p.ndim != 1 or p.shape != q.shape:
        raise ValueError(f"histograms must be two lists of one length, not {p.shape} and {q.shape}")
    if (p < 0.0).any() or (q < 0.0).any():
        raise ValueError("histograms must not be negative")
    if not (p.sum() > 0.0 and q.sum() > 0.0):
        return float("nan")
    # Where the circle is cut is free: the median is the cut that moves least.
    difference = np.cumsum(p / p.sum() - q / q.sum())
    return float(np.abs(difference - np.median(difference)).sum() * (360.0 / p.size))


def _resultant(angle_deg: ArrayLike, weight: ArrayLike | None) -> tuple[complex, float]:
    """Weighted sum of the unit vectors, and the sum of the weights."""
    angles = np.asarray(angle_deg, float).ravel()
    weights = np.ones_like(angles) if weight is None else np.asarray(weight, float).ravel()
    if weights.shape != angles.shape or not (weights >= 0.0).all():
        raise ValueError(f"{angles.size} angles need as many weights, at least 0")
    return complex(np.sum(weights * np.exp(1j * np.radians(angles % 360.0)))), float(weights.sum())


# --- colours ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ColourStatistics:
    """Colour statistics of many pixels.

    Attributes:
        n: number of pixels; without pixels everything else is nan.
        mean_lab: `(3,)` CIELAB (D65) of the mean linear colour: the colour of a blurred image.
        lab_of_pixels: `(3,)` mean of the pixels' CIELAB.
        sd: `(3,)` standard deviation of the pixels' L*, a* and b*.
        covariance: `(3, 3)` of the pixels' L*, a* and b*.
        hue_spectrum: `(180,)` percentage of the pixels in each hue bin; sums to 100 minus the grey ones.
        grey_share: fraction of the pixels that are grey and have no hue.
        mean_hue_deg: mean direction of the hues; nan if they have none.
        resultant_length: of the hues: 1 for a single hue, 0 without direction.
        circular_sd_deg: circular standard deviation of the hues.
        kappa: concentration of the von Mises distribution of this resultant length.
    """

    n: int
    mean_lab: Floats
    lab_of_pixels: Floats
    sd: Floats
    covariance: Floats
    hue_spectrum: Floats
    grey_share: float
    mean_hue_deg: float
    resultant_length: float
    circular_sd_deg: float
    kappa: float

    @classmethod
    def from_pixels(
        cls, linear: ArrayLike, codes: NDArray[np.uint8] | None = None, hues: ArrayLike | None = None
    ) -> Self:
        """Compute the statistics of pixels; their order changes nothing but rounding.

        Args:
            linear: `(n, 3)` linear sRGB, 0 to 1.
            codes: `(m, 3)` 8-bit sRGB from which the hues are counted; None encodes `linear`.
            hues: `(181,)` hue counts or fractions, used instead of `codes`; the last one is that of grey.

        Raises:
            ValueError: an array has another shape.
        """
        pixels = np.asarray(linear, float)
        if pixels.ndim != 2 or pixels.shape[1] != 3:
            raise ValueError(f"pixels must be (n, 3), not {pixels.shape}")
        if hues is None:
            hues = hue_histogram(srgb_codes(pixels) if codes is None else codes)
        counts = np.asarray(hues, float)
        if counts.shape != (HUE_BINS + 1,):
            raise ValueError(f"hues must be ({HUE_BINS + 1},), not {counts.shape}")
        with np.errstate(invalid="ignore"):
            fractions = counts / counts.sum()
        spectrum = 100.0 * fractions[:HUE_BINS]
        angles, weights = bin_angles(HUE_BINS), np.nan_to_num(spectrum)
        length = resultant_length(angles, weights)
        return cls(
            n=len(pixels),
            **_lab_statistics(pixels),
            hue_spectrum=spectrum,
            grey_share=float(fractions[HUE_BINS]),
            mean_hue_deg=circular_mean(angles, weights),
            resultant_length=length,
            circular_sd_deg=circular_sd(angles, weights),
            kappa=von_mises_kappa(length),
        )


def linear_srgb_to_lab(linear: ArrayLike) -> Floats:
    """`(..., 3)` CIELAB under D65 of linear sRGB `(..., 3)`."""
    return xyz_to_lab(np.asarray(linear, float) @ SRGB_TO_XYZ.T)


def delta_e_2000(first: ArrayLike, second: ArrayLike) -> Floats:
    """CIEDE2000 colour difference `(...)` of CIELAB colours `(..., 3)` (CIE 142:2001), by colour-science."""
    return np.asarray(colour_science().delta_E(np.asarray(first), np.asarray(second), method="CIE 2000"))


def srgb_codes(linear: ArrayLike) -> NDArray[np.uint8]:
    """8-bit sRGB of linear sRGB, clipped."""
    return encode_tone(np.asarray(linear, np.float32))


def hue_histogram(codes: NDArray[np.uint8]) -> NDArray[np.int64]:
    """`(181,)` number of pixels of 8-bit sRGB `(..., 3)` in each hue bin; the last bin counts grey pixels."""
    # The modulus turns the bin -1 of grey pixels into the last one.
    return np.bincount((hue_bins(codes) % (HUE_BINS + 1)).ravel(), minlength=HUE_BINS + 1)


def mean_hue_fractions(counts: Mapping[str, Sequence[NDArray[Any]]]) -> Floats:
    """`(181,)` mean hue fractions over images; each image has the same weight, as in the paper.

    Args:
        counts: hue histograms of the patches of each image. Images are summed in the order of their
            names, so that the order of the mapping changes no bit; those without pixels are left out.
    """
    histograms = [np.sum(counts[name], axis=0) for name in sorted(counts)]
    fractions = [histogram / histogram.sum() for histogram in histograms if histogram.sum() > 0]
    return np.mean(fractions, axis=0) if fractions else np.full(HUE_BINS + 1, np.nan)


def _lab_statistics(pixels: Floats) -> dict[str, Floats]:
    """Means, standard deviations and covariance in CIELAB of linear sRGB `(n, 3)`."""
    if not len(pixels):
        nan = np.full(3, np.nan)
        return {"mean_lab": nan, "lab_of_pixels": nan, "sd": nan, "covariance": np.full((3, 3), np.nan)}
    lab = linear_srgb_to_lab(pixels)
    mean = lab.mean(axis=0)
    deviations = lab - mean
    covariance = deviations.T @ deviations / len(lab)
    return {
        "mean_lab": linear_srgb_to_lab(pixels.mean(axis=0)),
        "lab_of_pixels": mean,
        "sd": np.sqrt(np.diag(covariance)),
        "covariance": covariance,
    }

"""What many pixels of one kind have in common: CIELAB of their mean and their spread, and their hues.

Colours are added up as light (linear sRGB) and told as they are seen (CIELAB under D65); hues are those of
HSV, in the bins of `pepperscene.truth`, as Barth et al. 2018 count them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import encode_tone
from pepperscene.camera.colorimetry import SRGB_TO_XYZ
from pepperscene.camera.colorimetry import xyz_to_lab as lab_of_xyz
from pepperscene.colour.statistics.circular import (
    bin_angles,
    circular_mean,
    circular_sd,
    concentration,
    resultant_length,
)
from pepperscene.spectra import colour_science
from pepperscene.truth.statistics import HUE_BINS, hue_bins

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ColourStatistics:
    """Colours of many pixels in a few numbers.

    Attributes:
        n: pixels; with none of them all else is nan.
        mean_lab: `(3,)` CIELAB (D65) of the mean of the linear colours: what a blurred picture shows.
        lab_of_pixels: `(3,)` mean of the pixels' CIELAB.
        sd: `(3,)` standard deviation of the pixels' L*, a* and b*.
        covariance: `(3, 3)` of the pixels' L*, a* and b*.
        hue_spectrum: `(180,)` percentage of the pixels at each hue; adds up to 100 less the grey ones.
        grey_share: of the pixels, that have no hue; in [0, 1].
        mean_hue_deg: mean direction of the hues; nan where they have none.
        resultant_length: of the hues' unit vectors: 1 one hue, 0 no direction.
        circular_sd_deg: sqrt(-2 ln R) of the hues.
        kappa: concentration of the von Mises distribution with this resultant length.
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
    def of(
        cls, linear: ArrayLike, codes: NDArray[np.uint8] | None = None, hues: ArrayLike | None = None
    ) -> Self:
        """The statistics of pixels; their order does not matter, beyond rounding.

        Args:
            linear: `(n, 3)` linear sRGB, 0 to 1.
            codes: `(m, 3)` 8-bit sRGB to count the hues in; None encodes `linear`.
            hues: `(181,)` instead of `codes`: shares or numbers of pixels at each hue, the grey ones last.

        Raises:
            ValueError: an array has another shape.
        """
        light = np.asarray(linear, float)
        if light.ndim != 2 or light.shape[1] != 3:
            raise ValueError(f"pixels must be (n, 3), not {light.shape}")
        counts = hue_counts_of(encoded(light) if codes is None else codes) if hues is None else hues
        spectrum, grey = _percentages(counts)
        angles = bin_angles(HUE_BINS)
        length = resultant_length(angles, _weights(spectrum))
        return cls(
            n=len(light),
            **_spread(light),
            hue_spectrum=spectrum,
            grey_share=grey,
            mean_hue_deg=circular_mean(angles, _weights(spectrum)),
            resultant_length=length,
            circular_sd_deg=circular_sd(angles, _weights(spectrum)),
            kappa=concentration(length),
        )


def linear_srgb_to_lab(linear: ArrayLike) -> Floats:
    """`(..., 3)` CIELAB under D65 of linear sRGB `(..., 3)`."""
    return lab_of_xyz(np.asarray(linear, float) @ SRGB_TO_XYZ.T)


def delta_e_2000(one: ArrayLike, other: ArrayLike) -> Floats:
    """CIEDE2000 colour difference `(...)` of CIELAB colours `(..., 3)` (CIE 142:2001), by colour-science."""
    return np.asarray(colour_science().delta_E(np.asarray(one), np.asarray(other), method="CIE 2000"))


def encoded(linear: ArrayLike) -> NDArray[np.uint8]:
    """8-bit sRGB of linear sRGB, clipped."""
    return encode_tone(np.asarray(linear, np.float32))


def hue_counts_of(codes: NDArray[np.uint8]) -> NDArray[np.int64]:
    """`(181,)` how many pixels of 8-bit sRGB `(..., 3)` have which hue; the last counts the grey ones."""
    # Minus one, the grey pixels' bin, becomes the last.
    return np.bincount((hue_bins(codes) % (HUE_BINS + 1)).ravel(), minlength=HUE_BINS + 1)


def mean_hue_shares(counts: Mapping[str, Sequence[NDArray[Any]]]) -> Floats:
    """`(181,)` shares of the hues, averaged over pictures as the paper does: each counts the same.

    Args:
        counts: by picture, `hue_counts_of` its patches. They are taken in the order of the names, so that the
            order of pictures changes no bit; pictures without pixels do not count.
    """
    pictures = [np.sum(counts[name], axis=0) for name in sorted(counts)]
    shares = [found / found.sum() for found in pictures if found.sum() > 0]
    return np.mean(shares, axis=0) if shares else np.full(HUE_BINS + 1, np.nan)


def _spread(light: Floats) -> dict[str, Floats]:
    """Means, deviations and covariance in CIELAB."""
    if not len(light):
        none = np.full(3, np.nan)
        return {"mean_lab": none, "lab_of_pixels": none, "sd": none, "covariance": np.full((3, 3), np.nan)}
    pixels = linear_srgb_to_lab(light)
    mean = pixels.mean(axis=0)
    deviations = pixels - mean
    covariance = deviations.T @ deviations / len(pixels)
    return {
        "mean_lab": linear_srgb_to_lab(light.mean(axis=0)),
        "lab_of_pixels": mean,
        "sd": np.sqrt(np.diag(covariance)),
        "covariance": covariance,
    }


def _percentages(counts: ArrayLike) -> tuple[Floats, float]:
    """Hue spectrum `(180,)` in per cent, and the share of grey pixels; nan where there are none at all."""
    found = np.asarray(counts, float)
    if found.shape != (HUE_BINS + 1,):
        raise ValueError(f"hues must be ({HUE_BINS + 1},), not {found.shape}")
    with np.errstate(invalid="ignore"):
        shares = found / found.sum()
    return 100.0 * shares[:HUE_BINS], float(shares[HUE_BINS])


def _weights(spectrum: Floats) -> Floats:
    """A spectrum as weights: none where there is no pixel."""
    return np.nan_to_num(spectrum)

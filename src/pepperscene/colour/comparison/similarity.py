"""How alike two sets are, by their sums: each measure of the plain sums first, then of each replicate.

Rows of sums are those of `resampling.BootstrapSums.totals`, columns those of `measuring`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from pepperscene.colour.comparison.measure import CELLS, CLASSES, HUES, LAB, LIGHT, PICTURES, PIXELS, SQUARES
from pepperscene.colour.statistics.bootstrap import Floats
from pepperscene.colour.statistics.circular import bin_angles, circular_emd, circular_mean, circular_sd
from pepperscene.colour.statistics.colours import linear_srgb_to_lab
from pepperscene.truth import HUE_BINS, centre_falloff, hue_spectrum_correlation

_ANGLES: Final = bin_angles(HUE_BINS)
_RINGS: Final = np.linspace(0.0, 1.0, 13)
"""Chosen: twelve rings, each two cells wide."""


def paired(
    measure: Callable[[Floats, Floats], float], one: Floats, other: Floats, *, resampled: bool = True
) -> Floats:
    """`(n,)` a measure of each pair of rows of two arrays `(n, ...)`; nan where a row is not finite.

    Args:
        measure: of two rows.
        one: of the first set.
        other: of the second.
        resampled: whether the replicates are wanted; else the first rows alone are looked at.
    """
    if not resampled:
        one, other = one[:1], other[:1]
    return np.array([
        measure(p, q) if np.isfinite(p).all() and np.isfinite(q).all() else np.nan
        for p, q in zip(one, other, strict=True)
    ])  # fmt: skip


def hue_spectra(sums: Floats) -> Floats:
    """`(n, 180)` percentage of a kind's pixels at each hue, averaged over the pictures (Fig. 12)."""
    return 100.0 * sums[:, HUES][:, :HUE_BINS] / sums[:, PICTURES, None]


def grey_shares(sums: Floats) -> Floats:
    """`(n,)` share of a kind's pixels that have no hue, averaged likewise."""
    return np.asarray(sums[:, HUES][:, HUE_BINS] / sums[:, PICTURES])


def mean_hues(spectra: Floats) -> Floats:
    """`(n,)` mean direction of hue spectra `(n, 180)`, degrees."""
    return np.array([circular_mean(_ANGLES, spectrum) for spectrum in spectra])


def hue_spreads(spectra: Floats) -> Floats:
    """`(n,)` circular standard deviation of hue spectra, degrees; nan where they have no direction."""
    spreads = np.array([circular_sd(_ANGLES, spectrum) for spectrum in spectra])
    # Of a single hue the logarithm leaves a minus zero.
    return np.where(np.isfinite(spreads), np.abs(spreads), np.nan)


def correlation(one: Floats, other: Floats) -> float:
    """Pearson's correlation of two arrays of one shape; nan where one is flat."""
    return hue_spectrum_correlation(one.ravel(), other.ravel())


def hue_distance(one: Floats, other: Floats) -> float:
    """Earth mover's distance of two hue spectra on the circle, degrees; nan where one is empty."""
    return circular_emd(one, other)


def mean_labs(sums: Floats) -> Floats:
    """`(n, 3)` CIELAB of the mean linear colour of a kind's pixels."""
    return linear_srgb_to_lab(sums[:, LIGHT] / sums[:, PIXELS, None])


def lab_spreads(sums: Floats) -> Floats:
    """`(n, 3)` standard deviation of L*, a* and b* over a kind's pixels."""
    mean = sums[:, LAB] / sums[:, PIXELS, None]
    return np.sqrt(np.maximum(sums[:, SQUARES] / sums[:, PIXELS, None] - mean**2, 0.0))


def class_shares(sums: Floats) -> Floats:
    """`(n, 8)` share of each class in all pixels (Fig. 10); nan for a class that nobody labelled.

    Where pixels have no label and none has a class's, nobody says that there is none of it.
    """
    counts, unlabelled = sums[:, :CLASSES], sums[:, CLASSES]
    shares = counts / sums.sum(axis=1)[:, None]
    return np.where((counts == 0.0) & (unlabelled > 0.0)[:, None], np.nan, shares)


def share_correlation(one: Floats, other: Floats) -> float:
    """Correlation of class shares `(8,)` over the classes that both know; nan of fewer than three."""
    known = np.isfinite(one) & np.isfinite(other)
    return correlation(one[known], other[known]) if np.count_nonzero(known) >= 3 else float("nan")


def place_maps(sums: Floats, organ_class: int) -> Floats:
    """`(n, rows, columns)` where a class lies: over the greatest value, as Fig. 11; nan if it is nowhere."""
    maps = sums.reshape(len(sums), CLASSES, *CELLS)[:, organ_class]
    greatest = maps.max(axis=(1, 2), keepdims=True)
    return maps / np.where(greatest > 0.0, greatest, np.nan)


def structure(one: Floats, other: Floats) -> float:
    """Structural similarity of two images in [0, 1]: unlike the correlation it sees levels, place by place.

    Wang et al. 2004, "Image quality assessment" (IEEE Trans. Image Process. 13:600), with their Gaussian
    window of 1.5 cells, by scikit-image.
    """
    from skimage.metrics import structural_similarity

    return float(
        structural_similarity(
            one, other, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
    )


def intensity_maps(sums: Floats) -> Floats:
    """`(n, rows, columns)` mean intensity image (Fig. 13), in [0, 1] of the greatest grey value."""
    return sums[:, :-2].reshape(len(sums), *CELLS) / (255.0 * sums[:, -1, None, None])


def mean_greys(sums: Floats) -> Floats:
    """`(n,)` mean grey value of the pictures, 0 to 255."""
    return np.asarray(sums[:, -2] / sums[:, -1])


def falloff(image: Floats) -> Floats:
    """`(12,)` mean of an intensity image in rings around its middle."""
    return centre_falloff(image, _RINGS)

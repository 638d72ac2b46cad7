"""Measures of one set and similarities of two, computed from their sums.

Each function takes sums `(n, ...)`, the plain ones first and then those of the bootstrap replicates
(`bootstrap.BootstrapSums.totals`), with the columns of `measure`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from pepperscene.colour.comparison.bootstrap import Estimate, Floats, estimate_values
from pepperscene.colour.comparison.measure import (
    CELLS,
    CLASSES,
    HUES,
    IMAGES,
    LAB,
    LAB_SQUARED,
    LINEAR,
    PIXELS,
)
from pepperscene.colour.statistics import bin_angles, circular_mean, circular_sd, linear_srgb_to_lab
from pepperscene.truth import HUE_BINS, centre_falloff, hue_spectrum_correlation

_ANGLES: Final = bin_angles(HUE_BINS)
_RINGS: Final = np.linspace(0.0, 1.0, 13)
"""Chosen: twelve rings, each two cells wide."""


def pairwise(
    measure: Callable[[Floats, Floats], float], first: Floats, second: Floats, *, resampled: bool = True
) -> Floats:
    """`(n,)` measure of each pair of rows of two arrays `(n, ...)`; nan where a row is not finite.

    Without `resampled`, only the first rows are measured, and not the replicates.
    """
    if not resampled:
        first, second = first[:1], second[:1]
    return np.array(
        [
            measure(p, q) if np.isfinite(p).all() and np.isfinite(q).all() else np.nan
            for p, q in zip(first, second, strict=True)
        ]
    )


def estimate_pair(
    measure: Callable[[Floats, Floats], float],
    rows: list[Floats],
    resampled: bool,
    why: str = "it is not defined",
) -> Estimate:
    """Estimate a measure of two sets from their rows, the plain ones first; see `estimate_values`."""
    return estimate_values(pairwise(measure, *rows, resampled=resampled), resampled, why)


def hue_spectra(sums: Floats) -> Floats:
    """`(n, 180)` percentage of a kind's pixels at each hue, averaged over images (Fig. 12)."""
    return 100.0 * sums[:, HUES][:, :HUE_BINS] / sums[:, IMAGES, None]


def grey_fractions(sums: Floats) -> Floats:
    """`(n,)` fraction of a kind's pixels that are grey, averaged over images."""
    return np.asarray(sums[:, HUES][:, HUE_BINS] / sums[:, IMAGES])


def mean_hues(spectra: Floats) -> Floats:
    """`(n,)` mean direction of hue spectra `(n, 180)`, degrees."""
    return np.array([circular_mean(_ANGLES, spectrum) for spectrum in spectra])


def hue_spreads(spectra: Floats) -> Floats:
    """`(n,)` circular standard deviation of hue spectra, degrees; nan if they have no direction."""
    spreads = np.array([circular_sd(_ANGLES, spectrum) for spectrum in spectra])
    # For a single hue the logarithm gives minus zero.
    return np.where(np.isfinite(spreads), np.abs(spreads), np.nan)


def mean_labs(sums: Floats) -> Floats:
    """`(n, 3)` CIELAB of the mean linear colour of a kind's pixels."""
    return linear_srgb_to_lab(sums[:, LINEAR] / sums[:, PIXELS, None])


def lab_spreads(sums: Floats) -> Floats:
    """`(n, 3)` standard deviation of L*, a* and b* over a kind's pixels."""
    mean = sums[:, LAB] / sums[:, PIXELS, None]
    return np.sqrt(np.maximum(sums[:, LAB_SQUARED] / sums[:, PIXELS, None] - mean**2, 0.0))


def class_fractions(sums: Floats) -> Floats:
    """`(n, 8)` fraction of each class in all pixels (Fig. 10); nan for a class that was not labelled.

    A class without labelled pixels is absent only if no pixel is unlabelled.
    """
    counts, unlabelled = sums[:, :CLASSES], sums[:, CLASSES]
    fractions = counts / sums.sum(axis=1)[:, None]
    return np.where((counts == 0.0) & (unlabelled > 0.0)[:, None], np.nan, fractions)


def mean_masks(sums: Floats, organ_class: int) -> Floats:
    """`(n, rows, columns)` mean mask of a class over its maximum, as in Fig. 11; nan without pixels."""
    masks = sums.reshape(len(sums), CLASSES, *CELLS)[:, organ_class]
    maxima = masks.max(axis=(1, 2), keepdims=True)
    return masks / np.where(maxima > 0.0, maxima, np.nan)


def mean_images(sums: Floats) -> Floats:
    """`(n, rows, columns)` mean intensity image (Fig. 13), in [0, 1] of the greatest grey value."""
    return sums[:, :-2].reshape(len(sums), *CELLS) / (255.0 * sums[:, -1, None, None])


def mean_greys(sums: Floats) -> Floats:
    """`(n,)` mean grey value of the images, 0 to 255."""
    return np.asarray(sums[:, -2] / sums[:, -1])


def radial_falloffs(images: Floats) -> Floats:
    """`(n, 12)` mean of intensity images `(n, rows, columns)` in rings around their centre."""
    return np.array([centre_falloff(image, _RINGS) for image in images])


def correlation(first: Floats, second: Floats) -> float:
    """Pearson correlation of two arrays of one shape; nan if one is constant."""
    return hue_spectrum_correlation(first.ravel(), second.ravel())


def class_fraction_correlation(first: Floats, second: Floats) -> float:
    """Correlation of class fractions `(8,)` over the classes known in both; nan with fewer than three."""
    known = np.isfinite(first) & np.isfinite(second)
    return correlation(first[known], second[known]) if np.count_nonzero(known) >= 3 else float("nan")


def ssim(first: Floats, second: Floats) -> float:
    """Structural similarity of two images in [0, 1]: unlike the correlation it compares local levels.

    Wang et al. 2004, "Image quality assessment" (IEEE Trans. Image Process. 13:600), with their Gaussian
    window of 1.5 cells, by scikit-image.
    """
    from skimage.metrics import structural_similarity

    return float(
        structural_similarity(
            first, second, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
    )

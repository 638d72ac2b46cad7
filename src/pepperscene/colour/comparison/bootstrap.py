"""Confidence intervals of measures of image sets, by the Bayesian bootstrap.

Rubin 1981, "The Bayesian bootstrap", Ann. Stat. 9:130: the weights of an image are drawn from the
exponential distribution of mean 1. Unlike resampling with replacement it never loses a kind that few images
show, and it sums image by image, so that memory does not grow with the set.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

REPLICATES: Final = 200
"""Chosen: the ends of a 95 % interval are five replicates inside, known to 1 % of probability."""

LEVEL: Final = 0.95

_BATCH: Final = 16  # chosen: vectors that are added by one matrix product


def bootstrap_weights(content: bytes) -> Floats:
    """`(1 + REPLICATES,)` weights of an image: 1 for the plain sum, then its weight in each replicate.

    The content of the image seeds them, so that neither its name nor its position in the set matters, and a
    image that is in both sets has the same weights in both.
    """
    words = np.frombuffer(hashlib.sha256(content).digest(), np.uint32)
    weights = np.random.default_rng(words.tolist()).standard_exponential(REPLICATES)
    return np.concatenate([[1.0], weights])


class BootstrapSums:
    """Sums of vectors `(width,)`, plain and in all replicates.

    Attributes:
        width: length of a vector.
        count: number of vectors added.
    """

    def __init__(self, width: int) -> None:
        self.width, self.count = width, 0
        self._sums = np.zeros((1 + REPLICATES, width))
        self._pending: list[tuple[Floats, Floats]] = []

    def add(self, values: ArrayLike, weights: Floats) -> None:
        """Add a vector `(width,)` with the weights of its image."""
        vector = np.asarray(values, float)
        if vector.shape != (self.width,):
            raise ValueError(f"a vector must be ({self.width},), not {vector.shape}")
        self._pending.append((vector, weights))
        self.count += 1
        if len(self._pending) == _BATCH:
            self._add_pending()

    def totals(self) -> Floats:
        """`(1 + REPLICATES, width)`: the plain sums, then those of the replicates."""
        self._add_pending()
        return self._sums

    def _add_pending(self) -> None:
        if self._pending:
            vectors, weights = (np.stack(column) for column in zip(*self._pending, strict=True))
            self._sums += weights.T @ vectors
            self._pending.clear()


@dataclass(frozen=True)
class Estimate:
    """A measured number with its confidence interval.

    Attributes:
        value: None if unknown.
        low: lower end of its 95 % interval; None if unknown.
        high: upper end; of an angle it may be the smaller number, if the interval contains 0.
        why: the reason for a missing value, as a clause.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""


def unknown_estimate(why: str) -> Estimate:
    """An estimate without a value, for this reason."""
    return Estimate(None, why=why)


def estimate_values(values: Floats, resampled: bool, why: str = "it is not defined") -> Estimate:
    """Estimate a measure from its value and its replicates `(1 + n,)`, or say why it is not finite.

    It has an interval if `resampled`; replicates of a single image carry no information.
    """
    if not np.isfinite(values[0]):
        return unknown_estimate(why)
    interval = confidence_interval(values) if resampled else None
    return Estimate(float(values[0]), *(interval or (None, None)))


def estimate_angles(values: Floats, resampled: bool, why: str) -> Estimate:
    """As `estimate_values`, for angles in degrees: the interval is that of the deviations from the value."""
    deviation = estimate_values((values - values[0] + 180.0) % 360.0 - 180.0, resampled, why)
    if deviation.value is None:
        return deviation
    if deviation.low is None or deviation.high is None:
        return Estimate(float(values[0]))
    return Estimate(
        float(values[0]), (values[0] + deviation.low) % 360.0, (values[0] + deviation.high) % 360.0
    )


def confidence_interval(values: Floats) -> tuple[float, float] | None:
    """95 % interval of a measure; it always contains the measure itself.

    The bias-corrected percentile interval (Efron 1981, "Nonparametric standard errors and confidence
    intervals", Can. J. Stat. 9:139): distances grow and correlations shrink when images are weighted
    unevenly, which shifts all replicates to one side.

    Returns:
        Lower and upper end, from the measure and its replicates `(1 + n,)`; None if the measure or more than
        one in ten of its replicates is not finite.
    """
    from scipy.special import ndtr, ndtri

    value, replicates = values[0], values[1:]
    finite = replicates[np.isfinite(replicates)]
    if not np.isfinite(value) or finite.size < 0.9 * replicates.size:
        return None
    # How far the measure is from the replicates' median shifts both percentiles by twice that deviate.
    below = np.count_nonzero(finite < value) + np.count_nonzero(finite == value) / 2.0
    bias = ndtri(np.clip(below / finite.size, 0.5 / finite.size, 1.0 - 0.5 / finite.size))
    probabilities = ndtr(2.0 * bias + ndtri(np.array([0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0])))
    low, high = np.quantile(finite, probabilities)
    return float(min(low, value)), float(max(high, value))

"""One random parameter: its distribution, moments and quantiles."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Final, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document

FloatArray = NDArray[np.float64]


class Origin(Document):
    """Origin of a number: a `source`, or `chosen` with the reason; one of them is required."""

    source: str = ""
    chosen: str = ""
    as_printed: str = ""
    used: str = ""

    @model_validator(mode="after")
    def _require_origin(self) -> Self:
        if not (self.source.strip() or self.chosen.strip()):
            raise ValueError("needs a source, or chosen with the reason")
        return self


def truncated_moments(mean: float, sd: float, low: float, high: float) -> tuple[float, float]:
    """Mean and standard deviation of a normal distribution truncated to [low, high].

    Johnson, Kotz & Balakrishnan 1994, Continuous Univariate Distributions 1, section 13.10.

    Raises:
        ValueError: the probability between the bounds is zero in floating point.
    """
    # Not scipy.stats.truncnorm: 0.36 ms instead of 0.9 us, and other last bits for 187 of 300 random bounds,
    # which would change every plant.
    a, b = (low - mean) / sd, (high - mean) / sd
    density = [math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi) for x in (a, b)]
    # Count the upper tail from above, since its probability would be lost in rounding.
    side = -1.0 if a > 0 else 1.0
    mass = 0.5 * side * (math.erfc(-side * b / math.sqrt(2.0)) - math.erfc(-side * a / math.sqrt(2.0)))
    if not mass > 0:
        raise ValueError("the distribution has no probability between its bounds")
    shift = (density[0] - density[1]) / mass
    variance = 1.0 + (a * density[0] - b * density[1]) / mass - shift * shift
    return mean + sd * shift, sd * math.sqrt(max(variance, 0.0))


@lru_cache(maxsize=4096)  # chosen: a cultivar has some hundred, and several cultivars share most
def parent_normal(mean: float, sd: float, low: float, high: float) -> tuple[float, float]:
    """Mean and sd of the normal distribution that has `mean` and `sd` when truncated to [low, high].

    Newton's method on both moments, with a numerical Jacobian.

    Raises:
        ValueError: there is no such distribution.
    """
    solution = np.array([mean, math.log(sd)])

    def residuals(parent: FloatArray) -> FloatArray:
        moments = truncated_moments(float(parent[0]), math.exp(float(parent[1])), low, high)
        return np.array([moments[0] - mean, moments[1] - sd]) / sd

    for _ in range(60):
        # Far from the solution numbers may overflow or underflow; then there is none.
        with np.errstate(all="ignore"):
            try:
                error = residuals(solution)
                if np.abs(error).max() < 1e-10:
                    return float(solution[0]), math.exp(float(solution[1]))
                steps = np.array([1e-6 * sd, 1e-6])
                jacobian = np.column_stack(
                    [(residuals(solution + np.eye(2)[k] * steps[k]) - error) / steps[k] for k in (0, 1)]
                )
                move = np.linalg.solve(jacobian, -error)
            except (ValueError, np.linalg.LinAlgError):
                break
        if not np.isfinite(move).all():
            break
        # Limit the step: far from the solution the moments hardly depend on the parent.
        solution = solution + move * min(1.0, 0.5 / max(abs(move[0]) / sd, abs(move[1]), 1e-12))
        if abs(solution[0] - mean) > 30 * sd or abs(solution[1] - math.log(sd)) > 3:
            break
    raise ValueError("no normal distribution has this mean and sd between its bounds; change low, high or sd")


Bin = tuple[float, float, float]

DEFAULT_BOUND_SD: Final = 3.0
"""Standard deviations from the mean at which a normal distribution is truncated if the file has no bounds."""
_LOWEST_POSITION: Final = 0.0025  # centre of the lowest of 200 stem parts, the maximum number


class Distribution(Origin):
    """One random parameter, in metres, radians or a plain number.

    Attributes:
        family: family of the distribution: "value" (constant), "normal" (truncated), "uniform", "histogram"
            (uniform within each bin), "curve" (a mean that follows the position along the stem, with a
            truncated normal distribution about it) or "blend" (interpolated between two others).
        mean: of the drawn values: for "normal" that of the truncated distribution, as is `sd`, so that a
            measured mean and standard deviation are reproduced whatever the bounds; for "curve" the mean
            along the stem.
        sd: standard deviation of the drawn values; for "curve" at any one position.
        low: smallest possible value.
        high: largest possible value.
        bins: (from, to, probability) of a histogram, ascending.
        along: (position, mean) of a curve, ascending; 0 is the foot of the stem and 1 its top.
        with_height: rank correlation with the position along the stem, -1 to 1; all values together still
            follow the stated distribution.
        between: (fraction, first, last) of a blend, whose quantiles are interpolated linearly.
    """

    family: Literal["value", "normal", "uniform", "histogram", "curve", "blend"]
    mean: float
    sd: float
    low: float
    high: float
    bins: tuple[Bin, ...] = ()
    along: tuple[tuple[float, float], ...] = ()
    with_height: Annotated[float, Field(gt=-1.0, lt=1.0)] = 0.0
    between: tuple[float, Distribution, Distribution] | None = None

    @property
    def follows_height(self) -> bool:
        """Whether values depend on the position along the stem."""
        parts = () if self.between is None else self.between[1:]
        return self.needs_position or self.with_height != 0.0 or any(part.follows_height for part in parts)

    @property
    def needs_position(self) -> bool:
        """Whether values are undefined without a position: a curve, or a blend with one."""
        parts = () if self.between is None else self.between[1:]
        return self.family == "curve" or any(part.needs_position for part in parts)

    def draw(self, rng: np.random.Generator, size: int | tuple[int, ...] = ()) -> FloatArray:
        """Draw independent values in metres, radians or a plain number, an array of this shape."""
        return self.quantiles(rng.random(size))

    def quantiles(self, probabilities: ArrayLike, positions: ArrayLike | None = None) -> FloatArray:
        """Quantile function, the inverse of the cumulative distribution function.

        Args:
            probabilities: in [0, 1], of any shape.
            positions: along the stem, of a shape that broadcasts with the probabilities: 0 at the foot and 1
                at the top, or where the growing top begins. With `with_height`, the values of n organs at the
                positions (i + 1/2) / n together follow the stated distribution. None ignores the position.

        Raises:
            ValueError: a curve without positions.
        """
        probability = np.asarray(probabilities, dtype=float)
        position = None if positions is None else np.asarray(positions, dtype=float)
        if self.with_height and position is not None:
            probability = _correlate_with_height(probability, position, self.with_height)
        # Rounding may exceed the bounds.
        return np.asarray(np.clip(self._quantiles(probability, position), self.low, self.high))

    def _quantiles(self, probability: FloatArray, position: FloatArray | None) -> FloatArray | np.float64:
        if self.between is not None:
            fraction, first, last = self.between
            values = first.quantiles(probability, position)
            return values + fraction * (last.quantiles(probability, position) - values)
        if self.family == "histogram":
            starts, lows, highs, weights = _cumulative_bins(self.bins)
            index = np.searchsorted(starts, probability, side="right") - 1
            bin_fraction = np.minimum((probability - starts[index]) / weights[index], 1.0)
            return lows[index] + bin_fraction * (highs[index] - lows[index])
        if self.family == "curve":
            if position is None:
                raise ValueError("a curve along the stem needs positions")
            positions, means = np.array(self.along).T
            standard = _truncated_normal(0.0, 1.0, -DEFAULT_BOUND_SD, DEFAULT_BOUND_SD)
            deviation = _truncated_normal_quantiles(probability, *standard)
            return np.interp(position, positions, means) + self.sd * deviation
        if self.family == "normal" and self.sd > 0:
            parent = _truncated_normal(self.mean, self.sd, self.low, self.high)
            return _truncated_normal_quantiles(probability, *parent)
        return self.low + probability * (self.high - self.low)


# Cached by value, so that a changed copy of a distribution does not get the result of the original.
@lru_cache(maxsize=4096)
def _truncated_normal(mean: float, sd: float, low: float, high: float) -> tuple[float, float, float, float]:
    """Mean and sd of the parent normal distribution, and its distribution function at both bounds."""
    parent_mean, parent_sd = parent_normal(mean, sd, low, high)
    scaled = ((bound - parent_mean) / parent_sd for bound in (low, high))
    cdf_low, cdf_high = (0.5 * math.erfc(-z / math.sqrt(2.0)) for z in scaled)
    return parent_mean, parent_sd, cdf_low, cdf_high


@lru_cache(maxsize=1024)
def _cumulative_bins(bins: tuple[Bin, ...]) -> tuple[FloatArray, ...]:
    """Cumulative probability at the start, ends and probability of a histogram's non-empty bins."""
    lows, highs, weights = np.array([row for row in bins if row[2] > 0]).T
    return np.concatenate(([0.0], np.cumsum(weights)[:-1])), lows, highs, weights


def _truncated_normal_quantiles(
    probability: FloatArray, mean: float, sd: float, cdf_low: float, cdf_high: float
) -> FloatArray:
    # scipy.stats.truncnorm.ppf takes 16 times as long and differs in the last bits of 42 % of the values.
    from scipy.special import ndtri

    scaled = np.clip(cdf_low + probability * (cdf_high - cdf_low), 1e-300, 1.0 - 1e-16)
    return np.asarray(mean + sd * ndtri(scaled))


def _correlate_with_height(probability: FloatArray, position: FloatArray, correlation: float) -> FloatArray:
    """Correlate probabilities with positions by a Gaussian copula; over all positions they stay uniform."""
    from scipy.special import ndtr, ndtri

    height = ndtri(np.clip(position, _LOWEST_POSITION, 1.0 - _LOWEST_POSITION))
    independent = ndtri(np.clip(probability, 1e-300, 1.0 - 1e-16))
    # The rank correlation of two normal variables is 6 / pi arcsin(r / 2) (Kruskal 1958, JASA 53:814).
    r = 2.0 * math.sin(math.pi * correlation / 6.0)
    return np.asarray(ndtr(r * height + math.sqrt(1.0 - r * r) * independent))

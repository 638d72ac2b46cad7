"""One random parameter: its law, its moments, and values drawn from it."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Final, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document


class Origin(Document):
    """Where a number comes from: a `source`, or `chosen` and why; one of them must be there."""

    source: str = ""
    chosen: str = ""
    as_printed: str = ""
    used: str = ""

    @model_validator(mode="after")
    def _has_origin(self) -> Self:
        if not (self.source.strip() or self.chosen.strip()):
            raise ValueError("needs a source, or chosen and why")
        return self


def truncated_moments(mean: float, sd: float, low: float, high: float) -> tuple[float, float]:
    """Mean and standard deviation of a normal law cut to [low, high].

    Johnson, Kotz & Balakrishnan 1994, Continuous Univariate Distributions 1, section 13.10.

    Raises:
        ValueError: the law has no probability between the bounds that floating point could tell from zero.
    """
    a, b = (low - mean) / sd, (high - mean) / sd
    density = [math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi) for x in (a, b)]
    # The upper tail is counted from above, or its probability would be lost in rounding.
    side = -1.0 if a > 0 else 1.0
    mass = 0.5 * side * (math.erfc(-side * b / math.sqrt(2.0)) - math.erfc(-side * a / math.sqrt(2.0)))
    if not mass > 0:
        raise ValueError("the law has no probability between its bounds")
    shift = (density[0] - density[1]) / mass
    spread = 1.0 + (a * density[0] - b * density[1]) / mass - shift * shift
    return mean + sd * shift, sd * math.sqrt(max(spread, 0.0))


def untruncated(mean: float, sd: float, low: float, high: float) -> tuple[float, float]:
    """Mean and standard deviation of the normal law that has `mean` and `sd` once cut to [low, high].

    Newton's method on both moments, with a numerical Jacobian.

    Raises:
        ValueError: no normal law has them.
    """
    found = np.array([mean, math.log(sd)])

    def missing(at: NDArray[np.float64]) -> NDArray[np.float64]:
        got = truncated_moments(float(at[0]), math.exp(float(at[1])), low, high)
        return np.array([got[0] - mean, got[1] - sd]) / sd

    for _ in range(60):
        # Far from the answer numbers may over- or underflow; then there is none.
        with np.errstate(all="ignore"):
            try:
                off = missing(found)
                if np.abs(off).max() < 1e-10:
                    return float(found[0]), math.exp(float(found[1]))
                steps = np.array([1e-6 * sd, 1e-6])
                jacobian = np.column_stack(
                    [(missing(found + np.eye(2)[k] * steps[k]) - off) / steps[k] for k in (0, 1)]
                )
                move = np.linalg.solve(jacobian, -off)
            except (ValueError, np.linalg.LinAlgError):
                break
        if not np.isfinite(move).all():
            break
        # Short steps: far from the answer the cut law hardly depends on its parent.
        found = found + move * min(1.0, 0.5 / max(abs(move[0]) / sd, abs(move[1]), 1e-12))
        if abs(found[0] - mean) > 30 * sd or abs(found[1] - math.log(sd)) > 3:
            break
    raise ValueError("no normal distribution has this mean and sd between its bounds; move low, high or sd")


Law = Literal["value", "normal", "uniform", "histogram", "curve", "blend"]
Bin = tuple[float, float, float]
FloatArray = NDArray[np.float64]

REACH: Final = 3.0
"""Standard deviations to either side at which a normal law is cut where its file states no bounds."""
_LOWEST_PLACE: Final = 0.0025  # the middle of the lowest of 200 stem parts, the most that a stem can have


class Distribution(Origin):
    """One random parameter, in metres, radians or a plain number.

    Attributes:
        law: "value" (fixed), "normal" (truncated), "uniform", "histogram" (uniform within each bin), "curve"
            (a mean that follows the place along the stem, and a truncated normal law about it) or "blend" (a
            law between two others).
        mean: of the drawn values: for a normal law that of the truncated distribution, as is `sd`, so that a
            measured mean and standard deviation come back whatever the bounds cut off; along a curve, of its
            mean from foot to top.
        sd: standard deviation of the drawn values; of a curve, at any one place.
        low: smallest value that can be drawn.
        high: largest value that can be drawn.
        bins: (from, to, probability) of a histogram, ascending.
        along: (place, mean) of a curve, ascending; 0 is the foot of the stem and 1 its top.
        with_height: rank correlation with the place along the stem, -1 to 1: the law of all values together
            stays the stated one.
        between: (share, first law, last law) of a blend, whose quantiles are mixed linearly.
    """

    law: Law
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
        """Whether values depend on the place along the stem."""
        below = () if self.between is None else self.between[1:]
        return self.needs_place or self.with_height != 0.0 or any(law.follows_height for law in below)

    @property
    def needs_place(self) -> bool:
        """Whether there are no values without a place: a curve, or a blend with one."""
        below = () if self.between is None else self.between[1:]
        return self.law == "curve" or any(law.needs_place for law in below)

    @overload
    def draw(self, rng: np.random.Generator) -> float: ...
    @overload
    def draw(self, rng: np.random.Generator, size: int | tuple[int, ...]) -> FloatArray: ...
    def draw(self, rng: np.random.Generator, size: int | tuple[int, ...] | None = None) -> float | FloatArray:
        """Independent values in metres, radians or a plain number; a float when `size` is None."""
        values = self.quantiles(rng.random(size))
        return float(values) if size is None else values

    def quantiles(self, shares: ArrayLike, places: ArrayLike | None = None) -> FloatArray:
        """The values that shares in [0, 1] of all draws lie below: the inverse distribution function.

        Args:
            shares: of any shape.
            places: along the stem, of a shape that broadcasts with the shares: 0 at the foot and 1 at the
                top, or where the still growing top begins. The law of `with_height` as a whole is the stated
                one if the places of n organs are (i + 1/2) / n. None for the law as a whole.

        Raises:
            ValueError: a curve without places.
        """
        share = np.asarray(shares, dtype=float)
        place = None if places is None else np.asarray(places, dtype=float)
        if self.with_height and place is not None:
            share = _tied(share, place, self.with_height)
        return np.asarray(np.clip(self._unbounded(share, place), self.low, self.high))

    def _unbounded(self, share: FloatArray, place: FloatArray | None) -> FloatArray | np.float64:
        """Quantiles that rounding may have put beyond the bounds."""
        if self.between is not None:
            weight, first, last = self.between
            values = first.quantiles(share, place)
            return values + weight * (last.quantiles(share, place) - values)
        if self.law == "histogram":
            starts, lows, highs, weights = _ladder(self.bins)
            step = np.searchsorted(starts, share, side="right") - 1
            inside = np.minimum((share - starts[step]) / weights[step], 1.0)
            return lows[step] + inside * (highs[step] - lows[step])
        if self.law == "curve":
            if place is None:
                raise ValueError("a curve along the stem has no values without places")
            places, means = np.array(self.along).T
            return np.interp(place, places, means) + self.sd * _cut_normal(share, *_STANDARD_CUT)
        if self.law == "normal" and self.sd > 0:
            return _cut_normal(share, *_parent(self.mean, self.sd, self.low, self.high))
        return self.low + share * (self.high - self.low)


# Both are kept beside the laws, so that a changed copy of a law cannot keep what was another's.
@lru_cache(maxsize=4096)
def _parent(mean: float, sd: float, low: float, high: float) -> tuple[float, float, float, float]:
    """Mean and sd of a normal law before truncation, and its distribution function at both bounds."""
    parent_mean, parent_sd = untruncated(mean, sd, low, high)
    below, above = (_cumulated((bound - parent_mean) / parent_sd) for bound in (low, high))
    return parent_mean, parent_sd, below, above


@lru_cache(maxsize=1024)
def _ladder(bins: tuple[Bin, ...]) -> tuple[FloatArray, ...]:
    """Of a histogram's bins that can occur: cumulated probability at the start, ends, probability."""
    lows, highs, weights = np.array([row for row in bins if row[2] > 0]).T
    return np.concatenate(([0.0], np.cumsum(weights)[:-1])), lows, highs, weights


def _cumulated(z: float) -> float:
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


def _cut_normal(share: FloatArray, mean: float, sd: float, below: float, above: float) -> FloatArray:
    """Quantiles of a normal law of which only the shares from `below` to `above` are left."""
    from scipy.special import ndtri

    within = np.clip(below + share * (above - below), 1e-300, 1.0 - 1e-16)
    return np.asarray(mean + sd * ndtri(within))


_STANDARD_SD: Final = untruncated(0.0, 1.0, -REACH, REACH)[1]
_STANDARD_CUT: Final = (
    0.0,
    _STANDARD_SD,
    _cumulated(-REACH / _STANDARD_SD),
    _cumulated(REACH / _STANDARD_SD),
)
"""The normal law that has mean 0 and sd 1 once it is cut, as `_cut_normal` takes it."""


def _tied(share: FloatArray, place: FloatArray, correlation: float) -> FloatArray:
    """Shares that depend on the place by a Gaussian copula, and are uniform over all places together."""
    from scipy.special import ndtr, ndtri

    height = ndtri(np.clip(place, _LOWEST_PLACE, 1.0 - _LOWEST_PLACE))
    own = ndtri(np.clip(share, 1e-300, 1.0 - 1e-16))
    # The rank correlation of two normal variables is 6 / pi arcsin(r / 2) (Kruskal 1958, JASA 53:814).
    r = 2.0 * math.sin(math.pi * correlation / 6.0)
    return np.asarray(ndtr(r * height + math.sqrt(1.0 - r * r) * own))

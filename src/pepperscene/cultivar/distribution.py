"""One random parameter: its law, its moments, and values drawn from it."""

from __future__ import annotations

from functools import cached_property
from statistics import NormalDist
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.cultivar.origin import Origin
from pepperscene.cultivar.truncated import untruncated

Law = Literal["value", "normal", "uniform", "histogram"]
Bin = tuple[float, float, float]


class Distribution(Origin):
    """One random parameter, in metres, radians or a plain number.

    Attributes:
        law: "value" (fixed), "normal" (truncated), "uniform" or "histogram" (uniform within each bin).
        mean: of the drawn values: for a normal law that of the truncated distribution, as is `sd`, so that a
            measured mean and standard deviation come back whatever the bounds cut off.
        sd: standard deviation of the drawn values.
        low: smallest value that can be drawn.
        high: largest value that can be drawn.
        bins: (from, to, probability) of a histogram, ascending.
    """

    law: Law
    mean: float
    sd: float
    low: float
    high: float
    bins: tuple[Bin, ...] = ()

    @overload
    def draw(self, rng: np.random.Generator) -> float: ...
    @overload
    def draw(self, rng: np.random.Generator, size: int | tuple[int, ...]) -> NDArray[np.float64]: ...
    def draw(
        self, rng: np.random.Generator, size: int | tuple[int, ...] | None = None
    ) -> float | NDArray[np.float64]:
        """Independent values in metres, radians or a plain number; a float when `size` is None."""
        if size is None:
            return self.quantile(rng.random())
        return self.quantiles(rng.random(size))

    def quantile(self, share: float) -> float:
        """The value that a share in [0, 1] of all draws lies below (the inverse distribution function)."""
        if self.law == "histogram":
            starts, lows, highs, weights = self._ladder
            step = int(np.searchsorted(starts, share, side="right")) - 1
            inside = (share - starts[step]) / weights[step]
            return float(lows[step] + min(inside, 1.0) * (highs[step] - lows[step]))
        if self.law == "normal" and self.sd > 0:
            normal, below, above = self._parent
            within = min(max(below + share * (above - below), 1e-300), 1.0 - 1e-16)
            return min(max(normal.inv_cdf(within), self.low), self.high)
        return self.low + share * (self.high - self.low)

    def quantiles(self, shares: ArrayLike) -> NDArray[np.float64]:
        """`quantile` of an array of any shape."""
        given = np.asarray(shares, dtype=float)
        return np.array([self.quantile(float(share)) for share in given.ravel()]).reshape(given.shape)

    @cached_property
    def _parent(self) -> tuple[NormalDist, float, float]:
        """The normal law before truncation, and its distribution function at both bounds."""
        normal = NormalDist(*untruncated(self.mean, self.sd, self.low, self.high))
        return normal, normal.cdf(self.low), normal.cdf(self.high)

    @cached_property
    def _ladder(self) -> tuple[NDArray[np.float64], ...]:
        """Of the bins that can occur: cumulated probability at the start, ends, probability."""
        taken = [row for row in self.bins if row[2] > 0]
        lows, highs, weights = (np.array(column) for column in zip(*taken, strict=True))
        return np.concatenate(([0.0], np.cumsum(weights)[:-1])), lows, highs, weights

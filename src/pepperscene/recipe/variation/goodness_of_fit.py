"""Comparison of drawn values with the distributions that they are drawn from."""

from __future__ import annotations

import datetime
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.recipe.plan import Plan, moments
from pepperscene.recipe.variation.varied import Level, Varied, VariedChoice, VariedInTurn, VariedNumber

FEWEST_DRAWS: Final = 20  # chosen: with fewer, hardly any wrong distribution differs from the right one
_LEAST_EXPECTED: Final = 5.0
"""Of draws in a cell of a chi-squared test (Cochran 1954, Biometrics 10:417)."""
_MOST_CELLS: Final = 50  # chosen: of integers and dates; more cells find a wrong distribution less often


def draw_numbers(per: Level, plan: Plan, indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the set, scene or moment of frames `(n,)`; each of these has one draw."""
    scene_frames = {"set": plan.rotations * plan.scene_frames, "scene": plan.scene_frames}
    return indices // scene_frames[per] if per in scene_frames else moments(plan, indices)


def as_number(varied: Varied, value: Any) -> float:
    """A drawn value in JSON as a number: dates in days, outcomes by position; nan if not valid."""
    if isinstance(varied, VariedChoice | VariedInTurn):
        try:
            return float(varied.positions.get(value, np.nan))
        except TypeError:  # a list or table, which is no outcome
            return np.nan
    if isinstance(value, str):
        try:
            return float(datetime.date.fromisoformat(value).toordinal())
        except ValueError:
            return np.nan
    return float(value) if type(value) in (int, float) else np.nan


def distinct_draws(
    varied: Varied, plan: Plan, indices: ArrayLike, numbers: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The known draws among the values `(n,)` of frames: one for each set, scene or moment."""
    known = np.isfinite(numbers)
    units = draw_numbers(varied.per, plan, np.asarray(indices, np.int64)[known])
    first: NDArray[np.float64] = numbers[known][np.unique(units, return_index=True)[1]]
    return first


def goodness_of_fit(varied: Varied, draws: NDArray[np.float64]) -> float | None:
    """The p-value of draws under their distribution.

    By the Kolmogorov-Smirnov test for numbers, and a chi-squared test for integers, dates and choices.

    Args:
        varied: the distribution.
        draws: `(n,)` finite, one for each set, scene or moment, as of `as_number`.

    Returns:
        The p-value; None for values in turn, constants and fewer than `FEWEST_DRAWS` draws.
    """
    if len(draws) < FEWEST_DRAWS or isinstance(varied, VariedInTurn):
        return None
    if isinstance(varied, VariedChoice):
        counts = np.bincount(draws.astype(np.int64), minlength=len(varied.outcomes))
        return _chi_squared(counts, np.array(varied.probabilities))
    assert isinstance(varied, VariedNumber)
    if varied.distribution.low == varied.distribution.high:
        return None
    if varied.kind == "number":
        from scipy.stats import ks_1samp

        return float(ks_1samp(draws, varied.cumulative).pvalue)
    edges = _cell_edges(varied, len(draws))
    counts = np.bincount(np.searchsorted(edges, draws), minlength=len(edges) + 1)
    return _chi_squared(counts, np.diff(varied.cumulative(edges), prepend=0.0, append=1.0))


def _cell_edges(varied: VariedNumber, count: int) -> NDArray[np.float64]:
    """Edges halfway between integers, of cells that are about equally probable."""
    cells = min(_MOST_CELLS, max(2, int(count / (2 * _LEAST_EXPECTED))))
    quantiles = varied.distribution.quantiles(np.arange(1, cells) / cells)
    numbers = np.exp(quantiles) if varied.logarithmic else quantiles
    return np.unique(np.floor(numbers) + 0.5)


def _chi_squared(counts: NDArray[np.int64], probabilities: NDArray[np.float64]) -> float | None:
    """The p-value of counts; rare cells are pooled. None if a single cell is left."""
    from scipy.stats import chi2

    possible = probabilities > 0
    if counts[~possible].any():
        return 0.0
    expected = counts.sum() * probabilities[possible] / probabilities.sum()
    order = np.argsort(expected)
    expected, counts = expected[order], counts[possible][order]
    # Pool the rarest cells into one that is expected to hold enough draws.
    pooled = int(np.searchsorted(expected, _LEAST_EXPECTED))
    while 0 < pooled < len(expected) and expected[:pooled].sum() < _LEAST_EXPECTED:
        pooled += 1
    if pooled:
        expected = np.concatenate(([expected[:pooled].sum()], expected[pooled:]))
        counts = np.concatenate(([counts[:pooled].sum()], counts[pooled:]))
    if len(expected) < 2:
        return None
    return float(chi2.sf(float(np.sum((counts - expected) ** 2 / expected)), len(expected) - 1))

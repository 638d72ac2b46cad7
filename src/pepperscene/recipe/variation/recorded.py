"""Varied values as `dataset.json` records them: drawn again for any frame, compared with distributions."""

from __future__ import annotations

import datetime
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.cultivar import Distribution
from pepperscene.errors import short_repr
from pepperscene.recipe.plan import FrameSpec, Plan, moments
from pepperscene.recipe.variation.varied import (
    LEVELS,
    Key,
    Kind,
    Level,
    Varied,
    VariedChoice,
    VariedInTurn,
    VariedNumber,
    as_json,
    draw_values,
    json_value,
)

_TOLERANCE: Final = 1e-9
"""Relative. Chosen: libraries of other machines differ in the last bits of logarithms and quantiles."""

_DISTRIBUTION: Final = ("family", "mean", "sd", "low", "high", "bins")
_FAMILIES: Final = ("value", "normal", "uniform", "histogram")
"""Those of values that do not depend on a position along a stem."""


def read_variation(recipe: Mapping[str, Any]) -> tuple[Varied, ...]:
    """The varied values in the recipe of a `dataset.json`.

    They draw the same values as those of the recipe itself, except that dates are text. Their `identity` is
    what was recorded.

    Raises:
        ValueError: the record is not valid.
    """
    recorded = recipe.get("variation", {})
    if not isinstance(recorded, Mapping):
        raise ValueError("variation must be an object")
    try:
        variation = tuple(_read_varied(str(name), identity) for name, identity in recorded.items())
        # Parameters can each be valid and still not make a distribution: drawing a value raises an error.
        for varied in variation:
            varied.describe()
            varied.value(0.5, 0)
    except (LookupError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"variation is not valid ({type(error).__name__}: {error})") from None
    return variation


def _read_varied(name: str, identity: Mapping[str, Any]) -> Varied:
    key: Key = tuple(int(part) if part.isdecimal() else part for part in name.split("."))
    per, draw = identity["per"], identity.get("draw", name)
    if per not in LEVELS:
        raise ValueError(f"{name}.per must be one of {', '.join(LEVELS)}, not {short_repr(per)}")
    if not isinstance(draw, str):
        raise ValueError(f"{name}.draw must be a name")
    if "in_turn" in identity:
        return VariedInTurn(key, per, draw, _not_empty(identity["in_turn"], name))
    is_reversed = identity.get("reversed", False)
    if "outcomes" in identity:
        pairs = _not_empty(identity["outcomes"], name)
        outcomes, probabilities = zip(*pairs, strict=True)
        weights = tuple(map(float, probabilities))
        return VariedChoice(key, per, draw, outcomes, weights, reversed=is_reversed)
    if identity["family"] not in _FAMILIES or identity["kind"] not in get_args(Kind):
        raise ValueError(f"{name} must have a known family and kind")
    parameters = {part: identity[part] for part in _DISTRIBUTION}
    distribution = Distribution(chosen="as recorded", **parameters)
    kind, is_logarithmic = identity["kind"], bool(identity["logarithmic"])
    return VariedNumber(key, per, draw, distribution, kind, is_logarithmic, reversed=is_reversed)


def _not_empty(values: Any, name: str) -> tuple[Any, ...]:
    if not isinstance(values, list) or not values:
        raise ValueError(f"{name} must have at least one value")
    return tuple(values)


def recorded_twins(recipe: Mapping[str, Any]) -> dict[str, list[Any]]:
    """The values of twins by dotted key in the recipe of a `dataset.json`."""
    twins = recipe.get("twins", {})
    return {str(key): list(values) for key, values in twins.items()} if isinstance(twins, Mapping) else {}


def recorded_draws(
    recipe: Mapping[str, Any], variation: tuple[Varied, ...], spec: FrameSpec
) -> dict[str, Any]:
    """What a frame's JSON must have under `drawn`, by the recipe of a `dataset.json` and its `variation`.

    Raises:
        LookupError: the record has too few values for twins.
    """
    twins = {dotted: json_value(values[spec.twin]) for dotted, values in recorded_twins(recipe).items()}
    return as_json(draw_values(variation, int(recipe["seed"]), spec)) | twins


def same_value(expected: Any, found: Any) -> bool:
    """Whether a drawn value in a frame's JSON is the expected one."""
    if isinstance(expected, float) and isinstance(found, float | int) and not isinstance(found, bool):
        return math.isclose(expected, found, rel_tol=_TOLERANCE, abs_tol=0.0)
    if isinstance(found, str) and os.path.isabs(found):
        # The record has names of files without their folders.
        return bool(expected in (found, Path(found).stem))
    return type(expected) is type(found) and bool(expected == found)


MIN_DRAWS: Final = 20  # chosen: with fewer, hardly any wrong distribution differs from the right one
_MIN_EXPECTED: Final = 5.0
"""Of draws in a cell of a chi-squared test (Cochran 1954, Biometrics 10:417)."""
_MAX_CELLS: Final = 50  # chosen: of integers and dates; more cells find a wrong distribution less often


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
        draws: `(n,)` finite, one for each set, scene or moment, as in `as_number`.

    Returns:
        The p-value; None for values in turn, constants and fewer than `MIN_DRAWS` draws.
    """
    if len(draws) < MIN_DRAWS or isinstance(varied, VariedInTurn):
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
    cells = min(_MAX_CELLS, max(2, int(count / (2 * _MIN_EXPECTED))))
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
    pooled = int(np.searchsorted(expected, _MIN_EXPECTED))
    while 0 < pooled < len(expected) and expected[:pooled].sum() < _MIN_EXPECTED:
        pooled += 1
    if pooled:
        expected = np.concatenate(([expected[:pooled].sum()], expected[pooled:]))
        counts = np.concatenate(([counts[:pooled].sum()], counts[pooled:]))
    if len(expected) < 2:
        return None
    return float(chi2.sf(float(np.sum((counts - expected) ** 2 / expected)), len(expected) - 1))

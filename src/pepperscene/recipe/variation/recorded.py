"""Varied values as `dataset.json` records them: read from there, and drawn again for any frame."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, get_args

from pepperscene.cultivar import Distribution
from pepperscene.errors import short_repr
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.variation.varied import (
    LEVELS,
    Key,
    Kind,
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

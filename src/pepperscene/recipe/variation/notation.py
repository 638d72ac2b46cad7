"""Notation of varied values in a recipe: the tables of cultivar files, with `per` and `draw`."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Final

from pepperscene.cultivar import parse_distribution
from pepperscene.errors import short_repr
from pepperscene.recipe.variation.varied import (
    LEVELS,
    Key,
    Kind,
    Level,
    Varied,
    VariedChoice,
    VariedInTurn,
    VariedNumber,
)

_SETTINGS: Final = ("per", "draw", "reversed", "scale", "in_turn", "source", "chosen")
_NUMBER_KEYS: Final = ("mean", "sd", "low", "high", "value", "uniform", "histogram")
_SUM_TOLERANCE: Final = 1e-6  # of weights, which files give with few digits
_MAX_NAMES: Final = 1_000  # chosen: each can be a file, of which checking takes milliseconds
_EXAMPLES: Final = (
    "{ mean = 1, sd = 0.1 }, { uniform = [0, 1] }, { first = 0.5, second = 0.5 } or { in_turn = [1, 2] }"
)


def parse_varied(key: Key, raw: Mapping[str, Any], kind: Kind | None, default: Level) -> Varied:
    """Read the table of a varied value.

    Args:
        key: of the value.
        raw: its table.
        kind: of a number that the recipe needs here; None for a name or a switch.
        default: what a value is drawn for if the table has no `per`.

    Raises:
        ValueError: the table is not valid; the message says what is allowed.
    """
    per, draw = raw.get("per", default), raw.get("draw", ".".join(map(str, key)))
    if per not in LEVELS:
        raise ValueError(f"per must be one of {', '.join(LEVELS)}, not {short_repr(per)}")
    if not isinstance(draw, str) or not draw:
        raise ValueError("draw must be a name")
    is_reversed = raw.get("reversed", False)
    if not isinstance(is_reversed, bool):
        raise ValueError("reversed must be true or false")
    content = {name: value for name, value in raw.items() if name not in _SETTINGS}
    if "in_turn" in raw:
        if content or {"draw", "reversed", "scale"} & raw.keys():
            raise ValueError("in_turn allows no other key but per")
        return VariedInTurn(key, per, draw, _values_in_turn(raw["in_turn"]))
    if not content:
        raise ValueError(f"must be a value, or a table such as {_EXAMPLES}")
    if kind is not None and set(content) & set(_NUMBER_KEYS):
        return _parse_number(key, per, draw, is_reversed, content, raw.get("scale", "linear"), kind)
    if "scale" in raw:
        raise ValueError("scale is for distributions of numbers only")
    outcomes, probabilities = _parse_outcomes(content, kind)
    return VariedChoice(key, per, draw, outcomes, probabilities, reversed=is_reversed)


def _values_in_turn(raw: Any) -> tuple[Any, ...]:
    if not isinstance(raw, list | tuple) or not raw:
        raise ValueError("in_turn must be a list of at least one value")
    if any(isinstance(value, dict) for value in raw):
        raise ValueError("in_turn must be a list of values, not of tables")
    names = len({value for value in raw if isinstance(value, str)})
    if names > _MAX_NAMES:
        raise ValueError(f"in_turn has {names:,} different names; at most {_MAX_NAMES:,} are allowed")
    return tuple(raw)


def _parse_number(
    key: Key, per: Level, draw: str, is_reversed: bool, content: dict[str, Any], scale: Any, kind: Kind
) -> VariedNumber:
    if scale not in ("linear", "log"):
        raise ValueError(f'scale must be "linear" or "log", not {short_repr(scale)}')
    unknown = [name for name in content if name not in _NUMBER_KEYS]
    if unknown:
        raise ValueError(f"{unknown[0]} is not a known key of a distribution of numbers")
    if kind == "date":
        _check_dates(content)
    numbers = given = {name: _as_numbers(value, name, kind) for name, value in content.items()}
    if "uniform" not in numbers and not {"mean", "value", "histogram"} & set(numbers):
        # Limits alone are a uniform distribution.
        if set(numbers) != {"low", "high"}:
            raise ValueError("must have low and high, or mean and sd, or uniform, or histogram")
        numbers = {"uniform": [_limit(numbers, "low"), _limit(numbers, "high")]}
        if not numbers["uniform"][0] < numbers["uniform"][1]:
            raise ValueError("low must be less than high")
    distribution = parse_distribution({**numbers, "chosen": "by the recipe"})
    if any(first == last for first, last, _ in distribution.bins):
        raise ValueError("each bin of the histogram must ascend; give single values as a table of outcomes")
    _check_whole(given, kind)
    exact: tuple[float, float] | None = None
    if scale == "log":
        if set(numbers) != {"uniform"} or kind == "date":
            raise ValueError('scale = "log" needs low and high, and is not for dates')
        if not distribution.low > 0:
            raise ValueError('scale = "log" needs limits above 0')
        exact = distribution.low, distribution.high
        logarithms = [math.log(limit) for limit in exact]
        distribution = parse_distribution({"uniform": logarithms, "chosen": "by the recipe"})
    return VariedNumber(key, per, draw, distribution, kind, scale == "log", exact, reversed=is_reversed)


def _check_whole(numbers: Mapping[str, Any], kind: Kind) -> None:
    """Limits and constants of integers are integers; means can be anything."""
    limits = [("low", numbers.get("low")), ("high", numbers.get("high")), ("value", numbers.get("value"))]
    limits += [("uniform", limit) for limit in numbers.get("uniform", ())]
    for name, limit in limits:
        if kind == "integer" and isinstance(limit, float) and not limit.is_integer():
            raise ValueError(f"{name} must be a whole number, not {limit:g}")


def _limit(numbers: Mapping[str, Any], name: str) -> float:
    """A limit, checked as the value of a constant."""
    try:
        return parse_distribution({"value": numbers[name], "chosen": "by the recipe"}).low
    except ValueError as error:
        raise ValueError(str(error).replace("value", name, 1)) from None


def _check_dates(content: Mapping[str, Any]) -> None:
    """All numbers of a distribution of dates are dates, except its standard deviation and its weights."""
    for name, value in content.items():
        rows = value if isinstance(value, list | tuple) else [value]
        dates = [row[:2] if isinstance(row, list | tuple) else [row] for row in rows]
        if name != "sd" and not all(type(date) is datetime.date for row in dates for date in row):
            raise ValueError(f"{name} must be a date, such as 2016-05-31")


def _as_numbers(value: Any, name: str, kind: Kind) -> Any:
    """Dates as numbers of days; everything else as it is."""
    if isinstance(value, list | tuple):
        return [_as_numbers(item, name, kind) for item in value]
    if isinstance(value, datetime.date):
        if kind != "date":
            raise ValueError(f"{name} must be a number")
        return value.toordinal()
    return value


def _parse_outcomes(
    content: Mapping[str, Any], kind: Kind | None
) -> tuple[tuple[Any, ...], tuple[float, ...]]:
    """Outcomes and their probabilities; keys that are numbers or switches become those."""
    if len(content) > _MAX_NAMES:
        raise ValueError(f"has {len(content):,} outcomes; at most {_MAX_NAMES:,} are allowed")
    for name, weight in content.items():
        is_number = isinstance(weight, int | float) and not isinstance(weight, bool)
        if not is_number or not 0.0 <= weight <= 1.0:
            raise ValueError(
                f"{name} must be a probability, from 0 to 1; allowed are tables such as {_EXAMPLES}"
            )
    total = math.fsum(content.values())
    if abs(total - 1.0) > _SUM_TOLERANCE:
        raise ValueError(f"the probabilities sum to {total:g} and must sum to 1")
    outcomes = tuple(_outcome(name, kind) for name in content)
    return outcomes, tuple(float(weight) for weight in content.values())


def _outcome(name: str, kind: Kind | None) -> Any:
    """A key of a file as the value that it stands for."""
    if kind is None:
        return {"true": True, "false": False}.get(name, name)
    # Other text can be a name that the key allows too ("auto"); the recipe's validation checks it.
    with suppress(ValueError):
        if kind == "date":
            return datetime.date.fromisoformat(name)
        return int(name) if kind == "integer" else float(name)
    return name

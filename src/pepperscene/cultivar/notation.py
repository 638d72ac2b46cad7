"""File notation of distributions and choices: keys with their units, and the checks of each parameter type.

Files give lengths in millimetres and angles in degrees, where the key says so (`mean_mm`, `histogram_deg`);
here they become metres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import partial
from itertools import pairwise
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from pepperscene.cultivar.distribution import DEFAULT_BOUND_SD, Distribution, Origin, parent_normal

NOTHING: Final = "none"
NUMBERS: Final = (
    "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"
)  # fmt: skip

Probability = Annotated[float, Field(ge=0.0, le=1.0)]


def check_sum(values: Iterable[float], names: str) -> float:
    """The sum of probabilities or weights; `ValueError` unless it is 1, but for the few digits of files."""
    total = math.fsum(values)
    if abs(total - 1.0) > 1e-6:
        raise ValueError(f"{names} sum to {total:g} and must sum to 1")
    return total


class Choice(Origin):
    """Table of outcomes with their probabilities, which sum to 1, next to the keys of the origin.

    Attributes:
        probabilities: outcome -> probability, in the order of the file.
    """

    probabilities: dict[str, Probability]

    @model_validator(mode="before")
    @classmethod
    def _collect_outcomes(cls, raw: Any) -> Any:
        """Separate the outcomes of the file's flat table from the keys of the origin."""
        if isinstance(raw, Choice):
            return raw
        if not isinstance(raw, Mapping):
            example = "one = 0.7, two = 0.3" if issubclass(cls, Number) else "petiole = 0.9, none = 0.1"
            raise ValueError(f"must be a table of probabilities, such as {{ {example}, chosen = … }}")
        if "probabilities" in raw:
            return raw
        outcomes = {key: value for key, value in raw.items() if key not in Origin.model_fields}
        for name, value in outcomes.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} must be a probability, from 0 to 1")
        check_sum(outcomes.values(), "the probabilities")
        origin = {key: value for key, value in raw.items() if key in Origin.model_fields}
        return {**origin, "probabilities": outcomes}


class Number(Choice):
    """Random number of items: the outcomes are the words one to twelve."""

    @property
    def numbers(self) -> dict[int, float]:
        """Number -> probability, in the order of the file."""
        return {NUMBERS.index(word) + 1: chance for word, chance in self.probabilities.items()}


def _check_words(number: Number, words: tuple[str, ...]) -> Number:
    for word in number.probabilities:
        if word not in words:
            raise ValueError(f"{word} must be one of {', '.join(words)}")
    return number


Count = Annotated[Number, AfterValidator(partial(_check_words, words=NUMBERS))]
Lobes = Annotated[Number, AfterValidator(partial(_check_words, words=NUMBERS[1:5]))]


Unit = Literal["mm", "deg", ""]
_TO_SI: Final[dict[Unit, float]] = {"mm": 1e-3, "deg": math.pi / 180.0, "": 1.0}
_QUANTITY: Final[dict[Unit, str]] = {"mm": "a length", "deg": "an angle", "": "a plain number"}
_LARGEST: Final = 1e6  # chosen: a kilometre, 2778 turns; greater numbers are typing errors


def _parse_distribution(unit: Unit, raw: Any) -> Distribution:
    """Convert a distribution's table of a file to SI units."""
    if isinstance(raw, Distribution):
        return raw
    suffix = f"_{unit}" if unit else ""
    if not isinstance(raw, Mapping):
        raise ValueError(f"must be a table such as {{ mean{suffix} = 1, sd{suffix} = 0.1, source = … }}")
    origin: dict[str, Any] = {}
    numbers: dict[str, Any] = {}
    for key, value in raw.items():
        # An unknown unit still marks the key as a known one with a wrong unit.
        stem, _, key_unit = key.partition("_")
        if key in ("with_height", *Origin.model_fields):
            origin[key] = value
        elif stem not in ("mean", "sd", "low", "high", "value", "uniform", "histogram", "along"):
            raise ValueError(f"{key} is not a known key")
        elif key_unit != unit:
            raise ValueError(f"{key} has the wrong unit: this is {_QUANTITY[unit]}, so use {stem}{suffix}")
        else:
            numbers[stem] = value
    distribution = _parse_numbers(numbers, _TO_SI[unit], suffix, **origin)
    if "with_height" in origin and distribution.family in ("value", "curve"):
        raise ValueError("with_height needs a normal or uniform distribution or a histogram")
    return distribution


def _parse_numbers(numbers: dict[str, Any], factor: float, suffix: str, **origin: Any) -> Distribution:
    """The distribution that a table's numbers describe, in SI units."""
    keys = set(numbers)
    if keys == {"uniform"}:
        low, high = (factor * x for x in _number_row(numbers["uniform"], 2, f"uniform{suffix}"))
        if not low < high:
            raise ValueError(f"uniform{suffix} must be a smaller and a larger number")
        sd = (high - low) / math.sqrt(12.0)
        return Distribution(family="uniform", mean=0.5 * (low + high), sd=sd, low=low, high=high, **origin)
    if keys == {"histogram"}:
        return _parse_histogram(numbers["histogram"], factor, f"histogram{suffix}", **origin)
    along = numbers.pop("along", None)
    scaled = {
        key: factor * _finite_number(value, key + suffix)
        for key, value in numbers.items()
        if key not in ("uniform", "histogram")
    }
    if keys == {"value"}:
        value = scaled["value"]
        return Distribution(family="value", mean=value, sd=0.0, low=value, high=value, **origin)
    if {"along"} <= keys <= {"along", "sd", "low", "high"}:
        return _parse_curve(along, scaled, factor, suffix, **origin)
    if {"mean", "sd"} <= keys <= {"mean", "sd", "low", "high"}:
        return _parse_normal(scaled, suffix, **origin)
    raise ValueError(
        f"must have value{suffix}, or mean{suffix} and sd{suffix} (and low{suffix}, high{suffix}), "
        f"or uniform{suffix}, or histogram{suffix}, or along{suffix}, and only one of them"
    )


def _bounds(numbers: dict[str, float], lowest: float, highest: float, suffix: str) -> tuple[float, float]:
    """`low` and `high`, three standard deviations beyond the least and the greatest mean if not given."""
    reach = DEFAULT_BOUND_SD * numbers.get("sd", 0.0)
    low, high = numbers.get("low", lowest - reach), numbers.get("high", highest + reach)
    if suffix == "_mm" and low < 0 <= lowest and "low" not in numbers:
        raise ValueError("needs low_mm, since three standard deviations below the mean is a negative length")
    return low, high


def _parse_normal(numbers: dict[str, float], suffix: str, **origin: Any) -> Distribution:
    mean, sd = numbers["mean"], numbers["sd"]
    if sd <= 0:
        raise ValueError(f"sd{suffix} must be greater than 0; for a constant use value{suffix}")
    low, high = _bounds(numbers, mean, mean, suffix)
    if not low < mean < high:
        raise ValueError(f"mean{suffix} must be between low{suffix} and high{suffix}")
    parent_normal(mean, sd, low, high)
    return Distribution(family="normal", mean=mean, sd=sd, low=low, high=high, **origin)


def _parse_curve(
    raw: Any, numbers: dict[str, float], factor: float, suffix: str, **origin: Any
) -> Distribution:
    """A mean that follows the position along the stem, with the same spread everywhere."""
    if not isinstance(raw, (list, tuple)) or len(raw) < 2:
        raise ValueError(f"along{suffix} must be a list of at least two [position, mean]")
    positions, means = zip(*(_number_row(row, 2, f"along{suffix}") for row in raw), strict=True)
    if positions[0] != 0 or positions[-1] != 1 or any(b <= a for a, b in pairwise(positions)):
        raise ValueError(f"along{suffix}: positions must ascend from 0, the stem's foot, to 1, its top")
    sd = numbers.get("sd", 0.0)
    if sd < 0:
        raise ValueError(f"sd{suffix} must be 0 or more")
    along = tuple((position, factor * mean) for position, mean in zip(positions, means, strict=True))
    lowest, highest = min(mean for _, mean in along), max(mean for _, mean in along)
    low, high = _bounds(numbers, lowest, highest, suffix)
    if not low <= lowest <= highest <= high:
        raise ValueError(f"along{suffix}: every mean must be between low{suffix} and high{suffix}")
    mean = math.fsum(0.5 * (b[1] + a[1]) * (b[0] - a[0]) for a, b in pairwise(along))
    return Distribution(family="curve", mean=mean, sd=sd, low=low, high=high, along=along, **origin)


def _parse_histogram(raw: Any, factor: float, key: str, **origin: Any) -> Distribution:
    if not isinstance(raw, (list, tuple)) or not raw:
        raise ValueError(f"{key} must be a list of [from, to, weight]")
    bins = [_number_row(row, 3, key) for row in raw]
    if any(low > high for low, high, _ in bins) or any(weight < 0 for _, _, weight in bins):
        raise ValueError(f"{key}: no bin may descend, and every weight must be at least 0")
    if any(after[0] < before[1] for before, after in pairwise(bins)):
        raise ValueError(f"{key}: bins must ascend without overlap")
    total = check_sum((weight for _, _, weight in bins), f"{key}: the weights")
    scaled = tuple((factor * low, factor * high, weight / total) for low, high, weight in bins)
    mean = math.fsum(0.5 * (low + high) * weight for low, high, weight in scaled)
    # Second moment of a uniform bin: the square of its middle plus a twelfth of the square of its width.
    square = math.fsum(((a + b) ** 2 / 4 + (b - a) ** 2 / 12) * weight for a, b, weight in scaled)
    sd = math.sqrt(max(square - mean * mean, 0.0))
    filled = [row for row in scaled if row[2] > 0]
    low, high = filled[0][0], filled[-1][1]
    return Distribution(family="histogram", mean=mean, sd=sd, low=low, high=high, bins=scaled, **origin)


def _finite_number(raw: Any, key: str) -> float:
    if isinstance(raw, bool) or not isinstance(raw, (int, float)) or not -math.inf < raw < math.inf:
        raise ValueError(f"{key} must be a finite number")
    if not -_LARGEST <= raw <= _LARGEST:
        raise ValueError(f"{key} must be between {-_LARGEST:g} and {_LARGEST:g}")
    return float(raw)


def _number_row(raw: Any, length: int, key: str) -> list[float]:
    if not isinstance(raw, (list, tuple)) or len(raw) != length:
        raise ValueError(f"{key} must have {length} numbers")
    return [_finite_number(value, key) for value in raw]


def parse_distribution(raw: Mapping[str, Any]) -> Distribution:
    """Read the table of a distribution of plain numbers; raises ValueError if it is not valid."""
    return _parse_distribution("", raw)


Length = Annotated[Distribution, BeforeValidator(partial(_parse_distribution, "mm"))]
Angle = Annotated[Distribution, BeforeValidator(partial(_parse_distribution, "deg"))]
Ratio = Annotated[Distribution, BeforeValidator(partial(_parse_distribution, ""))]


def _check_range(
    distribution: Distribution, minimum: float, maximum: float = math.inf, *, exclusive: bool = False
) -> Distribution:
    """Raise ValueError if a value that can be drawn is outside the parameter's range."""
    slack, low, high = 1e-9, distribution.low, distribution.high
    if low < minimum - slack or high > maximum + slack or (exclusive and low <= minimum):
        allowed = f"above {minimum:g}" if exclusive else f"from {minimum:g}"
        upper = "" if maximum == math.inf else f" to {maximum:g}"
        raise ValueError(f"must be {allowed}{upper}, but is {low:.4g} to {high:.4g} (in metres if a length)")
    return distribution


def _check_once_per_plant(distribution: Distribution) -> Distribution:
    if distribution.follows_height:
        raise ValueError("is drawn once per plant, so it cannot follow the height")
    return distribution


SMALLEST_M: Final = 1e-6
"""Chosen: a plant cell is ten times as long; shorter organs are typing errors."""
LONGEST_M: Final = 3.0
"""Chosen: no leaf or stem section of a crop grown on strings is longer, and this catches metres instead of
millimetres."""
_LARGEST_FACTOR: Final = 1e3  # chosen: of ratios and of numbers of teeth; greater ones are typing errors

Size = Annotated[Length, AfterValidator(partial(_check_range, minimum=SMALLEST_M, maximum=LONGEST_M))]
"""A length without which the organ would vanish."""
Width = Annotated[Length, AfterValidator(partial(_check_range, minimum=0.0, maximum=LONGEST_M))]
Factor = Annotated[
    Ratio, AfterValidator(partial(_check_range, minimum=0.0, maximum=_LARGEST_FACTOR, exclusive=True))
]
Amount = Annotated[Ratio, AfterValidator(partial(_check_range, minimum=0.0, maximum=_LARGEST_FACTOR))]
Fraction = Annotated[Ratio, AfterValidator(partial(_check_range, minimum=0.0, maximum=1.0))]
OncePerPlant: Final = AfterValidator(_check_once_per_plant)
"""Marks a distribution from which each plant draws one value."""

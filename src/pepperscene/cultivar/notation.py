"""How a distribution is written in a file: the keys with their units, and what each law needs.

Lengths are millimetres and angles degrees there, where each key says so (`mean_mm`, `histogram_deg`), and
become metres and radians here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from pepperscene.cultivar.distribution import REACH, Distribution, Origin, untruncated

SUM_TOLERANCE: Final = 1e-6  # of probabilities and weights, which people write with few digits
NOTHING: Final = "none"
NUMBERS: Final = (
    "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"
)  # fmt: skip

Probability = Annotated[float, Field(ge=0.0, le=1.0)]


class Choice(Origin):
    """One of several outcomes, written as outcome = probability beside the origin; they sum to 1.

    Attributes:
        probabilities: outcome -> probability, in the order of the file.
    """

    probabilities: dict[str, Probability]

    @model_validator(mode="before")
    @classmethod
    def _gathered(cls, raw: Any) -> Any:
        """The file's flat table, with the outcomes set apart from the origin."""
        if isinstance(raw, Choice):
            return raw
        if not isinstance(raw, Mapping):
            such = "one = 0.7, two = 0.3" if issubclass(cls, Number) else "petiole = 0.9, none = 0.1"
            raise ValueError(f"must be a table of probabilities, such as {{ {such}, chosen = … }}")
        if "probabilities" in raw:
            return raw
        outcomes = {key: value for key, value in raw.items() if key not in Origin.model_fields}
        for name, value in outcomes.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} must be a probability, from 0 to 1")
        total = math.fsum(outcomes.values())
        if abs(total - 1.0) > SUM_TOLERANCE:
            raise ValueError(f"the probabilities sum to {total:g} and must sum to 1")
        origin = {key: value for key, value in raw.items() if key in Origin.model_fields}
        return {**origin, "probabilities": outcomes}


class Number(Choice):
    """How many: the outcomes are the words one to twelve."""

    @property
    def numbers(self) -> dict[int, float]:
        """Number -> probability, in the order of the file."""
        return {NUMBERS.index(word) + 1: share for word, share in self.probabilities.items()}


def _counts(number: Number, words: tuple[str, ...]) -> Number:
    for word in number.probabilities:
        if word not in words:
            raise ValueError(f"{word} must be one of {', '.join(words)}")
    return number


Count = Annotated[Number, AfterValidator(lambda number: _counts(number, NUMBERS))]
Lobes = Annotated[Number, AfterValidator(lambda number: _counts(number, NUMBERS[1:5]))]


Unit = Literal["mm", "deg", ""]
_TO_SI: Final[dict[Unit, float]] = {"mm": 1e-3, "deg": math.pi / 180.0, "": 1.0}
_CALLED: Final[dict[Unit, str]] = {"mm": "a length", "deg": "an angle", "": "a plain number"}
_LARGEST: Final = 1e6  # chosen: a kilometre, 2778 turns; beyond is a slip of the pen


def _in_unit(unit: Unit, raw: Any) -> Any:
    """A distribution's table as it stands in the file -> the fields of `Distribution`, in SI units."""
    if isinstance(raw, Distribution):
        return raw
    if not isinstance(raw, Mapping):
        raise ValueError(
            f"must be a table such as {{ mean{_suffix(unit)} = 1, sd{_suffix(unit)} = 0.1, source = … }}"
        )
    table = dict(raw)
    beside = ("with_height", *Origin.model_fields)
    fields: dict[str, Any] = {key: table.pop(key) for key in beside if key in table}
    numbers: dict[str, Any] = {}
    for key, value in table.items():
        stem, found = _split(key)
        if stem not in ("mean", "sd", "low", "high", "value", "uniform", "histogram", "along"):
            raise ValueError(f"{key} is not a known key")
        if found != unit:
            raise ValueError(
                f"{key} has the wrong unit: this is {_CALLED[unit]}, so write {stem}{_suffix(unit)}"
            )
        numbers[stem] = value
    law = _law(numbers, unit)
    if "with_height" in fields and law["law"] in ("value", "curve"):
        raise ValueError("with_height needs a normal or uniform law or a histogram to order by height")
    return fields | law


def _law(numbers: dict[str, Any], unit: Unit) -> dict[str, Any]:
    """The law that a table's numbers stand for, in SI units."""
    factor, suffix, keys = _TO_SI[unit], _suffix(unit), set(numbers)
    if keys == {"value"}:
        value = factor * _number(numbers["value"], f"value{suffix}")
        return {"law": "value", "mean": value, "sd": 0.0, "low": value, "high": value}
    if keys == {"uniform"}:
        low, high = (factor * x for x in _row(numbers["uniform"], 2, f"uniform{suffix}"))
        if not low < high:
            raise ValueError(f"uniform{suffix} must run from a smaller to a larger number")
        sd = (high - low) / math.sqrt(12.0)
        return {"law": "uniform", "mean": 0.5 * (low + high), "sd": sd, "low": low, "high": high}
    if keys == {"histogram"}:
        return _histogram(numbers["histogram"], factor, f"histogram{suffix}")
    if {"along"} <= keys <= {"along", "sd", "low", "high"}:
        return _curve(numbers, unit)
    if {"mean", "sd"} <= keys <= {"mean", "sd", "low", "high"}:
        return _normal({key: factor * _number(value, key + suffix) for key, value in numbers.items()}, unit)
    raise ValueError(
        f"must hold value{suffix}, or mean{suffix} and sd{suffix} (and low{suffix}, high{suffix}), "
        f"or uniform{suffix}, or histogram{suffix}, or along{suffix}, and only one of them"
    )


def _normal(numbers: dict[str, float], unit: Unit) -> dict[str, Any]:
    mean, sd, suffix = numbers["mean"], numbers["sd"], _suffix(unit)
    if sd <= 0:
        raise ValueError(f"sd{suffix} must be greater than 0; what is always the same is a value{suffix}")
    low = numbers.get("low", mean - REACH * sd)
    high = numbers.get("high", mean + REACH * sd)
    if not low < mean < high:
        raise ValueError(f"mean{suffix} must lie between low{suffix} and high{suffix}")
    if unit == "mm" and low < 0 <= mean and "low" not in numbers:
        raise ValueError("needs low_mm, since three standard deviations below the mean is a negative length")
    untruncated(mean, sd, low, high)
    return {"law": "normal", "mean": mean, "sd": sd, "low": low, "high": high}


def _curve(numbers: dict[str, Any], unit: Unit) -> dict[str, Any]:
    """A mean that follows the place along the stem, with the same spread everywhere."""
    factor, suffix, raw = _TO_SI[unit], _suffix(unit), numbers["along"]
    if not isinstance(raw, (list, tuple)) or len(raw) < 2:
        raise ValueError(f"along{suffix} must be a list of at least two [place, mean]")
    places, means = zip(*(_row(row, 2, f"along{suffix}") for row in raw), strict=True)
    if places[0] != 0 or places[-1] != 1 or any(after <= before for before, after in pairwise(places)):
        raise ValueError(f"along{suffix}: places must ascend from 0, the stem's foot, to 1, its top")
    about = {
        key: factor * _number(numbers[key], key + suffix) for key in ("sd", "low", "high") if key in numbers
    }
    sd = about.get("sd", 0.0)
    if sd < 0:
        raise ValueError(f"sd{suffix} must be 0 or more")
    along = [(place, factor * mean) for place, mean in zip(places, means, strict=True)]
    least, most = min(mean for _, mean in along), max(mean for _, mean in along)
    low, high = about.get("low", least - REACH * sd), about.get("high", most + REACH * sd)
    if not low <= least <= most <= high:
        raise ValueError(f"along{suffix}: every mean must lie between low{suffix} and high{suffix}")
    if unit == "mm" and low < 0 <= least and "low" not in numbers:
        raise ValueError("needs low_mm, since three standard deviations below the mean is a negative length")
    mean = math.fsum(0.5 * (b[1] + a[1]) * (b[0] - a[0]) for a, b in pairwise(along))
    return {"law": "curve", "mean": mean, "sd": sd, "low": low, "high": high, "along": along}


def _histogram(raw: Any, factor: float, key: str) -> dict[str, Any]:
    if not isinstance(raw, (list, tuple)) or not raw:
        raise ValueError(f"{key} must be a list of [from, to, weight]")
    bins = [_row(row, 3, key) for row in raw]
    if any(not low < high for low, high, _ in bins) or any(weight < 0 for _, _, weight in bins):
        raise ValueError(f"{key}: each bin must run upwards and have a weight of at least 0")
    if any(after[0] < before[1] for before, after in pairwise(bins)):
        raise ValueError(f"{key}: bins must ascend without overlap")
    total = math.fsum(weight for _, _, weight in bins)
    if abs(total - 1.0) > SUM_TOLERANCE:
        raise ValueError(f"{key}: the weights sum to {total:g} and must sum to 1")
    scaled = tuple((factor * low, factor * high, weight / total) for low, high, weight in bins)
    mean = math.fsum(0.5 * (low + high) * weight for low, high, weight in scaled)
    # Second moment of a uniform bin: the square of its middle plus a twelfth of the square of its width.
    square = math.fsum(
        ((low + high) ** 2 / 4 + (high - low) ** 2 / 12) * weight for low, high, weight in scaled
    )
    taken = [row for row in scaled if row[2] > 0]
    sd = math.sqrt(max(square - mean * mean, 0.0))
    return {
        "law": "histogram", "mean": mean, "sd": sd, "low": taken[0][0], "high": taken[-1][1], "bins": scaled
    }  # fmt: skip


def _split(key: str) -> tuple[str, str]:
    for unit in ("mm", "deg"):
        if key.endswith(f"_{unit}"):
            return key.removesuffix(f"_{unit}"), unit
    # A unit that is none of ours still marks the key as one of the known ones, wrongly written.
    stem, _, unit = key.partition("_")
    return stem, unit


def _suffix(unit: Unit) -> str:
    return f"_{unit}" if unit else ""


def _number(raw: Any, key: str) -> float:
    if isinstance(raw, bool) or not isinstance(raw, (int, float)) or not -math.inf < raw < math.inf:
        raise ValueError(f"{key} must be a finite number")
    if not -_LARGEST <= raw <= _LARGEST:
        raise ValueError(f"{key} must lie within {-_LARGEST:g} and {_LARGEST:g}")
    return float(raw)


def _row(raw: Any, length: int, key: str) -> list[float]:
    if not isinstance(raw, (list, tuple)) or len(raw) != length:
        raise ValueError(f"{key} must have {length} numbers")
    return [_number(value, key) for value in raw]


Length = Annotated[Distribution, BeforeValidator(partial(_in_unit, "mm"))]
Angle = Annotated[Distribution, BeforeValidator(partial(_in_unit, "deg"))]
Ratio = Annotated[Distribution, BeforeValidator(partial(_in_unit, ""))]


def _within(
    law: Distribution, *, least: float, most: float = math.inf, open_below: bool = False
) -> Distribution:
    """The law, if all that can be drawn from it lies in the range that its parameter has."""
    slack = 1e-9
    if law.low < least - slack or law.high > most + slack or (open_below and law.low <= least):
        above = f"above {least:g}" if open_below else f"from {least:g}"
        raise ValueError(
            f"must lie {above}{'' if most == math.inf else f' to {most:g}'} and can be "
            f"{law.low:.4g} to {law.high:.4g} (in metres if a length)"
        )
    return law


def _whole(law: Distribution) -> Distribution:
    """The law, if it can be drawn once for a whole plant."""
    if law.follows_height:
        raise ValueError("is drawn once a plant, so it cannot follow the height")
    return law


Size = Annotated[Length, AfterValidator(partial(_within, least=0.0, open_below=True))]
"""A length that must be there for the organ to be one."""
Width = Annotated[Length, AfterValidator(partial(_within, least=0.0))]
Factor = Annotated[Ratio, AfterValidator(partial(_within, least=0.0, open_below=True))]
Share = Annotated[Ratio, AfterValidator(partial(_within, least=0.0, most=1.0))]
OncePerPlant = AfterValidator(_whole)
"""Beside a law that all of a plant shares."""

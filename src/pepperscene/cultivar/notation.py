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

from pydantic import BeforeValidator

from pepperscene.cultivar.choice import SUM_TOLERANCE
from pepperscene.cultivar.distribution import Distribution
from pepperscene.cultivar.origin import Origin
from pepperscene.cultivar.truncated import untruncated

Unit = Literal["mm", "deg", ""]
_TO_SI: Final[dict[Unit, float]] = {"mm": 1e-3, "deg": math.pi / 180.0, "": 1.0}
_CALLED: Final[dict[Unit, str]] = {"mm": "a length", "deg": "an angle", "": "a plain number"}
_LARGEST: Final = 1e6  # chosen: a kilometre, 2778 turns; beyond is a slip of the pen
_DEFAULT_REACH: Final = 3.0  # standard deviations to either side, where no bounds are stated


def _in_unit(unit: Unit, raw: Any) -> Any:
    """A distribution's table as it stands in the file -> the fields of `Distribution`, in SI units."""
    if isinstance(raw, Distribution):
        return raw
    if not isinstance(raw, Mapping):
        raise ValueError(
            f"must be a table such as {{ mean{_suffix(unit)} = 1, sd{_suffix(unit)} = 0.1, source = … }}"
        )
    table = dict(raw)
    fields: dict[str, Any] = {key: table.pop(key) for key in Origin.model_fields if key in table}
    numbers: dict[str, Any] = {}
    for key, value in table.items():
        stem, found = _split(key)
        if stem not in ("mean", "sd", "low", "high", "value", "uniform", "histogram"):
            raise ValueError(f"{key} is not a known key")
        if found != unit:
            raise ValueError(
                f"{key} has the wrong unit: this is {_CALLED[unit]}, so write {stem}{_suffix(unit)}"
            )
        numbers[stem] = value
    return fields | _law(numbers, unit)


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
    if {"mean", "sd"} <= keys <= {"mean", "sd", "low", "high"}:
        return _normal({key: factor * _number(value, key + suffix) for key, value in numbers.items()}, unit)
    raise ValueError(
        f"must hold value{suffix}, or mean{suffix} and sd{suffix} (and low{suffix}, high{suffix}), "
        f"or uniform{suffix}, or histogram{suffix}, and only one of them"
    )


def _normal(numbers: dict[str, float], unit: Unit) -> dict[str, Any]:
    mean, sd, suffix = numbers["mean"], numbers["sd"], _suffix(unit)
    if sd <= 0:
        raise ValueError(f"sd{suffix} must be greater than 0")
    low = numbers.get("low", mean - _DEFAULT_REACH * sd)
    high = numbers.get("high", mean + _DEFAULT_REACH * sd)
    if not low < mean < high:
        raise ValueError(f"mean{suffix} must lie between low{suffix} and high{suffix}")
    if unit == "mm" and low < 0 <= mean and "low" not in numbers:
        raise ValueError("needs low_mm, since three standard deviations below the mean is a negative length")
    untruncated(mean, sd, low, high)
    return {"law": "normal", "mean": mean, "sd": sd, "low": low, "high": high}


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

"""A parameter of a fit, and its prior distributions and limits, from the shipped bounds file and a user's."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from pepperscene.cultivar import Distribution, Origin, Ratio
from pepperscene.document import read_toml
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder
from pepperscene.tuning.pigment_paths import CONTENT_FIELDS

Array = NDArray[np.float64]
Group = Literal["pigments", "cuticle", "light", "exposure", "camera"]
SHIPPED: Final = "tuning/bounds.toml"  # in the materials folder
_RATIO: Final[TypeAdapter[Distribution]] = TypeAdapter(Ratio)
_KEYS: Final = ("mean", "sd", "low", "high", "uniform", "relative", *Origin.model_fields)
_EXPECTED: Final = "must be a table such as { mean = 50, sd = 10, low = 20, high = 80, source = … }"
_MIN_MARGIN: Final = 0.1
_MAX_SD: Final = 0.5
"""For bounds that had to be clipped: the mean keeps a tenth of the width from either end, and the sd is at
most half of the mean's distance to the nearer end, which a truncated normal distribution can have. Chosen."""


@dataclass(frozen=True, eq=False)
class Parameter:
    """One parameter of a fit, with one or more entries.

    Attributes:
        name: Such as "leaf.chlorophyll" or "flash.colour".
        unit: Unit of its values; "" if dimensionless.
        meaning: Short description.
        group: Group that it belongs to.
        default: `(k,)` values of the recipe.
        low, high: Limits set by physics and by the file formats.
        floor: Value that means "none": 1 for PROSPECT's N and for a refractive index, else 0.
        labels: `(k,)` names of its entries; `("",)` for a single one.
        prior: `(k,)` prior distributions with mean, sd and bounds; empty until it is selected for a fit.
    """

    name: str
    unit: str
    meaning: str
    group: Group
    default: Array
    low: float = 0.0
    high: float = np.inf
    floor: float = 0.0
    labels: tuple[str, ...] = ("",)
    prior: tuple[Distribution, ...] = ()

    @property
    def entry_labels(self) -> tuple[str, ...]:
        """`(k,)` the name of each entry, with its label if it has one: "flash.colour (warmth)"."""
        return tuple(f"{self.name} ({label})" if label else self.name for label in self.labels)


@dataclass(frozen=True)
class Bounds:
    """Tables of one bounds file `where`, by key.

    If `strict`, as for a user's file, values out of the bounds are errors; shipped bounds are adapted.
    """

    where: str
    tables: Mapping[str, Mapping[str, Any]]
    strict: bool


def prior_distributions(
    selected: Iterable[Parameter],
    available: Iterable[Parameter],
    bounds: Mapping[str, Any] | str | Path | None = None,
) -> tuple[tuple[Distribution, ...], ...]:
    """Prior distribution of every entry of the selected parameters.

    The first of these keys that exists is used, in the user's tables and then in the shipped ones: the name
    with the entry's label (`flash.colour.warmth`), the name (`fruit.ripe.chlorophyll`), and the name for any
    surface (`*.ripe.chlorophyll`, then `*.chlorophyll`). If the recipe has none of a content,
    `*.added.chlorophyll` comes before the names for any surface.

    Raises:
        InputError: The user's file cannot be read; or one of its tables is not a valid distribution, has an
            unknown name, excludes the recipe's value, or allows impossible values.
    """
    layers = [_shipped_bounds()]
    if bounds is not None:
        layers.insert(0, _user_bounds(bounds, available))
    return tuple(
        tuple(_entry_prior(parameter, i, layers) for i in range(parameter.default.size))
        for parameter in selected
    )


@lru_cache(maxsize=1)
def _shipped_bounds() -> Bounds:
    path = shipped_folder("materials") / SHIPPED
    return Bounds(path.name, dict(_flatten(read_toml(path), path.name)), strict=False)


def _user_bounds(bounds: Mapping[str, Any] | str | Path, available: Iterable[Parameter]) -> Bounds:
    """A user's tables. All of them are checked, also those that are not used, so that typing errors show."""
    where = "bounds" if isinstance(bounds, Mapping) else str(bounds)
    tables = dict(_flatten(bounds if isinstance(bounds, Mapping) else read_toml(Path(bounds)), where))
    known = dict.fromkeys(
        key
        for parameter in available
        for i in range(parameter.default.size)
        for key in _entry_keys(parameter, i)
    )
    known |= dict.fromkeys(f"*.added.{content}" for content in CONTENT_FIELDS)
    for key, table in tables.items():
        if key not in known:
            close = get_close_matches(key, known, n=3, cutoff=0.5)
            hint = f"; closest are {', '.join(close)}" if close else ""
            raise InputError(where, f"is not the name of a parameter{hint}", key=key)
        _parse_table(table, where, key)
    return Bounds(where, tables, strict=True)


def _flatten(
    tables: Mapping[str, Any], where: str, prefix: str = ""
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Key -> table of a distribution; keys such as `leaf.chlorophyll` may be quoted or not."""
    for name, table in tables.items():
        key = f"{prefix}{name}"
        if not isinstance(table, Mapping):
            raise InputError(where, _EXPECTED, key=key, value=table)
        if table and all(isinstance(inner, Mapping) for inner in table.values()):
            yield from _flatten(table, where, f"{key}.")
        else:
            yield key, table


def _parse_table(table: Mapping[str, Any], where: str, key: str) -> tuple[Distribution, str]:
    """Distribution of a table, and whether its numbers are relative ("times", "plus") or not ("")."""
    for name in table:
        if name not in _KEYS:
            raise InputError(where, f"is not one of {', '.join(_KEYS)}", key=f"{key}.{name}")
    relative = table.get("relative", "")
    if relative not in ("", "times", "plus"):
        raise InputError(where, 'must be "times" or "plus"', key=f"{key}.relative", value=relative)
    if not table:
        raise InputError(where, _EXPECTED, key=key)
    try:
        return _RATIO.validate_python({name: table[name] for name in table if name != "relative"}), relative
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]["msg"].removeprefix("Value error, ")
        raise InputError(where, problem, key=key) from None


def _entry_keys(parameter: Parameter, entry: int) -> list[str]:
    """Keys of an entry's distribution, in order of precedence."""
    label, content = parameter.labels[entry], parameter.name.rpartition(".")[2]
    keys = [f"{parameter.name}.{label}"] if label else []
    keys.append(parameter.name)
    if parameter.group in ("pigments", "cuticle"):
        if parameter.default[entry] <= parameter.floor:
            keys.append(f"*.added.{content}")
        keys += dict.fromkeys((f"*.{parameter.name.partition('.')[2]}", f"*.{content}"))
    return keys


def _entry_prior(parameter: Parameter, entry: int, layers: Sequence[Bounds]) -> Distribution:
    for layer in layers:
        for key in _entry_keys(parameter, entry):
            if key in layer.tables:
                return _within_limits(parameter, float(parameter.default[entry]), layer, key)
    raise ValueError(f"there are no shipped bounds of {parameter.name}")


def _within_limits(parameter: Parameter, value: float, layer: Bounds, key: str) -> Distribution:
    """Distribution at the recipe's value; for shipped bounds, adapted to it and to what is possible."""
    prior, relative = _parse_table(layer.tables[key], layer.where, key)
    transforms = {"": (1.0, 0.0), "times": (value - parameter.floor, parameter.floor), "plus": (1.0, value)}
    scale, shift = transforms[relative]
    if scale <= 0.0:
        raise InputError(layer.where, f"cannot be relative: the recipe has no {parameter.name}", key=key)
    low, mean, high = (shift + scale * number for number in (prior.low, prior.mean, prior.high))
    sd = scale * prior.sd

    # A user's bounds are used as they are or refused.
    if layer.strict:
        interval = f"is {low:.4g} to {high:.4g}"
        if not low <= value <= high:
            problem = f"must include the recipe's value of {parameter.name}, {value:.4g}, but {interval}"
            raise InputError(layer.where, problem, key=key)
        if not relative and (low < parameter.low or high > parameter.high):
            problem = f"must be within {parameter.low:.4g} to {parameter.high:.4g}, but {interval}"
            raise InputError(layer.where, problem, key=key)

    # Shipped bounds are widened to the recipe's value, and relative ones clipped to the possible range.
    new_low, new_high = max(min(low, value), parameter.low), min(max(high, value), parameter.high)
    adapted = (new_low, new_high) != (low, high)
    if adapted:
        margin = _MIN_MARGIN * (new_high - new_low)
        mean = float(np.clip(mean, new_low + margin, new_high - margin))
        sd = min(sd, _MAX_SD * min(mean - new_low, new_high - mean))
    origin = {name: getattr(prior, name) for name in Origin.model_fields}
    family = "normal" if adapted else prior.family
    return Distribution(family=family, mean=mean, sd=sd, low=new_low, high=new_high, **origin)

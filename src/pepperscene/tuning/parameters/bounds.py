"""How far parameters may go, and what is known of them beforehand: distributions as in cultivar files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

from pepperscene.cultivar import Distribution, Origin, Ratio
from pepperscene.document import read_toml
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder
from pepperscene.tuning.parameters.surface import NAMES
from pepperscene.tuning.parameters.tunables import Tunables

SHIPPED: Final = "tuning/bounds.toml"
"""In the materials."""

_RATIO: Final[TypeAdapter[Distribution]] = TypeAdapter(Ratio)
_KEYS: Final = ("mean", "sd", "low", "high", "uniform", "relative", *Origin.model_fields)
_SUCH: Final = "must be a table such as { mean = 50, sd = 10, low = 20, high = 80, source = … }"
_LEAST_ROOM: Final = 0.1
_STEEPEST: Final = 0.5
"""Of bounds that had to be cut to what is possible: the mean keeps a tenth of their width from either end,
and the sd is at most half of its distance to the nearer one, which some truncated normal law has. Chosen."""


@dataclass(frozen=True)
class Bounds:
    """The tables of one bounds file.

    Attributes:
        where: the file, for messages.
        tables: key -> table of a law.
        binding: whether they are a user's, which are followed or refused; the shipped ones give way.
    """

    where: str
    tables: Mapping[str, Mapping[str, Any]]
    binding: bool


def priors(
    wanted: Iterable[Tunables],
    every: Iterable[Tunables],
    bounds: Mapping[str, Any] | str | Path | None = None,
) -> tuple[tuple[Distribution, ...], ...]:
    """Of every entry of some parameters, its law.

    The first of these keys that there is holds, in the user's tables and then in the shipped ones: the name
    with the entry's label (`flash.colour.warmth`), the name (`fruit.ripe.chlorophyll`), and that of any
    surface (`*.ripe.chlorophyll`, `*.chlorophyll`); before the latter, where the recipe has nothing of a
    content, `*.added.chlorophyll`.

    Args:
        wanted: at the recipe's own values.
        every: all that the recipe has.
        bounds: a user's file or its tables.

    Raises:
        InputError: the file cannot be read, or a table is not such a law, names nothing that is known, keeps
            the recipe's own value out, or allows what cannot be.
    """
    layers = [_shipped()]
    if bounds is not None:
        layers.insert(0, _users(bounds, every))
    return tuple(tuple(_prior(one, i, layers) for i in range(one.value.size)) for one in wanted)


# --- tables ---------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _shipped() -> Bounds:
    path = shipped_folder("materials") / SHIPPED
    return Bounds(path.name, dict(_flat(read_toml(path), path.name)), binding=False)


def _users(bounds: Mapping[str, Any] | str | Path, every: Iterable[Tunables]) -> Bounds:
    """A user's tables, every one checked, so that no slip of the pen goes unseen."""
    where = "bounds" if isinstance(bounds, Mapping) else str(bounds)
    tables = dict(_flat(bounds if isinstance(bounds, Mapping) else read_toml(Path(bounds)), where))
    known = dict.fromkeys(key for own in every for i in range(own.value.size) for key in _keys(own, i))
    known |= dict.fromkeys(f"*.added.{what}" for what in NAMES)
    for key, table in tables.items():
        if key not in known:
            close = get_close_matches(key, known, n=3, cutoff=0.5)
            closest = f"; closest are {', '.join(close)}" if close else ""
            raise InputError(where, f"is not the name of anything that can be fitted{closest}", key=key)
        _law(table, where, key)
    return Bounds(where, tables, binding=True)


def _flat(tables: Mapping[str, Any], where: str, before: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Key -> table of a law; `leaf.chlorophyll` may stand in quotes or not."""
    for name, table in tables.items():
        key = f"{before}{name}"
        if not isinstance(table, Mapping):
            raise InputError(where, _SUCH, key=key, value=table)
        if table and all(isinstance(below, Mapping) for below in table.values()):
            yield from _flat(table, where, f"{key}.")
        else:
            yield key, table


def _law(table: Mapping[str, Any], where: str, key: str) -> tuple[Distribution, str]:
    """The law that a table states, and what its numbers are relative to."""
    for name in table:
        if name not in _KEYS:
            raise InputError(where, f"is not one of {', '.join(_KEYS)}", key=f"{key}.{name}")
    relative = table.get("relative", "")
    if relative not in ("", "times", "plus"):
        raise InputError(where, 'must be "times" or "plus"', key=f"{key}.relative", value=relative)
    if not table:
        raise InputError(where, _SUCH, key=key)
    try:
        return _RATIO.validate_python({name: table[name] for name in table if name != "relative"}), relative
    except ValidationError as fault:
        said = fault.errors(include_url=False)[0]["msg"].removeprefix("Value error, ")
        raise InputError(where, said, key=key) from None


# --- one entry ------------------------------------------------------------------------------------------


def _keys(own: Tunables, entry: int) -> list[str]:
    """Where an entry's law is looked for, in order."""
    label, what = own.labels[entry], own.name.rpartition(".")[2]
    keys = [f"{own.name}.{label}"] if label else []
    keys.append(own.name)
    if own.group in ("pigments", "cuticle"):
        if own.value[entry] <= own.floor:
            keys.append(f"*.added.{what}")
        keys += dict.fromkeys((f"*.{own.name.partition('.')[2]}", f"*.{what}"))
    return keys


def _prior(own: Tunables, entry: int, layers: Sequence[Bounds]) -> Distribution:
    """The law of one entry."""
    for layer in layers:
        for key in _keys(own, entry):
            if key in layer.tables:
                return _fitted(own, float(own.value[entry]), layer, key)
    raise ValueError(f"there are no shipped bounds of {own.name}")


def _fitted(own: Tunables, value: float, layer: Bounds, key: str) -> Distribution:
    """A layer's law at the recipe's own value, within what is possible."""
    law, relative = _law(layer.tables[key], layer.where, key)
    scale, shift = {"": (1.0, 0.0), "times": (value - own.floor, own.floor), "plus": (1.0, value)}[relative]
    if scale <= 0.0:
        raise InputError(layer.where, f"cannot be relative: the recipe has nothing of {own.name}", key=key)
    low, mean, high = (shift + scale * number for number in (law.low, law.mean, law.high))
    sd = scale * law.sd

    # What a user states is followed or refused.
    if layer.binding:
        span = f"goes from {low:.4g} to {high:.4g}"
        if not low <= value <= high:
            allowed = f"must hold what the recipe has of {own.name}, {value:.4g}, and {span}"
            raise InputError(layer.where, allowed, key=key)
        if not relative and (low < own.low or high > own.high):
            allowed = f"must lie within {own.low:.4g} to {own.high:.4g} and {span}"
            raise InputError(layer.where, allowed, key=key)

    # Shipped bounds make room for what the recipe has, and relative ones keep to what is possible.
    least, most = max(min(low, value), own.low), min(max(high, value), own.high)
    cut = (least, most) != (low, high)
    if cut:
        room = _LEAST_ROOM * (most - least)
        mean = float(np.clip(mean, least + room, most - room))
        sd = min(sd, _STEEPEST * min(mean - least, most - mean))
    said = {name: getattr(law, name) for name in Origin.model_fields}
    return Distribution(law="normal" if cut else law.law, mean=mean, sd=sd, low=least, high=most, **said)

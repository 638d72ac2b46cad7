"""How far parameters may go, and what is known of them beforehand: distributions as in cultivar files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

from pepperscene.cultivar import Distribution, Origin, Ratio
from pepperscene.document import read_toml
from pepperscene.errors import InputError
from pepperscene.shipped import shelf
from pepperscene.tuning.own import Own

SHIPPED: Final = "tuning/bounds.toml"
"""In the materials."""

_RATIO: Final[TypeAdapter[Distribution]] = TypeAdapter(Ratio)
_LAWS: Final = ("mean", "sd", "low", "high", "uniform")
_ABOUT: Final = ("times", "plus")
_KEYS: Final = (*_LAWS, "relative", *Origin.model_fields)
_LEAST_ROOM: Final = 0.1
_STEEPEST: Final = 0.5
"""Of bounds that had to be cut to what is possible: the mean keeps a tenth of their width from either end, and
the sd is at most half of its distance to the nearer one, which some truncated normal law has. Chosen."""


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
    wanted: Sequence[Own], known: Sequence[str], bounds: Mapping[str, Any] | str | Path | None = None
) -> tuple[tuple[Distribution, ...], ...]:
    """Of every entry of every parameter, its law.

    The first of these keys that there is holds, in the user's tables and then in the shipped ones: the name
    with the entry's label (`flash.colour.warmth`), the name, and the name of any surface (`*.chlorophyll`);
    where the recipe has nothing of a content, `*.added.chlorophyll` before that.

    Args:
        wanted: at the recipe's own values.
        known: every name that the recipe has.
        bounds: a user's file or its tables.

    Raises:
        InputError: the file cannot be read, or a table is not such a law, names nothing that is known, keeps
            the recipe's own value out, or allows what cannot be.
    """
    layers = [_shipped()]
    if bounds is not None:
        layers.insert(0, _users(bounds, known, wanted))
    return tuple(tuple(_prior(one, i, layers) for i in range(one.value.size)) for one in wanted)


def _shipped() -> Bounds:
    path = shelf("materials") / SHIPPED
    return Bounds(path.name, dict(_flat(read_toml(path), path.name)), binding=False)


def _users(bounds: Mapping[str, Any] | str | Path, known: Sequence[str], wanted: Sequence[Own]) -> Bounds:
    """A user's tables, every one checked, so that no slip of the pen goes unseen."""
    where = "bounds" if isinstance(bounds, Mapping) else str(bounds)
    tables = dict(_flat(bounds if isinstance(bounds, Mapping) else read_toml(Path(bounds)), where))
    labelled = {f"{one.name}.{label}" for one in wanted for label in one.labels if label}
    surfaceless = {f"*.{name.partition('.')[2]}" for name in known if "." in name}
    added = {f"*.added.{key.removeprefix('*.')}" for key in surfaceless}
    for key, table in tables.items():
        if not {key, key.rpartition(".")[0]} & {*known} and key not in labelled | surfaceless | added:
            close = get_close_matches(key, [*known, *sorted(surfaceless)], n=3, cutoff=0.5)
            closest = f"; closest are {', '.join(close)}" if close else ""
            raise InputError(where, key, None, f"is not the name of anything that can be fitted{closest}")
        _law(table, where, key)
    return Bounds(where, tables, binding=True)


def _flat(tables: Mapping[str, Any], where: str, before: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Key -> table of a law; `leaf.chlorophyll` may stand in quotes or not."""
    for name, table in tables.items():
        key = f"{before}{name}"
        if not isinstance(table, Mapping):
            allowed = "must be a table such as { mean = 50, sd = 10, low = 20, high = 80, source = … }"
            raise InputError(where, key, table, allowed)
        if table and all(isinstance(below, Mapping) for below in table.values()):
            yield from _flat(table, where, f"{key}.")
        else:
            yield key, table


def _law(table: Mapping[str, Any], where: str, key: str) -> tuple[Distribution, str]:
    """The law that a table states, and what its numbers are relative to."""
    for name in table:
        if name not in _KEYS:
            raise InputError(where, f"{key}.{name}", None, f"is not one of {', '.join(_KEYS)}")
    relative = table.get("relative", "")
    if relative and relative not in _ABOUT:
        raise InputError(where, f"{key}.relative", relative, 'must be "times" or "plus"')
    try:
        law = _RATIO.validate_python({name: table[name] for name in table if name != "relative"})
    except ValidationError as fault:
        said = fault.errors(include_url=False)[0]["msg"].removeprefix("Value error, ")
        raise InputError(where, key, None, said) from None
    return law, relative


def _prior(own: Own, entry: int, layers: Sequence[Bounds]) -> Distribution:
    """The law of one entry."""
    value, (first, _, rest) = float(own.value[entry]), own.name.partition(".")
    keys = [f"{own.name}.{own.labels[entry]}"] if own.labels[entry] else []
    keys.append(own.name)
    if rest and first != "flash":
        keys += [f"*.added.{rest}"] * (value <= own.floor) + [f"*.{rest}"]
    for layer in layers:
        for key in keys:
            if key in layer.tables:
                return _fitted(own, value, layer, key)
    raise ValueError(f"there are no shipped bounds of {own.name}")


def _fitted(own: Own, value: float, layer: Bounds, key: str) -> Distribution:
    """A layer's law at the recipe's own value, within what is possible."""
    law, relative = _law(layer.tables[key], layer.where, key)
    scale, shift = 1.0, 0.0
    if relative == "times":
        scale, shift = value - own.floor, own.floor
        if scale <= 0.0:
            raise InputError(
                layer.where, key, None, f"cannot be relative, since the recipe has no {own.name}"
            )
    elif relative == "plus":
        shift = value
    low, mean, high = (shift + scale * number for number in (law.low, law.mean, law.high))
    sd = scale * law.sd
    said = {name: getattr(law, name) for name in Origin.model_fields}
    if layer.binding:
        # What a user states is followed or refused.
        if not low <= value <= high:
            allowed = f"must hold what the recipe has, {value:.4g}, and goes from {low:.4g} to {high:.4g}"
            raise InputError(layer.where, key, None, allowed)
        if not relative and (low < own.low or high > own.high):
            allowed = f"must lie within {own.low:.4g} to {own.high:.4g} and goes from {low:.4g} to {high:.4g}"
            raise InputError(layer.where, key, None, allowed)
    # Shipped bounds make room for what the recipe has, and relative ones keep to what is possible.
    cut_low, cut_high = max(min(low, value), own.low), min(max(high, value), own.high)
    if (cut_low, cut_high) != (low, high):
        room = _LEAST_ROOM * (cut_high - cut_low)
        mean = float(np.clip(mean, cut_low + room, cut_high - room))
        sd = min(sd, _STEEPEST * min(mean - cut_low, cut_high - mean))
    kind = "uniform" if law.law == "uniform" and (cut_low, cut_high) == (low, high) else "normal"
    return Distribution(law=kind, mean=mean, sd=sd, low=cut_low, high=cut_high, **said)

"""Find the varied values in a recipe's tables, and replace each by a typical value."""

from __future__ import annotations

import copy
import datetime
import types
import typing
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Final

from pepperscene.document import toml_key
from pepperscene.errors import InputError
from pepperscene.recipe.tables import PLANT_TABLES
from pepperscene.recipe.variation.notation import parse_varied
from pepperscene.recipe.variation.varied import Key, Kind, Level, Varied
from pepperscene.units import is_table, table_fields

OVERRIDE: Final = "override"
"""Table of changed values of the cultivar file, in which only tables with the key `per` are varied values."""

FIXED: Final = {"name", "seed", "plan", "expect", "twins", "rig", "lamps"}
"""Top-level keys whose values are the same for all frames."""


def extract_varied(
    table: Mapping[str, Any], model: Any, where: str
) -> tuple[dict[str, Any], tuple[Varied, ...]]:
    """Separate a recipe's table, as in its file, into one with typical values and the varied values.

    Raises:
        InputError: the table of a varied value is not valid, or a value cannot vary.
    """
    nominal, found = copy.deepcopy(dict(table)), list[Varied]()
    for key, raw, annotation in list(_value_tables(nominal, model)):
        if key[0] in FIXED:
            raise InputError(
                where, "must be a value, because it is the same for all frames", key=toml_key(key)
            )
        if annotation is None and "in_turn" not in raw:
            raise InputError(where, "must be a list, each number of which can vary", key=toml_key(key))
        try:
            # Plants are grown for a set; other values cost nothing to change from frame to frame.
            default: Level = "set" if key[0] in PLANT_TABLES else "frame"
            varied = parse_varied(key, raw, _kind(annotation), default)
        except ValueError as error:
            raise InputError(where, str(error), key=toml_key(key)) from None
        found.append(varied)
        set_value(nominal, key, varied.nominal)
    _check_draws(found, where)
    return nominal, tuple(found)


def set_value(tables: Any, key: Key, value: Any) -> None:
    """Replace a value in nested tables and lists."""
    *outer, last = key
    for part in outer:
        if isinstance(tables[part], tuple):
            tables[part] = list(tables[part])
        tables = tables[part]
    tables[last] = value


def _value_tables(table: Any, model: Any, above: Key = ()) -> Iterator[tuple[Key, dict[str, Any], Any]]:
    """Yield the key, the table and the type of each value that is given as a table."""
    for name, value in table.items():
        key: Key = (*above, name)
        annotation = None if model is None else table_fields(model).get(name)
        if key == (OVERRIDE,) and isinstance(value, dict):
            yield from _override_tables(value, key)
        elif annotation is None:
            continue  # an unknown key, which is reported by the validation
        elif isinstance(value, dict):
            below = table_model(annotation, value)
            if below is not None:
                yield from _value_tables(value, below, key)
            elif not _holds_tables(annotation):
                yield key, value, None if _is_list(annotation) else annotation
        elif isinstance(value, list):
            yield from _list_tables(value, annotation, key)


def _list_tables(values: list[Any], annotation: Any, above: Key) -> Iterator[tuple[Key, dict[str, Any], Any]]:
    """Yield the key, the table and the type of each element that is given as a table, in nested lists too."""
    # In `str | tuple[float, ...]`, elements are numbers although the value can be text.
    elements = tuple(_element_types(annotation))
    annotation = typing.Union[elements] if elements else annotation  # noqa: UP007 - of a number of types
    for number, value in enumerate(values):
        if isinstance(value, dict) and not _holds_tables(annotation):
            yield (*above, number), value, annotation
        elif isinstance(value, list):
            yield from _list_tables(value, annotation, (*above, number))


def _element_types(annotation: Any) -> Iterator[Any]:
    """The types of the elements of each list or tuple in a type."""
    parts = [part for part in typing.get_args(annotation) if part is not Ellipsis]
    if typing.get_origin(annotation) in (tuple, list):
        yield from parts
    else:
        for part in parts:
            yield from _element_types(part)


def _override_tables(
    table: dict[str, Any] | list[Any], above: Key
) -> Iterator[tuple[Key, dict[str, Any], Any]]:
    """Yield the key, the table and the type of each number that is given as a table, in lists too."""
    for name, value in table.items() if isinstance(table, dict) else enumerate(table):
        if isinstance(value, dict) and "per" in value:
            yield (*above, name), value, int if name in _integer_keys() else float
        elif isinstance(value, dict | list):
            yield from _override_tables(value, (*above, name))


@cache
def _integer_keys() -> frozenset[str]:
    """Keys of a cultivar file whose values are integers."""
    from pepperscene.cultivar.organs import MODELS
    from pepperscene.cultivar.slot import Slot
    from pepperscene.cultivar.structure import Stem

    fields = (item for model in (Stem, Slot, *MODELS.values()) for item in table_fields(model).items())
    return frozenset(name for name, annotation in fields if set(_plain_types(annotation)) == {int})


def table_model(annotation: Any, value: Any = None) -> Any:
    """The model of a field that holds a table, optional or not; None for single values.

    Of several models with a key `kind`, it is the one of the value's kind.
    """
    models: list[Any] = list(_models(annotation))
    if len(models) < 2:
        return models[0] if models else None
    kind = value.get("kind") if isinstance(value, dict) else None
    for model in models:
        if kind in typing.get_args(table_fields(model)["kind"]):
            return model
    return None


def _models(annotation: Any) -> Iterator[type[Any]]:
    """The models in a type, outside of containers."""
    if is_table(annotation):
        yield annotation
    elif typing.get_origin(annotation) not in (tuple, list, dict):
        for part in typing.get_args(annotation):
            yield from _models(part)


def _holds_tables(annotation: Any) -> bool:
    """Whether a type is a model, a table of free keys, or a container of them."""
    is_free = annotation is dict or typing.get_origin(annotation) is dict
    return is_free or is_table(annotation) or any(map(_holds_tables, typing.get_args(annotation)))


def _is_list(annotation: Any) -> bool:
    """Whether all values of a type are lists, or missing."""
    if typing.get_origin(annotation) is typing.Annotated:
        return _is_list(typing.get_args(annotation)[0])
    if typing.get_origin(annotation) in (types.UnionType, typing.Union):
        return all(_is_list(part) for part in typing.get_args(annotation) if part is not types.NoneType)
    return typing.get_origin(annotation) in (tuple, list)


def _kind(annotation: Any) -> Kind | None:
    """The kind of number in a type; None for names and switches."""
    plain = set(_plain_types(annotation))
    if str in plain:
        return None
    if datetime.date in plain:
        return "date"
    if float in plain:
        return "number"
    return "integer" if int in plain else None


def _plain_types(annotation: Any) -> Iterator[Any]:
    """The types of numbers, text and dates in a type, also inside of containers."""
    if annotation in (int, float, str, datetime.date):
        yield annotation
    for part in typing.get_args(annotation):
        yield from _plain_types(part)


def _check_draws(found: list[Varied], where: str) -> None:
    """A draw that several values share is for the same sets, scenes or frames."""
    levels: dict[str, Varied] = {}
    for varied in found:
        first = levels.setdefault(varied.draw, varied)
        if first.per != varied.per:
            problem = (
                f"must have per = {first.per!r}, like {first.name}, which shares the draw {varied.draw!r}"
            )
            raise InputError(where, problem, key=f"{varied.name}.per", value=varied.per)

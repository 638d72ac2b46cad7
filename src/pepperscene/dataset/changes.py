"""Single values laid over a recipe, as `--set KEY=VALUE` gives them."""

from __future__ import annotations

import copy
import datetime
import json
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any, Final

from pydantic import BaseModel

from pepperscene.dataset.recipe import Recipe
from pepperscene.errors import InputError

OPTION: Final = "--set"
_LONGEST: Final = 80  # chosen: what a message shows of a change


def read_changes(texts: Iterable[str]) -> dict[str, Any]:
    """Values by dotted key, out of "KEY=VALUE"; of two with the same key the last one counts.

    A value is read as in a TOML file; what is none, such as a bare word, is taken as text.

    Raises:
        InputError: not of that form, or a value that opens a quote or a bracket and does not close it.
    """
    changes: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(OPTION, "", None, f"{_short(text)!r} must be KEY=VALUE")
        # The last one of a key also comes last.
        changes.pop(key.strip(), None)
        changes[key.strip()] = _value(key.strip(), value.strip())
    return changes


def as_tables(key: str, value: Any) -> dict[str, Any]:
    """A change as the tables of a recipe file that says it alone.

    Raises:
        InputError: a recipe has no such key; the message lists those that there are.
    """
    model: type[BaseModel] | None = Recipe
    parts = key.split(".")
    for depth, part in enumerate(parts):
        fields = {} if model is None else model.model_fields
        if part not in fields:
            above = ".".join(parts[:depth])
            inside = f"allowed{f' in {above}' if above else ''} are {', '.join(fields)}"
            allowed = f"is not a known key; {inside if fields else f'{above} is no table'}"
            raise InputError(f"{OPTION} {_short(key)}", "", None, allowed)
        model = _table(fields[part].annotation)
    tables: Any = copy.deepcopy(value)
    for part in reversed(parts):
        tables = {part: tables}
    return dict(tables)


def label(key: str, value: Any) -> str:
    """A change as it is given on the command line, for messages."""
    return _short(f"{OPTION} {key}={_written(value)}")


def _value(key: str, text: str) -> Any:
    read = _read(text)
    if read is not None:
        return read
    if text.startswith(('"', "'", "[", "{")):
        raise InputError(_short(f"{OPTION} {key}={text}"), "", None, "is not a value as in a TOML file")
    return text


def _read(text: str) -> Any:
    """What a text says as a value of a TOML file, or None."""
    try:
        read = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return None
    # Further lines could say more than a value.
    return read["value"] if set(read) == {"value"} else None


def _table(annotation: Any) -> type[BaseModel] | None:
    """The table that a field holds, also where it may be missing; None for single values."""
    for kind in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


def _written(value: Any) -> str:
    """A value as `_value` reads it."""
    if isinstance(value, bool):
        return str(value).lower()
    try:
        if isinstance(value, datetime.date):
            return value.isoformat()
        if isinstance(value, str):
            return value if _bare(value) else json.dumps(value, ensure_ascii=False)
        if isinstance(value, Mapping):
            return "{" + ", ".join(f"{key} = {_written(item)}" for key, item in value.items()) + "}"
        return repr(value)
    except (ValueError, RecursionError):
        # Python writes no integers of thousands of digits.
        return "…"


def _bare(text: str) -> bool:
    """Whether a text is read as itself without quotes."""
    try:
        return bool(_value("", text.strip()) == text)
    except InputError:
        return False


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"

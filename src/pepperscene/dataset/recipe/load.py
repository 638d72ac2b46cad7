"""Single values laid over a recipe, as `--set KEY=VALUE` gives them."""

from __future__ import annotations

import copy
import datetime
import json
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from pepperscene.dataset.recipe.equipment import (
    check_greenhouse,
    load_camera,
    load_recipe_cover,
    load_recipe_cultivar,
)
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.document import read_toml, validate
from pepperscene.errors import InputError
from pepperscene.shipped import find_file

OPTION: Final = "--set"
_LONGEST: Final = 80  # chosen: what a message shows of a change


def parse_changes(texts: Iterable[str]) -> dict[str, Any]:
    """Values by dotted key, out of "KEY=VALUE"; of two with the same key the last one counts.

    A value is read as in a TOML file; what is none, such as a bare word, is taken as text.

    Raises:
        InputError: not of that form, or a value that opens a quote or a bracket and does not close it.
    """
    changes: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(OPTION, f"{_short(text)!r} must be KEY=VALUE")
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
            raise InputError(f"{OPTION} {_short(key)}", allowed)
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
        raise InputError(_short(f"{OPTION} {key}={text}"), "is not a value as in a TOML file")
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


_LONGEST_CHAIN: Final = 16  # chosen: nobody reads a recipe through more files than this
_FILE_KEYS: Final = (
    ("cultivar",), ("camera", "sensor"), ("camera", "lens"), ("camera", "flash"), ("camera", "filter"),
    ("daylight", "cover"), ("growth", "until"),
)  # fmt: skip
"""Keys whose value may be a path, relative to the recipe file that says it."""

_EXPECT: Final = "expect"
_SAME_FRAMES: Final = {"name", "seed", "plan"}
"""Tables and keys that change which frames there are, but not what they are like."""

_Layer = tuple[str, dict[str, Any]]


def load_recipe(name_or_path: str | Path, changes: Mapping[str, Any] | None = None) -> Recipe:
    """Read a recipe by the name of a shipped one or by path.

    A recipe with `extends = "other"` starts from that recipe, a shipped one or a path relative to its own
    file, and replaces single values: tables are merged key by key, lists are replaced whole. What it expects
    goes on for other names, seeds and plans alone: what was measured tells nothing of other views or light.

    Args:
        name_or_path: of the recipe.
        changes: values to replace, by dotted key ("camera.sensor"); paths are relative to the current folder.

    Raises:
        InputError: a file is missing or not TOML, files extend each other in a circle, a key is unknown or
            missing, a value is of the wrong type or outside its range; the message names file, key and value.
    """
    files = _layers(find_file("recipes", name_or_path))
    changed = [(label(key, value), as_tables(key, value)) for key, value in (changes or {}).items()]
    for _, table in changed:
        _resolve_all(table, Path())
    layers = [*reversed(changed), *files]
    merged: dict[str, Any] = {}
    for _, table in reversed(layers):
        merged = _merge(merged, table)

    if _outgrown(list(changes or ()), files):
        del merged[_EXPECT]
    where = files[0][0]
    try:
        recipe = validate(Recipe, merged, where)
        # What stands in the files that it names is for their readers; that they are there is for the recipe.
        for load in (load_recipe_cultivar, load_recipe_cover, load_camera, check_greenhouse):
            load(recipe, where)
    except InputError as fault:
        if fault.where != where:
            raise
        raise _placed(fault, layers, OPTION if changed else where) from None
    return recipe


def _outgrown(changed: Sequence[str], files: Sequence[_Layer]) -> bool:
    """Whether what is expected of the frames was said of others: by a file whose views, plants or light
    another file or a change has replaced since.
    """
    above = {key.partition(".")[0] for key in changed}
    for _, table in files:
        if _EXPECT in above:
            return False
        if _EXPECT in table:
            return not above <= _SAME_FRAMES
        above |= table.keys()
    return False


def _placed(fault: InputError, layers: list[_Layer], default: str) -> InputError:
    """The fault with the file or the change that says it, or at least holds the table where it is."""
    above = fault.key.rpartition(".")[0]
    holders = [one for key in (fault.key, above) if key for one in layers if _holds(one[1], key)]
    where = holders[0][0] if holders else default
    if where.startswith(f"{OPTION} {fault.key}="):
        # The label of a change tells key and value already.
        return InputError(where, fault.problem)
    return InputError(where, fault.problem, key=fault.key, value=fault.value)


def _layers(path: Path) -> list[_Layer]:
    """The recipe's own table, then that of the one it extends, and so on."""
    layers: list[_Layer] = []
    seen: list[Path] = []
    while True:
        if path.resolve() in seen or len(seen) == _LONGEST_CHAIN:
            raise InputError(
                seen[-1], "must not lead back to itself, nor on for ever", key="extends", value=str(path)
            )
        seen.append(path.resolve())
        table = read_toml(path)
        base = table.pop("extends", None)
        _resolve_all(table, path.parent)
        layers.append((str(path), table))
        if base is None:
            return layers
        if not isinstance(base, str):
            raise InputError(path, "must be the name or the path of a recipe", key="extends", value=base)
        try:
            path = find_file("recipes", _relative(base, path.parent))
        except InputError as fault:
            raise InputError(path, fault.problem, key="extends", value=base) from None


def _resolve_all(table: dict[str, Any], folder: Path) -> None:
    for keys in _FILE_KEYS:
        _resolve(table, keys, folder)


def _resolve(table: dict[str, Any], keys: tuple[str, ...], folder: Path) -> None:
    """Make the path under a dotted key absolute, where there is one; anything else is left to validation."""
    for key in keys[:-1]:
        inner = table.get(key)
        if not isinstance(inner, dict):
            return
        table = inner
    value = table.get(keys[-1])
    if isinstance(value, str):
        table[keys[-1]] = _relative(value, folder)


def _relative(wanted: str, folder: Path) -> str:
    """A path as seen from a folder; a bare name stays what it is."""
    if not wanted.endswith(".toml") and Path(wanted).parent == Path("."):
        return wanted
    return os.path.normpath(folder.absolute() / wanted)


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`over` laid over `base`: tables key by key, all else replaced."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        both = isinstance(value, dict) and isinstance(below, dict)
        merged[key] = _merge(below, value) if both and isinstance(below, dict) else value
    return merged


def _holds(table: Any, dotted: str) -> bool:
    """Whether a table says something under a dotted key; an index into a list counts as the list."""
    for key in dotted.split("."):
        if isinstance(table, list):
            return True
        if not isinstance(table, dict) or key not in table:
            return False
        table = table[key]
    return True

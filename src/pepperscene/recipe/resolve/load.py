"""Reading recipes: files that extend each other, changes of single values, and files that a recipe names."""

from __future__ import annotations

import copy
import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from pepperscene.document import extends_chain
from pepperscene.errors import ArgumentError, InputError
from pepperscene.recipe.recipe import FILE_FOLDERS, Recipe, curve_keys
from pepperscene.recipe.resolve.merge import merge_layer, merge_tables
from pepperscene.recipe.resolve.named_files import NamedFiles
from pepperscene.recipe.resolve.parse import check_outcomes, parse_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe, load_files
from pepperscene.recipe.variation.extract import table_model
from pepperscene.shipped import find_file
from pepperscene.units import table_fields

_PATH_ENDINGS: Final = (".toml", ".yaml", ".yml", ".txt", ".csv", ".json", ".py", ".ies", ".ldt")
"""Text with one of these endings is a path. Other text is one only if it has a folder; else it is a name."""

_EXPECT: Final = "expect"
_SAME_FRAMES: Final = {"name", "seed", "plan"}
"""Tables and keys that change which frames there are, but not the kind of frame."""

_CHECKED_LATER: Final = ("views", "override", "twins")
"""Tables whose keys depend on their content, and are checked with it."""

_CHANGES: Final = "changes"  # argument of `load_recipe`

_KEY_PART: Final = re.compile(r'"(?:[^"\\]|\\.)*"|[^."]+')

_Layer = tuple[str | None, dict[str, Any]]
"""A file's name, or None for the changes, and its table."""


def load_recipe(name_or_path: str | Path, changes: Mapping[str, Any] | None = None) -> Recipe:
    """Read a recipe by the name of a shipped one or by path.

    A recipe with `extends = "other"` starts from that recipe, a shipped one or a path relative to its own
    file, and replaces single values: tables are merged key by key, lists are replaced as a whole. `expect` is
    inherited only if nothing but name, seed and plan changes, because it describes frames of one kind.

    Args:
        name_or_path: of the recipe.
        changes: values to replace, by dotted key ("camera.sensor"); paths are relative to the current folder.

    Raises:
        InputError: a file is missing or not TOML, files extend each other in a cycle, a key is unknown or
            missing, a value is of the wrong type or outside its range; the message names file, key and value.
        ArgumentError: the same for a key of `changes`.
    """
    return resolve_recipe(name_or_path, changes).recipe


def resolve_recipe(
    recipe: Recipe | ResolvedRecipe | str | Path,
    changes: Mapping[str, Any] | None = None,
    seed: int | None = None,
    *,
    allow_code: bool = False,
) -> ResolvedRecipe:
    """Load a recipe and the files that it names, with errors as in `load_recipe`.

    Args:
        recipe: name of a shipped one, path, or a recipe. A resolved one is not loaded again.
        changes: as for `load_recipe`; only with a name or a path.
        seed: replaces the recipe's seed, unless None.
        allow_code: whether the recipe's code may run later, when cameras are placed: views of the kind
            "function". Nothing runs while a recipe is loaded. A resolved recipe that allows it keeps to that.
    """
    if isinstance(recipe, Recipe):
        resolved = _load_all(recipe.with_seed(seed), recipe.name)
    elif isinstance(recipe, ResolvedRecipe):
        resolved = recipe.with_seed(seed)
    else:
        resolved = _read_recipe(recipe, changes or {}).with_seed(seed)
    return replace(resolved, allow_code=True) if allow_code else resolved


def _read_recipe(name_or_path: str | Path, changes: Mapping[str, Any]) -> ResolvedRecipe:
    # The layers from the highest priority to the lowest.
    path = find_file("recipes", name_or_path)
    where, files = str(path), list[_Layer]()
    for file, table in extends_chain(path, "recipes", follow_links=False):
        _resolve_paths(table, file.parent)
        files.append((str(file), table))
    changed: dict[str, Any] = {}
    for key, value in changes.items():
        changed = merge_tables(changed, _change_tables(key, value), Recipe)
    _resolve_paths(changed, Path())
    layers = [(None, changed), *files] if changed else files

    # One table of all layers.
    merged: dict[str, Any] = {}
    for file, table in reversed(layers):
        merged = merge_layer(merged, table, is_file=file is not None)
    if _expect_is_outdated(list(changes), files):
        del merged[_EXPECT]
    try:
        return _load_all(parse_recipe(merged, where), where)
    except InputError as error:
        # Errors inside other files name those.
        if error.where != where:
            raise
        raise _with_origin(error, layers) from None


def _load_all(recipe: Recipe, where: str) -> ResolvedRecipe:
    files = NamedFiles()
    resolved = load_files(recipe, where, files)
    check_outcomes(recipe, where, files)
    return resolved


def parse_changes(texts: Iterable[str]) -> dict[str, Any]:
    """Read "KEY=VALUE" texts into values by dotted key; the last value of a key counts.

    A value is read as in a TOML file; anything that is not valid there, such as a bare word, is text.

    Raises:
        ArgumentError: a text has another form, or a value opens a quote or a bracket and does not close it.
    """
    changes: dict[str, Any] = {}
    for text in texts:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise ArgumentError(_CHANGES, f"{text!r} must be KEY=VALUE")
        # A repeated key moves to the end.
        changes.pop(key, None)
        changes[key] = _parse_value(key, value)
    return changes


def _parse_value(key: str, text: str) -> Any:
    try:
        tables = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        tables = {}
    # Further lines could hold more than a value.
    if set(tables) == {"value"}:
        return tables["value"]
    if text.startswith(('"', "'", "[", "{")):
        raise ArgumentError(_CHANGES, "is not a valid TOML value", key=key, value=text)
    return text


def _change_tables(key: str, value: Any) -> dict[str, Any]:
    """The tables of a recipe file that holds a single value; an unknown key is an error."""
    model: Any = Recipe
    parts = key.split(".")
    for depth, part in enumerate(parts):
        fields = {} if model is None else table_fields(model)
        if part not in fields:
            above = ".".join(parts[:depth])
            allowed = f"allowed{f' in {above}' if above else ''} are {', '.join(fields)}"
            problem = f"is not a known key; {allowed if fields else f'{above} is not a table'}"
            raise ArgumentError(_CHANGES, problem, key=key)
        if part in _CHECKED_LATER:
            break
        model = table_model(fields[part])
    tables: Any = copy.deepcopy(value)
    for part in reversed(parts):
        tables = {part: tables}
    return dict(tables)


def _expect_is_outdated(changed_keys: Sequence[str], files: Sequence[_Layer]) -> bool:
    """Whether `expect` comes from a file whose views, plants or light another layer has replaced since."""
    above = {key.partition(".")[0] for key in changed_keys}
    for _, table in files:
        if _EXPECT in above:
            return False
        if _EXPECT in table:
            return not above <= _SAME_FRAMES
        above |= table.keys()
    return False


def _with_origin(error: InputError, layers: list[_Layer]) -> InputError:
    """The error with the name of the layer that holds its key, or at least the table above the key.

    A number of frames that is missing is that of the layer that chose the kind of views.
    """
    key = _parts(error.key)
    if key[:1] == ("views",) or key == ("plan", "frames"):
        layers = layers[: _first_with_other_views(layers)]
    searched = (key, ("views", "kind") if key == ("plan", "frames") else (), key[:-1])
    holders = [layer for parts in searched if parts for layer in layers if _has_key(layer[1], parts)]
    where = (holders or layers)[0][0]
    if where is None:
        return ArgumentError(_CHANGES, error.problem, key=error.key, value=error.value)
    return InputError(where, error.problem, key=error.key, value=error.value)


def _first_with_other_views(layers: Sequence[_Layer]) -> int:
    """Number of the first layer whose views are of another kind, and replaced as a whole by those above."""
    views = [table.get("views") for _, table in layers]
    kinds = [table.get("kind") if isinstance(table, dict) else None for table in views]
    given = [kind for kind in kinds if kind is not None]
    others = (number for number, kind in enumerate(kinds) if kind is not None and kind != given[0])
    return next(others, len(layers))


def _resolve_paths(table: dict[str, Any], folder: Path) -> None:
    """Make the paths in a recipe's table absolute; values of a wrong type are left to validation."""
    twins, rig = table.get("twins"), table.get("rig")
    for *outer, last in (*FILE_FOLDERS, *curve_keys(table)):
        inner: Any = table
        for key in outer:
            inner = inner.get(key) if isinstance(inner, dict) else None
        holders = [(inner, last), (twins, ".".join((*outer, last)))]
        if outer == ["camera"] and isinstance(rig, list):
            holders += [(camera, last) for camera in rig]
        if outer == ["lamps"] and isinstance(inner, list):
            holders += [(lamp, last) for lamp in inner]
        for holder, key in holders:
            if isinstance(holder, dict) and key in holder:
                holder[key] = _absolute_paths(holder[key], folder)


def _absolute_paths(value: Any, folder: Path) -> Any:
    """The same for a name, a list of names, or the table of a varied name."""
    if isinstance(value, str):
        return _absolute_path(value, folder)
    if isinstance(value, list):
        return [_absolute_paths(item, folder) for item in value]
    if isinstance(value, dict):
        # Outcomes are keys; "in_turn" and the settings are no paths.
        return {
            _absolute_path(key, folder): _absolute_paths(item, folder) if key == "in_turn" else item
            for key, item in value.items()
        }
    return value


def _absolute_path(name_or_path: str, folder: Path) -> str:
    """A path relative to a folder as an absolute one; a bare name stays as it is."""
    if not name_or_path.endswith(_PATH_ENDINGS) and Path(name_or_path).parent == Path("."):
        return name_or_path
    return os.path.normpath(folder.absolute() / name_or_path)


def _parts(key: str) -> tuple[str, ...]:
    """The parts of a key in TOML's notation, of which some can be quoted."""
    return tuple(json.loads(part) if part[0] == '"' else part for part in _KEY_PART.findall(key))


def _has_key(table: Any, parts: Sequence[str]) -> bool:
    """Whether a table holds a key; an index into a list counts as the list."""
    for key in parts:
        if isinstance(table, list):
            return True
        if not isinstance(table, dict) or key not in table:
            return False
        table = table[key]
    return True

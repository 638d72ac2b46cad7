"""Reading recipes: files that extend each other, changes of single values, and files that a recipe names."""

from __future__ import annotations

import copy
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.recipe.resolved import ResolvedRecipe, load_files
from pepperscene.document import extends_chain, validate
from pepperscene.errors import ArgumentError, InputError
from pepperscene.shipped import find_file

_FILE_KEYS: Final = (
    ("cultivar",), ("camera", "sensor"), ("camera", "lens"), ("camera", "flash"), ("camera", "filter"),
    ("daylight", "cover"), ("growth", "until"),
)  # fmt: skip
"""Keys whose value may be a path, relative to the recipe file that holds it."""

_EXPECT: Final = "expect"
_SAME_FRAMES: Final = {"name", "seed", "plan"}
"""Tables and keys that change which frames there are, but not the kind of frame."""

_CHANGES: Final = "changes"  # argument of `load_recipe`

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
) -> ResolvedRecipe:
    """Load a recipe and the files that it names, with errors as of `load_recipe`.

    Args:
        recipe: name of a shipped one, path, or a recipe. A resolved one is not loaded again.
        changes: as for `load_recipe`; only with a name or a path.
        seed: replaces the recipe's seed, unless None.
    """
    if isinstance(recipe, Recipe):
        return load_files(recipe.with_seed(seed))
    if not isinstance(recipe, ResolvedRecipe):
        recipe = _read_recipe(recipe, changes or {})
    return recipe.with_seed(seed)


def _read_recipe(name_or_path: str | Path, changes: Mapping[str, Any]) -> ResolvedRecipe:
    # The layers from the highest priority to the lowest.
    path = find_file("recipes", name_or_path)
    where, files = str(path), list[_Layer]()
    for file, table in extends_chain(path, "recipes", follow_links=False):
        _resolve_paths(table, file.parent)
        files.append((str(file), table))
    changed: dict[str, Any] = {}
    for key, value in changes.items():
        changed = _merge_tables(changed, _change_tables(key, value))
    _resolve_paths(changed, Path())
    layers = [(None, changed), *files] if changed else files

    # One table of all layers.
    merged: dict[str, Any] = {}
    for _, table in reversed(layers):
        merged = _merge_tables(merged, table)
    if _expect_is_outdated(list(changes), files):
        del merged[_EXPECT]
    try:
        return load_files(validate(Recipe, merged, where), where)
    except InputError as error:
        # Errors inside other files name those.
        if error.where != where:
            raise
        raise _with_origin(error, layers) from None


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
    model: type[BaseModel] | None = Recipe
    parts = key.split(".")
    for depth, part in enumerate(parts):
        fields = {} if model is None else model.model_fields
        if part not in fields:
            above = ".".join(parts[:depth])
            allowed = f"allowed{f' in {above}' if above else ''} are {', '.join(fields)}"
            problem = f"is not a known key; {allowed if fields else f'{above} is not a table'}"
            raise ArgumentError(_CHANGES, problem, key=key)
        model = _table_model(fields[part].annotation)
    tables: Any = copy.deepcopy(value)
    for part in reversed(parts):
        tables = {part: tables}
    return dict(tables)


def _table_model(annotation: Any) -> type[BaseModel] | None:
    """The model of a field that holds a table, optional or not; None for single values."""
    for kind in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


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
    """The error with the name of the layer that holds its key, or at least the table above the key."""
    above = error.key.rpartition(".")[0]
    holders = [layer for key in (error.key, above) if key for layer in layers if _has_key(layer[1], key)]
    where = (holders or layers)[0][0]
    if where is None:
        return ArgumentError(_CHANGES, error.problem, key=error.key, value=error.value)
    return InputError(where, error.problem, key=error.key, value=error.value)


def _resolve_paths(table: dict[str, Any], folder: Path) -> None:
    """Make the paths in a recipe's table absolute; values of a wrong type are left to validation."""
    for *outer, last in _FILE_KEYS:
        inner: Any = table
        for key in outer:
            inner = inner.get(key) if isinstance(inner, dict) else None
        if isinstance(inner, dict) and isinstance(inner.get(last), str):
            inner[last] = _absolute_path(inner[last], folder)


def _absolute_path(name_or_path: str, folder: Path) -> str:
    """A path relative to a folder as an absolute one; a bare name stays as it is."""
    if not name_or_path.endswith(".toml") and Path(name_or_path).parent == Path("."):
        return name_or_path
    return os.path.normpath(folder.absolute() / name_or_path)


def _merge_tables(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Replace the values of `base` by those of `over`: tables key by key, everything else as a whole."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        tables = isinstance(value, dict) and isinstance(below, dict)
        merged[key] = _merge_tables(below, value) if tables and isinstance(below, dict) else value
    return merged


def _has_key(table: Any, dotted: str) -> bool:
    """Whether a table holds a dotted key; an index into a list counts as the list."""
    for key in dotted.split("."):
        if isinstance(table, list):
            return True
        if not isinstance(table, dict) or key not in table:
            return False
        table = table[key]
    return True

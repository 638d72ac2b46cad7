"""Reading a recipe: a TOML file, which may extend another one."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from pepperscene.dataset.recipe import NO_FLASH, Recipe
from pepperscene.document import read_toml, validated
from pepperscene.errors import InputError
from pepperscene.shipped import find

_LONGEST_CHAIN: Final = 16  # chosen: nobody reads a recipe through more files than this
_FILE_KEYS: Final = (("cultivar",), ("camera", "sensor"), ("camera", "lens"), ("camera", "flash"))
"""Keys whose value may be a path, relative to the recipe file that says it."""

_Layer = tuple[Path, dict[str, Any]]


def load_recipe(name_or_path: str | Path) -> Recipe:
    """Read a recipe by the name of a shipped one or by path.

    A recipe with `extends = "other"` starts from that recipe, a shipped one or a path relative to its own
    file, and replaces single values: tables are merged key by key, lists are replaced whole.

    Raises:
        InputError: a file is missing or not TOML, files extend each other in a circle, a key is unknown or
            missing, a value is of the wrong type or outside its range; the message names file, key and value.
    """
    layers = _layers(find("recipes", name_or_path))
    merged: dict[str, Any] = {}
    for _, table in reversed(layers):
        merged = _merge(merged, table)
    try:
        recipe = validated(Recipe, merged, layers[0][0])
        _check_files(recipe, layers[0][0])
    except InputError as fault:
        # The fault may stand in a file that this one extends: name the one that says it.
        if fault.where != str(layers[0][0]):
            raise
        where = next((path for path, table in layers if _holds(table, fault.key)), layers[0][0])
        raise InputError(where, fault.key, fault.value, fault.allowed) from None
    return recipe


def _check_files(recipe: Recipe, where: Path) -> None:
    """Refuse a recipe that names a file which is not there; what stands in the files is for their readers."""
    from pepperscene.camera import load_flash, load_lens, load_sensor
    from pepperscene.cultivar import load_cultivar

    camera = recipe.camera
    named: list[tuple[str, str, Callable[[str], object]]] = [
        ("cultivar", recipe.cultivar, load_cultivar),
        ("camera.sensor", camera.sensor, load_sensor),
        ("camera.lens", camera.lens, load_lens),
    ]
    if camera.flash != NO_FLASH:
        named.append(("camera.flash", camera.flash, load_flash))
    for key, name, load in named:
        try:
            load(name)
        except InputError as fault:
            if fault.key or fault.where != name:
                raise
            raise InputError(where, key, name, fault.allowed) from None


def _layers(path: Path) -> list[_Layer]:
    """The recipe's own table, then that of the one it extends, and so on."""
    layers: list[_Layer] = []
    seen: list[Path] = []
    while True:
        if path.resolve() in seen or len(seen) == _LONGEST_CHAIN:
            raise InputError(seen[-1], "extends", str(path), "must not lead back to itself, nor on for ever")
        seen.append(path.resolve())
        table = read_toml(path)
        base = table.pop("extends", None)
        for keys in _FILE_KEYS:
            _resolve(table, keys, path.parent)
        layers.append((path, table))
        if base is None:
            return layers
        if not isinstance(base, str):
            raise InputError(path, "extends", base, "must be the name or the path of a recipe")
        try:
            path = find("recipes", _relative(base, path.parent))
        except InputError as fault:
            raise InputError(path, "extends", base, fault.allowed) from None


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

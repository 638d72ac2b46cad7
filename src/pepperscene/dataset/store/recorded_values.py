"""What a `dataset.json` records of its recipe: values, which may differ between frames, and the crops.

The argument `info` is the content of the file, which only the functions on crops need to be of valid types.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import date
from functools import lru_cache
from typing import Any, Final

from pepperscene.errors import InputError
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.variation.extract import table_model
from pepperscene.recipe.variation.recorded import read_variation
from pepperscene.shipped import is_file, shipped_folder
from pepperscene.units import default_value, table_fields

DATE: Final = "growth.date"
"""The only key of a recipe that is a date."""


def is_varied(info: Mapping[str, Any], *keys: str) -> bool:
    """Whether any of some dotted keys of the recipe differs between the frames of a data set."""
    recipe = as_mapping(info.get("recipe"))
    varied = as_mapping(recipe.get("variation")).keys() | as_mapping(recipe.get("twins")).keys()
    return not varied.isdisjoint(keys)


def recorded_values(info: Mapping[str, Any], key: str) -> tuple[Any, ...]:
    """All values that a dotted key of the recipe has in a data set; a varied number has no listed values."""
    recipe = as_mapping(info.get("recipe"))
    # A twin's value takes the place of a drawn one.
    if key in (twins := as_mapping(recipe.get("twins"))):
        return _as_tuple(twins[key])
    if key in (variation := as_mapping(recipe.get("variation"))):
        return listed_values(as_mapping(variation[key]))
    return (recorded_value(info, key),)


def recorded_value(info: Mapping[str, Any], key: str) -> Any:
    """The value of a dotted key without a unit, the typical one if it varies; defaults are not recorded."""
    value: Any = info.get("recipe")
    model: Any = Recipe
    for part in key.split("."):
        value = as_mapping(value).get(part, None if value is None else default_value(model, part))
        model = table_model(table_fields(model)[part])
    return value


def listed_values(identity: Mapping[str, Any]) -> tuple[Any, ...]:
    """The values in turn or the outcomes of a recorded varied value; none for a distribution of numbers."""
    if "in_turn" in identity:
        return _as_tuple(identity["in_turn"])
    pairs = _as_tuple(identity.get("outcomes"))
    return tuple(pair[0] for pair in pairs if isinstance(pair, list) and pair)


def recorded_recipe(info: Mapping[str, Any]) -> Recipe:
    """The recipe of a data set, with the names of the user's own files, whose folders are not recorded.

    Args:
        info: the content of `dataset.json`, of valid types.

    Raises:
        InputError, ValueError: a value is not valid.
    """
    tables = {key: value for key, value in info["recipe"].items() if key != "variation"}
    recipe = Recipe.model_validate_json(json.dumps(tables, allow_nan=False))
    if DATE in recipe.twins:
        dates = tuple(date.fromisoformat(str(value)) for value in recipe.twins[DATE])
        recipe = recipe.model_copy(update={"twins": {**recipe.twins, DATE: dates}})
    return recipe.with_variation(read_variation(info["recipe"]))


def as_mapping(value: Any) -> dict[str, Any]:
    """A JSON object; empty for any other value."""
    return dict(value) if isinstance(value, Mapping) else {}


def _as_tuple(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, list | tuple) else ()


_SHIPPED_NAME: Final = re.compile(r"[A-Za-z0-9_-]+")
_COMMON_NAMES: Final = {"Capsicum annuum": "sweet pepper"}
_FRUIT_NAMES: Final = {
    "Capsicum annuum": "pepper",
    "Cucumis sativus": "cucumber",
    "Solanum lycopersicum": "tomato",
    "Solanum melongena": "eggplant",
}
"""Names of the class `pepper`, fruit, by species; all species of the shipped cultivars."""


def cultivar_names(info: Mapping[str, Any]) -> tuple[str, ...]:
    """The names of a data set's cultivars: one, unless the recipe varies it."""
    return tuple(dict.fromkeys(map(str, recorded_values(info, "cultivar"))))


def crop_name(info: Mapping[str, Any]) -> str:
    """The crops of a data set, joined by "and": the common name "sweet pepper", or the species of another.

    `dataset.json` has only the name of a cultivar. The species of a cultivar that is not shipped is unknown;
    its own name is used instead.
    """
    return " and ".join(dict.fromkeys(map(_crop_of_cultivar, cultivar_names(info))))


def fruit_name(info: Mapping[str, Any]) -> str:
    """The name of the fruit of a data set, such as "tomato"; "fruit" of other, unknown or several crops."""
    names = {_FRUIT_NAMES.get(_species(name) or "", "fruit") for name in cultivar_names(info)}
    return names.pop() if len(names) == 1 else "fruit"


def _crop_of_cultivar(name: str) -> str:
    species = _species(name)
    return name if species is None else _COMMON_NAMES.get(species, species)


@lru_cache(maxsize=64)
def _species(name: str) -> str | None:
    """The species of a shipped cultivar; None for others."""
    from pepperscene.cultivar import load_cultivar

    # The data set may be from anyone: a name must not be read as the path of another file.
    if not _SHIPPED_NAME.fullmatch(name) or not is_file(shipped_folder("plants") / f"{name}.toml"):
        return None
    try:
        return load_cultivar(name).species
    except InputError:
        return None

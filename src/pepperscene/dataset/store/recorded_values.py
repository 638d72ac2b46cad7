"""Values of a recipe as a `dataset.json` records them, which may differ between frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.variation.extract import table_model
from pepperscene.units import default_value, table_fields


def is_varied(info: Mapping[str, Any], *keys: str) -> bool:
    """Whether any of some dotted keys of the recipe differs between the frames of a data set.

    Args:
        info: the content of `dataset.json`, not validated.
        keys: of the recipe, such as "camera.exposure_us".
    """
    recipe = as_mapping(info.get("recipe"))
    varied = as_mapping(recipe.get("variation")).keys() | as_mapping(recipe.get("twins")).keys()
    return not varied.isdisjoint(keys)


def recorded_values(info: Mapping[str, Any], key: str) -> tuple[Any, ...]:
    """All values that a dotted key of the recipe has in a data set; a varied number has no listed values.

    Args:
        info: the content of `dataset.json`, not validated.
        key: of the recipe, such as "greenhouse.far_rows_as".
    """
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


def as_mapping(value: Any) -> dict[str, Any]:
    """A JSON object; empty for any other value."""
    return dict(value) if isinstance(value, Mapping) else {}


def _as_tuple(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, list | tuple) else ()

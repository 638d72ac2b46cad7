"""From the merged tables of a recipe to the validated recipe, with its varied values."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from pepperscene.document import Document, toml_key, validate
from pepperscene.errors import InputError
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.frame_setups import changed_recipe, recipe_tables, twin_changes
from pepperscene.recipe.resolve.merge import has_field
from pepperscene.recipe.rig import FIRST_CAMERA
from pepperscene.recipe.tables import PLANT_TABLES
from pepperscene.recipe.variation.extract import FIXED, OVERRIDE, extract_varied, set_value
from pepperscene.recipe.variation.varied import (
    MOST_CHECKED,
    Varied,
    VariedInTurn,
    VariedNumber,
    distinct_values,
)
from pepperscene.recipe.views_tables import FunctionViews, RandomViews, ViewsTable
from pepperscene.units import table_fields

_NEAR_LOW: Final = 1e-5
"""Probability of a value near the lower limit. Some keys allow 0, or a minimum and more; a range from 0 is an
error if values below the minimum are this frequent. Chosen: ten frames of the largest data set."""

_DERIVED: Final = ("twins", "cameras")
"""Fields of the plan that follow from other tables."""


def parse_recipe(table: Mapping[str, Any], where: str) -> Recipe:
    """Validate the tables of a recipe; all values that can be drawn must be valid.

    Args:
        table: as in a file, without `extends`.
        where: name of the recipe in errors.

    Raises:
        InputError: the first error, with its key and value.
    """
    nominal, variation = extract_varied(table, Recipe, where)
    try:
        _derive_plan(nominal, where)
        recipe = validate(Recipe, nominal, where)
    except InputError as error:
        raise _at_limit(error, nominal, variation, where) from None
    # A list of twins replaces the varied values in it, which would be recorded as drawn.
    variation = tuple(
        varied
        for varied in variation
        if not any(varied.name.startswith(f"{dotted}.") for dotted in recipe.twins)
    )
    recipe = recipe.with_variation(variation)
    _check_twins(recipe, where)
    _check_rig(recipe, where)
    for varied in variation:
        near_low = (varied.value(_NEAR_LOW, 0),) if isinstance(varied, VariedNumber) else ()
        for value in (*varied.extremes, *near_low):
            changed_recipe(recipe, [(varied.key, value)], where)
        if isinstance(varied, VariedInTurn):
            _check_each(recipe, varied, where)
    return recipe


def _check_each(recipe: Recipe, varied: VariedInTurn, where: str) -> None:
    """Check every value of a long list in its table alone, which takes a hundredth of the time."""
    values = distinct_values(varied.values)
    if len(values) <= MOST_CHECKED or varied.key[0] == OVERRIDE:
        return
    name = str(varied.key[0])
    tables, table = recipe_tables(recipe), TypeAdapter[Any](table_fields(Recipe)[name])
    for value in values:
        set_value(tables, varied.key, value)
        try:
            table.validate_python(tables[name])
        except ValidationError:
            changed_recipe(recipe, [(varied.key, value)], where)  # raises an error that names the key


def _at_limit(
    error: InputError, nominal: Mapping[str, Any], variation: tuple[Varied, ...], where: str
) -> InputError:
    """The error of a typical value, which no file holds, as that of the first limit or outcome with one."""
    for varied in variation:
        if toml_key(varied.key) != error.key:
            continue
        for value in varied.extremes:
            tables = copy.deepcopy(dict(nominal))
            set_value(tables, varied.key, value)
            try:
                validate(Recipe, tables, where)
            except InputError as other:
                if other.key == error.key:
                    return other
    return error


def _derive_plan(table: dict[str, Any], where: str) -> None:
    """Fill in the numbers of the plan that follow from other tables."""
    plan = table.get("plan")
    if not isinstance(plan, dict):
        return
    given = {name: plan[name] for name in _DERIVED if name in plan}
    plan = {key: value for key, value in plan.items() if key not in _DERIVED}
    if plan.get("select") == []:
        del plan["select"]
    twins, rig = table.get("twins"), table.get("rig")
    lengths = (
        [len(values) for values in twins.values() if isinstance(values, list)]
        if isinstance(twins, dict)
        else []
    )
    plan |= {"twins": max(1, *lengths)} if lengths else {}
    plan |= {"cameras": 1 + len(rig)} if isinstance(rig, list) and rig else {}
    for name, value in given.items():
        if value != plan.get(name, 1):
            raise InputError(where, "is not a known key", key=f"plan.{name}")
    if "frames" not in plan and "views" in table:
        from pepperscene.recipe.views.fixed_views import view_count

        views = validate(_Views, {"views": table["views"]}, where).views
        count = view_count(views, where)
        if count is None:
            problem = f"is required for views of the kind {views.kind}"
            raise InputError(where, problem, key="plan.frames")
        plan["frames"] = count
    table["plan"] = plan


class _Views(Document):
    views: ViewsTable


def _check_twins(recipe: Recipe, where: str) -> None:
    tables = recipe_tables(recipe)
    for dotted in recipe.twins:
        key = tuple(dotted.split("."))
        name = toml_key(("twins", dotted))
        if key[0] in FIXED or dotted == "views.kind" or not has_field(tables, key):
            raise InputError(where, "is not a key of a recipe that twins can differ in", key=name)
        if key[0] in PLANT_TABLES and isinstance(recipe.views, RandomViews | FunctionViews):
            problem = (
                f"needs views that do not depend on the plants, not those of the kind {recipe.views.kind!r}"
            )
            raise InputError(where, problem, key=name)
    for number in range(recipe.plan.twins if recipe.twins else 0):
        try:
            changed = changed_recipe(recipe, twin_changes(recipe, number), where)
        except InputError as error:
            raise _of_twins(error, recipe) from None
        if changed.views.kind != recipe.views.kind:
            name = toml_key(("twins", "views"))
            problem = f"must keep the kind of the views, {recipe.views.kind}"
            raise InputError(where, problem, key=name, value=changed.views.kind)


def _of_twins(error: InputError, recipe: Recipe) -> InputError:
    """An error of a whole table, as one of the first value of twins in it; others keep their key."""
    for dotted in recipe.twins:
        if error.key and dotted.startswith(f"{error.key}."):
            name = toml_key(("twins", dotted))
            return InputError(error.where, f"makes {error.key} invalid: {error.problem}", key=name)
    return error


def _check_rig(recipe: Recipe, where: str) -> None:
    names = [FIRST_CAMERA, *(camera.name for camera in recipe.rig)]
    for number, camera in enumerate(recipe.rig):
        if camera.name in names[: number + 1]:
            key, problem = f"rig.{number}.name", "must differ from the names of the other cameras"
            raise InputError(where, problem, key=key, value=camera.name)
        changed_recipe(recipe, [], where, camera=number + 1)

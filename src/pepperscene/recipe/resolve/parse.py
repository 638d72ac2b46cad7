"""From merged tables to the validated recipe: every value that it can have in any frame is checked."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

from pepperscene.document import Document, toml_key, validate
from pepperscene.errors import InputError
from pepperscene.recipe.camera_tables import FIRST_CAMERA
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.frame_setups import as_written, changed_recipe, recipe_tables, twin_changes
from pepperscene.recipe.resolve.load_camera import load_camera, load_depth_camera
from pepperscene.recipe.resolve.merge import has_field
from pepperscene.recipe.resolve.named_files import NamedFiles
from pepperscene.recipe.resolve.resolved import (
    check_growth,
    check_gutters,
    check_stand,
    check_views,
    load_first_stage,
    load_recipe_cover,
)
from pepperscene.recipe.tables import PLANT_TABLES
from pepperscene.recipe.variation.extract import FIXED, OVERRIDE, extract_varied, set_value
from pepperscene.recipe.variation.varied import (
    MAX_CHECKED,
    Key,
    Varied,
    VariedChoice,
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
    """Validate a recipe's tables, as in a file without `extends`; all values that can be drawn must be valid.

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
    if len(values) <= MAX_CHECKED or varied.key[0] == OVERRIDE:
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


Changes = tuple[tuple[Key, Any], ...]
"""Values of a recipe with their keys."""

_MAX_COMBINATIONS: Final = 128
"""Chosen: those of one group of tables take a tenth of a second. Of more, this number of random ones is
checked, which miss a given combination of three limits, each lower or upper, with probability 4e-8."""
_MAX_CULTIVARS: Final = 16  # chosen: loading a cultivar takes longer
_LAST: Final = 1.0 - 1e-9  # probability of the highest value that is drawn


def check_outcomes(recipe: Recipe, where: str | Path, files: NamedFiles) -> None:
    """Load all files that any frame needs, and check values that are drawn together, each valid by itself.

    Values depend on each other within a few groups of tables; of each, combinations of the limits of ranges,
    of all outcomes of choices, of all twins and of all cameras of the rig are checked.

    Raises:
        InputError: a file is missing or not valid, or values are not valid together.
    """
    if not (recipe.variation or recipe.twins or recipe.rig):
        return
    blended = set[tuple[str, str]]()
    checks: dict[tuple[str, ...], Callable[[Recipe], object]] = {
        ("camera", "developing"): lambda changed: load_camera(changed, where, files),
        ("depth_camera",): lambda changed: load_depth_camera(changed, where, files),
        ("daylight",): lambda changed: load_recipe_cover(changed, where, files),
        ("row", "greenhouse", "twine"): lambda changed: check_gutters(changed, where),
        ("row", "greenhouse", "stand", "views"): lambda changed: check_stand(changed, where),
        ("cultivar", "override", "growth"): lambda changed: check_growth(changed, where, files, blended),
        ("views", "cultivar"): lambda changed: _check_views(changed, where, files),
        # Its values depend on each other only, so its model checks all.
        ("auto_exposure",): lambda changed: None,
    }
    for tables, check in checks.items():
        cameras = range(1 + len(recipe.rig)) if "camera" in tables else range(1)
        most = _MAX_CULTIVARS if "growth" in tables else _MAX_COMBINATIONS
        for changes, camera in _combinations(_factors(recipe, tables), cameras, most):
            changed = changed_recipe(recipe, changes, str(where), camera)
            try:
                check(changed)
            except InputError as error:
                raise as_written(error, recipe, changes, camera) from None


def _check_views(changed: Recipe, where: str | Path, files: NamedFiles) -> None:
    try:
        check_views(changed, load_first_stage(changed, where, files), where)
    except InputError as error:
        if error.key != "plan.frames":
            raise
        problem = f"must give plan.frames = {error.value} views in every frame; {error.problem}"
        raise InputError(where, problem, key="views") from None


def _factors(recipe: Recipe, tables: Sequence[str]) -> list[list[Changes]]:
    """What is drawn independently, each with the values to combine: draws, values in turn, and twins."""
    draws: dict[tuple[str, str], list[Varied]] = {}
    for varied in recipe.variation:
        if varied.key[0] in tables:
            name = ("in turn", varied.per) if isinstance(varied, VariedInTurn) else ("draw", varied.draw)
            draws.setdefault(name, []).append(varied)
    factors = [_levels(group) for group in draws.values()]
    twins = [
        tuple(change for change in twin_changes(recipe, twin) if change[0][0] in tables)
        for twin in range(recipe.plan.twins if recipe.twins else 0)
    ]
    return [*factors, twins] if any(twins) else factors


def _levels(group: Sequence[Varied]) -> list[Changes]:
    """The values of one draw at the ends of its ranges and for each outcome."""
    if len(group) == 1:
        return [((group[0].key, value),) for value in group[0].extremes]
    if isinstance(group[0], VariedInTurn):
        period = math.lcm(*(len(varied.values) for varied in group if isinstance(varied, VariedInTurn)))
        turns = range(min(period, _MAX_COMBINATIONS))
        return [tuple((varied.key, varied.value(0.0, turn)) for varied in group) for turn in turns]
    probabilities = {0.0, _LAST}
    for varied in group:
        if isinstance(varied, VariedChoice):
            ends = np.concatenate([[0.0], np.cumsum(varied.probabilities)])
            middles = (ends[:-1] + ends[1:]) / 2.0
            probabilities |= {1.0 - float(p) if varied.reversed else float(p) for p in middles}
    return [
        tuple((varied.key, varied.value(_LAST - p if varied.reversed else p, 0)) for varied in group)
        for p in sorted(probabilities)
    ]


def _combinations(
    factors: Sequence[Sequence[Changes]], cameras: Iterable[int], most: int
) -> Iterator[tuple[Changes, int]]:
    """All combinations of the factors and the cameras, or `most` of them, with each value in at least one."""
    levels: list[Sequence[Any]] = [*factors, list(cameras)]
    if math.prod(map(len, levels)) <= most:
        rows: Iterable[Sequence[Any]] = itertools.product(*levels)
    else:
        rng = np.random.default_rng(0)
        count = max(most, *map(len, levels))
        # Columns that hold each value as often as the others, in random order.
        columns = [rng.permutation(np.arange(count) % len(column)) for column in levels]
        rows = (
            [column[i] for column, i in zip(levels, row, strict=True)] for row in zip(*columns, strict=True)
        )
    for *row, camera in rows:
        yield tuple(change for changes in row for change in changes), camera

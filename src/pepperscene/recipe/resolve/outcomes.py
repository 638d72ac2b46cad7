"""All values that a recipe can have in any frame: files can be loaded, and values are valid together."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.errors import InputError
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.frame_setups import as_written, changed_recipe, twin_changes
from pepperscene.recipe.resolve.load_camera import NamedFiles, load_camera, load_depth_camera
from pepperscene.recipe.resolve.resolved import (
    check_growth,
    check_gutters,
    check_views,
    load_first_stage,
    load_recipe_cover,
)
from pepperscene.recipe.variation.varied import Key, Varied, VariedChoice, VariedInTurn

Changes = tuple[tuple[Key, Any], ...]
"""Values of a recipe with their keys."""

_MOST_COMBINATIONS: Final = 128
"""Chosen: those of one group of tables take a tenth of a second. Of more, this number of random ones is
checked, which miss a given combination of three limits, each lower or upper, with probability 4e-8."""
_MOST_CULTIVARS: Final = 16  # chosen: loading a cultivar takes longer
_LAST: Final = 1.0 - 1e-9  # probability of the highest value that is drawn


def check_outcomes(recipe: Recipe, where: str | Path, files: NamedFiles) -> None:
    """Load all files that any frame needs, and check values that are drawn together.

    Values depend on each other within a few groups of tables; of each, combinations of the limits of ranges,
    of all outcomes of choices, of all twins and of all cameras of the rig are checked.

    Args:
        recipe: of which each value that can be drawn is valid by itself.
        where: name of the recipe in errors.
        files: the files that are loaded already.

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
        ("cultivar", "override", "growth"): lambda changed: check_growth(changed, where, files, blended),
        ("views", "cultivar"): lambda changed: _check_views(changed, where, files),
        # Its values depend on each other only, so its model checks all.
        ("auto_exposure",): lambda changed: None,
    }
    for tables, check in checks.items():
        cameras = range(1 + len(recipe.rig)) if "camera" in tables else range(1)
        most = _MOST_CULTIVARS if "growth" in tables else _MOST_COMBINATIONS
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
        turns = range(min(period, _MOST_COMBINATIONS))
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

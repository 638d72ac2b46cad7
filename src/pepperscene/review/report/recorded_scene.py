"""A scene of a data set, grown again from the recipe that the data set records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import date
from typing import TYPE_CHECKING, Any, Final

from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.document import validate
from pepperscene.errors import InputError
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.recipe import Recipe, digest
from pepperscene.recipe.resolve.frame_setups import FrameSetups
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.recipe.variation.recorded import read_variation
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.geometry import Mesh


_DATE: Final = "growth.date"
"""The only key of a recipe that is a date."""


class MissingSceneError(Exception):
    """A scene cannot be shown; the message is the reason, and part of the page."""


def recorded_recipe(info: Mapping[str, Any]) -> ResolvedRecipe:
    """The recipe of a data set from the content of its `dataset.json`, which `read_info` has checked.

    Raises:
        MissingSceneError: its scenes cannot be grown again: it is of another version, or of files that are
            not shipped or have changed.
    """
    if info["version"] != __version__:
        raise MissingSceneError(
            f"the data set was built by version {info['version']}, and this is {__version__}"
        )
    tables = {key: value for key, value in info["recipe"].items() if key != "variation"}
    variation = read_variation(info["recipe"])
    if any(varied.name == _DATE for varied in variation):
        raise MissingSceneError("the recipe draws dates, which data sets record as text")
    try:
        recipe = validate(Recipe, _with_dates(tables), "dataset.json").with_variation(variation)
        resolved = resolve_recipe(recipe)
        is_same = digest(dict(resolved.identity)) == info["recipe_sha256"]
    except (InputError, ValueError):
        # Data sets record the names of the user's own files, not their folders.
        is_same = False
    if not is_same:
        raise MissingSceneError("the recipe names files that are not shipped with this version")
    return resolved


def _with_dates(tables: Mapping[str, Any]) -> dict[str, Any]:
    """A recipe's tables from JSON, with dates instead of their text; raises `ValueError` if one is none."""
    changed = dict(tables)
    growth, twins = tables.get("growth") or {}, tables.get("twins") or {}
    if isinstance(growth.get("date"), str):
        changed["growth"] = {**growth, "date": date.fromisoformat(growth["date"])}
    if _DATE in twins:
        changed["twins"] = {**twins, _DATE: [date.fromisoformat(str(value)) for value in twins[_DATE]]}
    return changed


def grow_row(resolved: ResolvedRecipe, spec: FrameSpec) -> Mesh:
    """The plants of a frame's scene with the greenhouse, without far rows, in world coordinates.

    Raises:
        MissingSceneError: drawn values of the frame are not valid together.
    """
    try:
        setup = FrameSetups(resolved).at(spec)
    except InputError as error:
        raise MissingSceneError(str(error)) from None
    recipe = setup.recipe
    if recipe.greenhouse is not None:
        # Plants do not depend on the far rows.
        recipe = recipe.model_copy(update={"greenhouse": replace(recipe.greenhouse, far_rows=0)})
    return SceneBuilder(recipe, setup.cultivar).scene(spec.set, spec.rotation).mesh

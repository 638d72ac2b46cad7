"""A recipe with the files that it names, loaded; errors name the recipe's key."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pepperscene.errors import NEEDS_PERMISSION, InputError
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load_camera import (
    load_camera,
    load_depth_camera,
    load_lamps,
    surface_wavelengths,
)
from pepperscene.recipe.resolve.named_files import NamedFiles
from pepperscene.recipe.tables import GrowthTable
from pepperscene.recipe.views_tables import FunctionViews, RandomViews
from pepperscene.scene import Greenhouse
from pepperscene.units import NONE, file_values

if TYPE_CHECKING:
    from pepperscene.camera import Camera, DepthCamera, Lamp
    from pepperscene.cultivar import Cultivar
    from pepperscene.scene import Cover


@dataclass(frozen=True, eq=False)
class ResolvedRecipe:
    """A recipe and all files that it names, loaded once.

    Attributes:
        recipe: the validated recipe.
        cultivar: at the recipe's growth stage.
        camera: with the recipe's settings, without a pose.
        cover: between the sky and the crop, or None.
        depth_camera: with the recipe's settings, without a pose; None if the recipe has none.
        lamps: that stand in the scene, in world axes.
        allow_code: whether the user has asked for the recipe's code to run. It is part of no file.
    """

    recipe: Recipe
    cultivar: Cultivar
    camera: Camera
    cover: Cover | None
    depth_camera: DepthCamera | None = None
    allow_code: bool = False
    lamps: tuple[Lamp, ...] = ()

    @cached_property
    def identity(self) -> Mapping[str, Any]:
        """`Recipe.identity` of the recipe, computed once."""
        return self.recipe.identity()

    @cached_property
    def spectra_notes(self) -> tuple[str, ...]:
        """Sentences on the measured curves of organs, in the range of all cameras; see `curve_notes`."""
        if not self.cultivar.spectra:
            return ()
        from pepperscene.materials import curve_notes

        cameras = [camera for camera in (self.camera, self.depth_camera and self.depth_camera.left) if camera]
        seen = [surface_wavelengths(camera.sensor)[[0, -1]] for camera in cameras]
        return curve_notes(self.cultivar, min(nm[0] for nm in seen), max(nm[1] for nm in seen))

    def with_seed(self, seed: int | None) -> ResolvedRecipe:
        """The same with another seed, or itself if that is None; see `Recipe.with_seed`."""
        return self if seed is None else replace(self, recipe=self.recipe.with_seed(seed))

    def check_code(self) -> None:
        """Raise `InputError` if the poses of the cameras need code of the recipe, and it may not run.

        All code of a recipe runs after this check.
        """
        views = self.recipe.views
        if isinstance(views, FunctionViews) and not self.allow_code:
            problem = f"the code of {views.file} {NEEDS_PERMISSION}"
            raise InputError(self.recipe.name, problem, key="views.kind", value=views.kind)


def load_files(recipe: Recipe, where: str | Path = "", files: NamedFiles | None = None) -> ResolvedRecipe:
    """Load the files that a recipe names with its typical values.

    Errors name `where`, by default the recipe; `files` are those that are loaded already, and get these.

    Raises:
        InputError: a file is missing or not valid, or the parts do not fit together.
    """
    where, files = where or recipe.name, files or NamedFiles()
    cultivar, cover = load_recipe_cultivar(recipe, where, files), load_recipe_cover(recipe, where, files)
    if recipe.skin_texture != NONE:
        from pepperscene.materials.skin import load_skin

        # Loaded again with the surfaces, perhaps in another process; here for its errors.
        files.load(load_skin, where, "skin_texture", recipe.skin_texture)
    camera = load_camera(recipe, where, files)
    check_gutters(recipe, where)
    check_stand(recipe, where)
    check_views(recipe, cultivar, where)
    depth_camera = load_depth_camera(recipe, where, files)
    lamps = load_lamps(recipe, "world", where, files)
    return ResolvedRecipe(recipe, cultivar, camera, cover, depth_camera, lamps=lamps)


def check_views(recipe: Recipe, cultivar: Cultivar, where: str | Path) -> None:
    """Check what the views of a recipe refer to: a function, an organ, and the number of frames.

    The file of a function is not run.

    Raises:
        InputError: the file has no such function, no cultivar has such an organ, or the number of views is
            not that of the plan.
    """
    from pepperscene.recipe.views.fixed_views import view_count

    views = recipe.views
    if isinstance(views, FunctionViews):
        from pepperscene.recipe.views.user_function import check_definition

        check_definition(views, where)
    if isinstance(views, RandomViews) and isinstance(views.target, str):
        from pepperscene.recipe.views.targets import target_names

        names = target_names(cultivar.kinds)
        if views.target not in names:
            problem = f"must be a point or one of {', '.join(names)}"
            raise InputError(where, problem, key="views.target", value=views.target)
    count = view_count(views, str(where))
    if count is not None and recipe.plan.frames != count:
        problem = f"must be {count}, the number of views of the kind {views.kind!r}, or left out"
        raise InputError(where, problem, key="plan.frames", value=recipe.plan.frames)


def load_recipe_cover(
    recipe: Recipe, where: str | Path = "", files: NamedFiles | None = None
) -> Cover | None:
    """Load the cover above the crop, if there is one; arguments and errors as in `load_files`."""
    if recipe.daylight is None or recipe.daylight.cover == NONE:
        return None
    from pepperscene.scene import load_cover

    load = (files or NamedFiles()).load
    return load(load_cover, where or recipe.name, "daylight.cover", recipe.daylight.cover)


def load_recipe_cultivar(recipe: Recipe, where: str | Path = "", files: NamedFiles | None = None) -> Cultivar:
    """Load a recipe's cultivar at its growth stage; arguments and errors as in `load_files`."""
    where = where or recipe.name
    return _at_stage(recipe, where, *_load_stages(recipe, where, files or NamedFiles()))


def check_growth(recipe: Recipe, where: str | Path, files: NamedFiles, blended: set[tuple[str, str]]) -> None:
    """Check that a recipe's cultivar can be loaded at its growth stage.

    Arguments and errors are as in `load_files`.
    `blended` holds pairs of cultivars that are known to have stages between them; the recipe's is added.
    """
    first, last, fraction = _load_stages(recipe, where, files)
    names = (recipe.cultivar, recipe.growth.until if recipe.growth is not None else "")
    if names not in blended:
        _at_stage(recipe, where, first, last, fraction)
    blended.add(names)


def load_first_stage(recipe: Recipe, where: str | Path, files: NamedFiles) -> Cultivar:
    """Load a recipe's cultivar with its changes, before any growth."""
    return _load_stage(recipe, where, files, "cultivar", recipe.cultivar)


def _load_stage(recipe: Recipe, where: str | Path, files: NamedFiles, key: str, name: str) -> Cultivar:
    load = partial(_load_changed_cultivar, recipe, where)
    content = "cultivar " + json.dumps(recipe.override, sort_keys=True, default=str)
    return files.load(load, where, key, name, content)


def _load_stages(
    recipe: Recipe, where: str | Path, files: NamedFiles
) -> tuple[Cultivar, Cultivar | None, float]:
    """The recipe's cultivar, that of its growth's end, and the position between them."""
    growth, first = recipe.growth, load_first_stage(recipe, where, files)
    if growth is None:
        return first, None, 0.0
    last = _load_stage(recipe, where, files, "growth.until", growth.until)
    fraction = growth.share if growth.share is not None else _fraction_of_time(growth, first, last, where)
    return first, last, fraction


def _at_stage(
    recipe: Recipe, where: str | Path, first: Cultivar, last: Cultivar | None, fraction: float
) -> Cultivar:
    from pepperscene.cultivar import interpolate_cultivars

    if last is None or recipe.growth is None:
        return first
    try:
        return interpolate_cultivars(first, last, fraction)
    except (ValueError, InputError) as error:
        raise InputError(where, str(error), key="growth.until", value=recipe.growth.until) from None


def _load_changed_cultivar(recipe: Recipe, where: str | Path, name: str) -> Cultivar:
    """Load a cultivar with the recipe's changes; errors in these name the recipe's key."""
    from pepperscene.cultivar import load_cultivar
    from pepperscene.cultivar.cultivar import CHANGES

    try:
        cultivar = load_cultivar(name, recipe.override)
    except InputError as error:
        if error.where != CHANGES:
            raise
        raise InputError(where, error.problem, key=f"override.{error.key}", value=error.value) from None
    if cultivar.spectra:
        from pepperscene.materials import curve_notes

        curve_notes(cultivar, 0.0, 0.0)  # reads and checks the curves
    return cultivar


def _fraction_of_time(growth: GrowthTable, first: Cultivar, last: Cultivar, where: str | Path) -> float:
    """Position of the growth date between the dates of the two cultivars, in [0, 1]."""
    for key, cultivar in (("cultivar", first), ("growth.until", last)):
        if cultivar.date is None:
            problem = f"growth.date needs a date in the file of {cultivar.name} as well"
            raise InputError(where, problem, key=key, value=cultivar.name)
    assert growth.date is not None
    assert first.date is not None
    assert last.date is not None
    days = (last.date - first.date).days
    if days <= 0 or not first.date <= growth.date <= last.date:
        problem = f"must be between the dates of the two files, {first.date} and {last.date}"
        raise InputError(where, problem, key="growth.date", value=growth.date.isoformat())
    return (growth.date - first.date).days / days


def check_stand(recipe: Recipe, where: str | Path) -> None:
    """Raise `InputError` if a stand does not fit its recipe, or a file of a colour is not valid."""
    from pepperscene.materials.stand import colour_reflectance

    stand, row = recipe.stand, recipe.row
    if stand is None:
        return
    if recipe.greenhouse is not None or row.plants_front + row.plants_back > 1:
        problem = "is for one plant: row.plants_front = 1, row.plants_back = 0, and no table greenhouse"
        raise InputError(where, problem, key="stand")
    if stand.turn_rad and isinstance(recipe.views, FunctionViews | RandomViews):
        problem = "must be 0 with views that depend on the plant"
        raise InputError(where, problem, key="stand.turn_deg", value=file_values(stand)["turn_deg"])
    for key in ("pot_colour", "backdrop_colour"):
        try:
            colour_reflectance(getattr(stand, key), np.array([550.0]))
        except InputError as error:
            raise InputError(where, str(error), key=f"stand.{key}") from None


def check_gutters(recipe: Recipe, where: str | Path) -> None:
    """Raise `InputError` if gutters overlap, of the two rows or on both sides of an aisle."""
    row, greenhouse = file_values(recipe.row), file_values(recipe.greenhouse or Greenhouse())
    width_mm = greenhouse["gutter_width_mm"]
    limits = {"row.gap_mm": row["gap_mm"]} if recipe.row.plants_back else {}
    for key, limit in {**limits, "greenhouse.aisle_mm": greenhouse["aisle_mm"]}.items():
        if width_mm > limit:
            problem = f"must be at most {key}, {limit:g}, so that no two gutters overlap"
            raise InputError(where, problem, key="greenhouse.gutter_width_mm", value=width_mm)

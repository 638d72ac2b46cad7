"""A scene of a data set, grown again from the recipe that the data set records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pepperscene.dataset.recipe.frame_setups import FrameSetups
from pepperscene.dataset.recipe.load import resolve_recipe
from pepperscene.dataset.recipe.plan import FrameSpec
from pepperscene.dataset.recipe.recipe import Recipe, digest
from pepperscene.dataset.recipe.resolved import ResolvedRecipe
from pepperscene.dataset.scenes.scene_builder import SceneBuilder
from pepperscene.dataset.variation.recorded import read_variation
from pepperscene.document import validate
from pepperscene.errors import InputError
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.geometry import Mesh


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
    try:
        recipe = validate(Recipe, tables, "dataset.json").with_variation(read_variation(info["recipe"]))
        resolved = resolve_recipe(recipe)
        is_same = digest(dict(resolved.identity)) == info["recipe_sha256"]
    except InputError:
        # Data sets record the names of the user's own files, not their folders.
        is_same = False
    if not is_same:
        raise MissingSceneError("the recipe names files that are not shipped with this version")
    return resolved


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
        bare = recipe.greenhouse.model_copy(update={"far_rows": 0})
        recipe = recipe.model_copy(update={"greenhouse": bare})
    return SceneBuilder(recipe, setup.cultivar).scene(spec.set, spec.rotation).mesh

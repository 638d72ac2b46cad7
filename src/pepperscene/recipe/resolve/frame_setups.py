"""Everything that one frame needs from its recipe: its values, cultivar, camera and cover, loaded."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, TypeVar

from pepperscene.document import toml_key, validate
from pepperscene.errors import InputError
from pepperscene.recipe.camera_tables import FIRST_CAMERA
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load_camera import load_camera, load_depth_camera
from pepperscene.recipe.resolve.merge import merge_layer
from pepperscene.recipe.resolve.named_files import NamedFiles
from pepperscene.recipe.resolve.resolved import ResolvedRecipe, load_recipe_cover, load_recipe_cultivar
from pepperscene.recipe.tables import PLANT_TABLES
from pepperscene.recipe.variation.extract import set_value
from pepperscene.recipe.variation.varied import Key, as_json, draw_values, json_value

if TYPE_CHECKING:
    from pepperscene.camera import Camera, DepthCamera
    from pepperscene.cultivar import Cultivar
    from pepperscene.scene import Cover

_HELD: Final = 16
"""Chosen: number of cultivars, covers and cameras that are kept; others are loaded again when needed."""

Content = TypeVar("Content")


def frame_values(recipe: Recipe, spec: FrameSpec) -> tuple[Recipe, dict[str, Any]]:
    """Draw the values of a frame.

    Returns:
        The frame's recipe, without variation, twins and rig; and the values that differ between frames, by
            dotted key, ready for JSON.

    Raises:
        InputError: drawn values, each valid, are not valid together.
    """
    if not (recipe.variation or recipe.twins or recipe.rig):
        return recipe, {}
    draws = draw_values(recipe.variation, recipe.seed, spec)
    twins = {dotted: values[spec.twin] for dotted, values in recipe.twins.items()}
    changes: list[tuple[Key, Any]] = [(varied.key, value) for varied, value in draws]
    changes += twin_changes(recipe, spec.twin)
    where = f"{recipe.name}, frame {spec.index}"
    drawn = as_json(draws) | {dotted: json_value(value) for dotted, value in twins.items()}
    return changed_recipe(recipe, changes, where, spec.camera), drawn


def twin_changes(recipe: Recipe, twin: int) -> list[tuple[Key, Any]]:
    """The values in which a twin of a recipe differs, each with its key."""
    return [(tuple(dotted.split(".")), values[twin]) for dotted, values in recipe.twins.items()]


def camera_name(recipe: Recipe, spec: FrameSpec) -> str:
    """The name of a frame's camera on the rig."""
    return recipe.rig[spec.camera - 1].name if spec.camera else FIRST_CAMERA


def changed_recipe(recipe: Recipe, changes: Iterable[tuple[Key, Any]], where: str, camera: int = 0) -> Recipe:
    """A recipe with other values, and a camera of its rig as the camera; without variation, twins and rig.

    Raises:
        InputError: the values are not valid together.
    """
    tables, changes = recipe_tables(recipe), tuple(changes)
    try:
        for key, value in changes:
            _change(tables, key, value, where)
        if camera:
            tables = merge_layer(tables, {"camera": recipe.rig[camera - 1].camera})
        return validate(Recipe, tables, where)
    except InputError as error:
        raise as_written(error, recipe, changes, camera) from None


def _change(tables: dict[str, Any], key: Key, value: Any, where: str) -> None:
    try:
        set_value(tables, key, value)
    except (KeyError, TypeError, IndexError):
        problem = "belongs to a table that the recipe does not have"
        raise InputError(where, problem, key=toml_key(key)) from None


def as_written(
    error: InputError, recipe: Recipe, changes: Iterable[tuple[Key, Any]], camera: int = 0
) -> InputError:
    """An error of a changed recipe's frame, with the key under which the recipe's file holds its value.

    The recipe has its rig and twins; of the changes, those of twins are searched.
    """
    parts = error.key.split(".")
    if camera and parts[0] == "camera" and (len(parts) == 1 or parts[1] in recipe.rig[camera - 1].camera):
        key = ".".join(["rig", str(camera - 1), *parts[1:]])
        return InputError(error.where, error.problem, key=key, value=error.value)
    for changed, value in changes:
        dotted = ".".join(map(str, changed))
        is_twin = any(value is other for other in recipe.twins.get(dotted, ()))
        if is_twin and (error.key == dotted or error.key.startswith(f"{dotted}.")):
            problem = error.problem if error.key == dotted else f"{error.key} {error.problem}"
            return InputError(error.where, problem, key=toml_key(("twins", dotted)), value=error.value)
    return error


def recipe_tables(recipe: Recipe) -> dict[str, Any]:
    """A recipe's tables, with typical values for those that vary, and without expectations, twins and rig."""
    tables = recipe.model_dump(exclude={"expect": True, "twins": True, "rig": True, "plan": {"select"}})
    return {key: copy.deepcopy(value) for key, value in tables.items() if value is not None}


@dataclass(frozen=True, eq=False)
class FrameSetup:
    """What one frame depends on.

    Attributes:
        recipe: without variation.
        cultivar, camera, cover, depth_camera: as in `ResolvedRecipe`.
        drawn: the values that differ between frames, by dotted key, ready for JSON.
        plants: identifies the values that plants and their surroundings depend on.
        light: identifies the values that the sky depends on.
        optics: identifies the values that the camera depends on, and the depth camera.
    """

    recipe: Recipe
    cultivar: Cultivar
    camera: Camera
    cover: Cover | None
    drawn: Mapping[str, Any] = field(default_factory=dict)
    plants: str = ""
    light: str = ""
    optics: str = ""
    depth_camera: DepthCamera | None = None


class FrameSetups:
    """The setups of a recipe's frames; parts that frames share are loaded once.

    Args:
        resolved: the recipe with its files.
    """

    def __init__(self, resolved: ResolvedRecipe) -> None:
        self.resolved = resolved
        self._files = NamedFiles()
        self._parts: dict[str, dict[str, Any]] = {}
        recipe = resolved.recipe
        self.same_for_all = not (recipe.variation or recipe.twins or recipe.rig)
        self._only = FrameSetup(
            recipe, resolved.cultivar, resolved.camera, resolved.cover, depth_camera=resolved.depth_camera
        )

    def at(self, spec: FrameSpec) -> FrameSetup:
        """The setup of a frame; raises `InputError` if drawn values are not valid together."""
        if self.same_for_all:
            return self._only
        recipe, drawn = frame_values(self.resolved.recipe, spec)
        where = f"{self.resolved.recipe.name}, frame {spec.index}"
        tables = recipe.model_dump(mode="json")
        plants = _key(tables, PLANT_TABLES)
        light = _key(tables, ("daylight",))
        optics, files = _key(tables, ("camera", "developing", "depth_camera")), self._files
        return FrameSetup(
            recipe=recipe,
            cultivar=self._part("cultivar", plants, lambda: load_recipe_cultivar(recipe, where, files)),
            camera=self._part("camera", optics, lambda: load_camera(recipe, where, files)),
            cover=self._part("cover", light, lambda: load_recipe_cover(recipe, where, files)),
            drawn=drawn,
            plants=plants,
            light=light,
            optics=optics,
            depth_camera=self._part("depth camera", optics, lambda: load_depth_camera(recipe, where, files)),
        )

    def _part(self, name: str, key: str, load: Callable[[], Content]) -> Content:
        parts = self._parts.setdefault(name, {})
        if key not in parts:
            if len(parts) >= _HELD:
                del parts[next(iter(parts))]
            parts[key] = load()
        part: Content = parts[key]
        return part


def _key(tables: Mapping[str, Any], names: tuple[str, ...]) -> str:
    return json.dumps([tables[name] for name in names], sort_keys=True, default=str)

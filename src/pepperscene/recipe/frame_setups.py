"""Everything that one frame needs from its recipe: its values, cultivar, camera and cover, loaded."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, TypeVar

from pepperscene.recipe.frame_values import frame_values
from pepperscene.recipe.load_camera import NamedFiles, load_camera
from pepperscene.recipe.load_depth_camera import load_depth_camera
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolved import ResolvedRecipe, load_recipe_cover, load_recipe_cultivar
from pepperscene.recipe.tables import PLANT_TABLES

if TYPE_CHECKING:
    from pepperscene.camera import Camera, DepthCamera
    from pepperscene.cultivar import Cultivar
    from pepperscene.scene import Cover

_HELD: Final = 16
"""Chosen: number of cultivars, covers and cameras that are kept; others are loaded again when needed."""

Content = TypeVar("Content")


@dataclass(frozen=True, eq=False)
class FrameSetup:
    """What one frame depends on.

    Attributes:
        recipe: without variation.
        cultivar, camera, cover, depth_camera: as of `ResolvedRecipe`.
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
            recipe,
            resolved.cultivar,
            resolved.camera,
            resolved.cover,
            depth_camera=resolved.depth_camera,
        )

    def at(self, spec: FrameSpec) -> FrameSetup:
        """The setup of a frame; raises `InputError` if drawn values are not valid together."""
        if self.same_for_all:
            return self._only
        values = frame_values(self.resolved.recipe, spec)
        recipe, where = values.recipe, f"{self.resolved.recipe.name}, frame {spec.index}"
        tables = recipe.model_dump(mode="json")
        plants = _key(tables, PLANT_TABLES)
        light = _key(tables, ("daylight",))
        optics, files = _key(tables, ("camera", "developing", "depth_camera")), self._files
        return FrameSetup(
            recipe=recipe,
            cultivar=self._part("cultivar", plants, lambda: load_recipe_cultivar(recipe, where, files)),
            camera=self._part("camera", optics, lambda: load_camera(recipe, where, files)),
            cover=self._part("cover", light, lambda: load_recipe_cover(recipe, where, files)),
            drawn=values.drawn,
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

"""Scenes whose views show plants of far rows from near: these plants are grown in full."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pepperscene.building.scenes.scene_builder import BuiltScene, SceneBuilder
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.resolve.camera_views import CameraViews, DrawnViews
from pepperscene.recipe.views.near_plants import CoarsePlants

if TYPE_CHECKING:
    from pepperscene.scene import Scene

DECISIVE_VIEWS: Final = 64
"""The first random views of a scene decide which plants are grown in full; further ones are drawn so that
they show no coarse plant from near. Chosen: all frames of a scene wait for these views, .1 to .2 s of CPU
time for each."""


@dataclass(frozen=True, eq=False)
class NearScene:
    """A scene with its near plants in full.

    Attributes:
        built: its objects.
        coarse: the other plants of its far rows, or None without far rows.
        views: drawn before the plants were grown in full.
    """

    built: BuiltScene
    coarse: CoarsePlants | None
    views: DrawnViews


class NearPlants:
    """Finds the plants of far rows that views of a scene show from near; those of the last scene are kept.

    Args:
        views: of the recipe.
        renderer: makes the renderer of a scene.
    """

    def __init__(self, views: CameraViews, renderer: Callable[[Scene], Any]) -> None:
        self._views, self._renderer = views, renderer
        self._found: tuple[object, tuple[int, ...], DrawnViews] | None = None

    def grow(
        self, key: object, built: BuiltScene, builder: SceneBuilder, specs: Sequence[FrameSpec]
    ) -> NearScene:
        """Grow in full what the views of a scene show from near.

        Args:
            key: of the scene.
            built: the scene with coarse plants.
            builder: that built it.
            specs: all frames of the scene.
        """
        if not built.far_rows:
            return NearScene(built, None, {})
        if self._found is None or self._found[0] != key:
            self._found = None
            self._found = key, *self._find(built, builder, specs)
        _, numbers, drawn = self._found
        coarse = CoarsePlants(builder.far_models, built.far_rows, numbers)
        return NearScene(builder.with_full_plants(built, numbers), coarse, drawn)

    def _find(
        self, built: BuiltScene, builder: SceneBuilder, specs: Sequence[FrameSpec]
    ) -> tuple[tuple[int, ...], DrawnViews]:
        """The numbers of the plants, and the views if they depend on the scene."""
        coarse = CoarsePlants(builder.far_models, built.far_rows)
        if not self._views.depends_on_scene:
            return coarse.shown_near(self._views.near_views(specs)), {}
        from pepperscene.scene import assemble_scene

        scene = assemble_scene(built.mesh, skeleton=built.skeleton)
        visible = getattr(self._renderer(scene), "visible_points", None)
        if self._views.are_random:
            if visible is None:
                return (), {}  # such a renderer cannot show random views
            specs = [spec for spec in specs if spec.step < DECISIVE_VIEWS]
        return coarse.shown_near(self._views.near_views(specs, scene, visible)), self._views.drawn(scene)

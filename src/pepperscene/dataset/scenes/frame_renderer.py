"""From an index to a frame: the plants of its set, the scene of its rotation, the camera of its step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pepperscene.dataset.recipe.equipment import load_recipe_cover, load_recipe_cultivar, surface_wavelengths
from pepperscene.dataset.recipe.plan import FrameSpec, Stream, frame_seed, random_generator
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.scenes.scene_builder import SceneBuilder
from pepperscene.dataset.scenes.viewpoints import Viewpoints
from pepperscene.frame import OUTPUTS, Frame

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.geometry import Mesh
    from pepperscene.materials import Surface
    from pepperscene.render import Quality
    from pepperscene.scene import LightReach, Scene, Sky


class SceneRenderer(Protocol):
    """What renders the views of one scene."""

    def render(
        self,
        camera: Camera,
        outputs: Sequence[str] = ...,
        quality: str | Quality = ...,
        seed: int = ...,
        *,
        others: Mapping[str, Camera] = ...,
    ) -> Frame:
        """One view; `others` is there only where an output needs another camera."""


RendererFactory = Callable[["Scene"], SceneRenderer]


def mitsuba_renderer(scene: Scene) -> SceneRenderer:
    """The renderer of the render room, imported when first needed.

    Raises:
        SetupError: no JIT variant works on this machine.
    """
    from pepperscene.render import Renderer

    return Renderer(scene)


class FrameRenderer:
    """Renders the shots of a recipe, in any order, and keeps what neighbours share.

    The plants of one set and the renderer of one scene are held at a time, so that memory does not grow with
    the number of frames; going through the indices in ascending order makes each of them once.

    Attributes:
        recipe: what is shown.
        cultivar: that grows.
        views: the cameras of its path.
        culled: whether scenes go without what no frame can tell.

    Args:
        recipe: what to show.
        renderer: makes the renderer of a scene.
        culled: False keeps what no frame of a scene can tell; to compare with.

    Raises:
        InputError: the cultivar, the cover or a part of the camera is not found or not valid.
    """

    def __init__(
        self, recipe: Recipe, renderer: RendererFactory | None = None, *, culled: bool = True
    ) -> None:
        self.recipe = recipe
        self.culled = culled
        self._renderer_of = renderer or mitsuba_renderer
        self.cultivar = load_recipe_cultivar(recipe)
        self._cover = load_recipe_cover(recipe)
        self._planting = SceneBuilder(recipe, self.cultivar)
        self.views = Viewpoints(recipe, self._planting.house)
        self._told: dict[str, Any] = {}
        self._scene: tuple[tuple[int, int, bool], SceneRenderer] | None = None
        self._begun: Future[dict[str, Surface]] | None = None

    def render(self, shot: FrameSpec, outputs: Sequence[str], quality: str | Quality = "standard") -> Frame:
        """One frame.

        Args:
            shot: which one; `recipe.plan.frame(index)` gives it.
            outputs: names out of `OUTPUTS`.
            quality: "draft", "standard" or "reference", or one of your own.

        Raises:
            InputError: an output needs a stereo partner, and the recipe has none.
        """
        others = self.views.others(shot.step, outputs)
        traced = any(OUTPUTS[name].traced for name in outputs)
        seed = frame_seed(self.recipe.seed, shot.index)
        renderer = self._renderer(shot, traced, quality)
        # What needs no other camera is asked for without: a renderer need not know of them.
        further = {"others": others} if others else {}
        frame = renderer.render(self.camera(shot), outputs=outputs, quality=quality, seed=seed, **further)
        return Frame(frame.images, {**frame.metadata, **self._told})

    def camera(self, shot: FrameSpec) -> Camera:
        """The camera of a shot, at its place on the arc path, which leans with the row."""
        return self.views.camera(shot.step)

    def scene(self, shot: FrameSpec, *, traced: bool = True) -> Scene:
        """The scene of a shot.

        Args:
            shot: its set and rotation count.
            traced: False leaves out surfaces and sky, which labels and distances do not need.
        """
        from pepperscene.scene import assemble_scene

        planted = self._planting.scene(shot.set, shot.rotation)
        mesh = self._visible(planted.mesh) if self.culled else planted.mesh
        self._told = {
            "contacts": asdict(planted.contacts),
            "geometry": {"triangles": len(mesh.faces), "of": len(planted.mesh.faces)},
        }
        if not traced:
            return assemble_scene(mesh, skeleton=planted.skeleton)
        return assemble_scene(mesh, self._surfaces, self.sky(shot.set), planted.skeleton)

    def _visible(self, mesh: Mesh) -> Mesh:
        """What the frames of a scene can tell of it.

        All poses and the recipe's light decide, whatever is asked for: a frame's labels fit to its colour,
        and no frame depends on the others.
        """
        from pepperscene.scene import cull_mesh

        return cull_mesh(mesh, self.views.sight, self._reach)

    def _renderer(self, shot: FrameSpec, traced: bool, quality: str | Quality) -> SceneRenderer:
        """The renderer of the shot's scene; one that can trace light serves labels as well."""
        if self._scene is not None:
            (held_set, held_rotation, held_traced), renderer = self._scene
            if (held_set, held_rotation) == (shot.set, shot.rotation) and held_traced >= traced:
                return renderer
            # The old scene goes before the new one comes.
            del renderer
            self._scene = None
        # While two processes make plants no core is idle; while the row settles one is.
        self._planting.plants(shot.set)
        if traced:
            self._begin(quality)
        made = self._renderer_of(self.scene(shot, traced=traced))
        self._scene = ((shot.set, shot.rotation, traced), made)
        return made

    def _begin(self, quality: str | Quality) -> None:
        """Begin what a first picture needs besides its row, which settles meanwhile.

        What fails there is told where it is first needed.
        """
        if self._begun is not None:
            return
        with_surfaces = ThreadPoolExecutor(1, "surfaces")
        self._begun = with_surfaces.submit(self._made_surfaces)
        with_surfaces.shutdown(wait=False)

    def sky(self, which: int) -> Sky | None:
        """The daylight above a set, or None where the recipe has none."""
        from pepperscene.scene import partly_cloudy_sky

        light = self.recipe.daylight
        if light is None or light.illuminance_lx == 0:
            return None
        return partly_cloudy_sky(
            random_generator(self.recipe.seed, Stream.SKY, which),
            illuminance_lx=light.illuminance_lx,
            sun_azimuth_rad=float(np.radians(light.sun_azimuth_deg)),
            sun_elevation_rad=float(np.radians(light.sun_elevation_deg)),
            sun_fraction=light.sun_fraction,
            cloud_cover=light.cloud_cover,
            cover=self._cover,
        )

    @cached_property
    def _reach(self) -> LightReach:
        from pepperscene.scene import light_reach

        light, distance_m = self.recipe.daylight, self.recipe.path.distance_mm / 1e3
        if light is None or light.illuminance_lx == 0:
            return light_reach(self.views.equipment, distance_m, 0.0)
        # As from a clear sky: a hazy cover only softens the disc's shadows.
        sun_lx = light.illuminance_lx * light.sun_fraction
        facing_lx = sun_lx / np.sin(np.radians(light.sun_elevation_deg)) if sun_lx > 0 else 0.0
        return light_reach(self.views.equipment, distance_m, light.illuminance_lx - sun_lx, float(facing_lx))

    @cached_property
    def _surfaces(self) -> dict[str, Surface]:
        return self._made_surfaces() if self._begun is None else self._begun.result()

    def _made_surfaces(self) -> dict[str, Surface]:
        from pepperscene.materials import greenhouse_surfaces, organ_surfaces

        nm = surface_wavelengths(self.views.equipment.sensor)
        return {**organ_surfaces(self.cultivar, nm), **greenhouse_surfaces(nm)}

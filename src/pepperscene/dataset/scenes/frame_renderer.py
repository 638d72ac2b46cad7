"""Render frames by index: the plants of the set, the scene of the rotation, the camera of the step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pepperscene.dataset.recipe.load import resolve_recipe
from pepperscene.dataset.recipe.plan import FrameSpec, Stream, frame_seed, random_generator
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.recipe.resolved import ResolvedRecipe, surface_wavelengths
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
    """Renders views of one scene."""

    def render(
        self,
        camera: Camera,
        outputs: Sequence[str] = ...,
        quality: str | Quality = ...,
        seed: int = ...,
        *,
        others: Mapping[str, Camera] = ...,
    ) -> Frame:
        """Render one view; `others` is passed only if an output needs another camera."""


RendererFactory = Callable[["Scene"], SceneRenderer]


def mitsuba_renderer(scene: Scene) -> SceneRenderer:
    """The Mitsuba renderer of a scene, imported when first needed."""
    from pepperscene.render import Renderer

    return Renderer(scene)


@dataclass(frozen=True, eq=False)
class AssembledScene:
    """A scene, and its JSON-ready statistics: remaining `contacts`, and triangles in `geometry`."""

    scene: Scene
    statistics: Mapping[str, Any]


class FrameRenderer:
    """Renders the frames of a recipe in any order.

    The plants of one set and the renderer of one scene are held at a time, so memory does not grow with the
    number of frames; in ascending order of the indices each is made once.

    Attributes:
        resolved: the recipe with the files that it names; also as `recipe` and `cultivar`.
        views: the cameras along its path.
        culled: whether triangles that affect no frame are left out of scenes; False is for comparison.

    Args:
        recipe: a recipe, its resolved form, a shipped name or a path.
        renderer: makes the renderer of a scene; None for Mitsuba.
        culled: see the attribute.

    Raises:
        InputError: the recipe or a file that it names is missing or not valid.
    """

    def __init__(
        self,
        recipe: Recipe | ResolvedRecipe | str | Path,
        renderer: RendererFactory | None = None,
        *,
        culled: bool = True,
    ) -> None:
        self.resolved = resolve_recipe(recipe)
        self.recipe, self.cultivar = self.resolved.recipe, self.resolved.cultivar
        self.culled = culled
        self._renderer_factory = renderer or mitsuba_renderer
        self._scene_builder = SceneBuilder(self.recipe, self.cultivar)
        self.views = Viewpoints(self.recipe, self.resolved.camera, self._scene_builder.greenhouse)
        # Set, rotation and whether light can be traced; the scene's renderer and its statistics.
        self._held: tuple[tuple[int, int, bool], SceneRenderer, Mapping[str, Any]] | None = None

    def render(self, spec: FrameSpec, outputs: Sequence[str], quality: str | Quality = "standard") -> Frame:
        """Render one frame.

        Args:
            spec: the frame, from `recipe.plan.frame(index)`.
            outputs: names from `OUTPUTS`.
            quality: "draft", "standard", "reference", or a `Quality`.

        Raises:
            InputError: an output needs a stereo partner, and the recipe has none.
        """
        others = self.views.others(spec.step, outputs)
        renderer, statistics = self._renderer(spec, any(OUTPUTS[name].traced for name in outputs))
        seed = frame_seed(self.recipe.seed, spec.index)
        # Renderers receive other cameras only if an output needs them.
        further = {"others": others} if others else {}
        frame = renderer.render(self.camera(spec), outputs=outputs, quality=quality, seed=seed, **further)
        return Frame(frame.images, {**frame.metadata, **statistics})

    def camera(self, spec: FrameSpec) -> Camera:
        """The camera of a frame, at its place on the path."""
        return self.views.camera(spec.step)

    def scene(self, spec: FrameSpec, *, traced: bool = True) -> Scene:
        """The scene of a frame; without `traced` it has no surfaces and no sky, which labels do not need."""
        return self.assemble(spec, traced=traced).scene

    def assemble(self, spec: FrameSpec, *, traced: bool = True) -> AssembledScene:
        """The scene of a frame, as `scene`, with its statistics."""
        from pepperscene.scene import assemble_scene

        built = self._scene_builder.scene(spec.set, spec.rotation)
        mesh = self._cull(built.mesh) if self.culled else built.mesh
        statistics = {
            "contacts": asdict(built.contacts),
            "geometry": {"triangles": len(mesh.faces), "of": len(built.mesh.faces)},
        }
        if not traced:
            return AssembledScene(assemble_scene(mesh, skeleton=built.skeleton), statistics)
        scene = assemble_scene(mesh, self._surfaces, self.sky(spec.set), built.skeleton)
        return AssembledScene(scene, statistics)

    def _cull(self, mesh: Mesh) -> Mesh:
        """Leave out what affects no frame of a scene, by all poses and the recipe's light.

        Outputs do not matter, so a frame's labels fit its colour, and no frame depends on others.
        """
        from pepperscene.scene import cull_mesh

        return cull_mesh(mesh, self.views.frustums, self._light_reach)

    def sky(self, set_index: int) -> Sky | None:
        """The daylight above a set, or None if the recipe has none."""
        from pepperscene.scene import partly_cloudy_sky

        light = self.recipe.daylight
        if light is None or light.illuminance_lx == 0:
            return None
        return partly_cloudy_sky(
            random_generator(self.recipe.seed, Stream.SKY, set_index),
            illuminance_lx=light.illuminance_lx,
            sun_azimuth_rad=float(np.radians(light.sun_azimuth_deg)),
            sun_elevation_rad=float(np.radians(light.sun_elevation_deg)),
            sun_fraction=light.sun_fraction,
            cloud_cover=light.cloud_cover,
            cover=self.resolved.cover,
        )

    def _renderer(self, spec: FrameSpec, traced: bool) -> tuple[SceneRenderer, Mapping[str, Any]]:
        """The renderer of the frame's scene, and the scene's statistics."""
        usable = {(spec.set, spec.rotation, True), (spec.set, spec.rotation, traced)}
        if self._held is None or self._held[0] not in usable:
            # Release the old scene before making the new one.
            self._held = None
            assembled = self.assemble(spec, traced=traced)
            renderer = self._renderer_factory(assembled.scene)
            self._held = (spec.set, spec.rotation, traced), renderer, assembled.statistics
        return self._held[1:]

    @cached_property
    def _light_reach(self) -> LightReach:
        from pepperscene.scene import light_reach

        camera, light = self.resolved.camera, self.recipe.daylight
        distance_m = self.recipe.path.distance_mm / 1e3
        if light is None or light.illuminance_lx == 0:
            return light_reach(camera, distance_m, 0.0)
        # As for a clear sky: a hazy cover only softens the sun's shadows.
        sun_lx = light.illuminance_lx * light.sun_fraction
        normal_lx = sun_lx / np.sin(np.radians(light.sun_elevation_deg)) if sun_lx > 0 else 0.0
        return light_reach(camera, distance_m, light.illuminance_lx - sun_lx, float(normal_lx))

    @cached_property
    def _surfaces(self) -> dict[str, Surface]:
        from pepperscene.materials import greenhouse_surfaces, organ_surfaces

        nm = surface_wavelengths(self.resolved.camera.sensor)
        return {**organ_surfaces(self.cultivar, nm), **greenhouse_surfaces(nm)}

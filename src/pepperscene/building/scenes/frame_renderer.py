"""Render frames by index: the plants of the set, the scene of the rotation, the camera of the step."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pepperscene.building.scenes.exposures import FrameExposures
from pepperscene.building.scenes.optics import (
    SurfaceFactory,
    SurfacePreparation,
    largest_light_reach,
    lit_cameras,
    make_surfaces,
    prepare_for_mitsuba,
)
from pepperscene.building.scenes.scene_builder import BuiltScene, NearPlants, NearScene, SceneBuilder
from pepperscene.building.scenes.skies import sky_above
from pepperscene.building.scenes.turning import TurntableScenes, lamps_at, sky_at, turn_metadata, turn_of
from pepperscene.building.subprocess_rpc import FunctionWorker
from pepperscene.frame import Frame
from pepperscene.outputs import OUTPUTS, needs_surfaces
from pepperscene.recipe.plan import FrameSpec, frame_seed
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.camera_views import CameraViews
from pepperscene.recipe.resolve.frame_setups import FrameSetup, FrameSetups
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.load_camera import surface_range
from pepperscene.recipe.resolve.resolved import ResolvedRecipe

if TYPE_CHECKING:
    from pepperscene.camera import Camera, ChosenExposure, Lamp
    from pepperscene.geometry import Mesh
    from pepperscene.materials import Surface
    from pepperscene.recipe.views.fixed_views import View
    from pepperscene.render import Quality, Renderer
    from pepperscene.scene import Scene, Sky

RendererFactory = Callable[["Scene"], "Renderer"]


def mitsuba_renderer(scene: Scene) -> Renderer:
    """The Mitsuba renderer of a scene, imported when first needed."""
    from pepperscene.render import Renderer

    return Renderer(scene)


@dataclass(frozen=True, eq=False)
class AssembledScene:
    """A scene, and its JSON-ready statistics: remaining `contacts`, and triangles in `geometry`."""

    scene: Scene
    statistics: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class _HeldScene:
    """The scene that is held, and its renderer."""

    # Plants, set, rotation, whether it has surfaces and light, and the turn of the plant.
    key: tuple[str, int, int, bool, float]
    light: tuple[int, str, float]  # what the scene's own sky depends on
    assembled: AssembledScene
    renderer: Renderer


class FrameRenderer:
    """Renders the frames of a recipe in any order.

    The plants of one set, the surfaces of one cultivar and the renderer of one scene are held at a time, so
    memory does not grow with the number of frames; in ascending order of the indices each is made once.

    Attributes:
        resolved: the recipe with the files that it names; also as `recipe` and `cultivar`.
        setups: what each frame depends on.
        views: the cameras of the frames.
        culled: whether triangles that affect no frame are left out of scenes; False is for comparison. Scenes
            are never culled if views depend on the plants, if there are lamps, or if there is a stand, which
            cameras see from all sides.

    Args:
        recipe: a recipe, its resolved form, a shipped name or a path.
        renderer: makes the renderer of a scene; None for Mitsuba.
        culled: see the attribute.
        on_stage: called with the name of each stage that takes long, when it begins.
        allow_code: whether the recipe's code may run: views of the kind "function".

    Raises:
        InputError: the recipe or a file that it names is missing or not valid.
    """

    def __init__(
        self,
        recipe: Recipe | ResolvedRecipe | str | Path,
        renderer: RendererFactory | None = None,
        *,
        culled: bool = True,
        on_stage: Callable[[str], None] | None = None,
        allow_code: bool = False,
    ) -> None:
        self.resolved = resolve_recipe(recipe, allow_code=allow_code)
        self.recipe, self.cultivar = self.resolved.recipe, self.resolved.cultivar
        self.setups = FrameSetups(self.resolved)
        self.views = CameraViews(self.setups)
        sees_all = self.views.depends_on_scene or self.recipe.stand is not None or self.recipe.lamps
        self.culled = culled and not sees_all
        self._renderer_factory = renderer or mitsuba_renderer
        self._near_plants = NearPlants(self.views, self._renderer_factory)
        self._on_stage = on_stage or (lambda _: None)
        self._builders: tuple[str, SceneBuilder] | None = None
        self._held: _HeldScene | None = None
        self._turntable = TurntableScenes()
        self._skies: dict[tuple[int, str, str], Sky | None] = {}
        self._surfaces = SurfaceFactory()
        self._exposures = FrameExposures(self.frames_of_scene, self._meter)

    def render(self, spec: FrameSpec, outputs: Sequence[str], quality: str | Quality = "standard") -> Frame:
        """Render one frame.

        Args:
            spec: the frame, from `recipe.plan.frame(index)`.
            outputs: names from `OUTPUTS`.
            quality: "draft", "standard", "reference", or a `Quality`.

        Raises:
            InputError: an output needs a stereo partner or a depth camera, and the recipe has none.
        """
        setup = self.setups.at(spec)
        if any(OUTPUTS[name].traced for name in outputs):
            # A locked exposure needs the scene of another frame, which is not held beside this one's.
            self._exposures.at(spec, setup, quality)
        held = self._scene_of(spec, setup, needs_surfaces(outputs))
        return self.render_view(spec, held.assembled, held.renderer, outputs, quality, light=held.light)

    def render_view(
        self,
        spec: FrameSpec,
        assembled: AssembledScene,
        renderer: Renderer,
        outputs: Sequence[str],
        quality: str | Quality = "standard",
        *,
        view: View | None = None,
        seed: int | None = None,
        light: tuple[int, str, float] = (-1, "", 0.0),
    ) -> Frame:
        """Render a frame in a scene of the caller's, from another view or with another seed if given.

        Args:
            spec: the frame.
            assembled: a scene of the frame's plants, perhaps edited.
            renderer: of that scene.
            outputs: names from `OUTPUTS`.
            quality: as of `render`.
            view: of the main camera; the frame has no flow then.
            seed: of light transport and noise.
            light: set, `FrameSetup.light` and turn that the scene's own sky is for.
        """
        setup, traced = self.setups.at(spec), any(OUTPUTS[name].traced for name in outputs)
        scene, visible, plan = assembled.scene, renderer.visible_points, self.recipe.plan
        shown, flow = view or self.views.view(spec, scene, visible), None
        if "flow" in outputs and view is None and spec.step + 1 < plan.frames:
            later = plan.frame(spec.index + plan.cameras)
            flow = self.views.camera(later, self.views.view(later, scene, visible))
        exposure = self._exposures.at(spec, setup, quality) if traced else None
        frame_sky: Sky | Literal["scene"] | None = (
            self.sky(spec) if traced and light != (spec.set, setup.light, turn_of(spec, setup)) else "scene"
        )
        self._on_stage(f"rendering frame {spec.index}")
        frame = renderer.render(
            self.views.camera(spec, shown),
            outputs,
            quality,
            frame_seed(self.recipe.seed, spec.index) if seed is None else seed,
            partners=replace(self.views.partners(spec, outputs, shown), flow=flow),
            sky=frame_sky,
            exposure_control=None if exposure is None else exposure.locked or exposure.control,
        )
        described = {**frame.metadata, **assembled.statistics}
        if exposure is not None and "auto_exposure" in described:
            described["auto_exposure"] = exposure.to_metadata(described["auto_exposure"])
        described |= turn_metadata(spec, setup) if view is None else {}
        if view is None and (target := self.views.target(spec, scene)) is not None:
            organ = scene.mesh.instances[target]
            described["target"] = {"instance": target + 1, "plant": organ.plant, "kind": organ.kind}
        return Frame(frame.images, described)

    def camera(self, spec: FrameSpec, quality: str | Quality = "standard", *, traced: bool = True) -> Camera:
        """The camera of a frame, at its pose, with the exposure of the frame.

        Args:
            spec: the frame.
            quality: with which the frame is rendered; an automatic exposure depends on its bounces.
            traced: whether the camera takes photographs. Without, an automatic exposure is not metered, which
                takes the scene with its light: the camera then has an exposure of 1 ms. Poses, intrinsics and
                labels do not depend on it, but with a moving camera that has a rolling shutter.
        """
        setup = self.setups.at(spec)
        exposure = self._exposures.at(spec, setup, quality) if traced else None
        if exposure is None and not self.views.depends_on_scene:
            return self.views.camera(spec)
        held = self._scene_of(spec, setup, traced=exposure is not None)
        camera = self._camera_in(held, spec)
        if exposure is None:
            return camera
        from pepperscene.camera.image.auto_exposure import with_exposure

        return with_exposure(camera, exposure.locked or self._meter(spec, quality))

    def _meter(self, spec: FrameSpec, quality: str | Quality) -> ChosenExposure:
        """The exposure that a frame's own light gives it, as in the frame itself."""
        setup = self.setups.at(spec)
        held, seed = self._scene_of(spec, setup, traced=True), frame_seed(self.recipe.seed, spec.index)
        camera, control = self._camera_in(held, spec), setup.recipe.metering.control()
        return held.renderer.meter(camera, control, seed, self.sky(spec), quality)

    def _camera_in(self, held: _HeldScene, spec: FrameSpec) -> Camera:
        view = self.views.view(spec, held.assembled.scene, held.renderer.visible_points)
        return self.views.camera(spec, view)

    def scene(self, spec: FrameSpec, *, traced: bool = True) -> Scene:
        """The scene of a frame; without `traced` it has no surfaces and no sky, which labels do not need."""
        return self.assemble(spec, traced=traced).scene

    def assemble(
        self, spec: FrameSpec, *, traced: bool = True, prepare: SurfacePreparation | None = None
    ) -> AssembledScene:
        """The scene of a frame, as `scene`, with its statistics.

        `prepare` is called with its surfaces, if they are made beside the row.
        """
        setup = self.setups.at(spec)
        builder, others = self.builder(spec), self.frames_of_scene(spec)
        # Surfaces and sky do not depend on the row, whose contacts keep one core busy.
        beside = FunctionWorker() if traced and builder.shares_work(spec.set, spec.rotation) else None
        optics = functools.partial(self._optics, spec, setup, others)
        with beside or nullcontext(), ThreadPoolExecutor(1) as pool:
            pending = None
            if beside is not None:
                # Plants are made by two processes as well, so they come first.
                builder.plants(spec.set, beside)
                pending = pool.submit(optics, prepare, beside)
            near = self.grow(spec)
            mesh = self._culled_mesh(near, others)
        surfaces, sky = None, None
        if traced:
            surfaces, sky = optics() if pending is None else pending.result()
        return self._assembled(spec, near, mesh, surfaces, sky)

    def grow(self, spec: FrameSpec) -> NearScene:
        """The objects of a frame's scene, complete."""
        setup = self.setups.at(spec)
        builder, others = self.builder(spec), self.frames_of_scene(spec)
        coarse_only = self.built_scene(spec)
        return self._near_plants.grow((setup.plants, spec.set, spec.rotation), coarse_only, builder, others)

    def optics(
        self, spec: FrameSpec, nm: tuple[float, float] | None = None
    ) -> tuple[dict[str, Surface], Sky | None]:
        """The surfaces of a frame's scene by name, and its sky; `nm` replaces the range of its cameras."""
        setup = self.setups.at(spec)
        if nm is None:
            return self._optics(spec, setup, self.frames_of_scene(spec))
        texture, stand = setup.recipe.skin_texture, setup.recipe.stand
        return make_surfaces(setup.cultivar, *nm, texture, stand), self.sky(spec)

    def finish(
        self, spec: FrameSpec, near: NearScene, optics: tuple[Mapping[str, Surface], Sky | None] | None
    ) -> AssembledScene:
        """The scene that `assemble` makes of the objects of `grow`, and of `optics` unless for labels."""
        mesh = self._culled_mesh(near, self.frames_of_scene(spec))
        return self._assembled(spec, near, mesh, *(optics or (None, None)))

    def _culled_mesh(self, near: NearScene, specs: Sequence[FrameSpec]) -> Mesh:
        """The mesh of a scene without what affects none of its frames, by all poses and the recipe's light.

        Outputs do not matter, so a frame's labels fit its colour, and no frame depends on others.
        """
        from pepperscene.scene import cull_mesh

        if not self.culled:
            return near.built.mesh
        reach = largest_light_reach([self.setups.at(spec) for spec in specs])
        return cull_mesh(near.built.mesh, self.views.frustums(specs), reach)

    def _assembled(
        self,
        spec: FrameSpec,
        near: NearScene,
        mesh: Mesh,
        surfaces: Mapping[str, Surface] | None,
        sky: Sky | None,
    ) -> AssembledScene:
        from pepperscene.scene import assemble_scene

        statistics = {
            "contacts": asdict(near.built.contacts),
            "geometry": {"triangles": len(mesh.faces), "of": len(near.built.mesh.faces)},
        }
        lamps = self.lamps(spec) if surfaces is not None else ()
        scene = assemble_scene(mesh, surfaces, sky, near.built.skeleton, lamps)
        if near.coarse is not None and self.views.depends_on_scene:
            self.views.continue_in(scene, near.views, near.coarse)
        return AssembledScene(scene, statistics)

    @property
    def current_scene(self) -> Scene | None:
        """The scene that is held, of the last frame; None before the first."""
        return None if self._held is None else self._held.assembled.scene

    def sky(self, spec: FrameSpec) -> Sky | None:
        """The daylight of a frame, or None if the recipe has none."""
        setup = self.setups.at(spec)
        # The crop shades the floor.
        key = (spec.set, setup.light, setup.plants)
        if key not in self._skies:
            self._skies = {key: self._make_sky(spec, setup)}
        return sky_at(self._skies[key], turn_of(spec, setup))

    def built_scene(self, spec: FrameSpec) -> BuiltScene:
        """The objects of a frame's scene, with coarse plants in all far rows, and nothing left out."""
        return self._turntable.scene(spec, self.setups.at(spec), self.builder(spec))

    def lamps(self, spec: FrameSpec) -> tuple[Lamp, ...]:
        """The lamps of a frame that stand in its scene."""
        return lamps_at(self.resolved.lamps, turn_of(spec, self.setups.at(spec)))

    def _make_sky(self, spec: FrameSpec, setup: FrameSetup) -> Sky | None:
        light = setup.recipe.daylight
        if light is None or light.illuminance_lx == 0:
            return None
        return sky_above(
            self.builder(spec),
            setup,
            spec,
            illuminance_lx=light.illuminance_lx,
            sun_azimuth_rad=light.sun_azimuth_rad,
            sun_elevation_rad=light.sun_elevation_rad,
            sun_fraction=light.sun_fraction,
            cloud_cover=light.cloud_cover,
        )

    def builder(self, spec: FrameSpec) -> SceneBuilder:
        """The builder of scenes with a frame's plants and greenhouse."""
        setup = self.setups.at(spec)
        if self._builders is None or self._builders[0] != setup.plants:
            self._builders = setup.plants, SceneBuilder(setup.recipe, setup.cultivar)
        return self._builders[1]

    def _scene_of(self, spec: FrameSpec, setup: FrameSetup, traced: bool) -> _HeldScene:
        """The scene of a frame with its renderer."""
        key = (setup.plants, spec.set, spec.rotation, traced, turn_of(spec, setup))
        if self._held is None or self._held.key not in (key, (*key[:3], True, key[4])):
            # Release the old scene before making the new one.
            self._held = None
            self._on_stage("growing plants")
            prepare = prepare_for_mitsuba if self._renderer_factory is mitsuba_renderer else None
            assembled = self.assemble(spec, traced=traced, prepare=prepare)
            renderer = self._renderer_factory(assembled.scene)
            self._held = _HeldScene(key, (spec.set, setup.light, turn_of(spec, setup)), assembled, renderer)
        return self._held

    def frames_of_scene(self, spec: FrameSpec) -> list[FrameSpec]:
        """All frames of the scene with the same plants in the same places, in the order of their indices."""
        setup = self.setups.at(spec)
        specs = [self.recipe.plan.frame(index) for index in self.recipe.plan.scene_indices(spec)]
        return [other for other in specs if self.setups.at(other).plants == setup.plants]

    def _optics(
        self,
        spec: FrameSpec,
        setup: FrameSetup,
        specs: Sequence[FrameSpec],
        prepare: SurfacePreparation | None = None,
        worker: FunctionWorker | None = None,
    ) -> tuple[dict[str, Surface], Sky | None]:
        """The surfaces of a scene over PAR and what any camera of its frames detects, and its sky."""
        distinct = {other.optics: other for other in map(self.setups.at, specs)}.values()
        cameras = [camera for other in distinct for camera in lit_cameras(other)]
        first, last = surface_range(camera.sensor for camera in cameras)
        surfaces = self._surfaces.surfaces(
            setup.cultivar, first, last, worker, setup.recipe.skin_texture, setup.recipe.stand
        )
        if worker is not None:
            # Its memory is not needed any more, while the row is still being made.
            worker.close()
        if prepare is not None:
            prepare(surfaces.values())
        return surfaces, self.sky(spec)

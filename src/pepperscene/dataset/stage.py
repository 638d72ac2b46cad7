"""From an index to a frame: the plants of its set, the scene of its rotation, the camera of its step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.equipment import camera_of, cover_of, cultivar_of, surface_grid
from pepperscene.dataset.plan import Shot
from pepperscene.dataset.planting import Planting
from pepperscene.dataset.recipe import Recipe
from pepperscene.dataset.seeds import Stream, frame_seed, generator
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS, PARTNERED, Frame

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.geometry import Mesh
    from pepperscene.materials import Surface
    from pepperscene.render import Quality
    from pepperscene.scene import Reach, Scene, Sight, Sky


class RendererLike(Protocol):
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


RendererFactory = Callable[["Scene"], RendererLike]


def mitsuba_renderer(scene: Scene) -> RendererLike:
    """The renderer of the render room, imported when first needed.

    Raises:
        SetupError: no JIT variant works on this machine.
    """
    from pepperscene.render import Renderer

    return Renderer(scene)


def check_partner(recipe: Recipe, outputs: Iterable[str]) -> None:
    """Whether a recipe has the stereo partner that outputs need.

    Raises:
        InputError: it has none.
    """
    needing = sorted(PARTNERED.intersection(outputs))
    if needing and recipe.camera.baseline_mm is None:
        raise InputError(
            recipe.name,
            "camera.baseline_mm",
            None,
            f"must be told for the output {needing[0]}, in millimetres",
        )


class Stage:
    """Renders the shots of a recipe, in any order, and keeps what neighbours share.

    The plants of one set and the renderer of one scene are held at a time, so that memory does not grow with
    the number of frames; going through the indices in ascending order makes each of them once.

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
        self.cultivar = cultivar_of(recipe)
        self._cover = cover_of(recipe)
        self._first_camera = camera_of(recipe)
        self._planting = Planting(recipe, self.cultivar)
        self._told: dict[str, Any] = {}
        self._scene: tuple[tuple[int, int, bool], RendererLike] | None = None
        self._begun: Future[dict[str, Surface]] | None = None

    def render(self, shot: Shot, outputs: Sequence[str], quality: str | Quality = "standard") -> Frame:
        """One frame.

        Args:
            shot: which one; `recipe.plan.shot(index)` gives it.
            outputs: names out of `OUTPUTS`.
            quality: "draft", "standard" or "reference", or one of your own.

        Raises:
            InputError: an output needs a stereo partner, and the recipe has none.
        """
        others = self.others(shot, outputs)
        traced = any(OUTPUTS[name].traced for name in outputs)
        seed = frame_seed(self.recipe.seed, shot.index)
        renderer = self._renderer(shot, traced, quality)
        # What needs no other camera is asked for without: a renderer need not know of them.
        further = {"others": others} if others else {}
        frame = renderer.render(self.camera(shot), outputs=outputs, quality=quality, seed=seed, **further)
        return Frame(frame.images, {**frame.facts, **self._told})

    def camera(self, shot: Shot) -> Camera:
        """The camera of a shot, at its place on the arc path, which leans with the row."""
        return self._first_camera.at_pose(self._poses[shot.step])

    def others(self, shot: Shot, outputs: Sequence[str]) -> dict[str, Camera]:
        """The cameras that outputs of a shot need besides its own, by what for.

        "flow" is the camera of the next step, not there at the path's end; "stereo" the partner, which looks
        the same way from the baseline's length to the right, at the same time and so by the same flash.

        Raises:
            InputError: an output needs a stereo partner, and the recipe has none.
        """
        check_partner(self.recipe, outputs)
        found = {}
        if "flow" in outputs and shot.step + 1 < self.recipe.plan.frames:
            found["flow"] = self._first_camera.at_pose(self._poses[shot.step + 1])
        if PARTNERED.intersection(outputs):
            found["stereo"] = self._partner.at_pose(self._partner_poses[shot.step])
        return found

    def scene(self, shot: Shot, *, traced: bool = True) -> Scene:
        """The scene of a shot.

        Args:
            shot: its set and rotation count.
            traced: False leaves out surfaces and sky, which labels and distances do not need.
        """
        from pepperscene.scene import assemble

        planted = self._planting.scene(shot.set, shot.rotation)
        mesh = self._visible(planted.mesh) if self.culled else planted.mesh
        self._told = {
            "contacts": asdict(planted.contacts),
            "geometry": {"triangles": len(mesh.faces), "of": len(planted.mesh.faces)},
        }
        if not traced:
            return assemble(mesh, skeleton=planted.skeleton)
        return assemble(mesh, self._surfaces, self._sky(shot.set), planted.skeleton)

    def _visible(self, mesh: Mesh) -> Mesh:
        """What the frames of a scene can tell of it.

        All poses and the recipe's light decide, whatever is asked for: a frame's labels fit to its colour,
        and no frame depends on the others.
        """
        from pepperscene.scene import culled

        return culled(mesh, self._sight, self._reach)

    def _renderer(self, shot: Shot, traced: bool, quality: str | Quality) -> RendererLike:
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
        if self._renderer_of is mitsuba_renderer:
            from pepperscene.render import begin, quality_of

            begin(self._first_camera, quality_of(quality))

    def _sky(self, which: int) -> Sky | None:
        from pepperscene.scene import partly_cloudy

        light = self.recipe.daylight
        if light is None or light.illuminance_lx == 0:
            return None
        return partly_cloudy(
            generator(self.recipe.seed, Stream.SKY, which),
            illuminance_lx=light.illuminance_lx,
            sun_azimuth_rad=float(np.radians(light.sun_azimuth_deg)),
            sun_elevation_rad=float(np.radians(light.sun_elevation_deg)),
            sun_fraction=light.sun_fraction,
            cloud_cover=light.cloud_cover,
            cover=self._cover,
        )

    @cached_property
    def _sight(self) -> Sight:
        from pepperscene.scene import Sight, sight

        own = sight(self._first_camera, self._poses)
        if self.recipe.camera.baseline_mm is None:
            return own
        beside = sight(self._partner, self._partner_poses)
        return Sight(
            np.concatenate([own.normals, beside.normals]),
            np.concatenate([own.offsets, beside.offsets]),
            np.concatenate([own.places, beside.places]),
        )

    @cached_property
    def _reach(self) -> Reach:
        from pepperscene.scene import reach

        light, distance_m = self.recipe.daylight, self.recipe.path.distance_mm / 1e3
        if light is None or light.illuminance_lx == 0:
            return reach(self._first_camera, distance_m, 0.0)
        # As from a clear sky: a hazy cover only softens the disc's shadows.
        sun_lx = light.illuminance_lx * light.sun_fraction
        facing_lx = sun_lx / np.sin(np.radians(light.sun_elevation_deg)) if sun_lx > 0 else 0.0
        return reach(self._first_camera, distance_m, light.illuminance_lx - sun_lx, float(facing_lx))

    @cached_property
    def _surfaces(self) -> dict[str, Surface]:
        return self._made_surfaces() if self._begun is None else self._begun.result()

    def _made_surfaces(self) -> dict[str, Surface]:
        from pepperscene.materials import greenhouse_surfaces, organ_surfaces

        nm = surface_grid(self._first_camera.sensor)
        return {**organ_surfaces(self.cultivar, nm), **greenhouse_surfaces(nm)}

    @cached_property
    def _partner(self) -> Camera:
        """The stereo partner's camera; the one flash of the two stays where it is."""
        camera = self._first_camera
        if camera.flash is None:
            return camera
        right, down, forward = camera.flash.offset_m
        flash = replace(camera.flash, offset_m=(right - self._baseline_m, down, forward))
        return replace(camera, flash=flash)

    @cached_property
    def _partner_poses(self) -> NDArray[np.float64]:
        poses = self._poses.copy()
        poses[:, :3, 3] += self._baseline_m * poses[:, :3, 0]
        return poses

    @property
    def _baseline_m(self) -> float:
        assert (
            self.recipe.camera.baseline_mm is not None
        )  # asked for by `check_partner`, or where there is one
        return self.recipe.camera.baseline_mm / 1e3

    @cached_property
    def _poses(self) -> NDArray[np.float64]:
        from pepperscene.camera import arc_path

        path, house = self.recipe.path, self._planting.house
        first, last = (float(angle) for angle in np.radians(path.azimuth_deg))
        poses = arc_path(
            self.recipe.plan.frames,
            path.distance_mm / 1e3,
            (first, last),
            (path.height_mm[0] / 1e3, path.height_mm[1] / 1e3),
            float(np.radians(path.pitch_deg)),
        )
        # The arc keeps its distance from the row, wherever the row has leant to at that height.
        poses[:, 1, 3] -= [house.away(float(height)) for height in poses[:, 2, 3]]
        return poses

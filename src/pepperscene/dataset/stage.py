"""From an index to a frame: the plants of its set, the scene of its rotation, the camera of its step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.equipment import camera_of, cover_of, cultivar_of, surface_grid
from pepperscene.dataset.plan import Shot, rotated
from pepperscene.dataset.recipe import Recipe
from pepperscene.dataset.seeds import Stream, frame_seed, generator
from pepperscene.frame import OUTPUTS, Frame

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.geometry import Mesh
    from pepperscene.materials import Surface
    from pepperscene.scene import Scene, Sky


class RendererLike(Protocol):
    """What renders the views of one scene."""

    def render(
        self, camera: Camera, outputs: Sequence[str] = ..., quality: str = ..., seed: int = ...
    ) -> Frame:
        """One view."""


RendererFactory = Callable[["Scene"], RendererLike]


def mitsuba_renderer(scene: Scene) -> RendererLike:
    """The renderer of the render room, imported when first needed.

    Raises:
        SetupError: no JIT variant works on this machine.
    """
    from pepperscene.render import Renderer

    return Renderer(scene)


class Stage:
    """Renders the shots of a recipe, in any order, and keeps what neighbours share.

    The plants of one set and the renderer of one scene are held at a time, so that memory does not grow with
    the number of frames; going through the indices in ascending order makes each of them once.

    Args:
        recipe: what to show.
        renderer: makes the renderer of a scene.

    Raises:
        InputError: the cultivar, the cover or a part of the camera is not found or not valid.
    """

    def __init__(self, recipe: Recipe, renderer: RendererFactory | None = None) -> None:
        self.recipe = recipe
        self._renderer_of = renderer or mitsuba_renderer
        self.cultivar = cultivar_of(recipe)
        self._cover = cover_of(recipe)
        self._first_camera = camera_of(recipe)
        self._row: tuple[int, list[Mesh]] | None = None
        self._scene: tuple[tuple[int, int, bool], RendererLike] | None = None

    def render(self, shot: Shot, outputs: Sequence[str], quality: str = "standard") -> Frame:
        """One frame.

        Args:
            shot: which one; `recipe.plan.shot(index)` gives it.
            outputs: names out of `OUTPUTS`.
            quality: "draft", "standard" or "reference".
        """
        traced = any(OUTPUTS[name].traced for name in outputs)
        seed = frame_seed(self.recipe.seed, shot.index)
        renderer = self._renderer(shot, traced)
        return renderer.render(self.camera(shot), outputs=outputs, quality=quality, seed=seed)

    def camera(self, shot: Shot) -> Camera:
        """The camera of a shot, at its place on the arc path."""
        return self._first_camera.at_pose(self._poses[shot.step])

    def scene(self, shot: Shot, *, traced: bool = True) -> Scene:
        """The scene of a shot.

        Args:
            shot: its set and rotation count.
            traced: False leaves out surfaces and sky, which labels and distances do not need.
        """
        from pepperscene.scene import assemble, double_row

        plants, row = self._plants(shot.set), self.recipe.row
        mesh = double_row(
            rotated(plants[: row.plants_front], shot.rotation),
            rotated(plants[row.plants_front :], shot.rotation),
            spacing_m=row.spacing_mm / 1e3,
            gap_m=row.gap_mm / 1e3,
            shift_m=row.shift_mm / 1e3,
        )
        return assemble(mesh, self._surfaces, self._sky(shot.set)) if traced else assemble(mesh)

    def _renderer(self, shot: Shot, traced: bool) -> RendererLike:
        """The renderer of the shot's scene; one that can trace light serves labels as well."""
        if self._scene is not None:
            (held_set, held_rotation, held_traced), renderer = self._scene
            if (held_set, held_rotation) == (shot.set, shot.rotation) and held_traced >= traced:
                return renderer
            # The old scene goes before the new one comes.
            del renderer
            self._scene = None
        made = self._renderer_of(self.scene(shot, traced=traced))
        self._scene = ((shot.set, shot.rotation, traced), made)
        return made

    def _plants(self, which: int) -> list[Mesh]:
        """The meshes of a set's plants with their twine, the front row's first."""
        if self._row is None or self._row[0] != which:
            self._row = None
            count = self.recipe.row.plants_front + self.recipe.row.plants_back
            self._row = (which, [self._plant(which, number) for number in range(count)])
        return self._row[1]

    def _plant(self, which: int, number: int) -> Mesh:
        from pepperscene.geometry import mesh_plant
        from pepperscene.grammar import grow
        from pepperscene.scene import Twine, with_twine

        seed, twine = self.recipe.seed, self.recipe.twine
        plant = grow(self.cultivar, generator(seed, Stream.PLANT, which, number))
        mesh = mesh_plant(plant)
        if twine is None or twine.diameter_mm == 0:
            return mesh
        cord = Twine(twine.diameter_mm / 1e3, twine.turns_per_m)
        return with_twine(plant, mesh, cord, generator(seed, Stream.TWINE, which, number))

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
    def _surfaces(self) -> dict[str, Surface]:
        from pepperscene.materials import greenhouse_surfaces, organ_surfaces

        nm = surface_grid(self._first_camera.sensor)
        return {**organ_surfaces(self.cultivar, nm), **greenhouse_surfaces(nm)}

    @cached_property
    def _poses(self) -> NDArray[np.float64]:
        from pepperscene.camera import arc_path

        path = self.recipe.path
        first, last = (float(angle) for angle in np.radians(path.azimuth_deg))
        return arc_path(
            self.recipe.plan.frames,
            path.distance_mm / 1e3,
            (first, last),
            (path.height_mm[0] / 1e3, path.height_mm[1] / 1e3),
            float(np.radians(path.pitch_deg)),
        )

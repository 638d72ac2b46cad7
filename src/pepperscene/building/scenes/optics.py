"""The optics of scenes: the surfaces that cameras need, and how far lights reach that change their images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pepperscene.building.subprocess_rpc import FunctionWorker
from pepperscene.recipe.resolve.frame_setups import FrameSetup
from pepperscene.recipe.resolve.load_camera import GRID_STEP_NM
from pepperscene.units import NONE

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.cultivar import Cultivar
    from pepperscene.materials import Surface
    from pepperscene.scene import LightReach, Stand


SurfacePreparation = Callable[[Iterable["Surface"]], None]


def prepare_for_mitsuba(surfaces: Iterable[Surface]) -> None:
    """Compute what the Mitsuba renderer needs of surfaces; scenes that share them need it once."""
    from pepperscene.render import prepare_surfaces

    prepare_surfaces(surfaces)


class SurfaceFactory:
    """Makes the surfaces of cultivars; those of the last one are kept, because scenes share it."""

    def __init__(self) -> None:
        self._kept: tuple[tuple[Cultivar, float, float, str, Stand | None], dict[str, Surface]] | None = None

    def surfaces(
        self,
        cultivar: Cultivar,
        first_nm: float,
        last_nm: float,
        worker: FunctionWorker | None = None,
        skin: str = NONE,
        stand: Stand | None = None,
    ) -> dict[str, Surface]:
        """The surfaces of a cultivar, of the greenhouse and of a stand by name, see `make_surfaces`.

        A `worker` is another process that makes them, so that threads of this one can work meanwhile.
        """
        key = cultivar, first_nm, last_nm, skin, stand
        if self._kept is None or self._kept[0] != key:
            # Release the old surfaces before making new ones.
            self._kept = None
            made = None
            if worker is not None:
                # If it cannot be started or fails, they are made here.
                with suppress(OSError, EOFError):
                    made = worker.call(make_surfaces, *key)
            self._kept = key, make_surfaces(*key) if made is None else made
        return self._kept[1]


def make_surfaces(
    cultivar: Cultivar, first_nm: float, last_nm: float, skin: str = NONE, stand: Stand | None = None
) -> dict[str, Surface]:
    """The surfaces of a cultivar, of the greenhouse and of a stand by name, in this process."""
    from pepperscene.materials import greenhouse_surfaces, load_skin, organ_surfaces, stand_surfaces

    nm = np.arange(first_nm, last_nm + GRID_STEP_NM / 2, GRID_STEP_NM)
    texture = None if skin == NONE else load_skin(skin)
    of_stand = {} if stand is None else stand_surfaces(nm, stand.pot_colour, stand.backdrop_colour)
    return {**organ_surfaces(cultivar, nm, texture), **greenhouse_surfaces(nm), **of_stand}


def largest_light_reach(setups: Sequence[FrameSetup]) -> LightReach:
    """The largest reach of light in any of some frames."""
    from pepperscene.scene import combine_reaches

    distinct = {
        (setup.optics, setup.light, setup.recipe.views, setup.recipe.exposure_control): setup
        for setup in setups
    }
    return combine_reaches(
        [_light_reach(setup, camera) for setup in distinct.values() for camera in _exposures(setup)]
    )


def lit_cameras(setup: FrameSetup) -> list[Camera]:
    """The camera, and an imager of the depth camera with its projector as a flash."""
    depth_camera = setup.depth_camera
    if depth_camera is None:
        return [setup.camera]
    projector = depth_camera.projector
    flash = None if projector is None else projector.flood()
    return [setup.camera, replace(depth_camera.left, flash=flash)]


def _exposures(setup: FrameSetup) -> list[Camera]:
    """The cameras; that with automatic exposure has the shortest and the longest exposure."""
    control, (camera, *imagers) = setup.recipe.exposure_control, lit_cameras(setup)
    if control is None:
        return [camera, *imagers]
    return [*(replace(camera, exposure_s=limit_s) for limit_s in control.exposure_s), *imagers]


def _light_reach(setup: FrameSetup, camera: Camera) -> LightReach:
    from pepperscene.scene import light_reach

    light = setup.recipe.daylight
    distance_m = setup.recipe.views.subject_m
    if light is None or light.illuminance_lx == 0:
        return light_reach(camera, distance_m, 0.0)
    # As for a clear sky: a hazy cover only softens the sun's shadows.
    sun_lx = light.illuminance_lx * light.sun_fraction
    normal_lx = sun_lx / np.sin(light.sun_elevation_rad) if sun_lx > 0 else 0.0
    return light_reach(camera, distance_m, light.illuminance_lx - sun_lx, float(normal_lx))

"""The cameras of a frame with their lights, and how far these lights reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pepperscene.recipe.resolve.frame_setups import FrameSetup

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.scene import LightReach


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
    return [*(replace(camera, exposure_s=limit_us / 1e6) for limit_us in control.exposure_us), *imagers]


def _light_reach(setup: FrameSetup, camera: Camera) -> LightReach:
    from pepperscene.scene import light_reach

    light = setup.recipe.daylight
    distance_m = setup.recipe.views.subject_mm / 1e3
    if light is None or light.illuminance_lx == 0:
        return light_reach(camera, distance_m, 0.0)
    # As for a clear sky: a hazy cover only softens the sun's shadows.
    sun_lx = light.illuminance_lx * light.sun_fraction
    normal_lx = sun_lx / np.sin(np.radians(light.sun_elevation_deg)) if sun_lx > 0 else 0.0
    return light_reach(camera, distance_m, light.illuminance_lx - sun_lx, float(normal_lx))

"""Metering: the light of a scene in a reduced image, from which automatic exposure is computed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import SUBJECT_METERINGS, Camera, ExposureControl, metering_camera
from pepperscene.classes import PLANT_CLASSES
from pepperscene.render.aov.labels import class_ids, first_hits, instance_ids
from pepperscene.render.arrays import LocalCoordinates
from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import LightScene, sky_tables
from pepperscene.render.kernel_scene import KernelScene
from pepperscene.render.transport.denoise import denoised
from pepperscene.render.transport.path_lengths import needs_long_paths
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.scene import Scene

Images = NDArray[np.float32]

_SAMPLES: Final = 8
"""Per pixel, of all light. Chosen: with 4, which take two thirds of the time, one of some forty frames of
`randomised` with 320 x 240 pixels is 2.5 codes brighter than stated, with 8 it is .9. Without denoising, an
image of 16 samples of daylight is a fifth too dark, because the tone curve lowers the mean of noise."""
_RAYS: Final = 30_000
"""Least number of camera rays: pixels of smaller images get more samples. Chosen: in three images of 64 x 48
pixels, the stated grey is within 2 codes of the image's."""
_BRANCH: Final = 1 << 16
"""Spawn key below a frame's seed. Chosen: different from those of the frame's noise and samples."""


def metered_light(
    scene: Scene,
    light_scene_of: Callable[[float, float], LightScene],
    coordinates: LocalCoordinates,
    camera: Camera,
    seed: int,
    bounces: int = 2,
    most_bounces: int = 0,
) -> tuple[Images, Images]:
    """Trace daylight with the lamps, and then the flash, in a reduced image over the camera's field of view.

    The result depends on the arguments alone.

    Args:
        scene: everything that can be seen, and its sky.
        light_scene_of: the scene in the kernel over a range of wavelengths, in nanometres.
        coordinates: of the scene in the kernel.
        camera: lens, sensor, flash and pose; its exposure has no effect.
        seed: of the frame.
        bounces: scattering events after the first hit, as in the frame: by daylight, a greenhouse loses some
            per cent of its light without the second.
        most_bounces: likewise, of daylight, and of the flash where it needs long paths.

    Returns:
        Daylight, and the light of the flash while it is on, `(h, w, c)` each, electrons s-1 m-2 sr-1; zeros
        where there is no such light. The size is that of `metering_camera`.

    Raises:
        ValueError: a light is too strong for single precision.
    """
    small = metering_camera(camera)
    if small.flash is not None:
        # An exposure as long as the pulse does not average the flash with darkness.
        small = dataclasses.replace(small, exposure_s=small.flash.pulse_s)
    # Over the wavelengths of both lights, so that the frame itself uses the same scene in the kernel.
    response = spectral_response(small, scene)
    kernel_scene = light_scene_of(float(response.grid_nm[0]), float(response.grid_nm[-1]))
    rays, sky = camera_rays(small, coordinates), sky_tables(scene, response.grid_nm)
    # The frame's exposure, and so its mixture of both lights, is not known yet.
    samples = _SAMPLES * max(1, _RAYS // (_SAMPLES * small.width * small.height))
    long = Sampling(samples, samples, bounces, most_bounces=most_bounces)
    flash_alone = dataclasses.replace(response, lamps=None)
    is_long = needs_long_paths(dataclasses.replace(scene, sky=None), flash_alone)
    by_flash = long if is_long else dataclasses.replace(long, most_bounces=0)
    first, second = np.random.SeedSequence(seed, spawn_key=(_BRANCH,)).generate_state(2).tolist()

    daylight = flash = np.zeros((small.height, small.width, small.sensor.channels), np.float32)
    if sky is not None or response.lamps is not None:
        daylight = denoised(trace(kernel_scene, rays, response, None, sky, long, first))
    if small.flash is not None:
        flash = denoised(trace(kernel_scene, rays, flash_alone, small.flash, None, by_flash, second))
    return daylight, flash


def metered_subject(
    kernel: KernelScene, camera: Camera, control: ExposureControl
) -> NDArray[np.bool_] | None:
    """`(h, w)` whether the centre of each pixel shows a plant; None if the metering does not need it."""
    if control.metering not in SUBJECT_METERINGS:
        return None
    hits = first_hits(kernel.truth_scene(), camera_rays(camera, kernel.coordinates))
    mesh = kernel.scene.mesh
    return np.isin(class_ids(mesh, instance_ids(mesh, hits)), list(PLANT_CLASSES))

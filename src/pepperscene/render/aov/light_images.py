"""The outputs `irradiance` and `absorbed`: the PAR that the surface behind each pixel's centre gets.

A pixel is the mean of a few light paths from that point, as those of `pepperscene.render.absorbed` from
points of organs, without a filter: the mean over many pixels has no bias.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.arrays import device_float, device_uint
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.kernel.scene import LightScene
from pepperscene.render.transport.light_meters import LANES, Measured, meter_light, meter_tables
from pepperscene.render.transport.lights import FrameTables
from pepperscene.render.transport.owen_sobol import OwenSobol
from pepperscene.render.transport.samples import Samples
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene
from pepperscene.spectra.wavebands import PAR

MEASURED: Final[dict[str, Measured]] = {"irradiance": "received", "absorbed": "absorbed"}
"""What is measured, by the name of the output."""
_SAMPLES: Final = 8  # chosen: of a pixel


def light_images(
    kernel: LightScene, scene: Scene, rays: CameraRays, names: list[str], seed: int
) -> dict[str, NDArray[np.float32]]:
    """`(h, w)` images of PAR, W m-2 of both sides of the surfaces together; nan where there are none.

    Args:
        kernel: the scene with the optics of its surfaces over PAR.
        scene: the same scene under the sky of the frame.
        rays: of the camera's labels.
        names: of the outputs.
        seed: of the samples, the same for both outputs.
    """
    tables, total = meter_tables(kernel, scene, [PAR]), rays.width * rays.height
    images = {name: np.empty(total, np.float32) for name in names}
    for name, image in images.items():
        for start in range(0, total, LANES // _SAMPLES):
            end = min(start + LANES // _SAMPLES, total)
            image[start:end] = _pixels(tables, rays, MEASURED[name], seed, (start, end))
    return {name: image.reshape(rays.height, rays.width) for name, image in images.items()}


def _pixels(
    tables: FrameTables, rays: CameraRays, measured: Measured, seed: int, part: tuple[int, int]
) -> NDArray[np.float32]:
    """Light at the first hits of pixels from one number to another."""
    mi, dr = mitsuba_modules()
    lane = dr.arange(mi.UInt32, (part[1] - part[0]) * _SAMPLES)
    number = lane // _SAMPLES
    pixel = number + device_uint(part[0])
    row, half = pixel // rays.device_width, mi.Float(0.5)
    origin, direction = rays.centre_rays(pixel - row * rays.device_width, row, half, half)
    active, si, hit = tables.scene.intersect(mi.Ray3f(origin, direction), coherent=True)
    samples = Samples.on_surfaces(tables, OwenSobol(pixel, lane - number * _SAMPLES, device_uint(seed)))
    limits = [(device_float(PAR.first_nm), device_float(PAR.last_nm))]
    power, _ = meter_light(tables, samples, si, hit, active, limits, measured)
    light = dr.select(active, dr.maximum(power, 0.0), dr.nan)
    dr.eval(light)
    mean: NDArray[np.float32] = np.array(dr.block_reduce(dr.ReduceOp.Add, light / _SAMPLES, _SAMPLES))
    return mean

"""The output `albedo`: the diffuse reflectance of surfaces, in the colours of the camera, without noise.

A surface's albedo is `SurfacePoint.diffuse_reflectance`. A channel of the sensor sees its mean over
wavelength, weighted with the channel's response times the camera's reference light, so that a white diffuser
is 1 in all channels: the white balance is exact, whatever the photograph's is. The colour matrix of the
photograph then turns them into linear sRGB. So the light of the scene has no influence.

A pixel is the mean over fixed points of its area, with the lens geometry of the labels and everything in
focus. Points that hit no surface count as 0.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, colour_transform, reference_light
from pepperscene.render.arrays import device_array, device_uint
from pepperscene.render.kernel.camera import CameraRays, detected_wavelengths
from pepperscene.render.kernel.scene import LightScene
from pepperscene.render.surface.optics import STEP_NM, Optics
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene

_POINTS: Final = 16
"""Chosen: of every pixel, as a lattice whose points differ in both coordinates."""
_LATTICE_STEP: Final = 7
_LANES: Final = 1 << 20  # chosen: rays that are traced at a time; their colours take 12 MB


def albedo_image(kernel_scene: LightScene, scene: Scene, camera: Camera, rays: CameraRays) -> NDArray[Any]:
    """`(h, w, c)` float16 albedo, linear sRGB, or of the single channel of a monochrome sensor.

    Args:
        kernel_scene: with the optics of the scene's surfaces, over any wavelengths.
        scene: the same scene.
        camera: sensor, reference light and colour matrix.
        rays: of the camera's labels.

    Raises:
        ValueError, InputError: as `colour_transform`.
    """
    channels = camera.sensor.channels
    matrix = colour_transform(camera)[1] if channels == 3 else np.eye(1)
    optics = _reference_optics(kernel_scene, scene, camera)
    total = rays.width * rays.height
    image = np.empty((total, channels), np.float16)
    points = device_array(_pixel_points())
    for start in range(0, total, _LANES // _POINTS):
        end = min(start + _LANES // _POINTS, total)
        sums = np.stack(_sum_points(kernel_scene, optics, rays, points, start, end), axis=-1)
        image[start:end] = _transform(sums / np.float32(_POINTS), matrix)
    return image.reshape(rays.height, rays.width, channels)


def _reference_optics(kernel_scene: LightScene, scene: Scene, camera: Camera) -> Optics:
    """The surfaces in the colours that the sensor sees under the reference light."""
    grid = detected_wavelengths(camera.sensor)
    # The trapezoidal rule, as for the light of the photograph.
    steps = np.full(grid.size, STEP_NM)
    steps[[0, -1]] *= 0.5
    light = steps * reference_light(camera).at(grid)
    weights = camera.sensor.electrons_per_joule(grid).T * light[:, None]
    return kernel_scene.optics.with_colours(scene.surfaces, grid, weights)


def _sum_points(
    scene: LightScene, optics: Optics, rays: CameraRays, points: Any, start: int, end: int
) -> list[NDArray[np.float32]]:
    """`(end - start,)` sum of each channel over the points of pixels from one number to another."""
    mi, dr = mitsuba_modules()
    lane = dr.arange(mi.UInt32, (end - start) * _POINTS)
    number = lane // _POINTS
    at = dr.gather(mi.Point2f, points, lane - number * _POINTS)
    pixel = number + device_uint(start)
    row = pixel // rays.device_width
    origin, direction = rays.centre_rays(pixel - row * rays.device_width, row, at.x, at.y)
    active, si, hit = scene.intersect(mi.Ray3f(origin, direction), coherent=True)
    point = scene.surface_point(si, hit, active, optics, rays.footprint(si))
    values = list(dr.select(active, point.diffuse_reflectance(), 0.0))
    # Evaluate all channels in one kernel: reduced separately, each would run the kernel again.
    dr.eval(values)
    sums = [dr.block_reduce(dr.ReduceOp.Add, value, _POINTS) for value in values]
    dr.eval(sums)
    return [np.array(channel) for channel in sums]


def _pixel_points() -> NDArray[np.float32]:
    """`(16, 2)` points of a pixel, in [0, 1]."""
    number = np.arange(_POINTS)
    points = np.stack([number, number * _LATTICE_STEP % _POINTS], axis=1)
    return ((points + 0.5) / _POINTS).astype(np.float32)


def _transform(colours: NDArray[np.float32], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n, c)` colours after a colour matrix.

    Channel by channel: BLAS splits such products between threads, and its last bits depend on their number.
    """
    result = np.zeros(colours.shape)
    for channel, weight in np.ndindex(matrix.shape):
        result[:, channel] += matrix[channel, weight] * colours[:, weight]
    return result

"""Direct light of a depth camera's projector: its dots at first hits, with a shadow ray for each sample.

It is scattered by the BSDF of the surface, over the projector's own spectrum. Light of the projector that is
scattered more than once has hardly any contrast left, and is traced as that of a flash (`Projector.flood`).
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Projector
from pepperscene.render.arrays import device_array, device_float
from pepperscene.render.kernel.camera import CameraRays, RayPose, SpectralResponse
from pepperscene.render.kernel.scene import LightScene
from pepperscene.render.transport.accumulate import sum_samples
from pepperscene.render.transport.lights import FrameTables, frame_tables
from pepperscene.render.transport.samples import Samples
from pepperscene.render.variant import mitsuba_modules

Images = NDArray[np.float32]

_MIN_DISTANCE: Final = 1e-4  # local units: chosen, as of a flash
PROJECTED_SAMPLES: Final = 16
"""Per pixel, at least. Chosen: a dot covers one or two pixels, whose light is then within 3 %."""


class ProjectorSampler:
    """The dots of a projector in the kernel, at a fixed place in the axes of a camera.

    Args:
        projector: the device, at its place in the camera's axes.
        rays: of the camera.
    """

    def __init__(self, projector: Projector, rays: CameraRays) -> None:
        mi, dr = mitsuba_modules()
        rows, columns = projector.grid
        right, down = projector.half_slopes
        # A border of dots behind the projector, so that each cell has eight neighbours.
        directions = np.pad(projector.directions(), ((1, 1), (1, 1), (0, 0)))
        directions[[0, -1], :, 2] = directions[:, [0, -1], 2] = -1.0
        self._directions = device_array(directions)
        self._columns, self._rows = columns, rows
        self._per_slope = device_float(columns / (2.0 * right)), device_float(rows / (2.0 * down))
        self._sharpness = device_float(0.5 / projector.dot_deviation_rad**2)
        # Divided by squared distances in local units.
        self._intensity = device_float(projector.dot_intensity / rays.unit_m**2)
        offset = mi.Vector3f(*(float(x / rays.unit_m) for x in projector.offset_m))
        dr.make_opaque(offset)
        self._offset = offset

    def place(self, pose: RayPose) -> Any:
        """The projector's place for a camera at a pose, local coordinates."""
        return pose.centre + pose.to_world(self._offset)

    def irradiance(self, p: Any, pose: RayPose) -> Any:
        """W m-2 across the beam at points, over all wavelengths."""
        mi, dr = mitsuba_modules()
        to_point = _to_camera(pose, p - self.place(pose))
        square = dr.maximum(dr.squared_norm(to_point), _MIN_DISTANCE**2)
        direction = to_point * dr.rsqrt(square)
        # The cell of the direction, and its neighbours: a dot reaches no further.
        ahead = direction.z > 1e-3
        z = dr.select(ahead, direction.z, 1.0)
        column = dr.floor((direction.x / z) * self._per_slope[0] + 0.5 * self._columns)
        row = dr.floor((direction.y / z) * self._per_slope[1] + 0.5 * self._rows)
        # Outside the field, the cells of the border are the nearest.
        column = mi.Int32(dr.clip(column, -1.0, float(self._columns)))
        row = mi.Int32(dr.clip(row, -1.0, float(self._rows)))
        total = mi.Float(0.0)
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                x = dr.clip(column + right, -1, self._columns) + 1
                y = dr.clip(row + down, -1, self._rows) + 1
                # At the border two neighbours can be the same cell, whose dots are behind.
                dot = dr.gather(mi.Vector3f, self._directions, mi.UInt32(y * (self._columns + 2) + x))
                total += dr.exp(-self._sharpness * dr.squared_norm(direction - dot))
        return dr.select(ahead, total * self._intensity / square, 0.0)


def _to_camera(pose: RayPose, vector: Any) -> Any:
    """Turn a vector from world axes to those of a camera at a pose."""
    fixed = vector if pose.motion is None else pose.motion.rotated(vector, -pose.time)
    return pose.rotation.T @ fixed


def projected_light(
    scene: LightScene,
    rays: CameraRays,
    response: SpectralResponse,
    projector: Projector,
    samples: int,
    seed: int,
) -> Images:
    """`(h, w, c)` direct light of a projector, electrons s-1 m-2 sr-1, as the mean of samples of each pixel.

    Args:
        scene: geometry and materials over the wavelengths of the response.
        rays: of the camera.
        response: of the camera; its grid holds the projector's wavelengths.
        projector: the device, at its place in the camera's axes.
        samples: per pixel.
        seed: of the samples.
    """
    power = projector.spectral_power(response.grid_nm)
    tables = frame_tables(scene, rays, dataclasses.replace(response, flash=power), None, None)
    if not power.any():
        return np.zeros((rays.height, rays.width, tables.channels), np.float32)
    sampler = ProjectorSampler(projector, rays)
    # Electrons per joule, by channel.
    per_joule = (response.electrons_per_joule * (response.trapezoid_nm * power)[:, None]).sum(axis=0)
    weights = [device_float(value) for value in per_joule]

    def dots(tables: FrameTables, drawn: Samples) -> list[list[Any]]:
        return [_scattered_dots(tables, drawn, sampler, weights)]

    sums = sum_samples(tables, None, 0, samples, seed, dots)
    return np.stack(sums, axis=-1).reshape(rays.height, rays.width, -1) / np.float32(samples)


def _scattered_dots(
    tables: FrameTables, samples: Samples, sampler: ProjectorSampler, weights: list[Any]
) -> list[Any]:
    """Light of the projector that first hits scatter towards the camera: c values."""
    mi, dr = mitsuba_modules()
    active, si, hit = tables.scene.intersect(samples.ray, coherent=True)
    point = tables.scene.surface_point(si, hit, active, tables.flash_optics, tables.rays.footprint(si))
    place = sampler.place(samples.pose)
    irradiance = sampler.irradiance(si.p, samples.pose)
    value, _ = point.eval_pdf(si.to_local(dr.normalize(place - si.p)))
    lit = active & (irradiance > 0.0) & dr.any(value > 0.0)
    lit &= ~tables.scene.scene.ray_test(si.spawn_ray_to(place), mi.Bool(True), lit)
    return [dr.select(lit, value[k] * irradiance * weight, 0.0) for k, weight in enumerate(weights)]

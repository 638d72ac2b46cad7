"""The camera inside the kernel: its rays, shared by colour and labels, and its spectral response."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, Motion, Sensor
from pepperscene.camera.sensor.rows import RowWindows, row_strips
from pepperscene.render.arrays import (
    WORLD,
    LocalCoordinates,
    device_array,
    device_float,
    device_uint,
)
from pepperscene.render.kernel.lamps import FrameLamps, frame_lamps
from pepperscene.render.surface.optics import STEP_NM
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene

_MIN_FOOTPRINT_COSINE: Final = 0.05
"""Chosen: surfaces seen at less than 3 degrees count as seen at 3, since curved ones have no such pixels."""


@dataclass(frozen=True, eq=False)
class RayMotion:
    """Motion of the rays of a camera, and the times at which the rows of its image are exposed.

    Attributes:
        begin, length: `(h,)` first time of each row and its duration, seconds; see `RowWindows`.
        velocity: local units per second.
        axis, speed: unit axis of the rotation in world axes, and radians per second.
    """

    begin: Any
    length: Any
    velocity: Any
    axis: Any
    speed: Any

    def times(self, row: Any, fraction: Any) -> Any:
        """Times in the windows of rows, at fractions in [0, 1] of them."""
        mi, dr = mitsuba_modules()
        begin, length = (dr.gather(mi.Float, table, row) for table in (self.begin, self.length))
        return begin + fraction * length

    def rotated(self, vector: Any, time: Any) -> Any:
        """A vector after the rotation from time 0, as `Motion.rotate`."""
        _, dr = mitsuba_modules()
        angle = self.speed * time
        across = vector - dr.dot(vector, self.axis) * self.axis
        versine = 2.0 * dr.square(dr.sin(0.5 * angle))
        return vector + dr.sin(angle) * dr.cross(self.axis, vector) - versine * across


@dataclass(frozen=True, eq=False)
class RayPose:
    """The pose of a camera, or one for each ray of a moving camera."""

    rotation: Any
    origin: Any  # local coordinates
    motion: RayMotion | None = None
    time: Any = None  # seconds, with motion

    def to_world(self, vector: Any) -> Any:
        """Turn a vector from camera axes to world axes."""
        fixed = self.rotation @ vector
        return fixed if self.motion is None else self.motion.rotated(fixed, self.time)

    @property
    def centre(self) -> Any:
        """Projection centre, local coordinates."""
        return self.origin if self.motion is None else self.origin + self.motion.velocity * self.time


@dataclass(frozen=True, eq=False)
class CameraRays:
    """Rays of a camera; the pose is kernel data, so a moved camera reuses the compiled code.

    Attributes:
        width, height: of the image, pixels.
        device_width: the width as kernel data, so that another image size compiles nothing.
        slopes: `((h + 1) * (w + 1) * 2,)` undistorted (x/z, y/z) at the pixel corners; those of one row of a
            line scanner.
        row_stride: from the slopes of a row to those of the next, as kernel data; 0 for a line scanner.
        rotation: camera to world, at time 0 if the camera moves.
        origin: projection centre in local coordinates, at time 0.
        pixel_area: of a pixel at the principal point, at distance 1: the product of its sides' slopes.
        unit_m: of the local coordinates.
        focus_distance: to the plane in focus along the optical axis, local units; None: all is in focus.
        aperture_radius: of the entrance pupil, local units.
        motion: None if all rays have one pose.
    """

    width: int
    height: int
    device_width: Any
    slopes: Any
    row_stride: Any
    rotation: Any
    origin: Any
    pixel_area: Any
    unit_m: float = 1.0
    focus_distance: Any = None
    aperture_radius: Any = None
    motion: RayMotion | None = None

    def pose(self, row: Any, next_1d: Callable[[], Any]) -> RayPose:
        """The pose that rays through a row start from; `next_1d` is called only if the camera moves."""
        if self.motion is None:
            return RayPose(self.rotation, self.origin)
        return RayPose(self.rotation, self.origin, self.motion, self.motion.times(row, next_1d()))

    def footprint(self, si: Any) -> Any:
        """Area that a pixel covers of the surface at first hits, squared local units.

        That of a pixel at the principal point, seen from there; for others and for a pupil it is close.
        """
        _, dr = mitsuba_modules()
        return dr.square(si.t) * self.pixel_area / dr.maximum(dr.abs(si.wi.z), _MIN_FOOTPRINT_COSINE)

    def centre_rays(self, column: Any, row: Any, dx: Any, dy: Any) -> tuple[Any, Any]:
        """Origins and unit world directions through points (dx, dy) in [0, 1]^2 of pixels.

        They start at the pupil's centre, in the middle of their row's time. Exact for a pinhole, and off by
        less than 1e-6 rad if the distortion is smooth over a pixel.
        """
        mi, dr = mitsuba_modules()
        pose = self.pose(row, lambda: mi.Float(0.5))
        return pose.centre, dr.normalize(pose.to_world(self._camera_directions(column, row, dx, dy)))

    def sample_rays(
        self, pose: RayPose, column: Any, row: Any, point: Any, next_2d: Callable[[], Any]
    ) -> tuple[Any, Any]:
        """Origins and unit world directions of rays from a pose through points in [0, 1]^2 of pixels.

        With a plane in focus, rays start at random points of the entrance pupil and meet in that plane (the
        thin lens of Cook, Porter & Carpenter 1984). `next_2d` is called only then.
        """
        mi, dr = mitsuba_modules()
        direction = self._camera_directions(column, row, point.x, point.y)
        if self.focus_distance is None:
            return pose.centre, dr.normalize(pose.to_world(direction))
        pupil = self.aperture_radius * mi.warp.square_to_uniform_disk_concentric(next_2d())
        start = mi.Vector3f(pupil.x, pupil.y, 0.0)
        direction = dr.normalize(pose.to_world(self.focus_distance * direction - start))
        return pose.centre + pose.to_world(start), direction

    def _camera_directions(self, column: Any, row: Any, dx: Any, dy: Any) -> Any:
        """Directions (x/z, y/z, 1) in camera axes, bilinear between the pixel corners."""
        mi, dr = mitsuba_modules()
        first, width = row * self.row_stride + column, self.device_width
        a, b, c, d = (
            dr.gather(mi.Point2f, self.slopes, first + offset) for offset in (0, 1, width + 1, width + 2)
        )
        slope = dr.lerp(dr.lerp(a, b, dx), dr.lerp(c, d, dx), dy)
        return mi.Vector3f(slope.x, slope.y, 1.0)


def camera_rays(
    camera: Camera, coordinates: LocalCoordinates = WORLD, slopes: Any | None = None
) -> CameraRays:
    """Transfer a camera's lens and pose to the device, in local coordinates.

    `slopes` are those of earlier rays of the same lens and image size, which are not transferred again.
    """
    mi, dr = mitsuba_modules()
    if slopes is None:
        slopes = device_array(_single_slopes(camera))
    rotation = mi.Matrix3f(np.asarray(camera.pose[:3, :3], np.float32))
    origin = mi.Point3f(*(float(x) for x in coordinates.from_world(camera.pose[:3, 3])))
    dr.make_opaque(rotation, origin)
    width, matrix = device_uint(camera.width), camera.intrinsics
    row_stride = device_uint(0 if camera.sensor.line_scan else camera.width + 1)
    pixel_area = device_float(1.0 / (matrix[0, 0] * matrix[1, 1]))
    rays = CameraRays(
        camera.width,
        camera.height,
        width,
        slopes,
        row_stride,
        rotation,
        origin,
        pixel_area,
        coordinates.unit_m,
    )
    if camera.focus_m is None:
        return rays
    focus_distance, aperture_radius = (
        mi.Float(float(length / rays.unit_m)) for length in (camera.focus_m, camera.aperture_radius_m)
    )
    dr.make_opaque(focus_distance, aperture_radius)
    return replace(rays, focus_distance=focus_distance, aperture_radius=aperture_radius)


def _single_slopes(camera: Camera) -> NDArray[np.float32]:
    """The `ray_slopes` in single precision, converted strip by strip."""
    corners = 2 if camera.sensor.line_scan else camera.height + 1
    slopes = np.empty((corners, camera.width + 1, 2), np.float32)
    for rows in row_strips(camera.width + 1, corners):
        slopes[rows] = camera.ray_slopes(rows)
    return slopes


def moving_rays(rays: CameraRays, motion: Motion, windows: RowWindows) -> CameraRays:
    """The rays of a camera that moves, each at a time in its row's window.

    `rays` are those of time 0.
    """
    mi, dr = mitsuba_modules()
    velocity = mi.Vector3f(*(float(x / rays.unit_m) for x in motion.velocity_m_s))
    axis, speed = mi.Vector3f(*(float(x) for x in motion.axis)), mi.Float(motion.angular_speed_rad_s)
    dr.make_opaque(velocity, axis, speed)
    begin, length = device_array(windows.begin_s), device_array(windows.length_s)
    return replace(rays, motion=RayMotion(begin, length, velocity, axis, speed))


def label_rays(rays: CameraRays, camera: Camera) -> CameraRays:
    """The rays of a camera's ground truth.

    They are those of time 0, or of the middle of each row's exposure if the rows have poses of their own.
    """
    if camera.motion is None or not camera.rows_move:
        return rays
    return moving_rays(rays, camera.motion, camera.shutter.instants())


_NEGLIGIBLE_RESPONSE: Final = 1e-5
"""Chosen: a response below this fraction of its peak is left out; the error is below 1e-5."""
_STRONGEST_LIGHT: Final = 1e27
"""Electrons s-1 m-2 (sr-1): chosen, ten million times a flash of 200 klx at 50 cm, and above the infrared of
a sun on the horizon. Single precision ends at 3e38; next to a flash light is 1e8 times stronger, and mirrors
concentrate that another 1e3 times."""
_FAINTEST_FLASH: Final = 1e-10
"""Chosen: a flash below this fraction of the daylight is ignored. It adds 1e-6 at a centimetre."""


@dataclass(frozen=True, eq=False)
class SpectralResponse:
    """The spectral side of a camera on a wavelength grid.

    Attributes:
        grid_nm: `(n,)` wavelengths, `STEP_NM` apart.
        electrons_per_joule: `(n, c)` photo-electrons per joule, by channel: quantum efficiency times
            lambda / (h c).
        flash: `(n,)` W sr-1 nm-1 on the axis of the flash, averaged over the exposure; zeros without a flash.
        density: `(n,)` wavelength sampling density: response times expected light.
        by_band: whether the channels are bands, which are computed a few at a time.
        lamps: of the scene and the camera; None for none.
    """

    grid_nm: NDArray[np.float64]
    electrons_per_joule: NDArray[np.float64]
    flash: NDArray[np.float64]
    density: NDArray[np.float64]
    by_band: bool = False
    lamps: FrameLamps | None = None

    @property
    def trapezoid_nm(self) -> NDArray[np.float64]:
        """`(n,)` weights of the trapezoidal rule on the grid."""
        weights = np.full(self.grid_nm.size, STEP_NM)
        weights[[0, -1]] *= 0.5
        return weights


def spectral_response(camera: Camera, scene: Scene) -> SpectralResponse:
    """Tabulate a camera's response over the wavelengths that the sensor detects and a light emits.

    Raises:
        ValueError: a light is too strong for single precision.
    """
    # Limit the grid to wavelengths with both response and light.
    grid = detected_wavelengths(camera.sensor)
    lights = [_flash_intensity(camera, grid), *_daylight(scene, grid), *_lamp_light(camera, scene, grid)]
    emitted = np.flatnonzero(np.any(lights, axis=0))
    if emitted.size:
        grid = grid[max(emitted[0] - 1, 0) : emitted[-1] + 2]
    electrons = camera.sensor.electrons_per_joule(grid).T

    # Reject lights that overflow, and ignore a flash that cannot matter.
    flash, daylight = _flash_intensity(camera, grid), _daylight(scene, grid)
    lamps = frame_lamps(camera, scene, grid)
    lamp_light = [] if lamps is None else list(lamps.emitted)
    strengths = [float((light @ electrons).max()) for light in (flash, *daylight, *lamp_light)]
    if scene.sky is not None:
        # The spectra of the sky come first, each with its map of weights.
        for k, weights in enumerate(scene.sky.weights, start=1):
            strengths[k] *= float(weights.max())
    if not max(strengths) <= _STRONGEST_LIGHT:
        raise ValueError(
            f"a light is too strong: {max(strengths):.3g} electrons s-1 m-2, "
            f"at most {_STRONGEST_LIGHT:g} are allowed"
        )
    if strengths[0] < _FAINTEST_FLASH * max(strengths):
        flash = np.zeros(grid.size)

    # Half of the density follows the lights, all equally, and half the response: no light is left out.
    lights = [light / light.mean() for light in (flash, *daylight, *lamp_light) if light.any()]
    # A colour that detects nothing behind a filter adds nothing.
    peaks = electrons.max(axis=0)
    response = (electrons / np.where(peaks > 0, peaks, 1.0)).sum(axis=1)
    density = response * (np.mean(lights, axis=0) if lights else np.ones(grid.size))
    density = density / density.sum() + response / response.sum() + 1e-3 / grid.size
    by_band = camera.sensor.pattern == "bands"
    if not any(light.any() for light in lamp_light):
        lamps = None
    return SpectralResponse(grid, electrons, flash, density, by_band, lamps)


def detected_wavelengths(sensor: Sensor) -> NDArray[np.float64]:
    """`(n,)` wavelengths that a sensor detects, nanometres, `STEP_NM` apart."""
    efficiency = sensor.quantum_efficiency
    peak = efficiency.values.max()
    detected = efficiency.wavelength_nm[(efficiency.values > _NEGLIGIBLE_RESPONSE * peak).any(axis=0)]
    return np.arange(np.floor(detected[0]), np.ceil(detected[-1]) + STEP_NM, STEP_NM)


def _flash_intensity(camera: Camera, grid_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    if camera.flash is None:
        return np.zeros(grid_nm.size)
    return camera.flash.radiant_intensity(grid_nm) * camera.flash_duty


def _lamp_light(camera: Camera, scene: Scene, grid_nm: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """All light of each spectrum of the lamps."""
    lamps = frame_lamps(camera, scene, grid_nm)
    return [] if lamps is None else list(lamps.emitted)


def _daylight(scene: Scene, grid_nm: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Spectra of the sky's radiance, then of the sun's irradiance."""
    if scene.sky is None:
        return []
    sun = [scene.sky.sun.irradiance.at(grid_nm)] if scene.sky.sun is not None else []
    return [*scene.sky.radiance.at(grid_nm), *sun]

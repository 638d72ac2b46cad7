"""A camera's rays inside the kernel: one lens geometry for colour and for labels."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.render.kernel.arrays import WORLD, LocalCoordinates, device_number, device_table
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene


@dataclass(frozen=True, eq=False)
class CameraRays:
    """Rays of a camera. The lens is tabulated once at the pixels' corners; the pose is a kernel input, so
    that a moved camera reuses the compiled kernel.

    Attributes:
        width, height: of the image, pixels.
        columns: the width as a number that the kernel reads, so that other sizes compile nothing anew.
        slopes: `((h + 1) * (w + 1) * 2,)` undistorted (x/z, y/z) at the pixels' corners.
        rotation: camera to world.
        origin: the projection centre, in the coordinates of the scene's region.
        focus: distance of the plane in focus along the axis, units; None where all is sharp.
        aperture: radius of the entrance pupil, units.
        unit: of the region, metres.
    """

    width: int
    height: int
    columns: Any
    slopes: Any
    rotation: Any
    origin: Any
    focus: Any = None
    aperture: Any = None
    unit: float = 1.0

    def directions(self, column: Any, row: Any, dx: Any, dy: Any) -> Any:
        """Unit world directions through points (dx, dy) in [0, 1]^2 of pixels.

        Bilinear between the corners: exact for a pinhole, and off by less than 1e-6 rad for a lens whose
        distortion changes smoothly over a pixel.
        """
        _, dr = mitsuba_modules()
        return dr.normalize(self.rotation @ self._towards(column, row, dx, dy))

    def rays(self, column: Any, row: Any, place: Any, next_2d: Callable[[], Any]) -> tuple[Any, Any]:
        """Origins and unit directions in the world of rays through points `place` of pixels.

        With a plane in focus they start anywhere on the entrance pupil and meet in that plane (the thin lens
        of Cook, Porter & Carpenter 1984); `next_2d` is asked only then.
        """
        mi, dr = mitsuba_modules()
        towards = self._towards(column, row, place.x, place.y)
        if self.focus is None:
            return self.origin, dr.normalize(self.rotation @ towards)
        pupil = self.aperture * mi.warp.square_to_uniform_disk_concentric(next_2d())
        start = mi.Vector3f(pupil.x, pupil.y, 0.0)
        return (
            self.origin + self.rotation @ start,
            dr.normalize(self.rotation @ (self.focus * towards - start)),
        )

    def _towards(self, column: Any, row: Any, dx: Any, dy: Any) -> Any:
        """Camera-axis directions (x/z, y/z, 1), bilinear between the pixels' corners."""
        mi, dr = mitsuba_modules()
        first = row * (self.columns + 1) + column

        def corner(offset: Any) -> Any:
            return dr.gather(mi.Point2f, self.slopes, first + offset)

        upper = dr.lerp(corner(0), corner(1), dx)
        lower = dr.lerp(corner(self.columns + 1), corner(self.columns + 2), dx)
        slope = dr.lerp(upper, lower, dy)
        return mi.Vector3f(slope.x, slope.y, 1.0)


class LensCache:
    """Keeps the last lens table: along a path only the pose changes."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._slopes: Any = None

    def view(self, camera: Camera, region: LocalCoordinates = WORLD) -> CameraRays:
        """The camera's rays in a region's coordinates."""
        mi, dr = mitsuba_modules()
        key = (camera.lens, camera.width, camera.height, camera.sensor.name, camera.intrinsics.tobytes())
        if key != self._key:
            self._slopes = device_table(camera.ray_slopes())
            self._key = key
        rotation = mi.Matrix3f(np.asarray(camera.pose[:3, :3], np.float32))
        origin = mi.Point3f(*(float(x) for x in region.places(camera.pose[:3, 3])))
        dr.make_opaque(rotation, origin)
        columns = device_number(camera.width, whole=True)
        view = CameraRays(
            camera.width, camera.height, columns, self._slopes, rotation, origin, unit=region.unit
        )
        if camera.focus_m is None:
            return view
        focus, aperture = (
            mi.Float(float(length / region.unit)) for length in (camera.focus_m, camera.aperture_radius_m)
        )
        dr.make_opaque(focus, aperture)
        return dataclasses.replace(view, focus=focus, aperture=aperture)


STEP_NM: Final = 1.0
_NEGLIGIBLE: Final = 1e-5  # chosen: response below this share of its peak is left out; error below 1e-5

_STRONGEST: Final = 1e26
"""Electrons s-1 m-2 (sr-1) that a light may send: chosen, a million times a flash of 200 klx at 50 cm. Single
precision ends at 3e38; next to a flash there is 1e8 times more, and mirrors gather 1e4 times more of that."""
_FAINTEST: Final = 1e-10
"""Chosen: a flash with less than this share of the daylight is none. Even at a centimetre it adds one part in
a million."""


@dataclass(frozen=True, eq=False)
class Response:
    """The camera's spectral side on a grid, ready for the kernel.

    Attributes:
        grid_nm: `(n,)` equally spaced by `STEP_NM`.
        electrons: `(n, c)` photo-electrons per joule, by channel: quantum efficiency times lambda / (h c).
        flash: `(n,)` W sr-1 nm-1 on the flash's axis, averaged over the exposure; zeros without a flash.
        density: `(n,)` where to take wavelengths: response times expected light, for importance sampling.
    """

    grid_nm: NDArray[np.float64]
    electrons: NDArray[np.float64]
    flash: NDArray[np.float64]
    density: NDArray[np.float64]


def response(camera: Camera, scene: Scene) -> Response:
    """The response over the range that the sensor sees and a light shines in, no wider.

    Raises:
        ValueError: a light is too strong for single precision.
    """
    efficiency = camera.sensor.quantum_efficiency
    peak = efficiency.values.max()
    seen = efficiency.wavelength_nm[(efficiency.values > _NEGLIGIBLE * peak).any(axis=0)]
    grid = np.arange(np.floor(seen[0]), np.ceil(seen[-1]) + STEP_NM, STEP_NM)
    lit = np.flatnonzero(np.any([_flash(camera, grid), *_sky_spectra(scene, grid)], axis=0))
    if lit.size:
        grid = grid[max(lit[0] - 1, 0) : lit[-1] + 2]
    electrons = camera.sensor.electrons_per_joule(grid).T
    flash, daylight = _flash(camera, grid), _sky_spectra(scene, grid)
    strengths = [float((light @ electrons).max()) for light in (flash, *daylight)]
    if scene.sky is not None:
        # The sky's spectra come first, each with its map.
        for k, weights in enumerate(scene.sky.weights, start=1):
            strengths[k] *= float(weights.max())
    if not max(strengths) <= _STRONGEST:
        most = f"{_STRONGEST:g} are allowed"
        raise ValueError(f"a light is too strong: {max(strengths):.3g} electrons s-1 m-2 where {most}")
    if strengths[0] < _FAINTEST * max(strengths):
        flash = np.zeros(grid.size)

    # Half of the density follows all lights alike, half the response alone: no light is left out.
    lights = [light for light in (flash, *daylight) if light.any()]
    light = (
        np.mean([spectrum / spectrum.mean() for spectrum in lights], axis=0) if lights else np.ones(grid.size)
    )
    share = (electrons / electrons.max(axis=0)).sum(axis=1)
    density = share * light
    density = density / density.sum() + share / share.sum() + 1e-3 / grid.size
    return Response(grid, electrons, flash, density)


def _flash(camera: Camera, grid: NDArray[np.float64]) -> NDArray[np.float64]:
    if camera.flash is None:
        return np.zeros(grid.size)
    return camera.flash.radiant_intensity(grid) * camera.flash_duty


def _sky_spectra(scene: Scene, grid: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    if scene.sky is None:
        return []
    sun = [scene.sky.sun.irradiance.at(grid)] if scene.sky.sun is not None else []
    return [*scene.sky.radiance.at(grid), *sun]

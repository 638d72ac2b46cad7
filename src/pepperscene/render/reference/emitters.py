"""Flash, lamps and daylight as Mitsuba emitters, so that Mitsuba's own integrators can light our scenes.

They are a reference: our integrator never reads them, and shares no code with them, only the descriptions of
the lights: a matrix of discs with an angular profile (`pepperscene.camera.Flash`), and maps of radiance with
the sun's disc (`pepperscene.scene.Sky`), tabulated on the wavelength grid of the response.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash, Lamp
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Sky

_PROFILE_STEPS: Final = 1800  # chosen: 0.05 degrees, so that profiles given at whole degrees are exact
_TURN_STEPS: Final = 720  # chosen: half a degree about a lamp's axis
_SHORTEST_CHORD: Final = 1e-4  # chosen: of the sun's disc; single precision resolves directions to 1e-7


class SpectralTable:
    """Values on a regular wavelength grid, linear in between, as kernel data."""

    def __init__(self, grid_nm: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        mi, dr = mitsuba_modules()
        self.values = mi.Float(np.asarray(values, np.float32))
        self.first = mi.Float(float(grid_nm[0]))
        self.per_step = mi.Float(float((grid_nm.size - 1) / (grid_nm[-1] - grid_nm[0])))
        self.last = mi.Float(grid_nm.size - 1.001)
        dr.make_opaque(self.first, self.per_step, self.last)

    def at(self, wavelengths: Any, active: Any = True) -> Any:
        """Interpolate at each of a ray's wavelengths."""
        mi, dr = mitsuba_modules()
        result = mi.Spectrum(0.0)
        for k in range(len(wavelengths)):
            position = dr.clip((wavelengths[k] - self.first) * self.per_step, 0.0, self.last)
            left = mi.UInt32(position)
            low = dr.gather(mi.Float, self.values, left, active)
            high = dr.gather(mi.Float, self.values, left + 1, active)
            result[k] = dr.lerp(low, high, position - mi.Float(left))
        return result


@functools.cache
def point_emitter() -> Any:
    """Define the base of emitters that light samples choose points of, and that no ray meets."""
    mi, _ = mitsuba_modules()

    class PointEmitter(mi.Emitter):  # type: ignore[name-defined]
        """Points; construct with `of` of a class below."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.m_flags = mi.EmitterFlags.DeltaPosition

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Float(0.0)

        def eval(self, si: Any, active: Any = True) -> Any:
            return mi.Spectrum(0.0)

        def bbox(self) -> Any:
            return mi.BoundingBox3f()

    return PointEmitter


@functools.cache
def flash_emitter() -> Any:
    """Define the emitter class of the flash, once the variant is set."""
    mi, dr = mitsuba_modules()

    class FlashEmitter(point_emitter()):  # type: ignore[misc]
        """Equal discs across the camera's axis; construct with `of`.

        A light sample is a uniform point on them. The discs are no shapes: scattered rays pass through.
        """

        @classmethod
        def of(cls, flash: Flash, rays: CameraRays, intensity: SpectralTable) -> Any:
            """Make the flash of a camera; see `move_to`."""
            self = cls(mi.Properties())
            self.move_to(flash, rays, intensity)
            return self

        def move_to(self, flash: Flash, rays: CameraRays, intensity: SpectralTable) -> None:
            """Move the flash to the camera; `intensity` of all discs on the axis, W sr-1 nm-1."""
            # In the flash's own axes, which differ from the camera's for a flash that is turned.
            turn = np.eye(3) if flash.rotation is None else flash.rotation
            offset = np.asarray(flash.offset_m) @ turn
            centres = np.asarray(flash.emitters_m) + offset[:2]
            self.discs = mi.Float((centres / rays.unit_m).astype(np.float32).ravel())
            self.count = mi.UInt32(len(centres))
            self.radius, self.forward = (
                mi.Float(float(length / rays.unit_m)) for length in (flash.radius_m, offset[2])
            )
            dr.make_opaque(self.count, self.radius, self.forward)
            angles = np.linspace(0.0, math.pi / 2.0, _PROFILE_STEPS + 1)
            # Divided by squared distances in local units below.
            self.profile = mi.Float((flash.profile.at(angles) / rays.unit_m**2).astype(np.float32))
            self.rotation = rays.rotation
            if flash.rotation is not None:
                self.rotation = rays.rotation @ mi.Matrix3f(turn.astype(np.float32))
            self.origin, self.intensity = rays.origin, intensity

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            # The first coordinate selects a disc; its remainder and the second select a point on it.
            scaled = sample.x * mi.Float(self.count)
            chosen = dr.minimum(mi.UInt32(scaled), self.count - 1)
            remainder = mi.Point2f(dr.clip(scaled - mi.Float(chosen), 0.0, 1.0), sample.y)
            disc = dr.gather(mi.Point2f, self.discs, chosen, active)
            on_disc = disc + self.radius * mi.warp.square_to_uniform_disk_concentric(remainder)
            point = self.origin + self.rotation @ mi.Vector3f(on_disc.x, on_disc.y, self.forward)

            ds = dr.zeros(mi.DirectionSample3f)
            towards = point - it.p
            square = dr.squared_norm(towards)
            ds.p, ds.dist = point, dr.sqrt(square)
            ds.d = towards / ds.dist
            ds.n = mi.Normal3f(self.rotation @ mi.Vector3f(0.0, 0.0, 1.0))
            ds.time, ds.pdf, ds.delta = it.time, 1.0, True
            ds.emitter = mi.EmitterPtr(self)

            # The light of a point falls with the squared distance; the profile includes cos(theta).
            cosine = -dr.dot(ds.d, ds.n)
            step = dr.clip(
                dr.safe_acos(cosine) * (2.0 / math.pi * _PROFILE_STEPS), 0.0, _PROFILE_STEPS - 1e-3
            )
            left = mi.UInt32(step)
            low = dr.gather(mi.Float, self.profile, left, active)
            high = dr.gather(mi.Float, self.profile, left + 1, active)
            strength = dr.lerp(low, high, step - mi.Float(left)) / square
            lit = active & (cosine > 0.0)
            return ds, (self.intensity.at(it.wavelengths, active) * strength) & lit

    return FlashEmitter


@functools.cache
def lamp_emitter() -> Any:
    """Define the emitter class of a lamp, once the variant is set."""
    mi, dr = mitsuba_modules()

    class LampEmitter(point_emitter()):  # type: ignore[misc]
        """Points at the middles of equal parts of a lamp's shape; construct with `of`, then `place`."""

        @classmethod
        def of(cls, lamp: Lamp, emitted: SpectralTable, unit_m: float) -> Any:
            """Make a lamp that emits so much, W nm-1, in coordinates of this unit."""
            self = cls(mi.Properties())
            # The beam in equal steps of both angles, over squared local units.
            turn, angle = np.meshgrid(
                2.0 * math.pi * (np.arange(_TURN_STEPS) + 0.5) / _TURN_STEPS,
                math.pi * (np.arange(_PROFILE_STEPS) + 0.5) / _PROFILE_STEPS,
            )
            x, y = np.cos(turn) * np.sin(angle), np.sin(turn) * np.sin(angle)
            beam = lamp.beam.at(np.stack([x, y, np.cos(angle)], axis=-1)) / unit_m**2
            texels = mi.TensorXf(np.asarray(beam, np.float32)[..., None])
            self.beam = mi.Texture2f(texels, wrap_mode=dr.WrapMode.Repeat)
            self.emitted = emitted
            return self

        def place(self, points: NDArray[np.float64], rotation: NDArray[np.float64]) -> None:
            """Place the lamp: `(k, 3)` points in local coordinates, and its axes in the world's."""
            self.points = mi.Float(np.asarray(points, np.float32).ravel())
            self.count = mi.UInt32(len(points))
            self.to_lamp = mi.Matrix3f(np.asarray(rotation.T, np.float32))
            dr.make_opaque(self.count)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            chosen = dr.minimum(mi.UInt32(sample.x * mi.Float(self.count)), self.count - 1)
            point = dr.gather(mi.Point3f, self.points, chosen, active)
            ds = dr.zeros(mi.DirectionSample3f)
            towards = point - it.p
            square = dr.squared_norm(towards)
            ds.p, ds.dist = point, dr.sqrt(square)
            ds.d = towards / ds.dist
            ds.n, ds.time, ds.pdf, ds.delta = mi.Normal3f(-ds.d), it.time, 1.0, True
            ds.emitter = mi.EmitterPtr(self)
            local = self.to_lamp @ -ds.d
            turn = dr.atan2(local.y, local.x) * dr.inv_two_pi
            uv = mi.Point2f(turn - dr.floor(turn), dr.safe_acos(local.z) * dr.inv_pi)
            return ds, (
                self.emitted.at(it.wavelengths, active) * self.beam.eval(uv, active)[0] / square
            ) & active

    return LampEmitter


@functools.cache
def daylight_emitter() -> Any:
    """Define the emitter class of sky and sun, once the variant is set; Mitsuba allows one environment."""
    mi, dr = mitsuba_modules()

    class DaylightEmitter(mi.Emitter):  # type: ignore[name-defined]
        """Maps of radiance over the whole sphere and the sun's disc; construct with `of`.

        A light sample is a direction in the disc, or any direction if there is no sun. Light samples towards
        the maps are inefficient: half of them miss, and a scattered ray finds the sky anyway. Leaving them
        out cuts the error sixfold at equal time.
        """

        sun: SpectralTable | None

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying

        @classmethod
        def of(cls, sky: Sky, grid_nm: NDArray[np.float64], weight: float, reach: float) -> Any:
            """Make the daylight of a scene, with spectra on a regular grid.

            `weight` is relative to other emitters' for light samples; `reach` is a distance in local units
            that leaves the scene from anywhere in it.
            """
            props = mi.Properties()
            props["sampling_weight"] = weight
            self = cls(props)
            maps = np.ascontiguousarray(np.moveaxis(sky.weights, 0, -1))
            self.maps = mi.Texture2f(mi.TensorXf(maps), wrap_mode=dr.WrapMode.Repeat)
            self.spectra = [SpectralTable(grid_nm, row) for row in sky.radiance.at(grid_nm)]
            self.reach, self.sun = mi.Float(reach), None
            dr.make_opaque(self.reach)
            if sky.sun is None:
                return self
            # Single precision cannot distinguish the cosine of the disc's radius from 1, so the chord from
            # its centre is used. A cap of chord s has the solid angle pi s^2 (Archimedes), and s^2 is uniform
            # over it.
            chord = max(2.0 * math.sin(sky.sun.angular_radius / 2.0), _SHORTEST_CHORD)
            solid_angle = math.pi * chord**2
            self.sun = SpectralTable(grid_nm, sky.sun.irradiance.at(grid_nm) / solid_angle)
            direction = mi.Vector3f(*(float(x) for x in sky.sun.direction))
            self.chord, self.per_solid_angle = mi.Float(chord), mi.Float(1.0 / solid_angle)
            dr.make_opaque(direction, self.chord, self.per_solid_angle)
            self.sun_frame = mi.Frame3f(direction)
            return self

        def _radiance(self, direction: Any, wavelengths: Any, active: Any) -> Any:
            """The maps times their spectra, plus the sun in its disc."""
            azimuth = dr.atan2(direction.y, direction.x) * dr.inv_two_pi
            uv = mi.Point2f(azimuth - dr.floor(azimuth), dr.safe_acos(direction.z) * dr.inv_pi)
            radiance = mi.Spectrum(0.0)
            for weight, spectrum in zip(self.maps.eval(uv, active), self.spectra, strict=True):
                radiance += weight * spectrum.at(wavelengths, active)
            if self.sun is not None:
                radiance += self.sun.at(wavelengths, active) & self._in_disc(direction)
            return radiance & active

        def _in_disc(self, direction: Any) -> Any:
            return dr.squared_norm(direction - self.sun_frame.n) < dr.square(self.chord)

        def _density(self, direction: Any) -> Any:
            """Density of light samples over solid angle."""
            if self.sun is None:
                return mi.Float(0.25 * dr.inv_pi)
            return dr.select(self._in_disc(direction), self.per_solid_angle, 0.0)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            if self.sun is None:
                direction = mi.warp.square_to_uniform_sphere(sample)
            else:
                square = dr.square(self.chord) * sample.x
                across = dr.sqrt(square * (1.0 - 0.25 * square))
                sine, cosine = dr.sincos(dr.two_pi * sample.y)
                in_disc = mi.Vector3f(across * cosine, across * sine, 1.0 - 0.5 * square)
                direction = self.sun_frame.to_world(in_disc)

            ds = dr.zeros(mi.DirectionSample3f)
            ds.d, ds.dist = direction, self.reach
            ds.p, ds.n = it.p + direction * self.reach, mi.Normal3f(-direction)
            ds.time, ds.delta = it.time, False
            density = self._density(direction)
            ds.pdf = dr.select(active, density, 0.0)
            ds.emitter = mi.EmitterPtr(self)
            radiance = self._radiance(direction, it.wavelengths, active)
            return ds, dr.select(density > 0.0, radiance / dr.maximum(density, 1e-20), 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return dr.select(active, self._density(ds.d), 0.0)

        def eval(self, si: Any, active: Any = True) -> Any:
            return self._radiance(-si.wi, si.wavelengths, active)

    return DaylightEmitter

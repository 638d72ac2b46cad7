"""The flash and the daylight as Mitsuba emitters, so that Mitsuba's own integrators can light our scenes.

They are for the reference alone: our integrator never reads them, and nothing here is taken from it. What
both share is what the lights are: a matrix of discs with an angular profile (`pepperscene.camera.Flash`), and
maps of radiance with a sun's disc (`pepperscene.scene.Sky`), tabulated on the response's grid of wavelengths.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Sky

_PROFILE_STEPS: Final = 1800  # chosen: 0.05 degrees, so that profiles told at whole degrees are met exactly
_LEAST_CHORD: Final = 1e-4  # chosen: of a sun's disc; single precision tells directions apart to 1e-7


class SpectralTable:
    """Values on an even grid of wavelengths, linear in between; a kernel input, never compiled in."""

    def __init__(self, grid_nm: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        mi, dr = mitsuba_modules()
        self.values = mi.Float(np.asarray(values, np.float32))
        self.first = mi.Float(float(grid_nm[0]))
        self.per_step = mi.Float(float((grid_nm.size - 1) / (grid_nm[-1] - grid_nm[0])))
        self.last = mi.Float(grid_nm.size - 1.001)
        dr.make_opaque(self.first, self.per_step, self.last)

    def at(self, wavelengths: Any, active: Any = True) -> Any:
        """The values at each of a ray's wavelengths."""
        mi, dr = mitsuba_modules()
        found = mi.Spectrum(0.0)
        for k in range(len(wavelengths)):
            place = dr.clip((wavelengths[k] - self.first) * self.per_step, 0.0, self.last)
            left = mi.UInt32(place)
            low = dr.gather(mi.Float, self.values, left, active)
            high = dr.gather(mi.Float, self.values, left + 1, active)
            found[k] = dr.lerp(low, high, place - mi.Float(left))
        return found


@functools.cache
def flash_emitter() -> Any:
    """The class of the flash's emitter; made once the variant is known."""
    mi, dr = mitsuba_modules()

    class FlashEmitter(mi.Emitter):  # type: ignore[name-defined]
        """Equal discs across the camera's axis; construct through `of`.

        A light sample is a point of them, evenly. Scattered rays pass through: the discs are no shapes.
        """

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.m_flags = mi.EmitterFlags.DeltaPosition

        @classmethod
        def of(cls, flash: Flash, view: CameraRays, intensity: SpectralTable) -> Any:
            """The flash of a camera; see `aim`."""
            self = cls(_weighted(1.0))
            self.aim(flash, view, intensity)
            return self

        def aim(self, flash: Flash, view: CameraRays, intensity: SpectralTable) -> None:
            """Put the flash where the camera is; `intensity` on its axis, of all discs, W sr-1 nm-1."""
            centres = np.asarray(flash.emitters_m) + np.array(flash.offset_m[:2])
            self.discs = mi.Float((centres / view.unit).astype(np.float32).ravel())
            self.count = mi.UInt32(len(centres))
            self.radius, self.forward = (
                mi.Float(float(length / view.unit)) for length in (flash.radius_m, flash.offset_m[2])
            )
            dr.make_opaque(self.count, self.radius, self.forward)
            angles = np.linspace(0.0, math.pi / 2.0, _PROFILE_STEPS + 1)
            # Over squared distance, which the kernel tells in its own unit.
            self.profile = mi.Float((flash.profile.at(angles) / view.unit**2).astype(np.float32))
            self.rotation, self.origin, self.intensity = view.rotation, view.origin, intensity

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            # A disc by the first coordinate, a point on it by what is left of that and the second.
            place = sample.x * mi.Float(self.count)
            chosen = dr.minimum(mi.UInt32(place), self.count - 1)
            rest = mi.Point2f(dr.clip(place - mi.Float(chosen), 0.0, 1.0), sample.y)
            disc = dr.gather(mi.Point2f, self.discs, chosen, active)
            point = disc + self.radius * mi.warp.square_to_uniform_disk_concentric(rest)
            lamp = self.origin + self.rotation @ mi.Vector3f(point.x, point.y, self.forward)

            ds = dr.zeros(mi.DirectionSample3f)
            away = lamp - it.p
            square = dr.squared_norm(away)
            ds.p, ds.dist = lamp, dr.sqrt(square)
            ds.d = away / ds.dist
            ds.n = mi.Normal3f(self.rotation @ mi.Vector3f(0.0, 0.0, 1.0))
            ds.time, ds.pdf, ds.delta = it.time, 1.0, True
            ds.emitter = mi.EmitterPtr(self)

            # A point's light falls with the square of the distance; cos(theta) is in its profile.
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

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Float(0.0)

        def eval(self, si: Any, active: Any = True) -> Any:
            return mi.Spectrum(0.0)

        def bbox(self) -> Any:
            return mi.BoundingBox3f()

        def to_string(self) -> str:
            return "FlashEmitter[]"

    return FlashEmitter


@functools.cache
def daylight_emitter() -> Any:
    """The class of the daylight's emitter; made once the variant is known.

    Sky and sun are one, since a Mitsuba scene has one environment.
    """
    mi, dr = mitsuba_modules()

    class DaylightEmitter(mi.Emitter):  # type: ignore[name-defined]
        """Maps of radiance over the whole sphere and the sun's disc; construct through `of`.

        A light sample is a direction within the disc or, with the probability `sky_share`, any direction;
        scattered rays that leave the scene find both.
        """

        sun: SpectralTable | None

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying

        @classmethod
        def of(
            cls, sky: Sky, grid_nm: NDArray[np.float64], weight: float, sky_share: float, reach: float
        ) -> Any:
            """The daylight of a scene.

            Args:
                sky: maps and sun.
                grid_nm: even, for the spectra.
                weight: it is chosen for light samples in proportion to this.
                sky_share: of its light samples, the share that looks for the maps; 1 without a sun.
                reach: a distance in the kernel's unit that leaves the scene from anywhere in it.
            """
            self = cls(_weighted(weight))
            maps = np.ascontiguousarray(np.moveaxis(sky.weights, 0, -1))
            self.maps = mi.Texture2f(mi.TensorXf(maps), wrap_mode=dr.WrapMode.Repeat)
            self.spectra = [SpectralTable(grid_nm, row) for row in sky.radiance.at(grid_nm)]
            self.reach, self.sky_share = mi.Float(reach), mi.Float(sky_share)
            dr.make_opaque(self.reach, self.sky_share)
            self.sun = None
            if sky.sun is None:
                return self
            # A disc by the chord from its centre: single precision cannot tell its cosine from 1. A cap with
            # the chord s has the solid angle pi s^2 (Archimedes), and s^2 is even over it.
            chord = max(2.0 * math.sin(sky.sun.angular_radius / 2.0), _LEAST_CHORD)
            solid_angle = math.pi * chord**2
            self.sun = SpectralTable(grid_nm, sky.sun.irradiance.at(grid_nm) / solid_angle)
            towards = mi.Vector3f(*(float(x) for x in sky.sun.direction))
            self.chord, self.per_solid_angle = mi.Float(chord), mi.Float(1.0 / solid_angle)
            dr.make_opaque(towards, self.chord, self.per_solid_angle)
            self.towards = mi.Frame3f(towards)
            return self

        def _radiance(self, towards: Any, wavelengths: Any, active: Any) -> Any:
            """The maps times their spectra, and the sun's disc where it is."""
            azimuth = dr.atan2(towards.y, towards.x) * dr.inv_two_pi
            place = mi.Point2f(azimuth - dr.floor(azimuth), dr.safe_acos(towards.z) * dr.inv_pi)
            radiance = mi.Spectrum(0.0)
            for weight, spectrum in zip(self.maps.eval(place, active), self.spectra, strict=True):
                radiance += weight * spectrum.at(wavelengths, active)
            if self.sun is not None:
                radiance += self.sun.at(wavelengths, active) & self._in_disc(towards)
            return radiance & active

        def _in_disc(self, towards: Any) -> Any:
            return dr.squared_norm(towards - self.towards.n) < dr.square(self.chord)

        def _density(self, towards: Any) -> Any:
            """Of light samples, over solid angle."""
            everywhere = self.sky_share * (0.25 * dr.inv_pi)
            if self.sun is None:
                return everywhere
            return everywhere + dr.select(
                self._in_disc(towards), (1.0 - self.sky_share) * self.per_solid_angle, 0.0
            )

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            anywhere = sample.x < self.sky_share
            # What is left of the first coordinate within its share is again even.
            rest = dr.select(
                anywhere,
                sample.x / dr.maximum(self.sky_share, 1e-6),
                (sample.x - self.sky_share) / dr.maximum(1.0 - self.sky_share, 1e-6),
            )
            place = mi.Point2f(dr.clip(rest, 0.0, 1.0), sample.y)
            towards = mi.warp.square_to_uniform_sphere(place)
            if self.sun is not None:
                square = dr.square(self.chord) * place.x
                beside = dr.sqrt(square * (1.0 - 0.25 * square))
                sine, cosine = dr.sincos(dr.two_pi * place.y)
                on_disc = mi.Vector3f(beside * cosine, beside * sine, 1.0 - 0.5 * square)
                towards = dr.select(anywhere, towards, self.towards.to_world(on_disc))

            ds = dr.zeros(mi.DirectionSample3f)
            ds.d, ds.dist = towards, self.reach
            ds.p, ds.n = it.p + towards * self.reach, mi.Normal3f(-towards)
            ds.time, ds.delta = it.time, False
            density = self._density(towards)
            ds.pdf = dr.select(active, density, 0.0)
            ds.emitter = mi.EmitterPtr(self)
            found = self._radiance(towards, it.wavelengths, active)
            return ds, dr.select(density > 0.0, found / dr.maximum(density, 1e-20), 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return dr.select(active, self._density(ds.d), 0.0)

        def eval(self, si: Any, active: Any = True) -> Any:
            return self._radiance(-si.wi, si.wavelengths, active)

        def to_string(self) -> str:
            return "DaylightEmitter[]"

    return DaylightEmitter


def _weighted(weight: float) -> Any:
    props = mitsuba_modules()[0].Properties()
    props["sampling_weight"] = weight
    return props

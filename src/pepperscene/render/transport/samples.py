"""A wavefront of samples: camera rays, what the lights send along them, and their wavelengths."""

from __future__ import annotations

from collections.abc import Sequence as Row
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.kernel.arrays import aligned, device_number, device_table
from pepperscene.render.kernel.camera import STEP_NM, CameraRays, Response
from pepperscene.render.kernel.scene import LightScene, SkyTables
from pepperscene.render.surface.channels import ChannelOptics
from pepperscene.render.transport.flash import FlashMatrix
from pepperscene.render.transport.owen_sobol import Sequence
from pepperscene.render.variant import mitsuba_modules

_PLACES: Final = 4  # chosen among 1, 2 and 4: the least error for the same time

_DISTINCT_SUN: Final = 0.02
"""Chosen: where a white body half a metre from the flash owes the sun more than this share of its light, the
sun's edges are as sharp as the flash's. Below, its light at first hits is soft light like any other."""
_LEAST: Final = 1e-30  # chosen: no light or chance that matters is smaller, and single precision holds it


@dataclass(frozen=True, eq=False)
class Lamps:
    """What the lights send out, by channel or at a sample's wavelengths, whichever its light is carried in.

    Attributes:
        flash: radiant intensity on the axis; None without a flash.
        sun: irradiance across its beam; None without a sun.
        sky: radiance of each of the sky's spectra.
    """

    flash: Any | None
    sun: Any | None
    sky: Row[Any]


class FrameTables:
    """What all samples of a frame share.

    Attributes:
        roulette: whether paths may end, and shadow rays go to one of two lights, by a chance that follows the
            light. Such decisions jump with what surfaces do, so pictures that are differentiated go without.
    """

    roulette = True

    def __init__(
        self,
        scene: LightScene,
        view: CameraRays,
        spectral: Response,
        flash: Flash | None,
        sky: SkyTables | None,
    ) -> None:
        self.scene, self.view, self.sky, self.spectral = scene, view, sky, spectral
        self.channels = spectral.electrons.shape[1]
        self.flash = FlashMatrix(flash, view) if flash is not None and spectral.flash.any() else None
        sun = None if sky is None or sky.sun_frame is None else np.asarray(sky.sun_irradiance)

        # Light that comes by one surface only is carried by channel, all its integrals taken here by the
        # trapezoidal rule, which light carried at wavelengths follows as well.
        self._steps = np.full(spectral.grid_nm.size, STEP_NM)
        self._steps[[0, -1]] *= 0.5
        reference = spectral.flash if spectral.flash.any() else np.ones(spectral.grid_nm.size)
        self.white = self._integrals(reference)
        self.lights = self.flash is not None or self.sky is not None
        self.lit = ChannelOptics.of(scene.optics, self._weights(reference))
        self.sunlit: ChannelOptics | None = None
        if sun is not None and self._is_distinct(sun):
            self.sunlit = ChannelOptics.of(scene.optics, self._weights(sun))
        self.lamps = Lamps(
            flash=None if self.flash is None else self._colour(spectral.flash),
            sun=None if sun is None else self._colour(sun),
            sky=[self._colour(np.asarray(table)[: spectral.grid_nm.size]) for table in sky.radiance]
            if sky is not None
            else [],
        )
        self.per_white = [device_number(1.0 / value) for value in self.white]

    def _weights(self, spectrum: NDArray[np.floating]) -> NDArray[np.float64]:
        """`(n, c)` what each wavelength of a light counts for in each channel."""
        return np.asarray(self.spectral.electrons * (self._steps * spectrum)[:, None])

    def _integrals(self, spectrum: NDArray[np.floating]) -> NDArray[np.float64]:
        """`(c,)` a light's integral over wavelength as each channel counts it."""
        return self._weights(spectrum).sum(axis=0)

    def _colour(self, spectrum: NDArray[np.floating]) -> Any:
        mi, dr = mitsuba_modules()
        colour = (mi.Color3f if self.channels == 3 else mi.Color1f)(
            *(float(x) for x in self._integrals(spectrum))
        )
        dr.make_opaque(colour)
        return colour

    def _is_distinct(self, sun: NDArray[np.floating]) -> bool:
        """Whether the sun's light on surfaces matters beside the flash's."""
        if self.flash is None:
            return True
        # A flash of intensity I lights what is half a metre away with I / .25 m2.
        flash = self._integrals(self.spectral.flash).sum() / 0.25
        return bool(self._integrals(sun).sum() > _DISTINCT_SUN * flash)


class SpectralTables:
    """The camera's and the lights' spectra for light that is carried at single wavelengths."""

    def __init__(self, tables: FrameTables) -> None:
        mi, _ = mitsuba_modules()
        spectral, sky = tables.spectral, tables.sky
        self.first_nm = device_number(spectral.grid_nm[0])
        self.last_entry = device_number(spectral.grid_nm.size - 1.001)
        self.distribution = mi.ContinuousDistribution(
            mi.ScalarVector2f(spectral.grid_nm[0], spectral.grid_nm[-1]), aligned(spectral.density)
        )
        self.electrons = [device_table(column) for column in spectral.electrons.T]
        self.flash = device_table(spectral.flash) if tables.flash is not None else None
        self.sun = sky.sun_irradiance if sky is not None and sky.sun_frame is not None else None
        self.sky = sky.radiance if sky is not None else ()


class Samples:
    """Camera rays of a wavefront and the light on what they meet."""

    def __init__(self, tables: FrameTables, pixel: Any, index: Any, seed: Any) -> None:
        mi, _ = mitsuba_modules()
        self.tables = tables
        sequence = Sequence(pixel, index, seed)
        self.next_1d, self.next_2d = sequence.next_1d, sequence.next_2d
        view = tables.view
        row = pixel // view.columns
        start, towards = view.rays(pixel - row * view.columns, row, self.next_2d(), self.next_2d)
        self.ray = mi.Ray3f(start, towards)

    def flash_and_sun(self, si: Any, point: Any, active: Any, lamps: Lamps) -> Any:
        """Radiance towards the viewer from one point of the flash and one of the sun's disc.

        Rays from later hits are incoherent and dear, so one shadow ray serves both: it goes to either, with a
        chance in proportion to what that would send unshadowed, by which its light is then divided.
        """
        nothing = point.reflectance * 0.0
        flashed = self.tables.flash is not None and lamps.flash is not None
        if self.tables.sky is None or lamps.sun is None:
            return self._flash(si, point, active, lamps) if flashed else nothing
        if not flashed:
            return self.sun(si, point, active, lamps)
        if not self.tables.roulette:
            return self._flash(si, point, active, lamps) + self.sun(si, point, active, lamps)
        _, dr = mitsuba_modules()
        flash, target = self._from_emitter(si, point, active, lamps, self.next_2d())
        sun, towards = self._from_sun(si, point, active, lamps)
        both = dr.sum(flash) + dr.sum(sun)
        share = dr.select(both > 0.0, dr.sum(flash) / dr.maximum(both, _LEAST), 0.0)
        to_flash = self.next_1d() < share
        chance = dr.select(to_flash, share, 1.0 - share)
        light = dr.select(to_flash, flash, sun) / dr.maximum(chance, _LEAST)
        ray = dr.select(to_flash, si.spawn_ray_to(target), si.spawn_ray(towards))
        some = active & (both > 0.0)
        return light & (some & ~self.tables.scene.scene.ray_test(ray, some))

    def _flash(self, si: Any, point: Any, active: Any, lamps: Lamps) -> Any:
        """Radiance towards the viewer from one point of the flash."""
        _, dr = mitsuba_modules()
        light, target = self._from_emitter(si, point, active, lamps, self.next_2d())
        return light & ~self._between(si, target, active & dr.any(light > 0.0))

    def whole_flash(self, si: Any, point: Any, active: Any, lamps: Lamps) -> Any:
        """Radiance towards the viewer from several places of the flash.

        Near the camera the emitters differ by far in what they send to a point, and most of the picture lies
        in their half-shadows: so the mean over several places is taken, spread evenly over the flash, with a
        shadow ray to each. Rays from one hit to the same part of the flash are coherent and cheaper than
        those to new hits.
        """
        mi, dr = mitsuba_modules()
        if self.tables.flash is None or lamps.flash is None:
            return point.reflectance * 0.0
        place, total = self.next_2d(), 0.0
        for k in range(_PLACES):
            light, target = self._from_emitter(
                si, point, active, lamps, mi.Point2f((k + place.x) / _PLACES, place.y)
            )
            total += light & ~self._between(si, target, active & dr.any(light > 0.0))
        return total / _PLACES

    def _between(self, si: Any, target: Any, active: Any) -> Any:
        """Whether something stands between a hit and a point."""
        mi, _ = mitsuba_modules()
        return self.tables.scene.scene.ray_test(si.spawn_ray_to(target), mi.Bool(True), active)

    def _from_emitter(self, si: Any, point: Any, active: Any, lamps: Lamps, place: Any) -> tuple[Any, Any]:
        """Unshadowed light of a point of the flash, and that point."""
        _, dr = mitsuba_modules()
        assert self.tables.flash is not None
        target, falloff = self.tables.flash.towards(si.p, place)
        value, _ = point.eval_pdf(si.to_local(dr.normalize(target - si.p)))
        return (value * lamps.flash * falloff) & (active & (falloff > 0.0)), target

    def sun(self, si: Any, point: Any, active: Any, lamps: Lamps) -> Any:
        """Radiance towards the viewer from the sun's disc alone."""
        if self.tables.sky is None or lamps.sun is None:
            return point.reflectance * 0.0
        light, towards = self._from_sun(si, point, active, lamps)
        return light & ~self.tables.scene.scene.ray_test(si.spawn_ray(towards), active)

    def _from_sun(self, si: Any, point: Any, active: Any, lamps: Lamps) -> tuple[Any, Any]:
        """Unshadowed light of a point of the sun's disc, and the direction to it."""
        mi, dr = mitsuba_modules()
        sky = self.tables.sky
        assert sky is not None
        # Squared chords from the disc's centre are even over it, as squared radii are over a flat disc.
        place = sky.sun_chord * mi.warp.square_to_uniform_disk_concentric(self.next_2d())
        square = dr.squared_norm(place)
        beside = place * dr.sqrt(1.0 - 0.25 * square)
        towards = sky.sun_frame.to_world(mi.Vector3f(beside.x, beside.y, 1.0 - 0.5 * square))
        value, _ = point.eval_pdf(si.to_local(towards))
        return (value * lamps.sun) & active, towards

    def sky(self, towards: Any, active: Any, lamps: Lamps, *, seen: bool) -> Any:
        """Radiance of the sky from a direction; the sun's disc only where it is seen directly."""
        mi, dr = mitsuba_modules()
        sky = self.tables.sky
        if sky is None:
            return 0.0
        azimuth = dr.atan2(towards.y, towards.x) * dr.inv_two_pi
        place = mi.Point2f(azimuth - dr.floor(azimuth), dr.safe_acos(towards.z) * dr.inv_pi)
        nothing: Any = lamps.sky[0] if lamps.sky else lamps.sun
        radiance = nothing * 0.0
        for weight, spectrum in zip(sky.weights.eval(place, active), lamps.sky, strict=True):
            radiance += weight * spectrum
        if seen and lamps.sun is not None:
            square = dr.square(sky.sun_chord)
            inside = dr.squared_norm(towards - sky.sun_frame.n) < square
            radiance += (lamps.sun / (dr.pi * square)) & inside
        return radiance & active


class Wavelengths:
    """Four wavelengths for each sample, with the lights and the sensor at them.

    A pixel's samples share out the spectrum evenly: `place` is well spread over them.
    """

    def __init__(self, tables: SpectralTables, place: Any) -> None:
        mi, _ = mitsuba_modules()
        self.tables = tables
        self.nm, self.weights = mi.Spectrum(0.0), mi.Spectrum(0.0)
        for k in range(4):
            nm, density = tables.distribution.sample_pdf((place + k) / 4.0)
            self.nm[k] = nm
            self.weights[k] = 0.25 / density
        # Spectra are looked up once: under each hit's own mask they would be fetched again and again.
        self.electrons = [self._at(table) for table in tables.electrons]
        self.lamps = Lamps(
            flash=None if tables.flash is None else self._at(tables.flash),
            sun=None if tables.sun is None else self._at(tables.sun),
            sky=[self._at(table) for table in tables.sky],
        )

    def channels(self, radiance: Any) -> list[Any]:
        """The sensor's sum over wavelengths for each channel, electrons s-1 m-2 sr-1."""
        _, dr = mitsuba_modules()
        return [dr.sum(radiance * self.weights * electrons) for electrons in self.electrons]

    def _at(self, table: Any) -> Any:
        """A table on the response's grid, linear in between, at the samples' wavelengths."""
        mi, dr = mitsuba_modules()
        found = mi.Spectrum(0.0)
        for k in range(4):
            x = dr.clip((self.nm[k] - self.tables.first_nm) / STEP_NM, 0.0, self.tables.last_entry)
            left = dr.floor(x)
            index = mi.UInt32(left)
            found[k] = dr.lerp(
                dr.gather(mi.Float, table, index), dr.gather(mi.Float, table, index + 1), x - left
            )
        return found

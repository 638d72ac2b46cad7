"""A wavefront of samples: camera rays, the light that reaches the points they hit, and their wavelengths."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any, Final

from pepperscene.render.surface.optics import STEP_NM
from pepperscene.render.transport.lights import FrameTables, LightSpectra
from pepperscene.render.transport.owen_sobol import OwenSobol
from pepperscene.render.variant import mitsuba_modules

_FLASH_POINTS: Final = 4  # chosen among 1, 2 and 4: the smallest error for the same time
TINY: Final = 1e-30  # chosen: below any relevant light or probability, and safe in single precision


class Samples:
    """Camera rays of a wavefront, and the light at the points that they hit.

    Light is returned as radiance towards the viewer, in the form of `spectra`: by channel or by wavelength.
    """

    def __init__(self, tables: FrameTables, pixel: Any, index: Any, seed: Any) -> None:
        mi, _ = mitsuba_modules()
        self.tables = tables
        self.sequence = sequence = OwenSobol(pixel, index, seed)
        self.next_1d, self.next_2d = sequence.next_1d, sequence.next_2d
        rays = tables.rays
        row = pixel // rays.device_width
        column, point = pixel - row * rays.device_width, self.next_2d()
        # The flash is on the camera: it lights what a ray sees from where both are at the ray's time.
        self.pose = rays.pose(row, self.next_1d)
        start, direction = rays.sample_rays(self.pose, column, row, point, self.next_2d)
        self.ray: Any = mi.Ray3f(start, direction)

    def subset(self, lanes: Any) -> Samples:
        """Some lanes of the wavefront, without their camera rays; the next random numbers are the same."""
        mi, dr = mitsuba_modules()
        part = copy.copy(self)
        part.sequence = sequence = self.sequence.subset(lanes)
        part.next_1d, part.next_2d, part.ray = sequence.next_1d, sequence.next_2d, None
        if self.pose.motion is not None:
            part.pose = replace(self.pose, time=dr.gather(mi.Float, self.pose.time, lanes))
            dr.eval(part.pose.time)
        return part

    def flash_light(self, si: Any, point: Any, active: Any, spectra: LightSpectra) -> Any:
        """Light of the flash at first hits, as the mean over evenly spread points with a shadow ray to each.

        Close to the camera, the emitters light a point very differently, and most of the image is in their
        penumbras. Shadow rays from one hit are coherent, and cheaper than rays to new hits.
        """
        mi, dr = mitsuba_modules()
        if self.tables.flash is None or spectra.flash is None:
            return point.reflectance * 0.0
        offset, total = self.next_2d(), 0.0
        for k in range(_FLASH_POINTS):
            stratum = mi.Point2f((k + offset.x) / _FLASH_POINTS, offset.y)
            light, target = self.unshadowed_flash(si, point, active, spectra, stratum)
            total += light & ~self.is_occluded(si, target, active & dr.any(light > 0.0))
        return total / _FLASH_POINTS

    def sun_light(self, si: Any, point: Any, active: Any, spectra: LightSpectra) -> Any:
        """Light of one point of the sun's disc."""
        if self.tables.sky is None or spectra.sun is None:
            return point.reflectance * 0.0
        light, direction = self.unshadowed_sun(si, point, active, spectra)
        return light & ~self.tables.scene.scene.ray_test(si.spawn_ray(direction), active)

    def flash_and_sun_light(self, si: Any, point: Any, active: Any, spectra: LightSpectra) -> Any:
        """Light of one point of the flash and one of the sun's disc, at later hits.

        Shadow rays from later hits are incoherent and expensive, so one serves both: it goes to either, with
        a probability in proportion to the unshadowed light, and the light is divided by that probability.
        """
        at_hit = si, point, active, spectra
        has_sun = self.tables.sky is not None and spectra.sun is not None
        if self.tables.flash is None or spectra.flash is None:
            return self.sun_light(*at_hit)
        if not has_sun:
            return self._one_point_flash_light(*at_hit)
        if not self.tables.roulette:
            return self._one_point_flash_light(*at_hit) + self.sun_light(*at_hit)
        _, dr = mitsuba_modules()
        flash, target = self.unshadowed_flash(*at_hit, self.next_2d())
        sun, direction = self.unshadowed_sun(*at_hit)
        both = dr.sum(flash) + dr.sum(sun)
        flash_fraction = dr.select(both > 0.0, dr.sum(flash) / dr.maximum(both, TINY), 0.0)
        to_flash = self.next_1d() < flash_fraction
        probability = dr.select(to_flash, flash_fraction, 1.0 - flash_fraction)
        light = dr.select(to_flash, flash, sun) / dr.maximum(probability, TINY)
        ray = dr.select(to_flash, si.spawn_ray_to(target), si.spawn_ray(direction))
        lit = active & (both > 0.0)
        return light & (lit & ~self.tables.scene.scene.ray_test(ray, lit))

    def sky_radiance(self, direction: Any, active: Any, spectra: LightSpectra, *, with_sun: bool) -> Any:
        """Radiance of the sky from a direction; with the sun's disc if it is seen directly."""
        _, dr = mitsuba_modules()
        sky = self.tables.sky
        if sky is None:
            return 0.0
        uv = _sky_uv(direction)
        first: Any = spectra.sky[0] if spectra.sky else spectra.sun
        radiance = first * 0.0
        for weight, spectrum in zip(sky.weights.eval(uv, active), spectra.sky, strict=True):
            radiance += weight * spectrum
        if with_sun and spectra.sun is not None:
            square = dr.square(sky.sun_chord)
            in_disc = dr.squared_norm(direction - sky.sun_frame.n) < square
            radiance += (spectra.sun / (dr.pi * square)) & in_disc
        return radiance & active

    def sky_weights(self, direction: Any, active: Any, *, with_sun: bool) -> list[Any]:
        """Factors of the sky's spectra, and then that of the sun's, in the radiance from a direction.

        The sun's is there if the sky has one and `with_sun` asks for its disc.
        """
        mi, dr = mitsuba_modules()
        sky = self.tables.sky
        if sky is None:
            return []
        weights = [weight & active for weight in sky.weights.eval(_sky_uv(direction), active)]
        if with_sun and sky.sun_frame is not None:
            square = dr.square(sky.sun_chord)
            in_disc = dr.squared_norm(direction - sky.sun_frame.n) < square
            weights.append(mi.Float(dr.rcp(dr.pi * square)) & (in_disc & active))
        return weights

    def _one_point_flash_light(self, si: Any, point: Any, active: Any, spectra: LightSpectra) -> Any:
        _, dr = mitsuba_modules()
        light, target = self.unshadowed_flash(si, point, active, spectra, self.next_2d())
        return light & ~self.is_occluded(si, target, active & dr.any(light > 0.0))

    def is_occluded(self, si: Any, target: Any, active: Any) -> Any:
        """Whether a surface is between a hit and a point."""
        mi, _ = mitsuba_modules()
        return self.tables.scene.scene.ray_test(si.spawn_ray_to(target), mi.Bool(True), active)

    def unshadowed_flash(
        self, si: Any, point: Any, active: Any, spectra: LightSpectra, sample: Any
    ) -> tuple[Any, Any]:
        """Unshadowed light of a point of the flash, and that point."""
        _, dr = mitsuba_modules()
        assert self.tables.flash is not None
        target, falloff = self.tables.flash.sample_point(si.p, sample, self.pose)
        value, _ = point.eval_pdf(si.to_local(dr.normalize(target - si.p)))
        return (value * spectra.flash * falloff) & (active & (falloff > 0.0)), target

    def unshadowed_sun(self, si: Any, point: Any, active: Any, spectra: LightSpectra) -> tuple[Any, Any]:
        """Unshadowed light of a point of the sun's disc, and the direction to it."""
        mi, dr = mitsuba_modules()
        sky = self.tables.sky
        assert sky is not None
        # Squared chords from the centre are uniform over a cap, as squared radii are over a flat disc.
        chord = sky.sun_chord * mi.warp.square_to_uniform_disk_concentric(self.next_2d())
        square = dr.squared_norm(chord)
        across = chord * dr.sqrt(1.0 - 0.25 * square)
        direction = sky.sun_frame.to_world(mi.Vector3f(across.x, across.y, 1.0 - 0.5 * square))
        value, _ = point.eval_pdf(si.to_local(direction))
        return (value * spectra.sun) & active, direction


def _sky_uv(direction: Any) -> Any:
    """Coordinates of directions in the texture of the sky's weights."""
    mi, dr = mitsuba_modules()
    azimuth = dr.atan2(direction.y, direction.x) * dr.inv_two_pi
    return mi.Point2f(azimuth - dr.floor(azimuth), dr.safe_acos(direction.z) * dr.inv_pi)


class SampleWavelengths:
    """Four wavelengths for each sample, and the lights and the sensor at these.

    Args:
        tables: of the frame.
        position: in [0, 1), well spread over a pixel's samples, which then cover the spectrum evenly.
    """

    def __init__(self, tables: FrameTables, position: Any) -> None:
        mi, _ = mitsuba_modules()
        self.tables = tables
        self.nm, self.weights = mi.Spectrum(0.0), mi.Spectrum(0.0)
        for k in range(4):
            nm, density = tables.wavelengths.sample_pdf((position + k) / 4.0)
            self.nm[k] = nm
            self.weights[k] = 0.25 / density
        # Spectra are looked up once: under the mask of each hit they would be gathered again and again.
        self.electrons_per_joule = [self._lookup(table) for table in tables.electrons_per_joule]
        self.spectra = LightSpectra(
            flash=None if tables.spectra.flash is None else self._lookup(tables.spectra.flash),
            sun=None if tables.spectra.sun is None else self._lookup(tables.spectra.sun),
            sky=[self._lookup(table) for table in tables.spectra.sky],
        )

    def channels(self, radiance: Any) -> list[Any]:
        """Integrate radiance over wavelength in each sensor channel, electrons s-1 m-2 sr-1."""
        _, dr = mitsuba_modules()
        return [dr.sum(radiance * self.weights * electrons) for electrons in self.electrons_per_joule]

    def _lookup(self, table: Any) -> Any:
        """A table at the samples' wavelengths, linear between its entries."""
        mi, dr = mitsuba_modules()
        result = mi.Spectrum(0.0)
        for k in range(4):
            x = dr.clip((self.nm[k] - self.tables.first_nm) / STEP_NM, 0.0, self.tables.last_entry)
            left = dr.floor(x)
            index = mi.UInt32(left)
            result[k] = dr.lerp(
                dr.gather(mi.Float, table, index), dr.gather(mi.Float, table, index + 1), x - left
            )
        return result

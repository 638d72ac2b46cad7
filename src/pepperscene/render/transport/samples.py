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
_SOFT_LAMP_POINTS: Final = 32  # of many lamps, whose light few samples carry; see benchmarks/lamps.py
_GOLDEN: Final = 0.6180339887498949  # of the golden ratio; steps of it fill the unit interval evenly
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

    @classmethod
    def on_surfaces(cls, tables: FrameTables, sequence: OwenSobol) -> Samples:
        """Samples that start on surfaces, without a camera, and so without lights that move with one."""
        samples = cls.__new__(cls)
        samples.tables, samples.sequence, samples.ray, samples.pose = tables, sequence, None, None
        samples.next_1d, samples.next_2d = sequence.next_1d, sequence.next_2d
        return samples

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

    def later_light(self, si: Any, point: Any, active: Any, spectra: LightSpectra) -> Any:
        """Light of one point of the flash, one of the sun's disc and one of a lamp, at later hits.

        Shadow rays from later hits are incoherent and expensive, so one serves all: it goes to one light,
        with a probability in proportion to the unshadowed light, and the light is divided by it.
        """
        at_hit = si, point, active, spectra
        if self.tables.lamps is not None and spectra.lamps:
            return self._light_with_lamps(*at_hit)
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

    def lamp_light(
        self, si: Any, point: Any, active: Any, spectra: LightSpectra, group: int | None = None
    ) -> Any:
        """Light of the lamps of a spectrum, or of all, at first hits; see `flash_light`."""
        mi, dr = mitsuba_modules()
        lamps = self.tables.lamps
        if lamps is None or not spectra.lamps:
            return point.reflectance * 0.0
        limits = (lamps.groups[group], lamps.groups[group + 1]) if group is not None else None
        choice, place, total = self.next_1d(), self.next_2d(), 0.0
        count = _FLASH_POINTS if self.tables.lamp_optics else _SOFT_LAMP_POINTS
        positions = [(k + choice) / count for k in range(count)]
        for k, chosen in enumerate(lamps.choose(si, point, active, self.pose, positions, limits)):
            # Each point is even over the whole shape, because the number of the choice decides the lamp.
            sample = mi.Point2f(_wrapped(place.x + k / count), _wrapped(place.y + k * _GOLDEN))
            light, target = self._unshadowed_lamp((si, point, active), spectra, chosen, sample)
            total += light & ~self.is_occluded(si, target, active & dr.any(light > 0.0))
        return total / count

    def one_lamp_light(self, si: Any, point: Any, active: Any) -> list[Any]:
        """Light of one point of one lamp at later hits, over the spectrum of 1 W, by spectrum."""
        assert self.tables.lamps is not None
        (chosen,) = self.tables.lamps.choose(si, point, active, self.pose, [self.next_1d()])
        light, target, group = self._lamp_point(si, point, active, chosen, self.next_2d())
        _, dr = mitsuba_modules()
        light = light & ~self.is_occluded(si, target, active & dr.any(light > 0.0))
        return [light & (group == k) for k in range(len(self.tables.lamps.groups) - 1)]

    def _lamp_point(
        self, si: Any, point: Any, active: Any, chosen: tuple[Any, Any], sample: Any
    ) -> tuple[Any, Any, Any]:
        """Unshadowed light of a point of a chosen lamp over its probability, that point, and the spectrum."""
        _, dr = mitsuba_modules()
        lamps, (number, probability) = self.tables.lamps, chosen
        assert lamps is not None
        target, falloff, group = lamps.point(number, si.p, sample, self.pose)
        value, _ = point.eval_pdf(si.to_local(dr.normalize(target - si.p)))
        lit = active & (falloff > 0.0) & (probability > 0.0)
        return (value * (falloff / dr.maximum(probability, TINY))) & lit, target, group

    def _unshadowed_lamp(
        self, at_hit: tuple[Any, Any, Any], spectra: LightSpectra, chosen: tuple[Any, Any], sample: Any
    ) -> tuple[Any, Any]:
        """As `_lamp_point`, with the spectrum's light."""
        _, dr = mitsuba_modules()
        light, target, group = self._lamp_point(*at_hit, chosen, sample)
        emitted = spectra.lamps[0]
        for k, spectrum in enumerate(spectra.lamps[1:], start=1):
            emitted = dr.select(group == k, spectrum, emitted)
        return light * emitted, target

    def _light_with_lamps(self, si: Any, point: Any, active: Any, spectra: LightSpectra) -> Any:
        """Light of one point of the flash, of the sun's disc, or of one lamp, as `later_light`."""
        _, dr = mitsuba_modules()
        at_hit = si, point, active, spectra
        assert self.tables.lamps is not None
        (chosen,) = self.tables.lamps.choose(si, point, active, self.pose, [self.next_1d()])
        light, target = self._unshadowed_lamp((si, point, active), spectra, chosen, self.next_2d())
        lights = [(light, si.spawn_ray_to(target))]
        if self.tables.flash is not None and spectra.flash is not None:
            light, target = self.unshadowed_flash(*at_hit, self.next_2d())
            lights.append((light, si.spawn_ray_to(target)))
        if self.tables.sky is not None and spectra.sun is not None:
            light, direction = self.unshadowed_sun(*at_hit)
            lights.append((light, si.spawn_ray(direction)))
        scene = self.tables.scene.scene
        if not self.tables.roulette:
            return sum(light & ~scene.ray_test(ray, active) for light, ray in lights)
        # The first light whose share, with those before it, is above a random number.
        strengths = [dr.sum(light) for light, _ in lights]
        total, position, before = sum(strengths), self.next_1d(), 0.0
        light, ray = lights[0]
        probability = strengths[0] / dr.maximum(total, TINY)
        for k in range(1, len(lights)):
            before = before + strengths[k - 1] / dr.maximum(total, TINY)
            takes = (position >= before) & (strengths[k] > 0.0)
            light, ray = dr.select(takes, lights[k][0], light), dr.select(takes, lights[k][1], ray)
            probability = dr.select(takes, strengths[k] / dr.maximum(total, TINY), probability)
        lit = active & (total > 0.0)
        return (light / dr.maximum(probability, TINY)) & (lit & ~scene.ray_test(ray, lit))

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


def _wrapped(value: Any) -> Any:
    """The fraction of a number at least 0."""
    _, dr = mitsuba_modules()
    return value - dr.floor(value)


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
        self.source = self._lookup(tables.source)
        self.electrons_per_joule = [self._lookup(table) for table in tables.electrons_per_joule]
        self.spectra = LightSpectra(
            flash=None if tables.spectra.flash is None else self._lookup(tables.spectra.flash),
            sun=None if tables.spectra.sun is None else self._lookup(tables.spectra.sun),
            sky=[self._lookup(table) for table in tables.spectra.sky],
            lamps=[self._lookup(table) for table in tables.spectra.lamps],
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

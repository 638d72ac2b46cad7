"""Light for a flash at the camera, in one or three channels of a sensor: what a wavefront of samples adds.

The flash is nearly deterministic; all other light is small and smooth (a tenth of the signal in `barth2018`).
So at the first hit the flash and the sun get separate shadow rays, towards points of their discs, at
later hits one for both, and the sky is found by BSDF sampling alone. Light that meets one surface only is
carried by sensor channel, with its integrals over wavelength taken in advance; light that meets more is
carried at four wavelengths per sample.

Sensors with bands have the same light in another form: see `band_light`.
"""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.arrays import device_uint
from pepperscene.render.transport.accumulate import SampleAccumulator, SampleSums, sum_samples
from pepperscene.render.transport.light_cache import LightCache, light_cache
from pepperscene.render.transport.lights import FrameTables
from pepperscene.render.transport.path_lengths import LONG_ROULETTE, ROULETTE
from pepperscene.render.transport.samples import Samples, SampleWavelengths
from pepperscene.render.variant import mitsuba_modules


@dataclass(frozen=True, eq=False)
class ChannelLight:
    """Light of samples in one or three channels.

    Attributes:
        tables: of the frame.
        lengths: `bounces` and `most_bounces` of `Sampling`.
        seed: of the samples.
    """

    tables: FrameTables
    lengths: tuple[int, int]
    seed: int
    directions: int = 0

    @functools.cached_property
    def cache(self) -> LightCache | None:
        """Light at second hits, from paths of its own; None without `directions`."""
        if self.directions == 0:
            return None
        return _fill_cache(self.tables, self.lengths, (self.seed ^ _CACHE_SALT) & 0xFFFFFFFF)

    def accumulator(self, height: int) -> SampleAccumulator:
        """An accumulator of this light in some rows, without samples."""
        return SampleAccumulator(height, self.tables.rays.width, self.tables.white)

    def sum_direct(
        self, pixels: NDArray[np.int64] | None, first: int, count: int, within: tuple[int, int] | None = None
    ) -> SampleSums:
        """Sums of direct light over samples from the first on; pixels as of `sum_samples`."""
        return sum_samples(self.tables, pixels, first, count, self.seed, _direct_light, within=within)

    def sum_all(self, count: int, within: tuple[int, int] | None = None) -> SampleSums:
        """Sums of all light over the first samples of all pixels, or of those within limits."""
        if self.cache is None:
            indirect = functools.partial(_indirect, lengths=self.lengths)
        else:
            indirect = functools.partial(_gathered, cache=self.cache, directions=self.directions)
        all_light = functools.partial(_all_light, indirect=indirect)
        return sum_samples(self.tables, None, 0, count, self.seed, all_light, within=within)


def _direct_light(tables: FrameTables, samples: Samples) -> list[list[Any]]:
    """Direct light: 3 c + 5 values."""
    return [_direct(tables, samples, *tables.scene.intersect(samples.ray, coherent=True))]


def _all_light(tables: FrameTables, samples: Samples, indirect: Any) -> list[list[Any]]:
    """Direct and indirect light along the same camera rays: 4 c + 6 values."""
    first_hit = tables.scene.intersect(samples.ray, coherent=True)
    direct = _direct(tables, samples, *first_hit)
    return [direct + indirect(tables, samples, *first_hit)]


def total_light(tables: FrameTables, samples: Samples, bounces: int) -> list[Any]:
    """The sum of all light: c values, and nothing that their derivatives do not need."""
    first_hit, c = tables.scene.intersect(samples.ray, coherent=True), tables.channels
    direct = _direct(tables, samples, *first_hit)[: 2 * c]
    indirect = _indirect(tables, samples, *first_hit, lengths=(bounces, 0))
    return [direct[k] + direct[c + k] + indirect[k] for k in range(c)]


def _direct(tables: FrameTables, samples: Samples, active: Any, si: Any, hit: Any) -> list[Any]:
    """Flash, sky and sun, albedo, normal, hit, and the sum of squares of the light: 3 c + 5 values."""
    mi, dr = mitsuba_modules()
    footprint = tables.rays.footprint(si)
    point = tables.scene.surface_point(si, hit, active, tables.flash_optics, footprint)
    flash = samples.flash_light(si, point, active, tables.colours)
    sky_and_sun = point.reflectance * 0.0 + samples.sky_radiance(
        samples.ray.d, ~active, tables.colours, with_sun=True
    )
    if tables.sun_optics is not None:
        sunlit_point = tables.scene.surface_point(si, hit, active, tables.sun_optics, footprint)
        sky_and_sun += samples.sun_light(si, sunlit_point, active, tables.colours)
    albedo = dr.select(active, point.albedo(), 0.0)
    # With its relief, whose shading the denoiser would take for noise otherwise.
    relief = si.to_world(point.frame.n)
    normal = dr.select(active, dr.select(si.wi.z > 0, relief, -relief), 0.0)
    values = [*flash, *sky_and_sun, *albedo, normal.x, normal.y, normal.z]
    return [*values, dr.select(active, mi.Float(1.0), 0.0), _sum_of_squares(tables, flash + sky_and_sun)]


def _indirect(
    tables: FrameTables, samples: Samples, active: Any, si: Any, hit: Any, lengths: tuple[int, int]
) -> list[Any]:
    """Daylight at the first hit and all light scattered more than once: c + 1 values.

    `lengths` are `bounces` and `most_bounces` of `Sampling`.
    """
    mi, _ = mitsuba_modules()
    wavelengths = SampleWavelengths(tables, samples.next_1d())
    lights = wavelengths.spectra
    si = mi.SurfaceInteraction3f(si)
    si.wavelengths = wavelengths.nm
    point = tables.scene.surface_point(si, hit, active, footprint=tables.rays.footprint(si))
    light = mi.Spectrum(0.0)
    if tables.sun_optics is None:
        light += samples.sun_light(si, point, active, lights)
    throughput = mi.Spectrum(1.0)
    bounces, most = lengths
    for bounce in range(bounces + 1):
        last = bounce == bounces and most <= bounces
        if last and tables.sky is None:
            break
        ray, active, throughput = _scatter(tables, samples, si, point, active, throughput)
        if last:
            # The last scattered ray only tests whether it reaches the sky.
            escaped = active & ~tables.scene.scene.ray_test(ray, active)
            light += throughput * samples.sky_radiance(ray.d, escaped, lights, with_sun=False)
            break
        if bounce == bounces:
            light += _continued_light(tables, samples, wavelengths, lengths, ray, active, throughput)
            break
        si, point, active, (sky, lamps) = _arrive(tables, samples, wavelengths, ray, active)
        light += throughput * sky
        light += throughput * lamps
    channels = wavelengths.channels(light)
    return [*channels, _sum_of_squares(tables, channels)]


_CACHE_SALT = 0x5BD1E995
_CACHE_PATHS = int(os.environ.get("PATHS", 1 << 20))


def _gathered(
    tables: FrameTables, samples: Samples, active: Any, si: Any, hit: Any, cache: LightCache, directions: int
) -> list[Any]:
    """As `_indirect`, with rays in several directions that end at second hits: c + 1 values."""
    mi, dr = mitsuba_modules()
    wavelengths = SampleWavelengths(tables, samples.next_1d())
    lights = wavelengths.spectra
    si = mi.SurfaceInteraction3f(si)
    si.wavelengths = wavelengths.nm
    point = tables.scene.surface_point(si, hit, active, footprint=tables.rays.footprint(si))
    light = mi.Spectrum(0.0)
    if tables.sun_optics is None:
        light += samples.sun_light(si, point, active, lights)
    lobe = samples.next_1d()
    for k in range(directions):
        wo, density, weight, _ = point.sample((lobe + k) / directions, samples.next_2d())
        going = active & (density > 0.0) & dr.any(weight > 0.0)
        weight = dr.select(going, weight / directions, 0.0)
        ray = si.spawn_ray(si.to_world(wo))
        ray.wavelengths = wavelengths.nm
        is_hit, second, second_hit = tables.scene.intersect(ray, going)
        light += weight * samples.sky_radiance(ray.d, going & ~is_hit, lights, with_sun=False)
        is_hit &= going
        albedo = 1.0 if os.environ.get("NOALB") else tables.scene.surface_point(second, second_hit, is_hit, footprint=None).albedo()
        light += weight * cache.outgoing(second, second_hit, albedo, wavelengths.source, is_hit)
    channels = wavelengths.channels(light)
    return [*channels, _sum_of_squares(tables, channels)]


def _fill_cache(tables: FrameTables, lengths: tuple[int, int], seed: int) -> LightCache:
    """Trace paths through all of an image, and keep the light that arrives from their second hits."""
    mi, dr = mitsuba_modules()
    cells = tables.scene.cells
    pixels = tables.rays.width * tables.rays.height
    count = max(_CACHE_PATHS // pixels, 1)
    step = max(pixels // _CACHE_PATHS, 1)
    parts = []
    for index in range(count):
        lane = dr.arange(mi.UInt32, pixels // step)
        samples = Samples(tables, lane * step, device_uint(index), device_uint(seed))
        side, light, expected = _second_light(tables, samples, lengths)
        dr.eval(side, light, expected)
        arrived = np.flatnonzero(np.asarray(side) < 2 * cells.count)
        parts.append([np.asarray(values)[..., arrived] for values in (side, light, expected)])
    return light_cache(cells, *(np.concatenate(values, axis=-1) for values in zip(*parts, strict=True)))


def _second_light(tables: FrameTables, samples: Samples, lengths: tuple[int, int]) -> tuple[Any, Any, Any]:
    """Cells of second hits, light that leaves them, and what is expected: albedo times light source."""
    mi, dr = mitsuba_modules()
    active, si, hit = tables.scene.intersect(samples.ray, coherent=True)
    wavelengths = SampleWavelengths(tables, samples.next_1d())
    si = mi.SurfaceInteraction3f(si)
    si.wavelengths = wavelengths.nm
    point = tables.scene.surface_point(si, hit, active, footprint=tables.rays.footprint(si))
    wo, density, weight, _ = point.sample(samples.next_1d(), samples.next_2d())
    active &= (density > 0.0) & dr.any(weight > 0.0)
    ray = si.spawn_ray(si.to_world(wo))
    ray.wavelengths = wavelengths.nm
    is_hit, si, hit = tables.scene.intersect(ray, active)
    active = active & is_hit
    point = tables.scene.surface_point(si, hit, active, footprint=None)
    number = dr.select(active, tables.scene.cells.at(si, hit, active), 2 * tables.scene.cells.count)
    expected = dr.select(active, (1.0 if os.environ.get("NOALB") else point.albedo()) * wavelengths.source, 0.0)
    light = dr.select(active, samples.flash_and_sun_light(si, point, active, wavelengths.spectra), 0.0)
    light += _light_after(tables, samples, wavelengths, lengths, si, point, active)
    return number, light, expected


def _light_after(
    tables: FrameTables,
    samples: Samples,
    wavelengths: SampleWavelengths,
    lengths: tuple[int, int],
    si: Any,
    point: Any,
    active: Any,
) -> Any:
    """Light that second hits scatter, except that of lamps."""
    mi, dr = mitsuba_modules()
    lights, light, throughput = wavelengths.spectra, mi.Spectrum(0.0), mi.Spectrum(1.0)
    bounces, most = lengths
    for bounce in range(1, bounces + 1):
        last = bounce == bounces and most <= bounces
        if last and tables.sky is None:
            break
        ray, active, throughput = _scatter(tables, samples, si, point, active, throughput)
        if last:
            escaped = active & ~tables.scene.scene.ray_test(ray, active)
            light += throughput * samples.sky_radiance(ray.d, escaped, lights, with_sun=False)
            break
        if bounce == bounces:
            light += _continued_light(tables, samples, wavelengths, lengths, ray, active, throughput)
            break
        si, point, active, (sky, lamps) = _arrive(tables, samples, wavelengths, ray, active)
        light += throughput * sky
        light += throughput * lamps
    return light


def _scatter(
    tables: FrameTables,
    samples: Samples,
    si: Any,
    point: Any,
    active: Any,
    throughput: Any,
    roulette: tuple[float, float] = ROULETTE,
) -> tuple[Any, Any, Any]:
    """Scatter paths at surface points: their rays, which of them go on, and their throughput."""
    mi, dr = mitsuba_modules()
    wo, density, weight, _ = point.sample(samples.next_1d(), samples.next_2d())
    throughput = throughput * weight
    # Russian roulette: leaves absorb most of the light, and rays for the rest are expensive.
    survival = mi.Float(1.0)
    if tables.roulette:
        survival = dr.clip(roulette[0] * dr.max(throughput), roulette[1], 1.0)
    active = active & (density > 0.0) & (samples.next_1d() < survival) & dr.any(throughput > 0.0)
    # Inactive lanes keep old values, which can be NaN, and 0 times NaN is NaN.
    throughput = dr.select(active, throughput / survival, 0.0)
    return si.spawn_ray(si.to_world(wo)), active, throughput


def _arrive(
    tables: FrameTables, samples: Samples, wavelengths: SampleWavelengths, ray: Any, active: Any
) -> tuple[Any, Any, Any, tuple[Any, Any]]:
    """Follow scattered rays to surface points: interactions, points, which are hit, and light of both ends.

    The light is that of the sky for rays that escape, and that of flash and sun at the points.
    """
    lights = wavelengths.spectra
    ray.wavelengths = wavelengths.nm
    is_hit, si, hit = tables.scene.intersect(ray, active)
    # No texel can be seen in scattered light, and a relief has its mean.
    point = tables.scene.surface_point(si, hit, active & is_hit, footprint=None)
    sky = samples.sky_radiance(ray.d, active & ~is_hit, lights, with_sun=False)
    active = active & is_hit
    return si, point, active, (sky, samples.flash_and_sun_light(si, point, active, lights))


def _continued_light(
    tables: FrameTables,
    samples: Samples,
    wavelengths: SampleWavelengths,
    lengths: tuple[int, int],
    ray: Any,
    active: Any,
    throughput: Any,
) -> Any:
    """Light of paths from scattered rays on, until Russian roulette ends them: a loop inside the kernel."""
    mi, dr = mitsuba_modules()
    sequence, first_dimension = samples.sequence, samples.sequence.dimension
    bounces, most = lengths

    def is_active(ray: Any, active: Any, throughput: Any, light: Any, bounce: Any, dimension: Any) -> Any:
        return active

    def body(ray: Any, active: Any, throughput: Any, light: Any, bounce: Any, dimension: Any) -> Any:
        sequence.dimension = dimension
        si, point, active, (sky, lamps) = _arrive(tables, samples, wavelengths, ray, active)
        active &= bounce < most
        light += throughput * (sky + (lamps & active))
        bounce += 1
        ray, active, throughput = _scatter(tables, samples, si, point, active, throughput, LONG_ROULETTE)
        return ray, active, throughput, light, bounce, sequence.dimension

    ray.wavelengths = wavelengths.nm
    bounce, dimension = device_uint(bounces), device_uint(first_dimension)
    state = (ray, active, throughput, mi.Spectrum(0.0), bounce, dimension)
    light = dr.while_loop(state, is_active, body, label="continued paths")[3]
    sequence.dimension = first_dimension
    return light


def _sum_of_squares(tables: FrameTables, channels: Any) -> Any:
    """Sum of the squares of the channels, in units of the light of a white body."""
    _, dr = mitsuba_modules()
    return sum(dr.square(channel * scale) for channel, scale in zip(channels, tables.per_white, strict=True))

"""Light transport for a flash at the camera: one traversal for all light, then more samples of its edges.

The flash is nearly deterministic; all other light is small and smooth (a tenth of the signal in `barth2018`).
So at the first hit the flash and the sun get separate shadow rays, towards points of their discs, at
later hits one for both, and the sky is found by BSDF sampling alone. Light that meets one surface only is
carried by sensor channel, with its integrals over wavelength taken in advance; light that meets more is
carried at four wavelengths per sample. The first samples of a pixel trace both; where they show edges, more
samples follow that stop at the first hit.

The samples of a pixel are adjacent in the wavefront, so that the sum over a pixel is a block reduction: no
atomics, and the same bits in each run, however the wavefront is split.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.kernel.arrays import device_array, device_uint
from pepperscene.render.kernel.camera import CameraRays, SpectralResponse
from pepperscene.render.kernel.scene import LightScene, SkyTables
from pepperscene.render.transport.accumulate import Counts, Images, SampleAccumulator, TracedLight
from pepperscene.render.transport.lights import FrameTables, frame_tables
from pepperscene.render.transport.samples import Samples, SampleWavelengths
from pepperscene.render.variant import mitsuba_modules

_LANES: Final = 1 << 20
"""Wavefront of a pass. Chosen: 25 results per sample take 105 MB. With twice as many the first frame of
`demo` takes 130 MB more, and a further one 4.7 instead of 4.9 CPU seconds (medians of eight)."""
_REFINEMENT_ROUNDS: Final = 3  # chosen
_ROULETTE: Final = (2.0, 0.25)
"""Chosen: a path survives with twice the fraction of light that it still carries, so that pale surfaces end
no path, and at least with this probability, which bounds the weight of a survivor. Half of the former takes a
quarter less time and has a fifth more noise: no gain."""
_LONG_ROULETTE: Final = (0.5, 0.1)
"""The same beyond `Sampling.bounces`. Chosen: a visible frame of `greenhouse` by daylight then takes 3 % more
time than without these paths, with `_ROULETTE` 6 %; the noise of its soft samples rises from 1.20 to 1.31 of
their mean."""


@dataclass(frozen=True, eq=False)
class Sampling:
    """Numbers of samples; powers of two spread best.

    Attributes:
        samples: per pixel, everywhere.
        indirect: how many of these trace indirect light as well.
        bounces: scattering events after the first hit.
        required: from the samples so far to the number that each pixel should have, `(h * w,)`; None to take
            `samples` everywhere.
        most_bounces: if above `bounces`, paths go on after these until Russian roulette ends them, for up to
            this many.
    """

    samples: int
    indirect: int
    bounces: int
    required: Callable[[SampleAccumulator], Counts] | None = None
    most_bounces: int = 0


def trace(
    scene: LightScene,
    rays: CameraRays,
    response: SpectralResponse,
    flash: Flash | None,
    sky: SkyTables | None,
    sampling: Sampling,
    seed: int,
) -> TracedLight:
    """Trace the light that reaches each pixel of a camera in a scene with materials over its response."""
    return trace_rows(frame_tables(scene, rays, response, flash, sky), sampling, seed)


def trace_rows(tables: FrameTables, sampling: Sampling, seed: int, rows: slice = slice(None)) -> TracedLight:
    """Trace the light that reaches the pixels of some rows, with the samples that `trace` takes there.

    `Sampling.required` sees these rows alone.
    """
    width = tables.rays.width
    top, bottom, _ = rows.indices(tables.rays.height)
    within = (top * width, bottom * width)
    accumulator = SampleAccumulator(bottom - top, width, tables.white)
    first = 0
    # One traversal for all light, then the samples without indirect light.
    if tables.has_lights:
        first = min(sampling.indirect, sampling.samples)
        all_light = functools.partial(_all_light, bounces=sampling.bounces, most=sampling.most_bounces)
        accumulator.add_all(sum_samples(tables, None, 0, first, seed, all_light, within), first)
    if sampling.samples > first:
        remaining = sampling.samples - first
        sums = sum_samples(tables, None, first, remaining, seed, _direct_light, within)
        accumulator.add_direct(sums, remaining)

    if not tables.has_lights or sampling.required is None:
        return accumulator.light()

    # Continue the sample sequences of pixels that need more.
    for _ in range(_REFINEMENT_ROUNDS):
        refinements = list(_refinements(accumulator.samples, sampling.required(accumulator)))
        for begin, end, pixels in refinements:
            sums = sum_samples(tables, pixels + within[0], begin, end - begin, seed, _direct_light)
            accumulator.add_direct(sums, end - begin, pixels)
        if not refinements:
            break
    return accumulator.light()


def _refinements(taken: Counts, required: Counts) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """First sample, end sample and pixels of each refinement."""
    for begin in np.flatnonzero(np.bincount(taken)).tolist():
        pixels = np.flatnonzero((taken == begin) & (required > begin))
        for end in np.flatnonzero(np.bincount(required[pixels])).tolist():
            yield begin, end, pixels[required[pixels] == end]


def sum_samples(
    tables: FrameTables,
    pixels: NDArray[np.int64] | None,
    first: int,
    count: int,
    seed: int,
    integrand: Callable[[FrameTables, Samples], list[Any]],
    within: tuple[int, int] | None = None,
) -> list[Images]:
    """Sum an integrand's k values over samples `first` to `first + count - 1` of n pixels: k times `(n,)`.

    `pixels` are row-major indices, or None for all or those `within` limits; `integrand` computes the values
    of a wavefront.
    """
    start, end = within or (0, tables.rays.width * tables.rays.height)
    if pixels is not None:
        start, end = 0, len(pixels)
    block = max(_LANES // count, 1)
    if end - start <= block:
        return _sum_pass(tables, pixels, (start, end), first, count, seed, integrand)
    # Copied pass by pass, so that the device holds the sums of one pass and not those of the whole image.
    sums: list[Images] = []
    for low in range(start, end, block):
        high = min(low + block, end)
        parts = _sum_pass(tables, pixels, (low, high), first, count, seed, integrand)
        sums = sums or [np.empty(end - start, np.float32) for _ in parts]
        for whole, part in zip(sums, parts, strict=True):
            whole[low - start : high - start] = part
    return sums


def _sum_pass(
    tables: FrameTables,
    pixels: NDArray[np.int64] | None,
    limits: tuple[int, int],
    first: int,
    count: int,
    seed: int,
    integrand: Callable[[FrameTables, Samples], list[Any]],
) -> list[Images]:
    """The sums of `sum_samples` for its pixels from one number to another, in the device's memory."""
    mi, dr = mitsuba_modules()
    start, end = limits
    salt, begin, per_pixel = (device_uint(n) for n in (seed & 0xFFFFFFFF, first, count))
    lane = dr.arange(mi.UInt32, (end - start) * count)
    number = lane // per_pixel
    index = begin + lane - number * per_pixel
    if pixels is None:
        pixel = number + device_uint(start)
    else:
        pixel = dr.gather(mi.UInt32, device_array(pixels[start:end], np.uint32), number)
    values = integrand(tables, Samples(tables, pixel, index, salt))
    # Evaluate all results in one kernel: reduced separately, each would run the kernel again.
    dr.eval(values)
    sums = [dr.block_reduce(dr.ReduceOp.Add, value, count) for value in values]
    dr.eval(sums)
    return [np.asarray(values_sum) for values_sum in sums]


def _direct_light(tables: FrameTables, samples: Samples) -> list[Any]:
    """Direct light: 3 c + 5 values."""
    return _direct(tables, samples, *tables.scene.intersect(samples.ray, coherent=True))


def _all_light(tables: FrameTables, samples: Samples, bounces: int, most: int = 0) -> list[Any]:
    """Direct and indirect light along the same camera rays: 4 c + 6 values."""
    first_hit = tables.scene.intersect(samples.ray, coherent=True)
    direct = _direct(tables, samples, *first_hit)
    return direct + _indirect(tables, samples, (bounces, most), *first_hit)


def total_light(tables: FrameTables, samples: Samples, bounces: int) -> list[Any]:
    """The sum of all light: c values, and nothing that their derivatives do not need."""
    first_hit, c = tables.scene.intersect(samples.ray, coherent=True), tables.channels
    direct = _direct(tables, samples, *first_hit)[: 2 * c]
    indirect = _indirect(tables, samples, (bounces, 0), *first_hit)
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
    tables: FrameTables, samples: Samples, lengths: tuple[int, int], active: Any, si: Any, hit: Any
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


def _scatter(
    tables: FrameTables,
    samples: Samples,
    si: Any,
    point: Any,
    active: Any,
    throughput: Any,
    roulette: tuple[float, float] = _ROULETTE,
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
        ray, active, throughput = _scatter(tables, samples, si, point, active, throughput, _LONG_ROULETTE)
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

"""Paths of scattered light in one or three channels, at four wavelengths per sample.

At later hits, flash and sun share a shadow ray, and the sky is found by BSDF sampling alone.
"""

from __future__ import annotations

from typing import Any

from pepperscene.render.arrays import device_uint
from pepperscene.render.transport.lights import FrameTables
from pepperscene.render.transport.path_lengths import LONG_ROULETTE, ROULETTE
from pepperscene.render.transport.samples import Samples, SampleWavelengths
from pepperscene.render.variant import mitsuba_modules


def first_point(
    tables: FrameTables, samples: Samples, active: Any, si: Any, hit: Any
) -> tuple[SampleWavelengths, Any, Any, Any]:
    """Wavelengths of the samples, first hits, their optical states, and indirect light of sun and lamps."""
    mi, _ = mitsuba_modules()
    wavelengths = SampleWavelengths(tables, samples.next_1d())
    si = mi.SurfaceInteraction3f(si)
    si.wavelengths = wavelengths.nm
    point = tables.scene.surface_point(si, hit, active, footprint=tables.rays.footprint(si))
    light = mi.Spectrum(0.0)
    if tables.sun_optics is None:
        light += samples.sun_light(si, point, active, wavelengths.spectra)
    if tables.lamps is not None and not tables.lamp_optics:
        light += samples.lamp_light(si, point, active, wavelengths.spectra)
    return wavelengths, si, point, light


def scattered_light(
    tables: FrameTables,
    samples: Samples,
    wavelengths: SampleWavelengths,
    at_hit: tuple[Any, Any, Any],
    light: Any,
    bounces: range,
    most: int,
) -> Any:
    """The light that hits send out: some light, and what paths from there on find.

    Args:
        tables: of the frame.
        samples: whose paths go on.
        wavelengths: of the samples.
        at_hit: interactions, optical states, and which samples are active.
        light: that of lamps which the hits scatter.
        bounces: numbers of the scattering events; the hits that camera rays find have the number 0.
        most: see `Sampling.most_bounces`.
    """
    mi, _ = mitsuba_modules()
    lights, throughput = wavelengths.spectra, mi.Spectrum(1.0)
    si, point, active = at_hit
    final = bounces.stop - 1
    for bounce in bounces:
        last = bounce == final and most <= final
        if last and tables.sky is None:
            break
        ray, active, throughput = scatter(tables, samples, si, point, active, throughput)
        if last:
            # The last scattered ray only tests whether it reaches the sky.
            escaped = active & ~tables.scene.scene.ray_test(ray, active)
            light += throughput * samples.sky_radiance(ray.d, escaped, lights, with_sun=False)
            break
        if bounce == final:
            lengths = final, most
            light += continued_light(tables, samples, wavelengths, lengths, ray, active, throughput)
            break
        si, point, active, (sky, lamps) = arrive(tables, samples, wavelengths, ray, active)
        light += throughput * sky
        light += throughput * lamps
    return light


def scatter(
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


def arrive(
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
    return si, point, active, (sky, samples.later_light(si, point, active, lights))


def continued_light(
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
        si, point, active, (sky, lamps) = arrive(tables, samples, wavelengths, ray, active)
        active &= bounce < most
        light += throughput * (sky + (lamps & active))
        bounce += 1
        ray, active, throughput = scatter(tables, samples, si, point, active, throughput, LONG_ROULETTE)
        return ray, active, throughput, light, bounce, sequence.dimension

    ray.wavelengths = wavelengths.nm
    bounce, dimension = device_uint(bounces), device_uint(first_dimension)
    state = (ray, active, throughput, mi.Spectrum(0.0), bounce, dimension)
    light = dr.while_loop(state, is_active, body, label="continued paths")[3]
    sequence.dimension = first_dimension
    return light

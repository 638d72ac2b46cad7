"""Indirect light from rays in several directions that end at their second hits.

Among leaves by daylight, nine tenths of the noise of scattered light arise after the second hit. So a part of
the paths are traced to their ends and fill a `LightCache`; the other rays take the light at their second hits
from there.

Where this differs from paths: the light of a cell of 3 cm is taken as even, over its area and over
directions. Where most light comes from the sun, each second hit has its own sunlight.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from pepperscene.interrupts import raise_if_interrupted
from pepperscene.render.arrays import device_uint
from pepperscene.render.quality import Gathering
from pepperscene.render.transport.channel_paths import first_point, scattered_light
from pepperscene.render.transport.light_cache import LightCache, PathLight
from pepperscene.render.transport.lights import FrameTables
from pepperscene.render.transport.samples import TINY, Samples, SampleWavelengths
from pepperscene.render.variant import mitsuba_modules

_SMOOTH: Final = 0.15  # roughness; chosen: that of fruit is .07 to .12, that of leaves from .22 on
_GLOSS_RAYS: Final = 2
"""Further rays of smooth surfaces, in the directions of their gloss. Chosen: the error of fruit in
`greenhouse` is 4 % less than without, for 4 % of the time of a frame."""
_SALT: Final = 0x5BD1E995  # chosen: the paths have other random numbers than the frame's samples


def gathered_light(
    tables: FrameTables,
    samples: Samples,
    wavelengths: SampleWavelengths,
    at_hit: tuple[Any, Any, Any],
    cache: LightCache,
    gathering: Gathering,
) -> Any:
    """Light that first hits scatter, from the sky and from the cached light of second hits.

    `at_hit` are interactions, optical states, and which samples are active.
    """
    mi, dr = mitsuba_modules()
    directions = gathering.directions
    si, point, active = at_hit
    light, lobe = mi.Spectrum(0.0), samples.next_1d()
    # A smooth surface shows the sky and the leaves around it: its gloss has rays of its own.
    is_smooth = active & (point.gloss.square < _SMOOTH**2)
    gloss_rays = dr.select(is_smooth, mi.Float(_GLOSS_RAYS), 0.0)
    for k in range(directions + _GLOSS_RAYS):
        if k < directions:
            # The directions divide the lobes among them.
            wo, density, weight, _ = point.sample((lobe + k) / directions, samples.next_2d())
            value, going = weight * density, active
        else:
            wo, value, density = point.sample_gloss(samples.next_1d(), samples.next_2d())
            going = is_smooth
        # Both kinds of rays have the weights of the balance heuristic (Veach & Guibas 1995).
        going = going & (density > 0.0) & dr.any(value > 0.0)  # `&=` would change the array that it names
        both = directions * density + gloss_rays * point.gloss_density(wo)
        weight = dr.select(going, value / dr.maximum(both, TINY), 0.0)
        ray = si.spawn_ray(si.to_world(wo))
        ray.wavelengths = wavelengths.nm
        is_hit, second, hit = tables.scene.intersect(ray, going)
        light += weight * samples.sky_radiance(ray.d, going & ~is_hit, wavelengths.spectra, with_sun=False)
        is_hit &= going
        second_point = tables.scene.surface_point(second, hit, is_hit, footprint=None)
        # Albedos of inactive lanes can be NaN, and 0 times NaN is NaN.
        expected = dr.select(is_hit, second_point.albedo() * wavelengths.source, 0.0)
        light += weight * cache.outgoing(second, hit, expected, is_hit)
        if gathering.sun_at_hits:
            sunlight = samples.sun_light(second, second_point, is_hit, wavelengths.spectra)
            light += weight * dr.select(is_hit, sunlight, 0.0)
    return light


def trace_paths(tables: FrameTables, lengths: tuple[int, int], seed: int, gathering: Gathering) -> PathLight:
    """Trace paths through all of an image, for the light that arrives from their second hits.

    Args:
        tables: of the frame.
        lengths: `bounces` and `most_bounces` of `Sampling`.
        seed: of the frame's samples.
        gathering: number of paths, which are one wavefront, and whether sunlight at second hits is left out.
    """
    mi, dr = mitsuba_modules()
    raise_if_interrupted()
    cells, pixels = tables.scene.cells, tables.rays.width * tables.rays.height
    paths = gathering.paths
    # A large image has a path in every `step`-th pixel, a small one has several in each.
    step, per_pixel = -(-pixels // paths), max(paths // pixels, 1)
    with_paths = -(-pixels // step)
    lane, count = dr.arange(mi.UInt32, with_paths * per_pixel), device_uint(with_paths)
    index = lane // count
    pixel = (lane - index * count) * device_uint(step)
    samples = Samples(tables, pixel, index, device_uint((seed ^ _SALT) & 0xFFFFFFFF))
    values = _second_light(tables, samples, lengths, with_sun=not gathering.sun_at_hits)
    dr.eval(values)
    is_hit = np.asarray(values[0]) < 2 * cells.count
    return PathLight(cells, *(np.asarray(part)[..., is_hit] for part in values))


def _second_light(
    tables: FrameTables, samples: Samples, lengths: tuple[int, int], *, with_sun: bool
) -> tuple[Any, Any, Any]:
    """Sides of cells at second hits, light that leaves them, and albedo times light source there.

    The side is beyond the last one without a second hit. No path ends by Russian roulette before it:
    survivors would count for too much.
    """
    mi, dr = mitsuba_modules()
    active, si, hit = tables.scene.intersect(samples.ray, coherent=True)
    wavelengths, si, point, _ = first_point(tables, samples, active, si, hit)
    wo, density, weight, _ = point.sample(samples.next_1d(), samples.next_2d())
    active &= (density > 0.0) & dr.any(weight > 0.0)
    ray = si.spawn_ray(si.to_world(wo))
    ray.wavelengths = wavelengths.nm
    is_hit, si, hit = tables.scene.intersect(ray, active)
    active = active & is_hit
    point = tables.scene.surface_point(si, hit, active, footprint=None)
    cells = tables.scene.cells
    side = dr.select(active, cells.at(si, hit, active), mi.UInt32(2 * cells.count))
    at_hit = si, point, active
    spectra = wavelengths.spectra if with_sun else replace(wavelengths.spectra, sun=None)
    lamps = samples.later_light(*at_hit, spectra)
    bounces, most = lengths
    light = scattered_light(tables, samples, wavelengths, at_hit, lamps, range(1, bounces + 1), most)
    expected = point.albedo() * wavelengths.source
    return side, dr.select(active, light, 0.0), dr.select(active, expected, 0.0)

"""Light transport for a flash at the camera: one traversal for all of it, then more of what has edges.

The flash is nearly deterministic, all else is small and smooth (a tenth of the signal in `barth2018`). So at
the first hit flash and sun are evaluated with shadow rays of their own, towards points of their discs, at
later hits with one for both, and the sky is found by BSDF sampling alone. Light that meets one surface only
is carried by sensor channel, with its integrals over wavelength taken beforehand; light that meets more is
carried at four wavelengths a sample. The first samples of a pixel trace both; where they show edges, more
follow that stop at the first hit.

Samples lie pixel by pixel in the wavefront, so that the sum over a pixel is a block reduction: no atomics,
the same bits in each run, however the wavefront is cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.kernel.arrays import device_number, device_table
from pepperscene.render.kernel.camera import CameraRays, Response
from pepperscene.render.kernel.scene import LightScene, SkyTables
from pepperscene.render.surface.optics import shading_normals
from pepperscene.render.transport.accumulate import Counts, Images, SampleAccumulator, TracedLight
from pepperscene.render.transport.samples import FrameTables, Samples, SpectralTables, Wavelengths
from pepperscene.render.variant import mitsuba_modules

_LANES: Final = 1 << 21  # chosen: wavefront of a pass; 25 results of a sample take 210 MB
_ROUNDS: Final = 3  # chosen: how often edges are asked whether they need more
_SURVIVAL, _LEAST_SURVIVAL = 2.0, 0.25
"""Chosen: a path lives on with twice the share of light that it still carries, so that pale surfaces end
none, and at least with this chance, which bounds the weight of a survivor. With half of the former there is a
quarter less time and a fifth more noise: the same worth."""


@dataclass(frozen=True, eq=False)
class Sampling:
    """How many samples go where; powers of two spread best.

    Attributes:
        samples: per pixel, everywhere.
        soft: of these, how many carry soft light.
        bounces: scattering events after the first hit.
        more: asked, from what there is, how many samples each pixel should have, `(h w,)`, until it wants no
            more than there are; None where `samples` are enough.
    """

    samples: int
    soft: int
    bounces: int
    more: Callable[[SampleAccumulator], Counts] | None = None


def trace(
    scene: LightScene,
    view: CameraRays,
    spectral: Response,
    flash: Flash | None,
    sky: SkyTables | None,
    sampling: Sampling,
    seed: int,
) -> TracedLight:
    """The light that reaches each pixel.

    Args:
        scene: with materials over the response's range.
        view: the camera's rays.
        spectral: the camera's response.
        flash: or None.
        sky: or None.
        sampling: how many samples go where.
        seed: of all that is random.
    """
    tables = FrameTables(scene, view, spectral, flash, sky)
    gathered = SampleAccumulator(view.height, view.width, tables.white)
    first = 0
    if tables.lights:
        # One traversal for all kinds of light, then the samples that carry none that is soft.
        spectra, first = SpectralTables(tables), min(sampling.soft, sampling.samples)

        def both(tables: FrameTables, samples: Samples) -> list[Any]:
            return _both(tables, spectra, samples, sampling.bounces)

        gathered.add_both(_summed(tables, None, 0, first, seed, both), first)
    if sampling.samples > first:
        rest = sampling.samples - first
        gathered.add_sharp(_summed(tables, None, first, rest, seed, _sharp_alone), rest)

    if tables.lights and sampling.more is not None:
        _refine(gathered, tables, sampling.more, seed)
    return gathered.light()


def _refine(
    gathered: SampleAccumulator, tables: FrameTables, more: Callable[[SampleAccumulator], Counts], seed: int
) -> None:
    """Edges and half-shadows go on where the first samples ended, until no pixel wants more."""
    for _ in range(_ROUNDS):
        steps = list(_steps(gathered.samples, more(gathered)))
        for begin, end, pixels in steps:
            sums = _summed(tables, pixels, begin, end - begin, seed, _sharp_alone)
            gathered.add_sharp(sums, end - begin, pixels)
        if not steps:
            return


def _steps(there: Counts, wanted: Counts) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """Samples from, to, and the pixels that go that way, wherever more are wanted."""
    for begin in np.flatnonzero(np.bincount(there)).tolist():
        pixels = np.flatnonzero((there == begin) & (wanted > begin))
        for end in np.flatnonzero(np.bincount(wanted[pixels])).tolist():
            yield begin, end, pixels[wanted[pixels] == end]


def _summed(
    tables: FrameTables,
    pixels: NDArray[np.int64] | None,
    first: int,
    count: int,
    seed: int,
    wavefront: Callable[[FrameTables, Samples], list[Any]],
) -> list[Images]:
    """Sums, k times `(n,)`, over samples `first` to `first + count - 1` of what a wavefront gives.

    Args:
        tables: of the frame.
        pixels: row-major indices, or None for all.
        first: sample of each pixel.
        count: of samples.
        seed: of the frame.
        wavefront: values of samples.
    """
    mi, dr = mitsuba_modules()
    total = tables.view.width * tables.view.height if pixels is None else len(pixels)
    block = max(_LANES // count, 1)
    salt, begin, per_pixel = (device_number(n, whole=True) for n in (seed & 0xFFFFFFFF, first, count))
    found: list[list[Images]] = []
    for start in range(0, total, block):
        here = min(block, total - start)
        lane = dr.arange(mi.UInt32, here * count)
        place = lane // per_pixel
        index = begin + lane - place * per_pixel
        if pixels is None:
            pixel = place + device_number(start, whole=True)
        else:
            pixel = dr.gather(mi.UInt32, device_table(pixels[start : start + here], np.uint32), place)
        values = wavefront(tables, Samples(tables, pixel, index, salt))
        # All results in one kernel: reduced one by one, the kernel would run once for each.
        dr.eval(values)
        sums = [dr.block_reduce(dr.ReduceOp.Add, value, count) for value in values]
        dr.eval(sums)
        found.append([np.asarray(one) for one in sums])
    return found[0] if len(found) == 1 else [np.concatenate(parts) for parts in zip(*found, strict=True)]


def _sharp_alone(tables: FrameTables, samples: Samples) -> list[Any]:
    """Light that meets one surface: 3 c + 5 values."""
    return _sharp(tables, samples, *_hit(tables.scene, samples.ray, coherent=True))


def _both(tables: FrameTables, spectra: SpectralTables, samples: Samples, bounces: int) -> list[Any]:
    """Light that meets one surface and light that meets more, along the same camera rays: 4 c + 6
    values.
    """
    found = _hit(tables.scene, samples.ray, coherent=True)
    sharp = _sharp(tables, samples, *found)
    return sharp + _soft(tables, spectra, samples, bounces, *found)


def all_light(tables: FrameTables, spectra: SpectralTables, samples: Samples, bounces: int) -> list[Any]:
    """Light of all kinds together: c values, and nothing that is not needed to differentiate them."""
    found, c = _hit(tables.scene, samples.ray, coherent=True), tables.channels
    flash_and_direct = _sharp(tables, samples, *found)[: 2 * c]
    soft = _soft(tables, spectra, samples, bounces, *found)
    return [flash_and_direct[k] + flash_and_direct[c + k] + soft[k] for k in range(c)]


def _sharp(tables: FrameTables, samples: Samples, active: Any, si: Any, hit: Any) -> list[Any]:
    """Flash at the first hit, sky seen and distinct sun, albedo, normal, hit, and the sum of squares of the
    light: 3 c + 5 values.
    """
    mi, dr = mitsuba_modules()
    point = tables.scene.point(si, hit, active, tables.lit)
    flash = samples.whole_flash(si, point, active, tables.lamps)
    direct = point.reflectance * 0.0 + samples.sky(samples.ray.d, ~active, tables.lamps, seen=True)
    if tables.sunlit is not None:
        direct += samples.sun(si, tables.scene.point(si, hit, active, tables.sunlit), active, tables.lamps)
    albedo = dr.select(active, point.albedo(), 0.0)
    normal = dr.select(active, dr.select(si.wi.z > 0, si.sh_frame.n, -si.sh_frame.n), 0.0)
    values = [*flash, *direct, *albedo, normal.x, normal.y, normal.z]
    return [*values, dr.select(active, mi.Float(1.0), 0.0), _square(tables, flash + direct)]


def _soft(
    tables: FrameTables,
    spectra: SpectralTables,
    samples: Samples,
    bounces: int,
    active: Any,
    si: Any,
    hit: Any,
) -> list[Any]:
    """Daylight at the first hit and all light that was scattered before it got there: c + 1 values."""
    mi, dr = mitsuba_modules()
    waves = Wavelengths(spectra, samples.next_1d())
    lamps = waves.lamps
    si = mi.SurfaceInteraction3f(si)
    si.wavelengths = waves.nm
    point = tables.scene.point(si, hit, active)
    light = mi.Spectrum(0.0)
    if tables.sunlit is None:
        light += samples.sun(si, point, active, lamps)
    throughput = mi.Spectrum(1.0)
    for bounce in range(bounces + 1):
        last = bounce == bounces
        if last and tables.sky is None:
            break
        wo, density, weight, _ = point.sample(samples.next_1d(), samples.next_2d())
        throughput *= weight
        # Russian roulette: leaves absorb most of the light, and rays for the rest are dear.
        survival = mi.Float(1.0)
        if tables.roulette:
            survival = dr.clip(_SURVIVAL * dr.max(throughput), _LEAST_SURVIVAL, 1.0)
        active &= (density > 0.0) & (samples.next_1d() < survival) & dr.any(throughput > 0.0)
        # Ended paths hold what their lane last saw, which can be NaN, and NaN times no light is NaN.
        throughput = dr.select(active, throughput / survival, 0.0)
        ray = si.spawn_ray(si.to_world(wo))
        if last:
            # The last hit's scattered ray only looks for the sky.
            seen = active & ~tables.scene.scene.ray_test(ray, active)
            light += throughput * samples.sky(ray.d, seen, lamps, seen=False)
            break
        ray.wavelengths = waves.nm
        met, si, hit = _hit(tables.scene, ray, active)
        point = tables.scene.point(si, hit, active & met)
        light += throughput * samples.sky(ray.d, active & ~met, lamps, seen=False)
        active &= met
        light += throughput * samples.flash_and_sun(si, point, active, lamps)
    channels = waves.channels(light)
    return [*channels, _square(tables, channels)]


def _square(tables: FrameTables, channels: Any) -> Any:
    """Sum of the squares of the channels, each in units of a white body's light."""
    _, dr = mitsuba_modules()
    return sum(dr.square(channel * scale) for channel, scale in zip(channels, tables.per_white, strict=True))


def _hit(scene: LightScene, ray: Any, active: Any = True, *, coherent: bool = False) -> Any:
    """Whether rays hit something, where, and what the tree found there."""
    found = scene.scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)
    hit = found.is_valid()
    return hit, shading_normals(scene.interaction(ray, found, hit)), found

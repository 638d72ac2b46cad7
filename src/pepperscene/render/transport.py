"""Light transport for a flash at the camera: one traversal for all of it, then more of what has edges.

The flash is nearly deterministic, all else is small and smooth (a tenth of the signal in `barth2018`). So at
each hit the flash is evaluated with one shadow ray towards a point of its discs, the sun with one towards its
disc, and the sky is found by BSDF sampling alone. Light that meets one surface only is carried by sensor
channel, with its integrals over wavelength taken beforehand; light that meets more is carried at four
wavelengths a sample. The first samples of a pixel trace both; where they show edges, more follow that stop at
the first hit.

Samples lie pixel by pixel in the wavefront, so that the sum over a pixel is a block reduction: no atomics,
the same bits in each run, however the wavefront is cut.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.facing import facing
from pepperscene.render.kernel import LightScene, SkyTables
from pepperscene.render.response import Response
from pepperscene.render.samples import FrameTables, Samples, SpectralTables, Wavelengths
from pepperscene.render.upload import device_number, device_table
from pepperscene.render.variant import kernel
from pepperscene.render.view import View

_LANES: Final = 1 << 21  # chosen: wavefront of a pass; 25 results of a sample take 210 MB
_PLACES: Final = 4  # chosen among 1, 2, 4 and 8: the least error for the same time
_SURVIVAL, _LEAST_SURVIVAL = 2.0, 0.25
"""Chosen: a path lives on with twice the share of light that it still carries, so that pale surfaces end
none, and at least with this chance, which bounds the weight of a survivor. With half of the former there is a
third less time and a quarter more noise: the same worth."""

Images = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Light:
    """One frame's light, summed over wavelengths by the sensor, per pixel and channel (c, 3 or 1).

    Attributes:
        flash: `(h, w, c)` straight from the flash to the first hit and back; electrons s-1 m-2 sr-1.
        open_flash: `(h, w, c)` the same with all shadows taken away.
        sky: `(h, w, c)` seen directly, and the sun at the first hit where it is as distinct as the flash.
        soft: `(h, w, c)` all the rest: daylight on surfaces and light that was scattered more than once.
        albedo: `(h, w, c)` of the first hit, weighted by the response to the flash, 0 where there is none;
            for the denoiser, as is what follows.
        normal: `(h, w, 3)` of the first hit, towards the camera, 0 where there is none.
        covered: `(h, w, 2)` share of the samples that hit something, among all and among the soft ones.
        samples: `(h, w)` how many there were.
        sharp_variance, soft_variance: `(h, w)` of one sample of open flash and sky, and of one of soft light:
            summed over the channels, each in units of a white body's light under the flash at one metre.
        white: `(c,)` that unit.
        soft_samples: how many samples carried soft light.
    """

    flash: Images
    open_flash: Images
    sky: Images
    soft: Images
    albedo: Images
    normal: Images
    covered: Images
    samples: NDArray[np.int32]
    sharp_variance: Images
    soft_variance: Images
    white: NDArray[np.float64]
    soft_samples: int

    def total(self) -> Images:
        """`(h, w, c)` all light as traced."""
        return self.flash + self.sky + self.soft


@dataclass(frozen=True, eq=False)
class Sampling:
    """How many samples go where; powers of two spread best.

    Attributes:
        samples: per pixel, everywhere.
        soft: of these, how many carry soft light.
        bounces: scattering events after the first hit.
        more: from the light of the first samples to how many each pixel should have, `(h, w)`; None for no
            more.
    """

    samples: int
    soft: int
    bounces: int
    more: Callable[[Light], NDArray[np.int32]] | None = None


def trace(
    scene: LightScene,
    view: View,
    spectral: Response,
    flash: Flash | None,
    sky: SkyTables | None,
    sampling: Sampling,
    seed: int,
) -> Light:
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
    if tables.flash is None and tables.sky is None:
        sums = _Sums(view.height, view.width, tables.channels)
        sums.add_sharp(None, _summed(tables, None, 0, sampling.samples, seed, _sharp_alone), sampling.samples)
        return sums.light(tables.white)

    # One traversal for all kinds of light, then the samples that carry none that is soft.
    sums = _Sums(view.height, view.width, tables.channels)
    soft = min(sampling.soft, sampling.samples)
    spectra = SpectralTables(tables)
    sums.add_both(
        _summed(tables, None, 0, soft, seed, lambda t, s: _both(t, spectra, s, sampling.bounces)), soft
    )
    if sampling.samples > soft:
        rest = sampling.samples - soft
        sums.add_sharp(None, _summed(tables, None, soft, rest, seed, _sharp_alone), rest)
    if sampling.more is None:
        return sums.light(tables.white)

    # Edges and half-shadows go on where the first samples ended.
    wanted = sampling.more(sums.light(tables.white)).ravel()
    for count in np.unique(wanted[wanted > sampling.samples]).tolist():
        pixels = np.flatnonzero(wanted == count)
        extra = count - sampling.samples
        sums.add_sharp(pixels, _summed(tables, pixels, sampling.samples, extra, seed, _edge), extra)
    return sums.light(tables.white)


class _Sums:
    """Sums over the samples of each pixel, as they come in."""

    def __init__(self, height: int, width: int, channels: int) -> None:
        self.shape, self.channels = (height, width), channels
        self.sharp = np.zeros((height * width, 4 * channels + 5), np.float32)
        self.soft = np.zeros((height * width, channels + 1), np.float32)
        self.covered_soft = np.zeros(height * width, np.float32)
        self.count = np.zeros(height * width, np.int32)
        self.soft_count = 0

    def add_sharp(self, pixels: NDArray[np.int64] | None, found: Images, count: int) -> None:
        """Sums of `count` samples each of some pixels, or of all."""
        where = slice(None) if pixels is None else pixels
        self.sharp[where] += found
        self.count[where] += count

    def add_both(self, found: Images, count: int) -> None:
        """Sums of samples that carry soft light as well."""
        edge = self.sharp.shape[1]
        self.add_sharp(None, found[:, :edge], count)
        self.soft += found[:, edge:]
        self.covered_soft += found[:, edge - 2]
        self.soft_count += count

    def light(self, white: NDArray[np.float64]) -> Light:
        """Means and variances."""
        c, (h, w) = self.channels, self.shape
        mean: Images = np.divide(self.sharp, self.count[:, None], dtype=np.float32)
        soft = self.soft / np.float32(max(self.soft_count, 1))
        flash, open_flash, sky, albedo = (mean[:, k * c : (k + 1) * c] for k in range(4))
        per_white = (1.0 / white).astype(np.float32)
        sharp_variance = _variance(mean[:, -1], (open_flash + sky) * per_white, self.count)
        soft_variance = _variance(soft[:, -1], soft[:, :c] * per_white, self.soft_count)
        covered = np.stack([mean[:, -2], self.covered_soft / np.float32(max(self.soft_count, 1))], axis=-1)

        def image(values: Images) -> Images:
            return np.ascontiguousarray(values.reshape(h, w, *values.shape[1:]), np.float32)

        return Light(
            flash=image(flash),
            open_flash=image(open_flash),
            sky=image(sky),
            soft=image(soft[:, :c]),
            albedo=image(albedo),
            normal=image(mean[:, 4 * c : 4 * c + 3]),
            covered=image(covered),
            samples=self.count.reshape(h, w).copy(),
            sharp_variance=image(sharp_variance),
            soft_variance=image(soft_variance),
            white=white,
            soft_samples=self.soft_count,
        )


def _variance(mean_square: Images, means: Images, count: Any) -> Images:
    """Variance of one sample, summed over channels, from the mean of squares and the means `(n, c)`."""
    spread = np.maximum(mean_square - np.square(means).sum(axis=-1), 0.0)
    return np.asarray(spread * (count / np.maximum(count - 1, 1)), np.float32)


def _summed(
    tables: FrameTables,
    pixels: NDArray[np.int64] | None,
    first: int,
    count: int,
    seed: int,
    wavefront: Callable[[FrameTables, Samples], list[Any]],
) -> Images:
    """`(n, k)`: sums over samples `first` to `first + count - 1` of the values that a wavefront gives.

    Args:
        tables: of the frame.
        pixels: row-major indices, or None for all.
        first: sample of each pixel.
        count: of samples.
        seed: of the frame.
        wavefront: values of samples.
    """
    mi, dr = kernel()
    total = tables.view.width * tables.view.height if pixels is None else len(pixels)
    block = max(_LANES // count, 1)
    salt, begin, per_pixel = (device_number(n, whole=True) for n in (seed & 0xFFFFFFFF, first, count))
    found: list[Images] = []
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
        found.append(np.stack([np.asarray(one) for one in sums], axis=-1))
    return found[0] if len(found) == 1 else np.concatenate(found)


def _sharp_alone(tables: FrameTables, samples: Samples) -> list[Any]:
    """Light that meets one surface, from several places of the flash: 4 c + 5 values."""
    return _sharp(tables, samples, _PLACES, *_hit(tables.scene, samples.ray, coherent=True))


def _edge(tables: FrameTables, samples: Samples) -> list[Any]:
    """Light that meets one surface, from one place of the flash, for pixels that have many samples."""
    return _sharp(tables, samples, 1, *_hit(tables.scene, samples.ray, coherent=True))


def _both(tables: FrameTables, spectra: SpectralTables, samples: Samples, bounces: int) -> list[Any]:
    """Light that meets one surface and light that meets more, along the same camera rays: 5 c + 6 values."""
    found = _hit(tables.scene, samples.ray, coherent=True)
    sharp = _sharp(tables, samples, _PLACES, *found)
    return sharp + _soft(tables, spectra, samples, bounces, *found)


def _sharp(tables: FrameTables, samples: Samples, places: int, active: Any, si: Any, hit: Any) -> list[Any]:
    """Flash at the first hit with and without shadows, sky seen and distinct sun, albedo, normal, hit, and
    the sum of squares: 4 c + 5 values.
    """
    mi, dr = kernel()
    point = tables.scene.point(si, hit, active, tables.lit)
    flash, open_flash = samples.whole_flash(si, point, active, tables.lamps, places)
    direct = point.reflectance * 0.0 + samples.sky(samples.ray.d, ~active, tables.lamps, seen=True)
    if tables.sunlit is not None:
        direct += samples.sun(si, tables.scene.point(si, hit, active, tables.sunlit), active, tables.lamps)
    albedo = dr.select(active, point.albedo(), 0.0)
    normal = dr.select(active, dr.select(si.wi.z > 0, si.sh_frame.n, -si.sh_frame.n), 0.0)
    values = [*flash, *open_flash, *direct, *albedo, normal.x, normal.y, normal.z]
    return [*values, dr.select(active, mi.Float(1.0), 0.0), _square(tables, open_flash + direct)]


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
    mi, dr = kernel()
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
        light += throughput * samples.flash(si, point, active, lamps)
        light += throughput * samples.sun(si, point, active, lamps)
    channels = waves.channels(light)
    return [*channels, _square(tables, channels)]


def _square(tables: FrameTables, channels: Any) -> Any:
    """Sum of the squares of the channels, each in units of a white body's light."""
    _, dr = kernel()
    return sum(dr.square(channel * scale) for channel, scale in zip(channels, tables.per_white, strict=True))


def _hit(scene: LightScene, ray: Any, active: Any = True, *, coherent: bool = False) -> Any:
    """Whether rays hit something, where, and what the tree found there."""
    found = scene.scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)
    hit = found.is_valid()
    return hit, facing(scene.interaction(ray, found, hit)), found

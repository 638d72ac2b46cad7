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
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.arrays import device_uint
from pepperscene.render.quality import Gathering
from pepperscene.render.transport.accumulate import (
    Images,
    SampleAccumulator,
    SampleSums,
    Surfaces,
    sum_samples,
)
from pepperscene.render.transport.channel_paths import first_point, scattered_light
from pepperscene.render.transport.gathering import gathered_light, trace_paths
from pepperscene.render.transport.light_cache import LightCache, PathLight, light_cache
from pepperscene.render.transport.lights import FrameTables
from pepperscene.render.transport.samples import Samples, SampleWavelengths
from pepperscene.render.variant import mitsuba_modules


@dataclass(frozen=True, eq=False)
class ChannelLight:
    """Light of samples in one or three channels.

    Attributes:
        tables: of the frame.
        lengths: `bounces` and `most_bounces` of `Sampling`.
        seed: of the samples.
        gathering: None to trace all paths to their ends.
    """

    tables: FrameTables
    lengths: tuple[int, int]
    seed: int
    gathering: Gathering | None = None

    @functools.cached_property
    def _indirect_light(self) -> Callable[..., list[Any]]:
        """What computes indirect light, with the light at second hits if it is gathered."""
        if self.gathering is None:
            return functools.partial(_indirect, lengths=self.lengths)
        return self._gathered_from(self._paths)

    @functools.cached_property
    def _independent_light(self) -> Callable[..., list[Any]]:
        """The same from half of the paths; see `measured_error`."""
        return self._gathered_from(self._paths.half())

    @functools.cached_property
    def _paths(self) -> PathLight:
        assert self.gathering is not None
        return trace_paths(self.tables, self.lengths, self.seed, self.gathering)

    def _gathered_from(self, paths: PathLight) -> Callable[..., list[Any]]:
        assert self.gathering is not None
        return functools.partial(_gathered, cache=light_cache(paths), gathering=self.gathering)

    def accumulator(self, height: int) -> SampleAccumulator:
        """An accumulator of this light in some rows, without samples."""
        return SampleAccumulator(height, self.tables.rays.width, self.tables.white)

    def sum_direct(
        self, pixels: NDArray[np.int64] | None, first: int, count: int, within: tuple[int, int] | None = None
    ) -> SampleSums:
        """Sums of direct light over samples from the first on; pixels as of `sum_samples`."""
        return sum_samples(self.tables, pixels, first, count, self.seed, _direct_light, within=within)

    def independent(self, pixels: NDArray[np.int64], count: int, number: int) -> Images:
        """`(n, c)` means of all light in some pixels over samples that are independent of all others.

        `number` is 0 or more; each has samples of its own. Only for gathered light.
        """
        all_light, seed = functools.partial(_all_light, indirect=self._independent_light), self.seed
        for _ in range(number + 1):
            # Any other seed gives other samples; a linear congruential step with chosen odd constants.
            seed = (seed * 0x9E3779B1 + 0x85EBCA6B) & 0xFFFFFFFF
        sums = sum_samples(self.tables, pixels, 0, count, seed, all_light)
        c = self.tables.channels
        parts = zip(sums[:c], sums[c : 2 * c], sums[3 * c + 5 : 4 * c + 5], strict=True)
        light = np.stack([sum(part) for part in parts], axis=-1)
        return np.asarray(light / np.float32(count), np.float32)

    def sum_all(self, count: int, within: tuple[int, int] | None = None) -> SampleSums:
        """Sums of all light over the first samples of all pixels, or of those within limits."""
        all_light = functools.partial(_all_light, indirect=self._indirect_light)
        return sum_samples(self.tables, None, 0, count, self.seed, all_light, within=within)

    def first_surfaces(self, rows: slice) -> Surfaces:
        """`(h, w)` number of the surface at the first sample of each pixel of some rows, from 1, or 0."""
        mi, dr = mitsuba_modules()
        width = self.tables.rays.width
        top, bottom, _ = rows.indices(self.tables.rays.height)
        pixel = dr.arange(mi.UInt32, (bottom - top) * width) + device_uint(top * width)
        samples = Samples(self.tables, pixel, mi.UInt32(0), device_uint(self.seed & 0xFFFFFFFF))
        scene = self.tables.scene
        hit = scene.scene.ray_intersect_preliminary(samples.ray, coherent=True)
        is_hit, face = hit.is_valid(), hit.prim_index
        dr.eval(is_hit, face)
        number = 1 + scene.mesh.face_surface[np.where(is_hit, face, 0)].astype(np.uint16)
        return np.where(is_hit, number, np.uint16(0)).reshape(-1, width)


def _direct_light(tables: FrameTables, samples: Samples) -> list[list[Any]]:
    """Direct light: 3 c + 5 values."""
    return [_direct(tables, samples, *tables.scene.intersect(samples.ray, coherent=True))]


def _all_light(tables: FrameTables, samples: Samples, indirect: Callable[..., list[Any]]) -> list[list[Any]]:
    """Direct and indirect light along the same camera rays: 4 c + 6 values."""
    first_hit = tables.scene.intersect(samples.ray, coherent=True)
    direct = _direct(tables, samples, *first_hit)
    return [direct + indirect(tables, samples, *first_hit)]


def total_light(tables: FrameTables, samples: Samples, bounces: int) -> list[Any]:
    """The sum of all light: c values, and nothing that their derivatives do not need."""
    c = tables.channels
    active, si, hit = tables.scene.intersect(samples.ray, coherent=True)
    direct = _direct(tables, samples, active, si, hit)[: 2 * c]
    indirect = _indirect(tables, samples, active, si, hit, (bounces, 0))
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
    for group, optics in enumerate(tables.lamp_optics):
        lit_point = tables.scene.surface_point(si, hit, active, optics, footprint)
        sky_and_sun += samples.lamp_light(si, lit_point, active, tables.colours, group)
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
    wavelengths, si, point, light = first_point(tables, samples, active, si, hit)
    bounces, most = lengths
    at_hit = si, point, active
    light = scattered_light(tables, samples, wavelengths, at_hit, light, range(bounces + 1), most)
    return _integrated(tables, wavelengths, light)


def _gathered(
    tables: FrameTables,
    samples: Samples,
    active: Any,
    si: Any,
    hit: Any,
    cache: LightCache,
    gathering: Gathering,
) -> list[Any]:
    """As `_indirect`, with rays in several directions that end at second hits: c + 1 values."""
    wavelengths, si, point, light = first_point(tables, samples, active, si, hit)
    light += gathered_light(tables, samples, wavelengths, (si, point, active), cache, gathering)
    return _integrated(tables, wavelengths, light)


def _integrated(tables: FrameTables, wavelengths: SampleWavelengths, light: Any) -> list[Any]:
    """The channels of light at wavelengths, and the sum of their squares."""
    channels = wavelengths.channels(light)
    return [*channels, _sum_of_squares(tables, channels)]


def _sum_of_squares(tables: FrameTables, channels: Any) -> Any:
    """Sum of the squares of the channels, in units of the light of a white body."""
    _, dr = mitsuba_modules()
    return sum(dr.square(channel * scale) for channel, scale in zip(channels, tables.per_white, strict=True))

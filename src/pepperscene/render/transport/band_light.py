"""Light in any number of bands, traced once for all of them.

A surface scatters light of all wavelengths into the same lobes, only its body's reflectance and transmittance
differ (`pepperscene.render.surface.scattering`). So a wavefront is first traced without wavelengths: for
each hit, light and paths are found by lobe, as the factors of reflectance, of transmittance, and of the gloss
(`SurfacePoint.by_lobe`), with all rays and their decisions. Then kernels that trace nothing compute a few
bands at a time from these factors. Their code is the same for any number of bands.

The light is that of `trace`: `_direct` and `_indirect` there say what is added where. `bands` says which
wavelengths light is carried at.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.arrays import BATCH, channel_array, device_uint
from pepperscene.render.kernel.camera import CameraRays, SpectralResponse
from pepperscene.render.kernel.scene import LightScene, SkyTables
from pepperscene.render.surface.scattering import SurfacePlace, by_lobe
from pepperscene.render.transport.accumulate import SampleAccumulator, SampleSums, sum_samples
from pepperscene.render.transport.band_paths import (
    UNIT,
    UNIT_LAMPS,
    FirstHit,
    Front,
    Paths,
    PathTracer,
    arrays,
    finite,
    follow,
    sky_light,
)
from pepperscene.render.transport.bands import (
    BROAD,
    BandTables,
    band_tables,
    broad_response,
    gather_batch,
)
from pepperscene.render.transport.lights import FrameTables, frame_tables
from pepperscene.render.transport.samples import Samples
from pepperscene.render.variant import mitsuba_modules

_LANES: Final = 1 << 18
"""Wavefront of a pass. Chosen: the 20 to 80 values of a sample that all bands share take 20 to 80 MB."""
_VALUES: Final = 1 << 24
"""Samples times bands of a pass, at most. Chosen: where paths are long, the light that each of them carries
in each band is kept from bounce to bounce, twice this number, 134 MB."""


class BandLight:
    """Light of samples in the bands of a sensor.

    Args:
        scene, rays, response, flash, sky: as of `trace`.
        lengths: `bounces` and `most_bounces` of `Sampling`.
        seed: of the samples.

    Attributes:
        tables: of the frame, in the broad channels.
        seed: of the samples.
    """

    def __init__(
        self,
        scene: LightScene,
        rays: CameraRays,
        response: SpectralResponse,
        flash: Flash | None,
        sky: SkyTables | None,
        lengths: tuple[int, int],
        seed: int,
    ) -> None:
        self.tables = frame_tables(scene, rays, broad_response(response), flash, sky)
        self.bands: BandTables = band_tables(
            scene.optics,
            response,
            sky,
            has_flash=self.tables.flash is not None,
            direct_sun=self.tables.sun_optics is not None,
            direct_lamps=bool(self.tables.lamp_optics),
        )
        self._paths, self.seed = PathTracer(self.tables, self.bands, lengths), seed
        self._lanes = max(min(_LANES, _VALUES // len(self.bands.batches) // BATCH), 1)

    def accumulator(self, height: int) -> SampleAccumulator:
        """An accumulator of this light in some rows, without samples."""
        return SampleAccumulator(height, self.tables.rays.width, self.bands.white, BROAD)

    def sum_direct(
        self, pixels: NDArray[np.int64] | None, first: int, count: int, within: tuple[int, int] | None = None
    ) -> SampleSums:
        """Sums of direct light over samples from the first on; pixels as of `sum_samples`."""
        integrand, lanes = self._direct_light, self._lanes
        sums = sum_samples(self.tables, pixels, first, count, self.seed, integrand, lanes, within)
        return self._ordered(sums)[0]

    def sum_all(self, count: int, within: tuple[int, int] | None = None) -> SampleSums:
        """Sums of all light over the first samples of all pixels, or of those within limits."""
        integrand, lanes = self._all_light, self._lanes
        sums = sum_samples(self.tables, None, 0, count, self.seed, integrand, lanes, within)
        direct, indirect = self._ordered(sums)
        return [*direct, *indirect]

    def _ordered(self, sums: list[Any]) -> tuple[list[Any], list[Any]]:
        """Sums of direct light, and then of indirect light, in the order of `SampleAccumulator`.

        They come in batches, without those of a light that does not shine.
        """
        count, number = self.bands.count, len(self.bands.batches)
        lights = [self.tables.flash is not None, self.tables.sky is not None or bool(self.tables.lamp_optics)]
        direct: list[Any] = []
        size = BATCH * sum(lights)
        for light, shines in enumerate(lights):
            first = BATCH * sum(lights[:light])
            places = [size * (k // BATCH) + first + k % BATCH for k in range(count)]
            direct += [sums[place] if shines else None for place in places]
        guides = size * number
        end = guides + BROAD + 5
        return direct + sums[guides:end], [*sums[end : end + count], *sums[end + number * BATCH :]]

    def _direct_light(self, tables: FrameTables, samples: Samples) -> Iterator[list[Any]]:
        """Batches of direct light; see `_direct_batches`."""
        _, dr = mitsuba_modules()
        hit = self._first_hit(samples, *self._intersect(samples))
        dr.eval(arrays(hit))
        yield from self._direct_batches(hit)

    def _all_light(self, tables: FrameTables, samples: Samples) -> Iterator[list[Any]]:
        """Batches of direct light, and then of indirect light along the same camera rays."""
        _, dr = mitsuba_modules()
        front, surface = self._intersect(samples)
        hit = self._first_hit(samples, front, surface)
        paths = self._paths.start(samples, front, hit.place)
        shared = [arrays(hit), [arrays(vertex) for vertex in paths.vertices], paths.slot]
        if paths.ray is not None:
            shared += [paths.ray, paths.active, paths.throughput]
        dr.eval(shared)  # all that is traced, in one kernel
        yield from self._direct_batches(hit)
        del hit
        yield from self._indirect_batches(samples, paths)

    def _intersect(self, samples: Samples) -> tuple[Front, SurfacePlace]:
        """First hits."""
        mi, _ = mitsuba_modules()
        scene = self.tables.scene
        active, si, hit = scene.intersect(samples.ray, coherent=True)
        surface = scene.surface_place(si, hit, active, self.tables.rays.footprint(si))
        point = self.bands.carriers.seen(surface, range(BROAD), active)
        return Front(si, point, active, mi.Color3f(1.0)), surface

    def _first_hit(self, samples: Samples, front: Front, surface: SurfacePlace) -> FirstHit:
        mi, dr = mitsuba_modules()
        si, point, active = front.si, front.point, front.active
        lobes = replace(point, by_lobe=True)
        flash = samples.flash_light(si, lobes, active, UNIT) if self.tables.flash is not None else None
        sun = None
        if self.bands.sun_optics is not None:
            sun = samples.sun_light(si, lobes, active, UNIT)
        relief = si.to_world(point.frame.n)
        normal = dr.select(active, dr.select(si.wi.z > 0, relief, -relief), 0.0)
        guides = [*dr.select(active, point.albedo(), 0.0), normal.x, normal.y, normal.z]
        return FirstHit(
            place=finite(surface.body, active),
            flash=flash,
            sun=sun,
            lamps=[
                samples.lamp_light(si, lobes, active, UNIT_LAMPS, group)
                for group in range(len(self.bands.lamp_optics))
            ],
            sky=samples.sky_weights(samples.ray.d, ~active, with_sun=True),
            guides=[*guides, dr.select(active, mi.Float(1.0), 0.0)],
        )

    def _direct_batches(self, hit: FirstHit) -> Iterator[list[Any]]:
        """By band the flash, and sky and sun, if there are such lights; then guides, and sums of squares."""
        mi, dr = mitsuba_modules()
        bands, squares = self.bands, dr.opaque(mi.Float, 0.0, dr.width(hit.guides[-1]))
        for start in bands.batches:
            first = device_uint(start)
            columns = [first + k for k in range(BATCH)]
            values, total = [], channel_array(BATCH)(0.0)
            if hit.flash is not None:
                seen = bands.flash_optics.reflectances(hit.place, columns, True)
                light = by_lobe(hit.flash, *seen) * gather_batch(bands.colours.flash, columns)
                values += [*light]
                total += light
            if hit.sky or hit.lamps:
                light = sky_light(hit.sky, bands.colours, columns)
                if hit.sun is not None and bands.sun_optics is not None:
                    seen = bands.sun_optics.reflectances(hit.place, columns, True)
                    light += by_lobe(hit.sun, *seen) * gather_batch(bands.colours.sun, columns)
                for lobes, optics, table in zip(
                    hit.lamps, bands.lamp_optics, bands.colours.lamps, strict=False
                ):
                    seen = optics.reflectances(hit.place, columns, True)
                    light += by_lobe(lobes, *seen) * gather_batch(table, columns)
                values += [*light]
                total += light
            squares += dr.squared_norm(total * gather_batch(bands.per_white, columns))
            dr.eval(values, squares)
            yield values
        yield [*hit.guides, squares]

    def _indirect_batches(self, samples: Samples, paths: Paths) -> Iterator[list[Any]]:
        """Indirect light by band, and then the sum of squares."""
        mi, dr = mitsuba_modules()
        bands = self.bands
        squares = dr.opaque(mi.Float, 0.0, dr.width(paths.slot))
        carried = self._paths.finish(samples, paths) if paths.ray is not None else None
        for number, start in enumerate(bands.batches):
            first = device_uint(start)
            if carried is None:
                light = follow(bands, paths.vertices, paths.slot, first, None)[1]
            else:
                light, carried[number] = carried[number], None
            columns = [first + k for k in range(BATCH)]
            squares += dr.squared_norm(light * gather_batch(bands.per_white, columns))
            values = [*light]
            dr.eval(values, squares)
            yield values
        yield [squares]

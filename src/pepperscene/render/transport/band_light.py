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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.kernel.arrays import BATCH, channel_array, device_uint
from pepperscene.render.kernel.camera import CameraRays, SpectralResponse
from pepperscene.render.kernel.scene import LightScene, SkyTables
from pepperscene.render.surface.body import BodyPlace, SurfacePlace
from pepperscene.render.surface.scattering import SurfacePoint, by_lobe
from pepperscene.render.transport.accumulate import SampleAccumulator, SampleSums
from pepperscene.render.transport.bands import (
    BROAD,
    BandTables,
    LightTables,
    band_tables,
    broad_response,
    gather_batch,
)
from pepperscene.render.transport.lights import FrameTables, LightSpectra, frame_tables
from pepperscene.render.transport.path_lengths import LONG_ROULETTE, ROULETTE
from pepperscene.render.transport.samples import Samples
from pepperscene.render.transport.wavefront import sum_samples
from pepperscene.render.variant import mitsuba_modules

_LANES: Final = 1 << 18
"""Wavefront of a pass. Chosen: the 20 to 80 values of a sample that all bands share take 20 to 80 MB."""
_VALUES: Final = 1 << 24
"""Samples times bands of a pass, at most. Chosen: where paths are long, the light that each of them carries
in each band is kept from bounce to bounce, twice this number, 134 MB."""
_TINY: Final = 1e-30  # chosen: as of `samples`
_UNIT: Final = LightSpectra(flash=1.0, sun=1.0, sky=())
"""Lights by lobe, whose spectra come with the bands."""


@dataclass(frozen=True, eq=False)
class _FirstHit:
    """Direct light of camera rays, before the bands.

    Attributes:
        place: of the body.
        flash, sun: light by lobe; None if there is none.
        sky: weights of the sky's spectra, and of the sun's, where rays leave the scene.
        guides: albedo in the broad channels, normal, and whether something is hit.
    """

    place: BodyPlace
    flash: Any | None
    sun: Any | None
    sky: list[Any]
    guides: list[Any]


@dataclass(eq=False)
class _Vertex:
    """A vertex of paths, before the bands.

    Attributes:
        sky: weights of the sky's spectra where the ray to here left the scene; empty for none.
        place: of the body; None at the end of paths.
        flash, sun: light by lobe; None if there is none.
        scatter: factor of the path by lobe; None at the end of paths.
    """

    sky: list[Any] = field(default_factory=list)
    place: BodyPlace | None = None
    flash: Any | None = None
    sun: Any | None = None
    scatter: Any | None = None


@dataclass(eq=False)
class _Front:
    """The end of paths so far: where they scatter next."""

    si: Any
    point: SurfacePoint
    active: Any
    throughput: Any  # in the broad channels


@dataclass(eq=False)
class _Paths:
    """Paths of a wavefront.

    Attributes:
        slot: of the wavelengths of each sample.
        vertices: of the first bounces.
        ray, active, throughput: of paths that go on; None for the ray if none do.
    """

    slot: Any
    vertices: list[_Vertex]
    ray: Any | None = None
    active: Any = None
    throughput: Any = None


class BandLight:
    """Light of samples in the bands of a sensor.

    Args:
        scene, rays, response, flash, sky: as of `trace`.
        lengths: `bounces` and `most_bounces` of `Sampling`.
        seed: of the samples.

    Attributes:
        tables: of the frame, in the broad channels.
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
        )
        self._lengths, self._seed = lengths, seed
        self._lanes = max(min(_LANES, _VALUES // len(self.bands.batches) // BATCH), 1)

    def accumulator(self) -> SampleAccumulator:
        """An accumulator of this light, without samples."""
        rays = self.tables.rays
        return SampleAccumulator(rays.height, rays.width, self.bands.white, BROAD)

    def sum_direct(self, pixels: NDArray[np.int64] | None, first: int, count: int) -> SampleSums:
        """Sums of direct light over samples from the first on, in some pixels or all."""
        sums = sum_samples(self.tables, pixels, first, count, self._seed, self._direct_light, self._lanes)
        return self._ordered(sums)[0]

    def sum_all(self, count: int) -> SampleSums:
        """Sums of all light over the first samples of all pixels."""
        sums = sum_samples(self.tables, None, 0, count, self._seed, self._all_light, self._lanes)
        direct, indirect = self._ordered(sums)
        return [*direct, *indirect]

    def _ordered(self, sums: list[Any]) -> tuple[list[Any], list[Any]]:
        """Sums of direct light, and then of indirect light, in the order of `SampleAccumulator`.

        They come in batches, without those of a light that does not shine.
        """
        count, number = self.bands.count, len(self.bands.batches)
        lights = [self.tables.flash is not None, self.tables.sky is not None]
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
        dr.eval(_arrays(hit))
        yield from self._direct_batches(hit)

    def _all_light(self, tables: FrameTables, samples: Samples) -> Iterator[list[Any]]:
        """Batches of direct light, and then of indirect light along the same camera rays."""
        _, dr = mitsuba_modules()
        front, surface = self._intersect(samples)
        hit = self._first_hit(samples, front, surface)
        paths = self._paths(samples, front, hit.place)
        shared = [_arrays(hit), [_arrays(vertex) for vertex in paths.vertices], paths.slot]
        if paths.ray is not None:
            shared += [paths.ray, paths.active, paths.throughput]
        dr.eval(shared)  # all that is traced, in one kernel
        yield from self._direct_batches(hit)
        del hit
        yield from self._indirect_batches(samples, paths)

    def _intersect(self, samples: Samples) -> tuple[_Front, SurfacePlace]:
        """First hits."""
        mi, _ = mitsuba_modules()
        scene = self.tables.scene
        active, si, hit = scene.intersect(samples.ray, coherent=True)
        surface = scene.surface_place(si, hit, active, self.tables.rays.footprint(si))
        point = self.bands.carriers.seen(surface, range(BROAD), active)
        return _Front(si, point, active, mi.Color3f(1.0)), surface

    def _first_hit(self, samples: Samples, front: _Front, surface: SurfacePlace) -> _FirstHit:
        mi, dr = mitsuba_modules()
        si, point, active = front.si, front.point, front.active
        lobes = replace(point, by_lobe=True)
        flash = samples.flash_light(si, lobes, active, _UNIT) if self.tables.flash is not None else None
        sun = None
        if self.bands.sun_optics is not None:
            sun = samples.sun_light(si, lobes, active, _UNIT)
        relief = si.to_world(point.frame.n)
        normal = dr.select(active, dr.select(si.wi.z > 0, relief, -relief), 0.0)
        guides = [*dr.select(active, point.albedo(), 0.0), normal.x, normal.y, normal.z]
        return _FirstHit(
            place=_finite(surface.body, active),
            flash=flash,
            sun=sun,
            sky=samples.sky_weights(samples.ray.d, ~active, with_sun=True),
            guides=[*guides, dr.select(active, mi.Float(1.0), 0.0)],
        )

    def _direct_batches(self, hit: _FirstHit) -> Iterator[list[Any]]:
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
            if hit.sky:
                light = _sky_light(hit.sky, bands.colours, columns)
                if hit.sun is not None and bands.sun_optics is not None:
                    seen = bands.sun_optics.reflectances(hit.place, columns, True)
                    light += by_lobe(hit.sun, *seen) * gather_batch(bands.colours.sun, columns)
                values += [*light]
                total += light
            squares += dr.squared_norm(total * gather_batch(bands.per_white, columns))
            dr.eval(values, squares)
            yield values
        yield [*hit.guides, squares]

    def _paths(self, samples: Samples, front: _Front, place: BodyPlace) -> _Paths:
        """Paths of the first bounces."""
        samples_slot = self.bands.slot(samples.next_1d())
        vertex = _Vertex(place=place)
        if self.tables.sun_optics is None and self.bands.emission.sun is not None:
            lobes = replace(front.point, by_lobe=True)
            vertex.sun = samples.sun_light(front.si, lobes, front.active, _UNIT)
        paths = _Paths(samples_slot, [vertex])
        bounces, most = self._lengths
        for bounce in range(bounces + 1):
            last = bounce == bounces and most <= bounces
            if last and self.tables.sky is None:
                break
            ray, active, throughput = self._scatter(samples, front, vertex, ROULETTE)
            if last:
                # The last scattered ray only tests whether it reaches the sky.
                escaped = active & ~self.tables.scene.scene.ray_test(ray, active)
                paths.vertices.append(_Vertex(sky=samples.sky_weights(ray.d, escaped, with_sun=False)))
                break
            if bounce == bounces:
                paths.ray, paths.active, paths.throughput = ray, active, throughput
                break
            front, vertex = self._arrive(samples, ray, active, throughput)
            paths.vertices.append(vertex)
        return paths

    def _scatter(
        self, samples: Samples, front: _Front, vertex: _Vertex, roulette: tuple[float, float]
    ) -> tuple[Any, Any, Any]:
        """Scatter paths: their rays, which go on, and their throughput in the broad channels."""
        _, dr = mitsuba_modules()
        lobes = replace(front.point, by_lobe=True)
        wo, density, weight, _ = lobes.sample(samples.next_1d(), samples.next_2d())
        throughput = front.throughput * by_lobe(weight, front.point.reflectance, front.point.transmittance)
        survival = dr.clip(roulette[0] * dr.max(throughput), roulette[1], 1.0)
        active = front.active & (density > 0.0) & (samples.next_1d() < survival) & dr.any(throughput > 0.0)
        # Inactive lanes keep old values, which can be NaN, and 0 times NaN is NaN.
        vertex.scatter = dr.select(active, weight / survival, 0.0)
        return (
            front.si.spawn_ray(front.si.to_world(wo)),
            active,
            dr.select(active, throughput / survival, 0.0),
        )

    def _arrive(self, samples: Samples, ray: Any, active: Any, throughput: Any) -> tuple[_Front, _Vertex]:
        """Follow scattered rays to surface points, or to the sky."""
        scene = self.tables.scene
        is_hit, si, hit = scene.intersect(ray, active)
        sky = samples.sky_weights(ray.d, active & ~is_hit, with_sun=False)
        active = active & is_hit
        surface = scene.surface_place(si, hit, active, footprint=None)
        point = self.bands.carriers.seen(surface, range(BROAD), active)
        vertex = _Vertex(sky, _finite(surface.body, active))
        vertex.flash, vertex.sun = self._flash_and_sun(samples, si, point, active)
        return _Front(si, point, active, throughput), vertex

    def _flash_and_sun(self, samples: Samples, si: Any, point: SurfacePoint, active: Any) -> tuple[Any, Any]:
        """Light by lobe at later hits, as `Samples.flash_and_sun_light`, of the flash and of the sun."""
        _, dr = mitsuba_modules()
        lobes, colours = replace(point, by_lobe=True), self.tables.colours
        has_flash, has_sun = self.tables.flash is not None, self.bands.emission.sun is not None
        if not (has_flash and has_sun):
            light = samples.flash_and_sun_light(
                si, lobes, active, replace(_UNIT, sun=1.0 if has_sun else None)
            )
            return light if has_flash else None, light if has_sun else None
        flash, target = samples.unshadowed_flash(si, lobes, active, _UNIT, samples.next_2d())
        sun, direction = samples.unshadowed_sun(si, lobes, active, _UNIT)
        body = point.reflectance, point.transmittance
        by_flash = dr.sum(by_lobe(flash, *body) * colours.flash)
        by_sun = dr.sum(by_lobe(sun, *body) * colours.sun)
        both = by_flash + by_sun
        flash_fraction = dr.select(both > 0.0, by_flash / dr.maximum(both, _TINY), 0.0)
        to_flash = samples.next_1d() < flash_fraction
        probability = dr.select(to_flash, flash_fraction, 1.0 - flash_fraction)
        ray = dr.select(to_flash, si.spawn_ray_to(target), si.spawn_ray(direction))
        lit = active & (both > 0.0)
        lit &= ~self.tables.scene.scene.ray_test(ray, lit)
        light = dr.select(to_flash, flash, sun) / dr.maximum(probability, _TINY)
        return light & (lit & to_flash), light & (lit & ~to_flash)

    def _indirect_batches(self, samples: Samples, paths: _Paths) -> Iterator[list[Any]]:
        """Indirect light by band, and then the sum of squares."""
        mi, dr = mitsuba_modules()
        bands = self.bands
        squares = dr.opaque(mi.Float, 0.0, dr.width(paths.slot))
        carried = self._long_paths(samples, paths) if paths.ray is not None else None
        for number, start in enumerate(bands.batches):
            first = device_uint(start)
            if carried is None:
                light = _follow(bands, paths.vertices, paths.slot, first, None)[1]
            else:
                light, carried[number] = carried[number], None
            columns = [first + k for k in range(BATCH)]
            squares += dr.squared_norm(light * gather_batch(bands.per_white, columns))
            values = [*light]
            dr.eval(values, squares)
            yield values
        yield [squares]

    def _long_paths(self, samples: Samples, paths: _Paths) -> list[Any]:
        """Light of each batch of all paths, until Russian roulette ends them.

        Each bounce is traced for all bands, and then added to what the paths carry in each.
        """
        _, dr = mitsuba_modules()
        firsts = [device_uint(start) for start in self.bands.batches]
        states: list[Any] = []
        for first in firsts:
            states.append(_follow(self.bands, paths.vertices, paths.slot, first, None))
            dr.eval(states[-1])
        paths.vertices.clear()
        ray, active, throughput = paths.ray, paths.active, paths.throughput
        # As kernel data, so that all bounces have the same code.
        samples.sequence.dimension = device_uint(samples.sequence.dimension)
        bounces, most = self._lengths
        for bounce in range(bounces, most + 1):
            front, vertex = self._arrive(samples, ray, active, throughput)
            goes_on = device_uint(bounce) < most
            front.active &= goes_on
            vertex.flash, vertex.sun = (
                None if light is None else light & goes_on for light in (vertex.flash, vertex.sun)
            )
            ray, active, throughput = self._scatter(samples, front, vertex, LONG_ROULETTE)
            dr.eval(_arrays(vertex), ray, active, throughput)
            dr.eval(samples.sequence.dimension)
            for number, first in enumerate(firsts):
                states[number] = _follow(self.bands, [vertex], paths.slot, first, states[number])
                dr.eval(states[number])
            if not dr.any(active)[0]:
                break
        return [light for _, light in states]


def _follow(
    bands: BandTables, vertices: Sequence[_Vertex], slot: Any, first: Any, state: tuple[Any, Any] | None
) -> tuple[Any, Any]:
    """What paths carry and the light that they have collected after some vertices, in a batch of bands.

    `state` is that before; None for camera rays.
    """
    mi, dr = mitsuba_modules()
    batch = channel_array(BATCH)
    throughput, light = (batch(1.0), batch(0.0)) if state is None else state
    entries = [(first + k) * bands.slots + slot for k in range(BATCH)]
    columns = [dr.gather(mi.UInt32, bands.columns, entry) for entry in entries]
    emission = bands.emission
    for vertex in vertices:
        if vertex.sky:
            light = light + throughput * _sky_light(vertex.sky, emission, entries)
        if vertex.place is None:
            continue
        seen = bands.spectra.reflectances(vertex.place, columns, True)
        for lobes, table in ((vertex.flash, emission.flash), (vertex.sun, emission.sun)):
            if lobes is not None:
                light = light + throughput * by_lobe(lobes, *seen) * gather_batch(table, entries)
        if vertex.scatter is not None:
            throughput = throughput * by_lobe(vertex.scatter, *seen)
    return throughput, light


def _sky_light(weights: Sequence[Any], lights: LightTables, entries: list[Any]) -> Any:
    """Light of the sky, and of the sun if it has a weight."""
    tables = [*lights.sky, lights.sun]
    total = channel_array(BATCH)(0.0)
    for weight, table in zip(weights, tables, strict=False):
        total += weight * gather_batch(table, entries)
    return total


def _finite(place: BodyPlace, active: Any) -> BodyPlace:
    """A place for kernels that do not know which lanes are active: those that are not get a place as well."""
    mi, dr = mitsuba_modules()
    colour = None if place.is_scanned is None else mi.Color3f(place.colour.x, place.colour.y, place.colour.z)
    values = {item.name: getattr(place, item.name) for item in fields(BodyPlace)} | {"colour": colour}
    masks = {name: values.pop(name) for name in ("in_front", "is_scanned")}
    return BodyPlace(
        **{name: None if mask is None else mask & active for name, mask in masks.items()},
        **{name: None if value is None else dr.select(active, value, 0) for name, value in values.items()},
    )


def _arrays(record: Any) -> list[Any]:
    """The arrays of a `_FirstHit` or a `_Vertex`, for their evaluation in one kernel."""
    values: list[Any] = []
    for item in fields(record):
        value = getattr(record, item.name)
        if isinstance(value, BodyPlace):
            values += _arrays(value)
        elif isinstance(value, list):
            values += value
        elif value is not None:
            values.append(value)
    return values

"""Paths of light that meets several surfaces, traced once for all bands of a sensor.

Three broad channels decide where paths go and when they end. What they scatter, and the light at their
vertices, is kept by lobe.

The kernels that trace leave what is the same for all bands in memory, as `FirstHit` and `Vertex`; the kernels
of the bands read it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

from pepperscene.render.arrays import BATCH, channel_array, device_uint
from pepperscene.render.surface.scattering import BodyPlace, SurfacePoint, by_lobe
from pepperscene.render.transport.bands import BROAD, BandTables, LightTables, gather_batch
from pepperscene.render.transport.lights import FrameTables, LightSpectra
from pepperscene.render.transport.path_lengths import LONG_ROULETTE, ROULETTE
from pepperscene.render.transport.samples import TINY, Samples
from pepperscene.render.variant import mitsuba_modules


@dataclass(frozen=True, eq=False)
class FirstHit:
    """Direct light of camera rays, before the bands.

    Attributes:
        place: of the body.
        flash, sun: light by lobe; None if there is none.
        lamps: light by lobe of each of their spectra.
        sky: weights of the sky's spectra, and of the sun's, where rays leave the scene.
        guides: albedo in the broad channels, normal, and whether something is hit.
    """

    place: BodyPlace
    flash: Any | None
    sun: Any | None
    sky: list[Any]
    guides: list[Any]
    lamps: list[Any] = field(default_factory=list)


@dataclass(eq=False)
class Vertex:
    """A vertex of paths, before the bands.

    Attributes:
        sky: weights of the sky's spectra where the ray to here left the scene; empty for none.
        place: of the body; None at the end of paths.
        flash, sun: light by lobe; None if there is none.
        lamps: light by lobe of each of their spectra.
        scatter: factor of the path by lobe; None at the end of paths.
    """

    sky: list[Any] = field(default_factory=list)
    place: BodyPlace | None = None
    flash: Any | None = None
    sun: Any | None = None
    scatter: Any | None = None
    lamps: list[Any] = field(default_factory=list)


def follow(
    bands: BandTables, vertices: Sequence[Vertex], slot: Any, first: Any, state: tuple[Any, Any] | None
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
            light = light + throughput * sky_light(vertex.sky, emission, entries)
        if vertex.place is None:
            continue
        seen = bands.spectra.reflectances(vertex.place, columns, True)
        lamps = zip(vertex.lamps, emission.lamps, strict=False)
        for lobes, table in ((vertex.flash, emission.flash), (vertex.sun, emission.sun), *lamps):
            if lobes is not None:
                light = light + throughput * by_lobe(lobes, *seen) * gather_batch(table, entries)
        if vertex.scatter is not None:
            throughput = throughput * by_lobe(vertex.scatter, *seen)
    return throughput, light


def sky_light(weights: Sequence[Any], lights: LightTables, entries: list[Any]) -> Any:
    """Light of the sky, and of the sun if it has a weight."""
    tables = [*lights.sky, lights.sun]
    total = channel_array(BATCH)(0.0)
    for weight, table in zip(weights, tables, strict=False):
        total += weight * gather_batch(table, entries)
    return total


def finite(place: BodyPlace, active: Any) -> BodyPlace:
    """A place for kernels that do not know which lanes are active: those that are not get a place as well."""
    mi, dr = mitsuba_modules()
    colour = None
    if place.is_scanned is not None and place.colour is not None:
        colour = mi.Color3f(place.colour.x, place.colour.y, place.colour.z)
    values = {item.name: getattr(place, item.name) for item in fields(BodyPlace)} | {"colour": colour}
    masks = {name: values.pop(name) for name in ("in_front", "is_scanned")}
    return BodyPlace(
        **{name: None if mask is None else mask & active for name, mask in masks.items()},
        **{name: None if value is None else dr.select(active, value, 0) for name, value in values.items()},
    )


def arrays(record: Any) -> list[Any]:
    """The arrays of a `FirstHit` or a `Vertex`, for their evaluation in one kernel."""
    values: list[Any] = []
    for item in fields(record):
        value = getattr(record, item.name)
        if isinstance(value, BodyPlace):
            values += arrays(value)
        elif isinstance(value, list):
            values += value
        elif value is not None:
            values.append(value)
    return values


UNIT: Final = LightSpectra(flash=1.0, sun=1.0, sky=())
"""Lights by lobe, whose spectra come with the bands."""
UNIT_LAMPS: Final = LightSpectra(flash=None, sun=None, sky=(), lamps=(1.0,))
"""As `UNIT`, for the lamps of one spectrum at a time."""


@dataclass(eq=False)
class Front:
    """The end of paths so far: where they scatter next."""

    si: Any
    point: SurfacePoint
    active: Any
    throughput: Any  # in the broad channels


@dataclass(eq=False)
class Paths:
    """Paths of a wavefront.

    Attributes:
        slot: of the wavelengths of each sample.
        vertices: of the first bounces.
        ray, active, throughput: of paths that go on; None for the ray if none do.
    """

    slot: Any
    vertices: list[Vertex]
    ray: Any = None
    active: Any = None
    throughput: Any = None

    def subset(self, lanes: Any) -> Paths:
        """The ends of the paths of some lanes, all of which go on."""
        mi, dr = mitsuba_modules()
        ray = mi.Ray3f(dr.gather(mi.Point3f, self.ray.o, lanes), dr.gather(mi.Vector3f, self.ray.d, lanes))
        paths = Paths(
            dr.gather(mi.UInt32, self.slot, lanes),
            [],
            ray,
            dr.opaque(mi.Bool, True, dr.width(lanes)),
            dr.gather(mi.Color3f, self.throughput, lanes),
        )
        dr.eval(paths.slot, ray, paths.throughput)
        return paths


@dataclass(frozen=True, eq=False)
class PathTracer:
    """Traces the paths of samples.

    Attributes:
        tables: of the frame, in the broad channels.
        bands: of the sensor.
        lengths: `bounces` and `most_bounces` of `Sampling`.
    """

    tables: FrameTables
    bands: BandTables
    lengths: tuple[int, int]

    def start(self, samples: Samples, front: Front, place: BodyPlace) -> Paths:
        """Paths of the first bounces from first hits."""
        slot = self.bands.slot(samples.next_1d())
        vertex = Vertex(place=place)
        if self.tables.sun_optics is None and self.bands.emission.sun is not None:
            lobes = replace(front.point, by_lobe=True)
            vertex.sun = samples.sun_light(front.si, lobes, front.active, UNIT)
        if self.tables.lamps is not None and not self.tables.lamp_optics:
            lobes = replace(front.point, by_lobe=True)
            groups = range(len(self.bands.emission.lamps))
            vertex.lamps = [
                samples.lamp_light(front.si, lobes, front.active, UNIT_LAMPS, group) for group in groups
            ]
        paths = Paths(slot, [vertex])
        bounces, most = self.lengths
        for bounce in range(bounces + 1):
            last = bounce == bounces and most <= bounces
            if last and self.tables.sky is None:
                break
            ray, active, throughput = self._scatter(samples, front, vertex, ROULETTE)
            if last:
                # The last scattered ray only tests whether it reaches the sky.
                escaped = active & ~self.tables.scene.scene.ray_test(ray, active)
                paths.vertices.append(Vertex(sky=samples.sky_weights(ray.d, escaped, with_sun=False)))
                break
            if bounce == bounces:
                paths.ray, paths.active, paths.throughput = ray, active, throughput
                break
            front, vertex = self._arrive(samples, ray, active, throughput)
            paths.vertices.append(vertex)
        return paths

    def _scatter(
        self, samples: Samples, front: Front, vertex: Vertex, roulette: tuple[float, float]
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

    def _arrive(self, samples: Samples, ray: Any, active: Any, throughput: Any) -> tuple[Front, Vertex]:
        """Follow scattered rays to surface points, or to the sky."""
        scene = self.tables.scene
        is_hit, si, hit = scene.intersect(ray, active)
        sky = samples.sky_weights(ray.d, active & ~is_hit, with_sun=False)
        active = active & is_hit
        surface = scene.surface_place(si, hit, active, footprint=None)
        point = self.bands.carriers.seen(surface, range(BROAD), active)
        vertex = Vertex(sky, finite(surface.body, active))
        vertex.flash, vertex.sun = self._flash_and_sun(samples, si, point, active)
        if self.tables.lamps is not None:
            vertex.lamps = samples.one_lamp_light(si, replace(point, by_lobe=True), active)
        return Front(si, point, active, throughput), vertex

    def _flash_and_sun(self, samples: Samples, si: Any, point: SurfacePoint, active: Any) -> tuple[Any, Any]:
        """Light by lobe at later hits, as `Samples.later_light`, of the flash and of the sun."""
        _, dr = mitsuba_modules()
        lobes, colours = replace(point, by_lobe=True), self.tables.colours
        has_flash, has_sun = self.tables.flash is not None, self.bands.emission.sun is not None
        if not (has_flash and has_sun):
            light = samples.later_light(si, lobes, active, replace(UNIT, sun=1.0 if has_sun else None))
            return light if has_flash else None, light if has_sun else None
        flash, target = samples.unshadowed_flash(si, lobes, active, UNIT, samples.next_2d())
        sun, direction = samples.unshadowed_sun(si, lobes, active, UNIT)
        body = point.reflectance, point.transmittance
        by_flash = dr.sum(by_lobe(flash, *body) * colours.flash)
        by_sun = dr.sum(by_lobe(sun, *body) * colours.sun)
        both = by_flash + by_sun
        flash_fraction = dr.select(both > 0.0, by_flash / dr.maximum(both, TINY), 0.0)
        to_flash = samples.next_1d() < flash_fraction
        probability = dr.select(to_flash, flash_fraction, 1.0 - flash_fraction)
        ray = dr.select(to_flash, si.spawn_ray_to(target), si.spawn_ray(direction))
        lit = active & (both > 0.0)
        lit &= ~self.tables.scene.scene.ray_test(ray, lit)
        light = dr.select(to_flash, flash, sun) / dr.maximum(probability, TINY)
        return light & (lit & to_flash), light & (lit & ~to_flash)

    def finish(self, samples: Samples, paths: Paths) -> list[Any]:
        """Light of each batch of all paths, until Russian roulette ends them.

        Each bounce is traced for all bands, and then added to what the paths carry in each. Whenever half of
        the paths have ended, the others move together.
        """
        mi, dr = mitsuba_modules()
        firsts = [device_uint(start) for start in self.bands.batches]
        states: list[Any] = []
        for first in firsts:
            states.append(follow(self.bands, paths.vertices, paths.slot, first, None))
            dr.eval(states[-1])
        paths.vertices.clear()
        total: list[Any] = [light for _, light in states]
        states = [(throughput, None) for throughput, _ in states]
        lanes = dr.arange(mi.UInt32, dr.width(paths.slot))
        bounces, most = self.lengths
        # As kernel data, so that all bounces have the same code.
        samples.sequence.dimension = device_uint(samples.sequence.dimension)
        for bounce in range(bounces, most + 1):
            alive = int(dr.count(paths.active)[0])
            if not alive:
                break
            if bounce == bounces or 2 * alive <= dr.width(lanes):
                kept = dr.compress(paths.active)
                _add_light(total, states, lanes)
                lanes = dr.gather(mi.UInt32, lanes, kept)
                samples, paths = samples.subset(kept), paths.subset(kept)
                states = [(_gathered(throughput, kept), _nothing(alive)) for throughput, _ in states]
                dr.eval(lanes, states)
            front, vertex = self._arrive(samples, paths.ray, paths.active, paths.throughput)
            goes_on = device_uint(bounce) < most
            front.active &= goes_on
            vertex.flash, vertex.sun = (
                None if light is None else light & goes_on for light in (vertex.flash, vertex.sun)
            )
            vertex.lamps = [light & goes_on for light in vertex.lamps]
            step = self._scatter(samples, front, vertex, LONG_ROULETTE)
            paths.ray, paths.active, paths.throughput = step
            dr.eval(arrays(vertex), step)
            dr.eval(samples.sequence.dimension)
            for number, first in enumerate(firsts):
                states[number] = follow(self.bands, [vertex], paths.slot, first, states[number])
                dr.eval(states[number])
        _add_light(total, states, lanes)
        return total


def _add_light(total: list[Any], states: list[Any], lanes: Any) -> None:
    """Add the light of some lanes to that of all."""
    mi, dr = mitsuba_modules()
    for number, (_, light) in enumerate(states):
        if light is None:
            continue
        for k in range(BATCH):
            whole = total[number][k]
            dr.scatter(whole, dr.gather(mi.Float, whole, lanes) + light[k], lanes)
            total[number][k] = whole
        dr.eval(total[number])


def _gathered(values: Any, lanes: Any) -> Any:
    """Some lanes of the values of a batch."""
    mi, dr = mitsuba_modules()
    return channel_array(BATCH)(*(dr.gather(mi.Float, values[k], lanes) for k in range(BATCH)))


def _nothing(width: int) -> Any:
    """Zeros that kernels read as data."""
    mi, dr = mitsuba_modules()
    return channel_array(BATCH)(*(dr.opaque(mi.Float, 0.0, width) for _ in range(BATCH)))

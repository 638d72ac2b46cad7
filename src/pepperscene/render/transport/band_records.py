"""What is traced for all bands together, and what bands make of it.

The kernels that trace leave these records in memory; the kernels of the bands read them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from pepperscene.render.arrays import BATCH, channel_array
from pepperscene.render.surface.body import BodyPlace
from pepperscene.render.surface.scattering import by_lobe
from pepperscene.render.transport.bands import BandTables, LightTables, gather_batch
from pepperscene.render.variant import mitsuba_modules


@dataclass(frozen=True, eq=False)
class FirstHit:
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
class Vertex:
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
        for lobes, table in ((vertex.flash, emission.flash), (vertex.sun, emission.sun)):
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

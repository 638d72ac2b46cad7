"""Packets of daylight, traced from the sky and the sun until surfaces have absorbed them.

Packets start on a box around the scene. One with direction w enters through one of the three faces that w
points into; their area across w is A = sum_i |w_i| A_i, and a radiance L brings the power L A per solid angle.
So packets with evenly spread starts across w carry it all, none starts where nothing can be hit, and nothing
else is known about the scene. Most starts are on the box of the organs that are of interest, and few on the
other one, with the weights of one density for both (Veach 1997, section 9.2).

At each hit the surface keeps 1 - E - A (R + T) of a packet (see `surface.scattering`), where the BSDF's own
sampling sends the rest on. So the power that enters is the sum of what is absorbed and what leaves.

Every packet has four wavelengths, spread evenly over a mixture of the bands, and its own power at each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry import Mesh
from pepperscene.render.arrays import LocalCoordinates, device_array, device_float, device_uint
from pepperscene.render.kernel.scene import LightScene, SkyTables, sky_tables
from pepperscene.render.surface.optics import STEP_NM
from pepperscene.render.transport.path_lengths import LONG_ROULETTE
from pepperscene.render.transport.samples import OwenSobol, at_wavelengths, sky_uv, sun_direction
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene, Sky
from pepperscene.spectra import photons_per_joule
from pepperscene.spectra.wavebands import Waveband

REPLICATES: Final = 32
"""Independent scramblings of the samples. Chosen: the error that they show has an error of an eighth."""
QUANTITIES: Final = 4
"""Of each band: absorbed W and umol s-1, received W and umol s-1."""
_NEAR: Final = 0.9  # chosen: share of the packets that start on the box of the organs of interest
_PADDING: Final = 1e-3  # of the largest side; chosen: rays start well outside of flat scenes
_MOST_BOUNCES: Final = 1000
"""Chosen: roulette has ended all packets long before, but those between lossless mirrors."""
_SUN_SHARE: Final = (0.1, 0.9)  # chosen: limits of the share of the packets that the sun gets
_AVOGADRO: Final = 6.02214076e23  # exact in the SI of 2019
UMOL_PER_J_NM: Final = float(photons_per_joule(1.0)) / _AVOGADRO * 1e6
"""Micromoles of photons per joule and nanometre of wavelength."""


class Box:
    """An axis-parallel box in local coordinates, on the device.

    Args:
        low, high: `(3,)` corners.
        padding: by which it is larger on all sides.
    """

    def __init__(self, low: NDArray[np.float64], high: NDArray[np.float64], padding: float) -> None:
        mi, dr = mitsuba_modules()
        self.sides = high - low + 2.0 * padding
        self.low = mi.Point3f(*(float(x) for x in low - padding))
        self.high = mi.Point3f(*(float(x) for x in high + padding))
        dr.make_opaque(self.low, self.high)

    def area_across(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """`(...)` area across directions `(..., 3)`."""
        x, y, z = self.sides
        return np.asarray(np.abs(directions) @ np.array([y * z, z * x, x * y]))

    def parts(self, w: Any) -> Any:
        """The areas of the three faces that a direction points into, across it."""
        mi, dr = mitsuba_modules()
        x, y, z = self.high - self.low
        return mi.Vector3f(dr.abs(w.x) * y * z, dr.abs(w.y) * z * x, dr.abs(w.z) * x * y)

    def entry(self, w: Any, sample1: Any, sample2: Any) -> Any:
        """A point of these faces, evenly spread across the direction."""
        mi, dr = mitsuba_modules()
        parts = self.parts(w)
        at = sample1 * dr.sum(parts)
        on_x, on_y = at < parts.x, at < parts.x + parts.y
        near = dr.select(w > 0.0, self.low, self.high)
        spread_x = dr.lerp(self.low.x, self.high.x, sample2.x)
        spread_y = dr.lerp(self.low.y, self.high.y, dr.select(on_x, sample2.x, sample2.y))
        spread_z = dr.lerp(self.low.z, self.high.z, sample2.y)
        return mi.Point3f(
            dr.select(on_x, near.x, spread_x),
            dr.select(~on_x & on_y, near.y, spread_y),
            dr.select(~on_y, near.z, spread_z),
        )

    def crossed(self, p: Any, w: Any) -> tuple[Any, Any, Any]:
        """Where lines through points enter and leave the box, and whether they cross it."""
        _, dr = mitsuba_modules()
        # A tiny component instead of 0 keeps the quotients finite.
        safe = dr.select(dr.abs(w) > 1e-12, w, 1e-12)
        one, other = (self.low - p) / safe, (self.high - p) / safe
        first, last = dr.max(dr.minimum(one, other)), dr.min(dr.maximum(one, other))
        return first, last, first < last


@dataclass(frozen=True, eq=False)
class PacketTables:
    """Kernel data of all packets under one sky; `packet_tables` makes it.

    Attributes:
        scene: geometry and surfaces.
        sky: maps, spectra and the sun.
        density: of directions over the sky's maps; None for a sky without maps that send out light.
        sun_share: share of the packets that come from the sun.
        whole, near: boxes of the scene, and of the organs of interest.
        near_share: share of the packets that start on the latter.
        first_nm, last_entry: as of `FrameTables`.
        wavelengths: distribution that wavelengths are sampled from.
        limits: of the bands, nanometres.
        face_target: `(f,)` number of each triangle's instance.
        targets: number of instances.
        unit_area: square metres of a squared local unit.
    """

    scene: LightScene
    sky: SkyTables
    density: Any | None
    sun_share: Any
    whole: Box
    near: Box
    near_share: Any
    first_nm: Any
    last_entry: Any
    wavelengths: Any
    limits: Sequence[tuple[Any, Any]]
    face_target: Any
    targets: int
    unit_area: Any


def packet_tables(
    scene: Scene,
    kernel: LightScene,
    coordinates: LocalCoordinates,
    bands: Sequence[Waveband],
    interest: NDArray[np.bool_],
) -> PacketTables | None:
    """Tabulate the light of a scene's sky; None if it is dark in all bands.

    Args:
        scene: with its sky.
        kernel: the same scene in the kernel, over all bands.
        coordinates: of the kernel's scene.
        bands: to trace.
        interest: `(i,)` the instances whose errors matter.
    """
    mi, _ = mitsuba_modules()
    first, last = band_range(bands)
    grid = np.arange(first, last + STEP_NM / 2, STEP_NM)
    sky = scene.sky
    tables = sky_tables(scene, grid)
    if sky is None or tables is None:
        return None
    whole, near = _boxes(scene.mesh, coordinates, interest)

    # Micromoles that each source brings into the box, at each wavelength.
    photons = grid * UMOL_PER_J_NM
    nodes = _node_weights(sky, np.asarray(sky.radiance.at(grid)), photons, bands, grid, whole)
    maps = float(nodes.mean())
    spectrum = sky.received() @ sky.radiance.at(grid)
    beam = 0.0
    if sky.sun is not None:
        irradiance = sky.sun.irradiance.at(grid)
        area = float(whole.area_across(sky.sun.direction))
        beam = area * float(_in_bands(irradiance * photons, bands, grid).sum() * STEP_NM)
        spectrum = spectrum + irradiance
    if not maps + beam > 0.0:
        return None
    share = float(np.clip(beam / (maps + beam), *_SUN_SHARE))
    share = 0.0 if beam == 0.0 else 1.0 if maps == 0.0 else share
    return PacketTables(
        scene=kernel,
        sky=tables,
        density=mi.Hierarchical2D0((nodes / nodes.max()).astype(np.float32)) if maps > 0.0 else None,
        sun_share=device_float(share),
        whole=whole,
        near=near,
        near_share=device_float(_NEAR),
        first_nm=device_float(first),
        last_entry=device_float(grid.size - 1.001),
        wavelengths=_wavelengths(spectrum * photons, bands, grid),
        limits=[(device_float(band.first_nm), device_float(band.last_nm)) for band in bands],
        face_target=device_array(scene.mesh.face_instance, np.uint32),
        targets=len(scene.mesh.instances),
        unit_area=device_float(coordinates.unit_m**2),
    )


def band_range(bands: Sequence[Waveband]) -> tuple[float, float]:
    """First and last wavelength of some bands, whole nanometres."""
    return float(np.floor(min(b.first_nm for b in bands))), float(np.ceil(max(b.last_nm for b in bands)))


def _boxes(mesh: Mesh, coordinates: LocalCoordinates, interest: NDArray[np.bool_]) -> tuple[Box, Box]:
    """The boxes of a scene, and of some instances."""
    vertices = coordinates.vertices(mesh)
    chosen = vertices[np.unique(mesh.faces[interest[mesh.face_instance]])] if interest.any() else vertices
    low, high = (np.asarray(limit, float) for limit in (vertices.min(axis=0), vertices.max(axis=0)))
    padding = _PADDING * float((high - low).max())
    near = [np.asarray(limit, float) for limit in (chosen.min(axis=0), chosen.max(axis=0))]
    # Inside the other one, with all that is of interest inside of it.
    return Box(low, high, padding), Box(near[0], near[1], 0.5 * padding)


def _in_bands(
    values: NDArray[np.float64], bands: Sequence[Waveband], grid: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Values at the grid's wavelengths, times the number of bands that these are in."""
    within = sum((grid >= band.first_nm) & (grid <= band.last_nm) for band in bands)
    return np.asarray(values * within)


def _node_weights(
    sky: Sky,
    radiance: NDArray[np.float64],
    photons: NDArray[np.float64],
    bands: Sequence[Waveband],
    grid: NDArray[np.float64],
    whole: Box,
) -> NDArray[np.float64]:
    """`(rows + 1, columns + 1)` photons from the corners of the maps' texels, whose mean is their total."""
    amounts = _in_bands(radiance * photons, bands, grid).sum(axis=1) * STEP_NM
    texels = np.tensordot(amounts, sky.weights.astype(float), 1)
    rows, columns = texels.shape
    # The mean of the texels around each corner: not 0 where the interpolated map is not.
    around = np.pad(np.pad(texels, ((0, 0), (1, 1)), "wrap"), ((1, 1), (0, 0)), "edge")
    corners = 0.25 * (around[:-1, :-1] + around[1:, :-1] + around[:-1, 1:] + around[1:, 1:])
    polar = np.linspace(0.0, np.pi, rows + 1)[:, None]
    azimuth = np.linspace(0.0, 2.0 * np.pi, columns + 1)
    towards = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0.0 * azimuth], -1
    )
    return np.asarray(corners * np.sin(polar) * whole.area_across(towards) * 2.0 * np.pi**2)


def _wavelengths(photons: NDArray[np.float64], bands: Sequence[Waveband], grid: NDArray[np.float64]) -> Any:
    """The distribution of wavelengths: equal parts for all bands, in proportion to the light within each."""
    mi, _ = mitsuba_modules()
    density = np.zeros(grid.size)
    for band in bands:
        # With the neighbouring entries, so that it is above 0 in all of the band.
        within = (grid > band.first_nm - STEP_NM) & (grid < band.last_nm + STEP_NM)
        part = np.where(within, photons, 0.0)
        # Where lights have little or nothing, some samples find that out.
        part = part + np.where(within, 0.05 * part.max(), 0.0)
        density += part / max(part.sum(), 1e-300)
    limits = mi.ScalarVector2f(grid[0], grid[-1])
    return mi.ContinuousDistribution(limits, (density / density.max()).astype(np.float32))


def trace_packets(tables: PacketTables, first: int, count: int, seed: int) -> NDArray[np.float64]:
    """Trace packets, `count` of each replicate from number `first` on.

    Returns:
        `(QUANTITIES * bands, REPLICATES, targets + 2)` sums over the packets, for each instance, then what
        leaves the scene and what entered it, both as received. The same each time: they are taken one packet
        after the other.
    """
    mi, dr = mitsuba_modules()
    lane = dr.arange(mi.UInt32, REPLICATES * count)
    replicate = lane // device_uint(count)
    index = lane - replicate * device_uint(count) + device_uint(first)
    sequence = OwenSobol(replicate, index, device_uint(seed))
    ray, power = _emit(tables, sequence)
    sums = np.zeros((QUANTITIES * len(tables.limits), REPLICATES * (tables.targets + 2)))
    values = _by_band(tables, ray.wavelengths, power)
    dr.eval(ray, power, replicate, values)
    entered = np.array(replicate).astype(np.intp) * (tables.targets + 2) + tables.targets + 1
    _add(sums, entered, [None] * len(values) + values)
    # As kernel data, so that all bounces have the same code.
    sequence.dimension = device_uint(sequence.dimension)
    state = _Packets(ray, power, mi.Spectrum(1.0), replicate, sequence)
    for _ in range(_MOST_BOUNCES):
        if not state.bounce(tables, sums):
            break
    return sums.reshape(len(sums), REPLICATES, tables.targets + 2)


def _add(sums: NDArray[np.float64], place: NDArray[np.intp], values: Sequence[Any]) -> None:
    """Add values to the sums at places; None adds nothing."""
    for row, value in zip(sums, values, strict=True):
        if value is not None:
            row += np.bincount(place, np.asarray(value), row.size)


def _by_band(tables: PacketTables, nm: Any, power: Any) -> list[Any]:
    """W, and then umol s-1, in all bands, of power at wavelengths."""
    _, dr = mitsuba_modules()
    inside = [(nm >= low) & (nm <= high) for low, high in tables.limits]
    photons = power * nm * UMOL_PER_J_NM
    return [dr.sum(values & mask) for values in (power, photons) for mask in inside]


def _emit(tables: PacketTables, sequence: OwenSobol) -> tuple[Any, Any]:
    """Rays of packets with their wavelengths, and the power of each, W."""
    mi, dr = mitsuba_modules()
    nm, power = mi.Spectrum(0.0), mi.Spectrum(0.0)
    shift, choice, towards = sequence.next_1d(), sequence.next_1d(), sequence.next_2d()
    for k in range(4):
        nm[k], density = tables.wavelengths.sample_pdf((shift + k) / 4.0)
        power[k] = 0.25 / density

    # Direction, from the sun or from the maps.
    from_sun = choice < tables.sun_share
    direction, radiance = mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(0.0)
    if tables.density is not None:
        uv, density = tables.density.sample(towards)
        sine, cosine = dr.sincos(dr.pi * uv.y)
        across, along = dr.sincos(dr.two_pi * uv.x)
        direction = mi.Vector3f(sine * along, sine * across, cosine)
        # The density is over the maps, whose area is 2 pi^2 sin(polar angle) times smaller as a solid angle.
        per_packet = 2.0 * dr.pi**2 * sine / dr.maximum(density * (1.0 - tables.sun_share), 1e-20)
        for weight, table in zip(tables.sky.weights.eval(sky_uv(direction)), tables.sky.radiance, strict=True):
            radiance += weight * at_wavelengths(table, nm, tables.first_nm, tables.last_entry)
        radiance *= per_packet
    if tables.sky.sun_frame is not None:
        sun = at_wavelengths(tables.sky.sun_irradiance, nm, tables.first_nm, tables.last_entry)
        direction = dr.select(from_sun, sun_direction(tables.sky, towards), direction)
        radiance = dr.select(from_sun, sun / dr.maximum(tables.sun_share, 1e-20), radiance)

    # Start, on either box, and the density of both across the direction.
    w = -direction
    choice, at = sequence.next_1d(), sequence.next_2d()
    on_near = choice < tables.near_share
    rescaled = dr.select(
        on_near, choice / tables.near_share, (choice - tables.near_share) / (1.0 - tables.near_share)
    )
    start = dr.select(on_near, tables.near.entry(w, rescaled, at), tables.whole.entry(w, rescaled, at))
    crosses = on_near | tables.near.crossed(start, w)[2]
    density = (1.0 - tables.near_share) / dr.sum(tables.whole.parts(w))
    density += (tables.near_share / dr.sum(tables.near.parts(w))) & crosses
    back = dr.select(on_near, tables.whole.crossed(start, w)[0], 0.0)
    ray = mi.Ray3f(start + back * w, w)
    ray.wavelengths = nm
    return ray, power * radiance * (tables.unit_area / density)


@dataclass(eq=False)
class _Packets:
    """Packets on their way.

    Attributes:
        ray: with wavelengths.
        power: at the start, W.
        throughput: what is left of it.
        replicate: of each.
        sequence: their random numbers.
    """

    ray: Any
    power: Any
    throughput: Any
    replicate: Any
    sequence: OwenSobol

    def bounce(self, tables: PacketTables, sums: NDArray[np.float64]) -> int:
        """Follow packets to their next hits, add what is absorbed there, scatter; how many go on."""
        mi, dr = mitsuba_modules()
        scene, nm = tables.scene, self.ray.wavelengths
        is_hit, si, hit = scene.intersect(self.ray)
        point = scene.surface_point(si, hit, is_hit, footprint=None)
        arriving = self.power * self.throughput
        kept = dr.select(is_hit, point.entering * (1.0 - point.albedo()), 0.0)
        values = _by_band(tables, nm, arriving * kept) + _by_band(tables, nm, arriving)
        target = dr.gather(mi.UInt32, tables.face_target, hit.prim_index, is_hit)
        place = dr.select(is_hit, target, tables.targets) + self.replicate * (tables.targets + 2)

        # Scatter, with Russian roulette.
        wo, density, weight, _ = point.sample(self.sequence.next_1d(), self.sequence.next_2d())
        throughput = self.throughput * weight
        survival = dr.clip(LONG_ROULETTE[0] * dr.max(throughput), LONG_ROULETTE[1], 1.0)
        goes_on = is_hit & (density > 0.0) & (self.sequence.next_1d() < survival) & dr.any(throughput > 0.0)
        ray, throughput = si.spawn_ray(si.to_world(wo)), throughput / survival
        dr.eval(values, place, goes_on, ray.o, ray.d, throughput, self.sequence.dimension)
        _add(sums, np.array(place).astype(np.intp), values)

        # Those that go on move together.
        lanes = dr.compress(goes_on)
        count = dr.width(lanes)
        if count == 0:
            return 0
        self.ray = mi.Ray3f(dr.gather(mi.Point3f, ray.o, lanes), dr.gather(mi.Vector3f, ray.d, lanes))
        self.ray.wavelengths = dr.gather(mi.Spectrum, nm, lanes)
        self.power = dr.gather(mi.Spectrum, self.power, lanes)
        self.throughput = dr.gather(mi.Spectrum, throughput, lanes)
        self.replicate = dr.gather(mi.UInt32, self.replicate, lanes)
        self.sequence = self.sequence.subset(lanes)
        dr.eval(self.ray, self.power, self.throughput, self.replicate)
        return int(count)

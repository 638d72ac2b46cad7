"""Meters on surfaces: the light that a surface receives or absorbs per area, both sides together.

A meter stands in the place of the surface's BSDF where a path begins. Its "BSDF" times cosine is
a(w) |cos w| / (2 pi) for directions w on both sides. a(w) is the absorptance 1 - E(w) - A(w) (R + T) of that
side (see `surface.scattering`), or 1 for all light that arrives. So sun, lamps and sky reach it as they
reach surfaces in images, and 2 pi times the light that it "scatters" is the integral of a |cos w| L over all
directions.

Cosines are those of the triangle, so that the sum over a mesh is what enters its triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry import Mesh
from pepperscene.geometry.surface_samples import area_normals
from pepperscene.render.arrays import device_array, device_float, device_uint
from pepperscene.render.kernel.camera import SpectralResponse
from pepperscene.render.kernel.lamps import frame_lamps
from pepperscene.render.kernel.scene import LightScene, sky_tables
from pepperscene.render.surface.optics import STEP_NM
from pepperscene.render.surface.scattering import SurfacePoint
from pepperscene.render.transport.channel_paths import continued_light
from pepperscene.render.transport.lights import FrameTables, frame_tables
from pepperscene.render.transport.owen_sobol import OwenSobol
from pepperscene.render.transport.samples import Samples, SampleWavelengths
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene
from pepperscene.spectra.lights import umol_per_joule
from pepperscene.spectra.wavebands import Waveband

Measured = Literal["absorbed", "received"]
REPLICATES: Final = 32
"""Independent scramblings of the samples of an organ. Chosen: the error that they show has an error of an
eighth."""
_MOST_BOUNCES: Final = 1000
"""Chosen: roulette has ended all paths long before, but those between lossless mirrors."""
LANES: Final = 1 << 19  # chosen: samples that are traced at a time; bounds the memory
_HALVINGS: Final = 22
"""Chosen: steps of the search for a triangle, enough for four million of one instance."""


@dataclass(frozen=True, eq=False)
class Meter:
    """A meter on a surface, in place of a `SurfacePoint`; directions are in the triangle's frame.

    Attributes:
        sides: the surface seen from the front and from the back; None to receive all light.
        reflectance, transmittance: 1, for what chooses between lights.
    """

    sides: tuple[SurfacePoint, SurfacePoint] | None
    reflectance: Any
    transmittance: Any

    def eval_pdf(self, wo: Any) -> tuple[Any, Any]:
        """Absorptance times cosine over 2 pi, and the density of `sample`."""
        _, dr = mitsuba_modules()
        cosine = dr.abs(wo.z)
        density = cosine * dr.inv_two_pi
        return self._absorptance(wo, cosine) * density, density

    def sample(self, sample1: Any, sample2: Any) -> tuple[Any, Any, Any, Any]:
        """Sample a direction, as `SurfacePoint.sample`."""
        mi, dr = mitsuba_modules()
        wo = mi.warp.square_to_cosine_hemisphere(sample2)
        wo.z = dr.select(sample1 < 0.5, wo.z, -wo.z)
        value, density = self.eval_pdf(wo)
        # Exactly along the surface there is no light.
        return wo, density, dr.select(density > 0.0, value / dr.maximum(density, 1e-20), 0.0), mi.UInt32(1)

    def _absorptance(self, wo: Any, cosine: Any) -> Any:
        _, dr = mitsuba_modules()
        if self.sides is None:
            return self.reflectance
        front, back = (point.near.at(point.openness, cosine) * (1.0 - point.albedo()) for point in self.sides)
        return dr.select(wo.z > 0.0, front, back)


def meter_at(scene: LightScene, si: Any, hit: Any, active: Any, measured: Measured) -> tuple[Any, Meter]:
    """A surface interaction with the triangle's own frame, and a meter there."""
    mi, _ = mitsuba_modules()
    si = mi.SurfaceInteraction3f(si)
    si.sh_frame = mi.Frame3f(si.n)
    ones = mi.Spectrum(1.0)
    sides = []
    if measured == "absorbed":
        for z in (1.0, -1.0):
            si.wi = mi.Vector3f(0.0, 0.0, z)
            sides.append(scene.surface_point(si, hit, active, footprint=None))
    return si, Meter((sides[0], sides[1]) if sides else None, ones, ones)


def meter_tables(kernel: LightScene, scene: Scene, bands: Sequence[Waveband]) -> FrameTables:
    """Kernel data of the lights of a scene in some bands; lamps that flash are left out."""
    first, last = band_range(bands)
    grid = np.arange(first, last + STEP_NM / 2, STEP_NM)
    lamps = frame_lamps(None, scene, grid)
    lights = [] if lamps is None else list(lamps.emitted)
    if scene.sky is not None:
        light = np.asarray(scene.sky.received() @ scene.sky.radiance.at(grid))
        if scene.sky.sun is not None:
            light = light + scene.sky.sun.irradiance.at(grid)
        lights.append(light)
    # All lights equally: which of them is strong differs from place to place.
    light = np.sum([light / light.mean() for light in lights if light.any()] or [np.ones(grid.size)], axis=0)
    density = _density(light * grid, bands, grid)
    within = np.asarray(density[:, None] > 0.0, np.float64)
    response = SpectralResponse(grid, within, np.zeros(grid.size), density, lamps=lamps)
    return frame_tables(kernel, None, response, None, sky_tables(scene, grid))


def band_range(bands: Sequence[Waveband]) -> tuple[float, float]:
    """First and last wavelength of some bands, whole nanometres."""
    return float(np.floor(min(b.first_nm for b in bands))), float(np.ceil(max(b.last_nm for b in bands)))


def _density(
    photons: NDArray[np.float64], bands: Sequence[Waveband], grid: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sampling density of wavelengths: equal parts for all bands, in proportion to the light within each."""
    density = np.zeros(grid.size)
    for band in bands:
        # With the neighbouring entries, so that it is above 0 in all of the band.
        within = (grid > band.first_nm - STEP_NM) & (grid < band.last_nm + STEP_NM)
        part = np.where(within, photons, 0.0)
        # Where lights have little or nothing, some samples find that out.
        part = part + np.where(within, max(0.05 * part.max(), 1e-12), 0.0)
        density += part / part.sum()
    return np.asarray(density)


def meter_light(
    tables: FrameTables,
    samples: Samples,
    si: Any,
    hit: Any,
    active: Any,
    limits: Sequence[tuple[Any, Any]],
    measured: Measured,
) -> list[Any]:
    """Light at surface interactions by one sample each: W m-2 in all bands, then umol m-2 s-1."""
    mi, dr = mitsuba_modules()
    wavelengths = SampleWavelengths(tables, samples.next_1d())
    si = mi.SurfaceInteraction3f(si)
    si.wavelengths = wavelengths.nm
    si, meter = meter_at(tables.scene, si, hit, active, measured)
    lamps = samples.later_light(si, meter, active, wavelengths.spectra)
    wo, density, weight, _ = meter.sample(samples.next_1d(), samples.next_2d())
    ray, seen = si.spawn_ray(si.to_world(wo)), active & (density > 0.0)
    # Paths go on with what they carry of the light that arrives, however little of that the surface absorbs.
    whole = mi.Spectrum(1.0)
    light = continued_light(tables, samples, wavelengths, (0, _MOST_BOUNCES), ray, seen, whole)
    power = dr.select(active, lamps + weight * light, 0.0) * wavelengths.weights * dr.two_pi
    inside = [(wavelengths.nm >= low) & (wavelengths.nm <= high) for low, high in limits]
    photons = power * wavelengths.nm * float(umol_per_joule(1.0))
    return [dr.sum(values & mask) for values in (power, photons) for mask in inside]


class OrganMeters:
    """Meters on all instances of a mesh, at points evenly spread over the area of each.

    Attributes:
        area_m2: `(i,)` area of each instance's triangles.
    """

    def __init__(self, mesh: Mesh, bands: Sequence[Waveband]) -> None:
        count = len(mesh.instances)
        order = np.argsort(mesh.face_instance, kind="stable")
        owner = mesh.face_instance[order].astype(np.intp)
        area = np.linalg.norm(area_normals(mesh.vertices[mesh.faces[order]].astype(float)), axis=1)
        ends = np.cumsum(area)
        first = np.searchsorted(owner, np.arange(count + 1))
        before = np.append(0.0, ends)[first]
        self.area_m2 = np.diff(before)
        share = (ends - before[owner]) / np.maximum(self.area_m2[owner], 1e-300)
        self._faces, self._share = device_array(order, np.uint32), device_array(share)
        self._first = device_array(first, np.uint32)
        self._limits = [(device_float(band.first_nm), device_float(band.last_nm)) for band in bands]

    def measure(
        self,
        tables: FrameTables,
        organs: NDArray[np.intp],
        first: int,
        count: int,
        seed: int,
        measured: Measured,
    ) -> NDArray[np.float64]:
        """`(2 * bands, REPLICATES, n)` sums over samples at some instances: W m-2, then umol m-2 s-1.

        `count` samples of each replicate are taken, from number `first` on. The sums have the same bits
        each time.
        """
        parts = []
        step = max(LANES // (REPLICATES * count), 1)
        for start in range(0, len(organs), step):
            parts.append(self._sums(tables, organs[start : start + step], first, count, seed, measured))
        return np.concatenate(parts, axis=-1)

    def _sums(
        self,
        tables: FrameTables,
        organs: NDArray[np.intp],
        first: int,
        count: int,
        seed: int,
        measured: Measured,
    ) -> NDArray[np.float64]:
        mi, dr = mitsuba_modules()
        size = len(organs) * REPLICATES * count
        lane = dr.arange(mi.UInt32, size)
        block = lane // device_uint(count)
        place = block // REPLICATES
        organ = dr.gather(mi.UInt32, device_array(organs, np.uint32), place)
        index = lane - block * device_uint(count) + device_uint(first)
        replicate = block - place * REPLICATES
        sequence = OwenSobol(organ * REPLICATES + replicate, index, device_uint(seed))
        samples = Samples.on_surfaces(tables, sequence)

        # A triangle in proportion to its area, and a point of it.
        position, at = samples.next_1d(), samples.next_2d()
        entry, last = (
            dr.gather(mi.UInt32, self._first, organ),
            dr.gather(mi.UInt32, self._first, organ + 1) - 1,
        )
        for _ in range(_HALVINGS):
            middle = (entry + last) >> 1
            is_before = dr.gather(mi.Float, self._share, middle) <= position
            entry = dr.minimum(dr.select(is_before, middle + 1, entry), last)
            last = dr.select(is_before, last, middle)
        hit = dr.zeros(mi.PreliminaryIntersection3f, size)
        hit.prim_index = dr.gather(mi.UInt32, self._faces, entry)
        hit.prim_uv = mi.warp.square_to_uniform_triangle(at)
        hit.t = mi.Float(0.0)
        ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, 1.0))
        active = dr.full(mi.Bool, True, size)
        si = tables.scene.interaction(ray, hit, active)
        values = meter_light(tables, samples, si, hit, active, self._limits, measured)
        dr.eval(values)
        sums = [dr.block_reduce(dr.ReduceOp.Add, value, count) for value in values]
        dr.eval(sums)
        return np.stack([np.array(one).reshape(-1, REPLICATES).T for one in sums]).astype(float)

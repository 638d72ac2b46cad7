"""The reference for our integrator: Mitsuba's `path` with our materials, camera rays and lights.

It shares geometry, materials, rays and the sensor's response with our integrator, but not how light is found:
emitters as Mitsuba plugins, one light sample and one scattered ray at each hit with multiple importance
sampling (Veach 1997), and Mitsuba's own Russian roulette.

Exposures in which the camera moves are the mean of images of cameras that stand still. Each image has one
pose, and its rows are combined afterwards: only the poses and the times of the rows are
those of our integrator, not how it samples time and moves rays and the flash.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.camera.sensor.rows import RowWindows
from pepperscene.geometry.mesh import PIGMENTS
from pepperscene.render.arrays import LocalCoordinates, device_uint, local_coordinates
from pepperscene.render.kernel.camera import CameraRays, camera_rays, spectral_response
from pepperscene.render.kernel.lamps import FrameLamps
from pepperscene.render.kernel.scene import mitsuba_mesh, organ_table
from pepperscene.render.quality import Quality
from pepperscene.render.reference.emitters import (
    SpectralTable,
    daylight_emitter,
    flash_emitter,
    lamp_emitter,
)
from pepperscene.render.surface.normals import shading_normals
from pepperscene.render.surface.optics import Optics
from pepperscene.render.surface.scattering import select_point
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene

SAMPLERS: Final = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
"""Mitsuba's samplers; all but the first round the number of samples up to one that they can spread evenly."""

_DIRECTION_ERROR: Final = 1e-4
"""Radians: chosen, above the rounding of the direction to the camera; one scattered ray in 1e8 is as near."""
_LANES: Final = 1 << 21  # chosen: wavefront of a pass; bounds the memory, and keeps all cores busy


@functools.cache
def surface_bsdf() -> Any:
    """Define `Optics` as a Mitsuba BSDF class, once the variant is set.

    The number of the organ is a face attribute, its pigment state and scanned colour are vertex attributes.
    """
    mi, dr = mitsuba_modules()
    flags = mi.BSDFFlags
    lobes = flags.GlossyReflection, flags.DiffuseReflection, flags.DiffuseTransmission

    class SurfaceBSDF(mi.BSDF):  # type: ignore[name-defined]
        """A body under a cuticle; construct with `of`."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            both = flags.FrontSide | flags.BackSide | flags.SpatiallyVarying
            self.m_components = [lobe | both for lobe in lobes]
            self.m_flags = self.m_components[0] | self.m_components[1] | self.m_components[2]
            self.optics: Optics
            self.rays: CameraRays | None = None  # of the camera that first hits are seen by

        @classmethod
        def of(cls, optics: Optics) -> Any:
            """Make the BSDF of a scene's surfaces."""
            self = cls(mi.Properties())
            self.optics = optics
            return self

        def _point(self, si: Any, active: Any) -> Any:
            """Interactions with normals turned towards the viewer, and the optical state there."""
            organ = mi.UInt32(si.shape.eval_attribute_1("face_organ", si, active) + 0.5)
            state = si.shape.eval_attribute_1("vertex_state", si, active)
            # Mitsuba finds the position in the triangle by normal equations, whose determinant is 0 in single
            # precision for the needle-like triangles of wires; these have one state everywhere.
            state = dr.select(dr.isfinite(state), state, 0.5)
            oriented = shading_normals(si)
            at_hit = oriented, organ, state, active
            colour = None
            if self.optics.scanned is not None:
                colour = si.shape.eval_attribute_3("vertex_colour", si, active)
                colour = dr.select(dr.isfinite(colour), colour, PIGMENTS)
            if self.rays is None:
                return oriented, self.optics.point(*at_hit, colour=colour)
            # The integrator does not say which hits are first ones: those whose viewer is the camera are.
            view, to_camera = si.to_world(si.wi), self.rays.origin - si.p
            distance = dr.norm(to_camera)
            radius = 0.0 if self.rays.focus_distance is None else self.rays.aperture_radius
            is_first = dr.norm(dr.cross(view, to_camera)) <= radius + _DIRECTION_ERROR * distance
            is_first &= dr.dot(view, to_camera) > 0.0
            first = mi.SurfaceInteraction3f(oriented)
            first.t = distance
            seen = self.optics.point(*at_hit, self.rays.footprint(first), colour)
            scattered = self.optics.point(*at_hit, None, colour)
            return oriented, select_point(is_first, seen, scattered)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            oriented, point = self._point(si, active)
            wo, density, weight, lobe = point.sample(sample1, sample2)
            bs = dr.zeros(mi.BSDFSample3f)
            # The caller's directions are in the frame that it passed.
            bs.wo = si.to_local(oriented.to_world(wo))
            bs.pdf, bs.eta = dr.select(active, density, 0.0), 1.0
            bs.sampled_component = lobe
            gloss, reflection, transmission = (mi.UInt32(int(flag)) for flag in lobes)
            bs.sampled_type = dr.select(lobe == 0, gloss, dr.select(lobe == 1, reflection, transmission))
            return bs, weight & active

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            oriented, point = self._point(si, active)
            value, density = point.eval_pdf(oriented.to_local(si.to_world(wo)))
            return value & active, dr.select(active, density, 0.0)

    return SurfaceBSDF


@dataclass(frozen=True, eq=False)
class PathScene:
    """A Mitsuba scene with emitters, for all poses of a camera."""

    scene: Any  # Mitsuba's
    bsdf: Any  # of all surfaces
    flash: Any  # the camera's emitter, or None
    coordinates: LocalCoordinates  # of the scene
    lamps: tuple[Any, ...] = ()  # emitters, in the order of `FrameLamps`


def path_scene(scene: Scene, camera: Camera) -> PathScene:
    """Build a scene with its emitters; the camera's sensor and flash set the range of wavelengths.

    Raises:
        ValueError: see `Optics.pack` and `local_coordinates`.
    """
    mi, _ = mitsuba_modules()
    response = spectral_response(camera, scene)
    grid, coordinates = response.grid_nm, local_coordinates(scene.mesh)
    organs, face_organ = organ_table(scene)
    limits, has_colours = (float(grid[0]), float(grid[-1])), scene.mesh.colour is not None
    optics = Optics.pack(scene.surfaces, *limits, coordinates.unit_m, organs, has_colours=has_colours)
    bsdf = surface_bsdf().of(optics)
    mesh = mitsuba_mesh(scene.mesh, bsdf, coordinates, face_organ)
    parts: dict[str, Any] = {"type": "scene", "plants": mesh}
    if camera.flash is not None:
        intensity = SpectralTable(grid, response.flash)
        parts["flash"] = flash_emitter().of(camera.flash, camera_rays(camera, coordinates), intensity)
    if scene.sky is not None:
        # With a flash or lamps, a sky without a sun gets no light samples; scattered rays find it.
        has_lamps = camera.flash is not None or response.lamps is not None
        weight = 1.0 if scene.sky.sun is not None or not has_lamps else 0.0
        diagonal = float(np.linalg.norm(np.ptp(scene.mesh.bounds, axis=0)))
        reach = 2.0 * diagonal / coordinates.unit_m + 1.0
        parts["daylight"] = daylight_emitter().of(scene.sky, grid, weight, reach)
    emitters: list[Any] = []
    if response.lamps is not None:
        emitted = zip(response.lamps.flux_W, response.lamps.group, strict=True)
        for lamp, (flux, group) in zip(response.lamps.lamps, emitted, strict=True):
            table = SpectralTable(grid, flux * response.lamps.spectra[group])
            emitters.append(lamp_emitter().of(lamp, table, coordinates.unit_m))
        _place_lamps(emitters, response.lamps, coordinates)
        parts |= {f"lamp{number}": emitter for number, emitter in enumerate(emitters)}
    return PathScene(mi.load_dict(parts), bsdf, parts.get("flash"), coordinates, tuple(emitters))


def _place_lamps(emitters: Sequence[Any], lamps: FrameLamps, coordinates: LocalCoordinates) -> None:
    """Place lamps in the scene, and those of the camera at its pose."""
    turn, centre = lamps.pose[:3, :3], lamps.pose[:3, 3]
    for emitter, lamp, moves in zip(emitters, lamps.lamps, lamps.at_camera, strict=True):
        placed = lamp.moved(turn, centre) if moves else lamp
        points = placed.position_m + placed.shape.spread_points_m() @ placed.rotation.T
        emitter.place(coordinates.from_world(points), placed.rotation)


def path_traced(
    scene: Scene,
    camera: Camera,
    *,
    spp: int,
    bounces: int,
    sampler: str = "independent",
    seed: int = 0,
    kernel_scene: PathScene | None = None,
    rows: tuple[int, int] | None = None,
) -> NDArray[np.float32]:
    """Trace the light that reaches each pixel with Mitsuba's path tracer.

    Args:
        scene: everything that can be seen.
        camera: lens, sensor, flash and pose.
        spp: samples per pixel; see `samples_taken`.
        bounces: scattering events after the first hit.
        sampler: one of `SAMPLERS`.
        seed: of the sampler.
        kernel_scene: from `path_scene`, to reuse for other poses of the same camera; None builds one.
        rows: the first row and the one after the last, of which h are traced; None for all.

    Returns:
        `(h, w, c)` electrons s-1 m-2 sr-1, as `TracedLight.total()`.

    Raises:
        ValueError: unknown sampler, no samples, or no surfaces.
    """
    mi, dr = mitsuba_modules()
    response = spectral_response(camera, scene)
    kernel_scene = kernel_scene or path_scene(scene, camera)
    rays = camera_rays(camera, kernel_scene.coordinates)
    kernel_scene.bsdf.rays = rays
    if camera.flash is not None:
        kernel_scene.flash.move_to(camera.flash, rays, SpectralTable(response.grid_nm, response.flash))

    if response.lamps is not None:
        _place_lamps(kernel_scene.lamps, response.lamps, kernel_scene.coordinates)
    integrator = mi.load_dict({"type": "path", "max_depth": bounces + 2})
    count = samples_taken(sampler, spp)
    first_row, end_row = rows or (0, rays.height)
    pixels = rays.width * (end_row - first_row)
    # The largest divisor of the count whose wavefront fits.
    per_pass = max((n for n in range(1, count + 1) if count % n == 0 and n * pixels <= _LANES), default=1)
    source = mi.load_dict({"type": sampler, "sample_count": count})
    source.set_samples_per_wavefront(per_pass)
    source.seed(seed & 0xFFFFFFFF, pixels * per_pass)
    distribution = mi.ContinuousDistribution(
        mi.ScalarVector2f(response.grid_nm[0], response.grid_nm[-1]), response.density.astype(np.float32)
    )
    electrons = [SpectralTable(response.grid_nm, column) for column in response.electrons_per_joule.T]
    total = np.zeros((pixels, len(electrons)))
    for number in range(count // per_pass):
        if number:
            source.advance()
        # The samples of a pixel are adjacent: sums without atomics, the same bits each time.
        ray, weights = _sample_rays(rays, (first_row, end_row), distribution, source, per_pass)
        radiance, _, _ = integrator.sample(kernel_scene.scene, source, ray)
        weighted = radiance * weights
        channels = [dr.sum(weighted * table.at(ray.wavelengths)) for table in electrons]
        source.schedule_state()
        dr.eval(channels)
        sums = [dr.block_reduce(dr.ReduceOp.Add, channel, per_pass) for channel in channels]
        dr.eval(sums)
        total += np.stack([np.asarray(channel_sums) for channel_sums in sums], axis=-1)
    return (total / count).reshape(end_row - first_row, rays.width, -1).astype(np.float32)


def samples_taken(sampler: str, spp: int) -> int:
    """Number of samples per pixel that a sampler takes for a request of `spp`: at least as many.

    Raises:
        ValueError: unknown sampler, or no samples.
    """
    if sampler not in SAMPLERS:
        raise ValueError(f"unknown sampler {sampler!r}; allowed are {', '.join(SAMPLERS)}")
    if spp < 1:
        raise ValueError(f"at least one sample per pixel is needed, not {spp}")
    mi, _ = mitsuba_modules()
    return int(mi.load_dict({"type": sampler, "sample_count": spp}).sample_count())


def _sample_rays(
    rays: CameraRays, rows: tuple[int, int], distribution: Any, sampler: Any, per_pass: int
) -> tuple[Any, Any]:
    """Rays of all pixels of some rows, each with four wavelengths, and the weights of these."""
    mi, dr = mitsuba_modules()
    pixel = dr.arange(mi.UInt32, rays.width * (rows[1] - rows[0]) * per_pass) // per_pass
    pixel += device_uint(rows[0] * rays.width)
    row = pixel // rays.width
    point, pose = sampler.next_2d(), rays.pose(row, sampler.next_1d)
    start, direction = rays.sample_rays(pose, pixel - row * rays.width, row, point, sampler.next_2d)
    wavelengths, weights = mi.Spectrum(0.0), mi.Spectrum(0.0)
    shift = sampler.next_1d()
    # One wavelength in each quarter of the density.
    for k in range(4):
        wavelengths[k], density = distribution.sample_pdf((shift + k) / 4.0)
        weights[k] = 0.25 / density
    return mi.RayDifferential3f(start, direction, 0.0, wavelengths), weights


INSTANTS: Final = 16
"""Chosen: images of each row over the time of a light; a sixteenth of a blur of ten pixels is below one."""


def exposed_paths(
    scene: Scene, camera: Camera, quality: Quality, seed: np.random.SeedSequence
) -> tuple[NDArray[np.float32], float]:
    """Trace an exposure with Mitsuba's path tracer.

    Daylight is traced at `INSTANTS` times in the exposure and the flash at as many in its pulse: a random one
    in each equal part of them. Each of the two lights has the quality's samples, divided among its times.

    Returns:
        `(h, w, c)` electrons s-1 m-2 sr-1, averaged over the exposure; and the samples per pixel.
    """
    signal = np.zeros((camera.height, camera.width, camera.sensor.channels))
    flash, samples = camera.flash, 0.0
    if scene.sky is not None or scene.lamps or camera.lamps or flash is None:
        daylight = replace(camera, flash=None)
        exposures = camera.shutter.exposures()
        samples += _add_instants(signal, scene, daylight, exposures, camera.exposure_s, quality, seed)
    if flash is not None:
        dark, camera = replace(scene, sky=None, lamps=()), replace(camera, lamps=())
        lit, longest = camera.shutter.flash_windows(flash.pulse_s), min(flash.pulse_s, camera.exposure_s)
        samples += _add_instants(signal, dark, camera, lit, longest, quality, seed)
    return signal.astype(np.float32), samples


def _add_instants(
    signal: NDArray[np.float64],
    scene: Scene,
    camera: Camera,
    windows: RowWindows,
    longest_s: float,
    quality: Quality,
    seed: np.random.SeedSequence,
) -> float:
    """Add the light of rows in their windows, as fractions of `longest_s`; return the samples per pixel."""
    step = longest_s / INSTANTS
    spp = -(-quality.samples // INSTANTS)
    (stream,) = seed.spawn(1)
    begin, finish = float(windows.begin_s.min()), float(windows.end_s.max())
    # One random time in each step. They repeat after all steps, so that each complete window has as many.
    number = np.arange(-1, int(np.ceil((finish - begin) / step)) + 1)
    times = begin + (number + np.random.default_rng(stream).random(INSTANTS)[number % INSTANTS]) * step
    kernel_scene = path_scene(scene, camera)
    for t, branch in zip(times, stream.spawn(len(times)), strict=True):
        rows = np.flatnonzero((windows.begin_s <= t) & (t < windows.end_s))
        if not rows.size:
            continue
        first, end = int(rows[0]), int(rows[-1]) + 1
        still = replace(camera, pose=camera.pose_at(t), motion=None)
        image = path_traced(
            scene,
            still,
            spp=spp,
            bounces=max(quality.bounces, quality.most_bounces),
            sampler=quality.sampler,
            seed=int(branch.generate_state(1)[0]),
            kernel_scene=kernel_scene,
            rows=(first, end),
        )
        signal[rows] += image[rows - first] / INSTANTS
    return float(INSTANTS * samples_taken(quality.sampler, spp))

"""The plain way, beside our own integrator: Mitsuba's `path` over our materials, camera rays and lights.

It shares with our integrator what is seen (mesh, materials, rays, the sensor's response) and nothing of how
light is found: emitters of Mitsuba's kind, one light sample and one scattered ray at each hit with multiple
importance sampling (Veach 1997), and Mitsuba's own Russian roulette.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.render.kernel.arrays import LocalCoordinates, local_coordinates
from pepperscene.render.kernel.camera import CameraRays, LensCache, Response, response
from pepperscene.render.kernel.scene import kernel_mesh
from pepperscene.render.reference.bsdf import surface_bsdf
from pepperscene.render.reference.emitters import SpectralTable, daylight_emitter, flash_emitter
from pepperscene.render.surface.optics import Optics
from pepperscene.render.surface.tables import pack
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene

SAMPLERS: Final = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
"""Of Mitsuba's; all but the first round the number of samples up to one that they can spread evenly."""

_LANES: Final = 1 << 21  # chosen: wavefront of a pass; bounds the memory, and fills two cores many times


@dataclass(frozen=True, eq=False)
class PathScene:
    """A scene with emitters inside Mitsuba, for all poses of a camera.

    Attributes:
        scene: of Mitsuba.
        flash: the emitter that goes with the camera, or None.
        range_nm: first and last wavelength of the materials and the daylight.
        region: whose coordinates it is told in.
        lights: whose they are: the camera's and the scene's, or others that stay where they are.
    """

    scene: Any
    flash: Any
    range_nm: tuple[float, float]
    region: LocalCoordinates
    lights: Literal["own", "others"] = "own"


def path_scene(
    scene: Scene, camera: Camera, *, sky_weight: float = 0.0, emitters: Mapping[str, Any] | None = None
) -> PathScene:
    """The scene with its emitters.

    Light samples go to the flash and to the sun, evenly. Those to the sky are dear: half of them would miss
    what a scattered ray finds anyway, and left out they cut the error sixfold at equal time.

    Args:
        scene: what stands where.
        camera: its sensor and flash set the range of wavelengths.
        sky_weight: chance of a light sample to look for the sky, against 1 for the flash and 1 for the sun;
            1 where there is neither.
        emitters: of Mitsuba by name, in place of the camera's and the scene's lights.

    Raises:
        ValueError: the scene was assembled without surfaces; or as `local_coordinates`.
    """
    if not scene.surfaces:
        raise ValueError("the scene has no surfaces: assemble it with them to render colour")
    mi, _ = mitsuba_modules()
    spectral = response(camera, scene)
    first, last = float(spectral.grid_nm[0]), float(spectral.grid_nm[-1])
    region = local_coordinates(scene.mesh)
    bsdf = surface_bsdf().of(Optics(pack(scene.surfaces, first, last, region.unit)))
    parts: dict[str, Any] = {"type": "scene", "plants": kernel_mesh(scene.mesh, bsdf, region)}
    if emitters is not None:
        return PathScene(mi.load_dict({**parts, **emitters}), None, (first, last), region, "others")
    if camera.flash is not None:
        intensity = SpectralTable(spectral.grid_nm, spectral.flash)
        parts["flash"] = flash_emitter().of(camera.flash, LensCache().view(camera, region), intensity)
    if scene.sky is not None:
        sun = 1.0 if scene.sky.sun is not None else 0.0
        if not sun and camera.flash is None:
            sky_weight = 1.0
        weight = sun + sky_weight
        share = sky_weight / weight if sun else 1.0
        reach = 2.0 * float(np.linalg.norm(np.ptp(scene.mesh.bounds, axis=0))) / region.unit + 1.0
        parts["daylight"] = daylight_emitter().of(scene.sky, spectral.grid_nm, weight, share, reach)
    return PathScene(mi.load_dict(parts), parts.get("flash"), (first, last), region)


def path_traced(
    scene: Scene,
    camera: Camera,
    *,
    spp: int,
    bounces: int,
    sampler: str = "independent",
    seed: int = 0,
    kernel_scene: PathScene | None = None,
) -> NDArray[np.float32]:
    """`(h, w, c)` light that reaches each pixel, in units of `TracedLight.total()`: electrons s-1 m-2 sr-1.

    Args:
        scene: what stands where.
        camera: lens, sensor, flash and pose.
        spp: samples per pixel; see `samples_taken`.
        bounces: scattering events after the first hit.
        sampler: one of `SAMPLERS`.
        seed: of the sampler; the same seed gives the same bits.
        kernel_scene: of `path_scene`, to be kept from frame to frame; None builds one.

    Raises:
        ValueError: unknown sampler, no samples, no surfaces, or a kernel scene for another camera.
    """
    mi, dr = mitsuba_modules()
    spectral = response(camera, scene)
    built = kernel_scene or path_scene(scene, camera)
    view = LensCache().view(camera, built.region)
    _aim(built, camera, view, spectral)

    integrator = mi.load_dict({"type": "path", "max_depth": bounces + 2})
    count = samples_taken(sampler, spp)
    pixels = view.width * view.height
    # The largest divisor of the count whose wavefront fits.
    per_pass = max((n for n in range(1, count + 1) if count % n == 0 and n * pixels <= _LANES), default=1)
    source = mi.load_dict({"type": sampler, "sample_count": count})
    source.set_samples_per_wavefront(per_pass)
    source.seed(seed & 0xFFFFFFFF, pixels * per_pass)
    rays = _Rays(view, spectral)
    total = np.zeros((pixels, spectral.electrons.shape[1]))
    for number in range(count // per_pass):
        if number:
            source.advance()
        # The samples of a pixel lie side by side: sums without atomics, the same bits each time.
        ray, weights = rays.sampled(source, per_pass)
        radiance, _, _ = integrator.sample(built.scene, source, ray)
        channels = rays.channels(radiance * weights, ray.wavelengths)
        source.schedule_state()
        dr.eval(channels)
        sums = [dr.block_reduce(dr.ReduceOp.Add, channel, per_pass) for channel in channels]
        dr.eval(sums)
        total += np.stack([np.asarray(part) for part in sums], axis=-1)
    return (total / count).reshape(view.height, view.width, -1).astype(np.float32)


def samples_taken(sampler: str, spp: int) -> int:
    """How many samples per pixel that sampler takes when asked for `spp`: at least as many.

    Raises:
        ValueError: unknown sampler, or no samples.
    """
    if sampler not in SAMPLERS:
        raise ValueError(f"unknown sampler {sampler!r}; allowed are {', '.join(SAMPLERS)}")
    if spp < 1:
        raise ValueError(f"at least one sample per pixel is needed, not {spp}")
    mi, _ = mitsuba_modules()
    return int(mi.load_dict({"type": sampler, "sample_count": spp}).sample_count())


class _Rays:
    """The camera's rays, each with four wavelengths, and the sensor at their end."""

    def __init__(self, view: CameraRays, spectral: Response) -> None:
        mi, _ = mitsuba_modules()
        self.view = view
        self.distribution = mi.ContinuousDistribution(
            mi.ScalarVector2f(spectral.grid_nm[0], spectral.grid_nm[-1]), spectral.density.astype(np.float32)
        )
        self.electrons = [SpectralTable(spectral.grid_nm, column) for column in spectral.electrons.T]

    def sampled(self, sampler: Any, per_pass: int) -> tuple[Any, Any]:
        """Rays pixel by pixel, and the weights of their wavelengths."""
        mi, dr = mitsuba_modules()
        view = self.view
        pixel = dr.arange(mi.UInt32, view.width * view.height * per_pass) // per_pass
        row = pixel // view.width
        start, towards = view.rays(pixel - row * view.width, row, sampler.next_2d(), sampler.next_2d)
        wavelengths, weights = mi.Spectrum(0.0), mi.Spectrum(0.0)
        shift = sampler.next_1d()
        # One wavelength in each quarter of the density.
        for k in range(4):
            wavelengths[k], density = self.distribution.sample_pdf((shift + k) / 4.0)
            weights[k] = 0.25 / density
        return mi.RayDifferential3f(start, towards, 0.0, wavelengths), weights

    def channels(self, weighted: Any, wavelengths: Any) -> list[Any]:
        """The sensor's sum over wavelengths for each channel, electrons s-1 m-2 sr-1."""
        _, dr = mitsuba_modules()
        return [dr.sum(weighted * table.at(wavelengths)) for table in self.electrons]


def _aim(built: PathScene, camera: Camera, view: CameraRays, spectral: Response) -> None:
    """Put the flash at the camera.

    Raises:
        ValueError: the kernel scene was made for another range of wavelengths, or with or without a flash.
    """
    if built.range_nm != (float(spectral.grid_nm[0]), float(spectral.grid_nm[-1])):
        raise ValueError("the kernel scene was made for a camera that sees another range of wavelengths")
    if built.lights == "others":
        return
    if (built.flash is None) != (camera.flash is None):
        raise ValueError("the kernel scene was made for a camera that has a flash where this has none")
    if camera.flash is not None:
        built.flash.aim(camera.flash, view, SpectralTable(spectral.grid_nm, spectral.flash))

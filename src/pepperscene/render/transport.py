"""Light transport for a flash at the camera, in two traversals: one for what is sharp, one for what is soft.

The flash is nearly deterministic, all else is small and smooth (a tenth of the signal in `barth2018`). So at
each hit the flash is evaluated with one shadow ray towards a point of its disc, the sun with one towards its
disc, and the sky is found by BSDF sampling alone. Samples lie pixel by pixel in the wavefront, so that the
sum over a pixel is a block reduction: no atomics, the same bits in each run. What has edges gets many
samples; what is soft gets few, each of them dearer.
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
from pepperscene.render.samples import FrameTables, Samples
from pepperscene.render.variant import kernel
from pepperscene.render.view import View

_LANES: Final = 1 << 21  # chosen: wavefront of a pass; 16 results of a sample take 134 MB
_LEAST_SURVIVAL: Final = 0.1  # chosen: bounds the weight of a survivor to ten times its light


@dataclass(frozen=True, eq=False)
class Light:
    """One frame's light, summed over wavelengths by the sensor, per pixel and channel (c, 3 or 1).

    Attributes:
        flash: `(h, w, c)` straight from the flash to the first hit and back; electrons s-1 m-2 sr-1.
        open_flash: `(h, w, c)` the same with all shadows taken away.
        sky: `(h, w, c)` seen directly.
        soft: `(h, w, c)` all the rest: sun, sky and light that was scattered more than once.
        albedo: `(h, w, c)` of the first hit, weighted by the response to the flash, 0 where there is none;
            for the denoiser, as is what follows.
        normal: `(h, w, 3)` of the first hit, towards the camera, 0 where there is none.
        covered: `(h, w, 2)` share of the samples that hit something, among the sharp ones and the soft.
    """

    flash: NDArray[np.float32]
    open_flash: NDArray[np.float32]
    sky: NDArray[np.float32]
    soft: NDArray[np.float32]
    albedo: NDArray[np.float32]
    normal: NDArray[np.float32]
    covered: NDArray[np.float32]

    def total(self) -> NDArray[np.float32]:
        """`(h, w, c)` all light as traced."""
        return self.flash + self.sky + self.soft


@dataclass(frozen=True, eq=False)
class Sampling:
    """How many samples go where; square numbers stratify best.

    Attributes:
        sharp: samples per pixel of what has edges.
        soft: samples per pixel of what is small and smooth.
        bounces: scattering events after the first hit.
    """

    sharp: int
    soft: int
    bounces: int


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
        seed: of the samplers.
    """
    tables = FrameTables(scene, view, spectral, flash, sky)
    sharp = _accumulated(tables, sampling.sharp, seed, lambda samples: _sharp(tables, samples))
    c = len(tables.electrons)
    flash_light, open_flash, sky_light, albedo, normal, covered = np.split(
        sharp, [c, 2 * c, 3 * c, 4 * c, 4 * c + 3], axis=-1
    )
    soft, soft_covered = np.zeros_like(sky_light), covered
    if tables.flash is not None or tables.sky is not None:
        found = _accumulated(tables, sampling.soft, ~seed, lambda s: _soft(tables, s, sampling.bounces))
        soft, soft_covered = found[..., :c], found[..., c:]
    covered = np.concatenate([covered, soft_covered], axis=-1)
    return Light(flash_light, open_flash, sky_light, soft, albedo, normal, covered)


def _accumulated(
    tables: FrameTables, count: int, seed: int, wavefront: Callable[[Samples], list[Any]]
) -> NDArray[np.float32]:
    """`(h, w, c)`: means over a pixel's samples of the values that a wavefront gives for each."""
    mi, dr = kernel()
    view = tables.view
    pixels = view.width * view.height
    # The largest divisor of the count whose wavefront fits.
    per_pass = max((n for n in range(1, count + 1) if count % n == 0 and n * pixels <= _LANES), default=1)
    sampler = mi.load_dict({"type": "multijitter", "sample_count": count})
    sampler.set_samples_per_wavefront(per_pass)
    sampler.seed(seed & 0xFFFFFFFF, pixels * per_pass)
    totals: list[Any] = []
    for number in range(count // per_pass):
        if number:
            sampler.advance()
            sampler.schedule_state()
        values = wavefront(Samples(tables, sampler, count, number * per_pass, per_pass, seed))
        # All results in one kernel: reduced one by one, the kernel would run once for each.
        dr.eval(values, sampler)
        sums = [dr.block_reduce(dr.ReduceOp.Add, value, per_pass) for value in values]
        totals = [total + part for total, part in zip(totals, sums, strict=True)] if totals else sums
        dr.eval(totals)
    images = np.stack([np.asarray(total).reshape(view.height, view.width) for total in totals], axis=-1)
    return (images / count).astype(np.float32)


def _sharp(tables: FrameTables, samples: Samples) -> list[Any]:
    """Flash at the first hit with and without shadows, sky seen, albedo, normal, hit: 4 c + 4 values."""
    mi, dr = kernel()
    ray = samples.ray
    active, si, point = _hit(tables.scene, ray, coherent=True)
    sky = samples.sky(ray.d, ~active, seen=True)
    flash, open_flash = samples.flash(si, point, active)
    albedo = dr.select(active, point.albedo(), 0.0)
    normal = dr.select(active, dr.select(si.wi.z > 0, si.sh_frame.n, -si.sh_frame.n), 0.0)
    light = [channel for part in (flash, open_flash, sky) for channel in samples.channels(part)]
    hit = dr.select(active, mi.Float(1.0), 0.0)
    return [*light, *samples.albedo(albedo), normal.x, normal.y, normal.z, hit]


def _soft(tables: FrameTables, samples: Samples, bounces: int) -> list[Any]:
    """Sun at the first hit, all light that was scattered before it got there, hit: c + 1 values."""
    mi, dr = kernel()
    active, si, point = _hit(tables.scene, samples.ray, coherent=True)
    seen = dr.select(active, mi.Float(1.0), 0.0)
    light = samples.sun(si, point, active)
    throughput = mi.Spectrum(1.0)
    for bounce in range(bounces + 1):
        last = bounce == bounces
        if last and tables.sky is None:
            break
        wo, density, weight, _ = point.sample(samples.next_1d(), samples.next_2d())
        throughput *= weight
        # Russian roulette: leaves absorb most of the light, and rays for the rest are dear.
        survival = dr.clip(dr.max(throughput), _LEAST_SURVIVAL, 1.0)
        active &= (density > 0.0) & (samples.next_1d() < survival) & dr.any(throughput > 0.0)
        # Ended paths hold what their lane last saw, which can be NaN, and NaN times no light is NaN.
        throughput = dr.select(active, throughput / survival, 0.0)
        ray = si.spawn_ray(si.to_world(wo))
        if last:
            # The last hit's scattered ray only looks for the sky.
            light += throughput * samples.sky(
                ray.d, active & ~tables.scene.scene.ray_test(ray, active), seen=False
            )
            break
        hit, si, point = _hit(tables.scene, ray, active)
        light += throughput * samples.sky(ray.d, active & ~hit, seen=False)
        active &= hit
        light += throughput * samples.flash(si, point, active)[0]
        light += throughput * samples.sun(si, point, active)
    return [*samples.channels(light), seen]


def _hit(scene: LightScene, ray: Any, active: Any = True, *, coherent: bool = False) -> Any:
    """Whether rays hit something, where, and what it is like there."""
    mi, _ = kernel()
    found = scene.scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)
    hit = found.is_valid()
    si = facing(found.compute_surface_interaction(ray, mi.RayFlags.All, hit))
    return hit, si, scene.point(si, found, hit)

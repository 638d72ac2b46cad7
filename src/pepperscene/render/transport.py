"""Light transport for a flash at the camera: one traversal for everything that a colour frame needs.

The flash is nearly deterministic, all else is small and smooth (measured: 5 % of the signal). So at each hit
the flash is evaluated with one shadow ray towards a point of its disc, the sun with one towards its disc, and
the sky is found by BSDF sampling alone. Samples lie pixel by pixel in the wavefront, so that the sum over a
pixel is a block reduction: no atomics, the same bits in each run. The wavelengths of a pixel are spread
evenly over its samples, four a sample, instead of drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.kernel import SkyTables
from pepperscene.render.response import STEP_NM, Response
from pepperscene.render.variant import kernel
from pepperscene.render.view import View

_LANES: Final = 1 << 21  # chosen: wavefront of a pass, about 0.3 GB for its sampler state and results


@dataclass(frozen=True, eq=False)
class Light:
    """One frame's light, summed over wavelengths by the sensor, per pixel.

    Attributes:
        sharp: `(h, w, 3)` flash at the first hit and sky seen directly; electrons s-1 m-2 sr-1.
        soft: `(h, w, 3)` all the rest: sun, sky and light that was scattered more than once.
        albedo: `(h, w, 3)` of the first hit, weighted by the response to the flash; for the denoiser.
        normal: `(h, w, 3)` of the first hit, towards the camera; for the denoiser.
    """

    sharp: NDArray[np.float32]
    soft: NDArray[np.float32]
    albedo: NDArray[np.float32]
    normal: NDArray[np.float32]


def trace(
    scene: Any,
    view: View,
    spectral: Response,
    flash: Flash | None,
    sky: SkyTables | None,
    *,
    samples: int,
    bounces: int,
    seed: int,
) -> Light:
    """The light that reaches each pixel.

    Args:
        scene: Mitsuba scene with materials (`kernel.light_scene`).
        view: the camera's rays.
        spectral: the camera's response.
        flash: or None.
        sky: or None.
        samples: per pixel, a square number for the best stratification.
        bounces: scattering events after the first hit.
        seed: of the sampler.
    """
    mi, dr = kernel()
    pixels = view.width * view.height
    per_pass = _samples_per_pass(samples, pixels)
    sampler = mi.load_dict({"type": "multijitter", "sample_count": samples})
    sampler.set_samples_per_wavefront(per_pass)
    sampler.seed(seed, pixels * per_pass)
    tracer = _Tracer(scene, view, spectral, flash, sky, samples, per_pass, bounces)

    totals: list[Any] = []
    for number in range(samples // per_pass):
        if number:
            sampler.advance()
            sampler.schedule_state()
        channels = tracer.wavefront(sampler, seed)
        # All results in one kernel: reduced one by one, the kernel would run once for each.
        dr.eval(channels, sampler)
        sums = [dr.block_reduce(dr.ReduceOp.Add, channel, per_pass) for channel in channels]
        totals = [total + part for total, part in zip(totals, sums, strict=True)] if totals else sums
        dr.eval(totals)
    images = np.stack([np.asarray(total).reshape(view.height, view.width) for total in totals], axis=-1)
    images = (images / samples).astype(np.float32)
    return Light(images[..., :3], images[..., 3:6], images[..., 6:9], images[..., 9:12])


def _samples_per_pass(samples: int, pixels: int) -> int:
    """The largest divisor of `samples` whose wavefront fits."""
    fitting = [n for n in range(1, samples + 1) if samples % n == 0 and n * pixels <= _LANES]
    return max(fitting, default=1)


class _Tracer:
    """Holds the tables of a frame while its wavefronts are traced."""

    def __init__(
        self,
        scene: Any,
        view: View,
        spectral: Response,
        flash: Flash | None,
        sky: SkyTables | None,
        samples: int,
        per_pass: int,
        bounces: int,
    ) -> None:
        mi, dr = kernel()
        self.scene, self.view, self.sky = scene, view, sky
        self.samples, self.per_pass, self.bounces = samples, per_pass, bounces
        self.first_nm = float(spectral.grid_nm[0])
        self.entries = spectral.grid_nm.size
        self.wavelengths = mi.ContinuousDistribution(
            mi.ScalarVector2f(spectral.grid_nm[0], spectral.grid_nm[-1]), spectral.density.astype(np.float32)
        )
        self.electrons = [mi.Float(column) for column in spectral.electrons.T]
        reference = spectral.flash if spectral.flash.any() else np.ones(spectral.grid_nm.size)
        white = (spectral.electrons * reference[:, None]).sum(axis=0) * STEP_NM
        self.albedo_scale = [mi.Float(float(1.0 / w)) for w in white]
        self.reference = mi.Float(reference)
        self.flash_disc: _FlashDisc | None = None
        if flash is not None and spectral.flash.any():
            self.flash_disc = _FlashDisc(flash, view, mi.Float(spectral.flash))
        dr.make_opaque(self.albedo_scale)

    def wavefront(self, sampler: Any, seed: int) -> list[Any]:
        """Twelve values for each sample of a pass: sharp, soft, albedo, normal."""
        mi, dr = kernel()
        # Camera rays: samples of a pixel lie side by side.
        lane = dr.arange(mi.UInt32, self.view.width * self.view.height * self.per_pass)
        pixel = lane // self.per_pass
        row = pixel // self.view.width
        place = sampler.next_2d()
        towards = self.view.directions(pixel - row * self.view.width, row, place.x, place.y)
        wavelengths, weights = self._spread_wavelengths(sampler, pixel, seed)
        ray = mi.Ray3f(self.view.origin, towards, 0.0, wavelengths)

        # First hit: flash and visible sky are sharp, sun is soft.
        si = self.scene.ray_intersect(ray)
        hit = si.is_valid()
        sharp = self._sky(ray, ~hit, seen=True)
        bsdf = si.bsdf()
        ctx = mi.BSDFContext()
        sharp += self._flash(si, bsdf, ctx, sampler, hit)
        soft = self._sun(si, bsdf, ctx, sampler, hit)
        albedo = dr.select(hit, bsdf.eval_diffuse_reflectance(si, hit), 1.0)
        normal = dr.select(hit, mi.Vector3f(dr.select(si.wi.z > 0, si.sh_frame.n, -si.sh_frame.n)), 0.0)

        # Later hits: everything they send back is soft. The last one's scattered ray only looks for the sky.
        throughput = mi.Spectrum(1.0)
        active = mi.Bool(hit)
        for bounce in range(self.bounces + 1):
            last = bounce == self.bounces
            if last and self.sky is None:
                break
            sample, factor = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), active)
            throughput *= factor
            active &= dr.any(throughput > 0.0)
            ray = si.spawn_ray(si.to_world(sample.wo))
            if last:
                soft += throughput * self._sky(ray, active & ~self.scene.ray_test(ray, active), seen=False)
                break
            si = self.scene.ray_intersect(ray, active)
            soft += throughput * self._sky(ray, active & ~si.is_valid(), seen=False)
            active &= si.is_valid()
            bsdf = si.bsdf()
            soft += throughput * self._flash(si, bsdf, ctx, sampler, active)
            soft += throughput * self._sun(si, bsdf, ctx, sampler, active)
        return [
            *self._channels(sharp, wavelengths, weights),
            *self._channels(soft, wavelengths, weights),
            *self._albedo(albedo, wavelengths, weights),
            normal.x,
            normal.y,
            normal.z,
        ]

    # --- wavelengths ------------------------------------------------------------------------------------

    def _spread_wavelengths(self, sampler: Any, pixel: Any, seed: int) -> Any:
        """Four wavelengths a sample and their weights; a pixel's samples share out the spectrum evenly."""
        mi, dr = kernel()
        stratum = dr.floor(sampler.next_1d() * self.samples)
        salt = mi.UInt32(seed & 0xFFFFFFFF)
        dr.make_opaque(salt)
        shift = mi.Float(mi.sample_tea_float32(pixel, salt))
        quarter = (dr.minimum(stratum, self.samples - 1.0) + shift) / self.samples
        wavelengths, weights = mi.Spectrum(0.0), mi.Spectrum(0.0)
        for k in range(4):
            nm, density = self.wavelengths.sample_pdf((quarter + k) / 4.0)
            wavelengths[k] = nm
            weights[k] = 0.25 / density
        return wavelengths, weights

    def _tabulated(self, table: Any, wavelengths: Any, active: Any = True) -> Any:
        """A table on the response's grid, linear in between, at the ray's wavelengths."""
        mi, dr = kernel()
        found = mi.Spectrum(0.0)
        for k in range(4):
            x = dr.clip((wavelengths[k] - self.first_nm) / STEP_NM, 0.0, self.entries - 1.001)
            left = dr.floor(x)
            index = mi.UInt32(left)
            a = dr.gather(mi.Float, table, index, active)
            b = dr.gather(mi.Float, table, index + 1, active)
            found[k] = dr.lerp(a, b, x - left)
        return found

    def _channels(self, radiance: Any, wavelengths: Any, weights: Any) -> list[Any]:
        """The sensor's sum over wavelengths for each channel, electrons s-1 m-2 sr-1."""
        _, dr = kernel()
        return [dr.sum(radiance * weights * self._tabulated(table, wavelengths)) for table in self.electrons]

    def _albedo(self, albedo: Any, wavelengths: Any, weights: Any) -> list[Any]:
        """The albedo as each channel sees it under the flash, 1 for a white body."""
        lit = albedo * self._tabulated(self.reference, wavelengths)
        channels = self._channels(lit, wavelengths, weights)
        return [channel * scale for channel, scale in zip(channels, self.albedo_scale, strict=True)]

    # --- lights -----------------------------------------------------------------------------------------

    def _flash(self, si: Any, bsdf: Any, ctx: Any, sampler: Any, active: Any) -> Any:
        """Radiance towards the viewer from the flash alone."""
        mi, _ = kernel()
        if self.flash_disc is None:
            return mi.Spectrum(0.0)
        point, falloff = self.flash_disc.towards(si.p, sampler.next_2d())
        lit = active & (falloff > 0.0)
        shadow = si.spawn_ray_to(point)
        lit &= ~self.scene.ray_test(shadow, lit)
        value = bsdf.eval(ctx, si, si.to_local(shadow.d), lit)
        return (value * self._tabulated(self.flash_disc.intensity, si.wavelengths, lit) * falloff) & lit

    def _sun(self, si: Any, bsdf: Any, ctx: Any, sampler: Any, active: Any) -> Any:
        """Radiance towards the viewer from the sun's disc alone."""
        mi, _ = kernel()
        if self.sky is None or self.sky.sun_frame is None:
            return mi.Spectrum(0.0)
        local = mi.warp.square_to_uniform_cone(sampler.next_2d(), self.sky.sun_cosine)
        towards = self.sky.sun_frame.to_world(local)
        lit = active & ~self.scene.ray_test(si.spawn_ray(towards), active)
        value = bsdf.eval(ctx, si, si.to_local(towards), lit)
        return (value * self._tabulated(self.sky.sun_irradiance, si.wavelengths, lit)) & lit

    def _sky(self, ray: Any, active: Any, *, seen: bool) -> Any:
        """Radiance of the sky along rays that hit nothing; the sun's disc only where it is seen directly."""
        mi, dr = kernel()
        if self.sky is None:
            return mi.Spectrum(0.0)
        azimuth = dr.atan2(ray.d.y, ray.d.x) * dr.inv_two_pi
        place = mi.Point2f(azimuth - dr.floor(azimuth), dr.safe_acos(ray.d.z) * dr.inv_pi)
        weights = self.sky.weights.eval(place, active)
        radiance = mi.Spectrum(0.0)
        for weight, table in zip(weights, self.sky.radiance, strict=True):
            radiance += weight * self._tabulated(table, ray.wavelengths, active)
        if seen and self.sky.sun_frame is not None:
            inside = dr.dot(ray.d, self.sky.sun_frame.n) > self.sky.sun_cosine
            disc = self._tabulated(self.sky.sun_irradiance, ray.wavelengths, active)
            radiance += (disc / (dr.two_pi * (1.0 - self.sky.sun_cosine))) & inside
        return radiance & active


class _FlashDisc:
    """The flash as a disc across the camera's axis, each point with the same angular profile."""

    def __init__(self, flash: Flash, view: View, intensity: Any) -> None:
        mi, dr = kernel()
        angles = np.linspace(0.0, np.pi / 2.0, 512)
        self.intensity = intensity
        self.profile = mi.Float(flash.profile.at(angles))
        self.steps = 511.0 / (np.pi / 2.0)
        offset = mi.Point3f(*(float(x) for x in flash.offset_m))
        self.radius = mi.Float(float(flash.radius_m))
        dr.make_opaque(offset, self.radius)
        self.rotation = view.rotation
        self.centre = view.origin + view.rotation @ mi.Vector3f(offset)

    def towards(self, p: Any, sample: Any) -> Any:
        """A point of the disc, and its falloff (profile over squared distance, m-2) seen from `p`."""
        mi, dr = kernel()
        on_disc = self.radius * mi.warp.square_to_uniform_disk_concentric(sample)
        point = self.centre + self.rotation @ mi.Vector3f(on_disc.x, on_disc.y, 0.0)
        away = p - point
        distance = dr.norm(away)
        forward = self.rotation @ mi.Vector3f(0.0, 0.0, 1.0)
        cosine = dr.dot(away, forward) / distance
        x = dr.clip(dr.safe_acos(cosine) * self.steps, 0.0, 510.999)
        left = dr.floor(x)
        index = mi.UInt32(left)
        profile = dr.lerp(
            dr.gather(mi.Float, self.profile, index), dr.gather(mi.Float, self.profile, index + 1), x - left
        )
        return point, dr.select(cosine > 0.0, profile / (distance * distance), 0.0)

"""A wavefront of samples: camera rays, their wavelengths, and the light on what they meet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.kernel import LightScene, SkyTables
from pepperscene.render.response import STEP_NM, Response
from pepperscene.render.variant import kernel
from pepperscene.render.view import View


class FrameTables:
    """What all samples of a frame share."""

    def __init__(
        self, scene: LightScene, view: View, spectral: Response, flash: Flash | None, sky: SkyTables | None
    ) -> None:
        mi, dr = kernel()
        self.scene, self.view, self.sky = scene, view, sky
        self.first_nm = mi.Float(float(spectral.grid_nm[0]))
        self.entries = spectral.grid_nm.size
        self.wavelengths = mi.ContinuousDistribution(
            mi.ScalarVector2f(spectral.grid_nm[0], spectral.grid_nm[-1]), spectral.density.astype(np.float32)
        )
        self.electrons = [mi.Float(column) for column in spectral.electrons.T]
        reference = spectral.flash if spectral.flash.any() else np.ones(self.entries)
        white = (spectral.electrons * reference[:, None]).sum(axis=0) * STEP_NM
        self.reference = mi.Float(reference)
        self.per_white = [mi.Float(float(1.0 / channel)) for channel in white]
        self.flash: FlashMatrix | None = None
        if flash is not None and spectral.flash.any():
            self.flash = FlashMatrix(flash, view, mi.Float(spectral.flash))
        dr.make_opaque(self.first_nm, self.per_white)


class Samples:
    """A wavefront of samples: camera rays, wavelengths, and the light on them.

    Samples of a pixel lie side by side. Each carries four wavelengths; a pixel's samples share out the
    spectrum evenly, shifted by a number of the pixel's own.
    """

    def __init__(
        self, tables: FrameTables, sampler: Any, count: int, first: int, per_pass: int, seed: int
    ) -> None:
        mi, dr = kernel()
        self.tables, self.sampler = tables, sampler
        self.next_1d, self.next_2d = sampler.next_1d, sampler.next_2d
        view = tables.view
        lane = dr.arange(mi.UInt32, view.width * view.height * per_pass)
        pixel = lane // per_pass
        row = pixel // view.width
        start, towards = view.rays(pixel - row * view.width, row, sampler.next_2d(), sampler.next_2d)

        # Each sample takes a stratum of the spectrum, in turn from a start of the pixel's own: a permutation
        # drawn from the sampler is correlated with its other dimensions where samples are few (a bias of 1 %
        # in blocks of pixels was seen).
        salt, first_sample = mi.UInt32(seed & 0xFFFFFFFF), mi.UInt32(first)
        dr.make_opaque(salt, first_sample)
        turn = mi.UInt32(mi.sample_tea_float32(pixel, salt ^ 0x9E3779B9) * count)
        stratum = mi.Float((first_sample + lane - pixel * per_pass + turn) % count)
        quarter = (stratum + mi.sample_tea_float32(pixel, salt)) / count
        self.wavelengths, self.weights = mi.Spectrum(0.0), mi.Spectrum(0.0)
        for k in range(4):
            nm, density = tables.wavelengths.sample_pdf((quarter + k) / 4.0)
            self.wavelengths[k] = nm
            self.weights[k] = 0.25 / density
        self.ray = mi.Ray3f(start, towards, 0.0, self.wavelengths)

        # Spectra are looked up once: under each hit's own mask they would be fetched again and again.
        self._electrons = [self._at_wavelengths(table) for table in tables.electrons]
        self._flash_intensity = self._at_wavelengths(tables.flash.intensity) if tables.flash else None
        sky = tables.sky
        self._sky_radiance = [self._at_wavelengths(table) for table in sky.radiance] if sky else []
        has_sun = sky is not None and sky.sun_frame is not None
        self._sun_irradiance = self._at_wavelengths(sky.sun_irradiance) if sky and has_sun else None

    # --- spectra ----------------------------------------------------------------------------------------

    def _at_wavelengths(self, table: Any) -> Any:
        """A table on the response's grid, linear in between, at the samples' wavelengths."""
        mi, dr = kernel()
        found = mi.Spectrum(0.0)
        for k in range(4):
            x = dr.clip(
                (self.wavelengths[k] - self.tables.first_nm) / STEP_NM, 0.0, self.tables.entries - 1.001
            )
            left = dr.floor(x)
            index = mi.UInt32(left)
            found[k] = dr.lerp(
                dr.gather(mi.Float, table, index), dr.gather(mi.Float, table, index + 1), x - left
            )
        return found

    def channels(self, radiance: Any) -> list[Any]:
        """The sensor's sum over wavelengths for each channel, electrons s-1 m-2 sr-1."""
        _, dr = kernel()
        return [dr.sum(radiance * self.weights * electrons) for electrons in self._electrons]

    def albedo(self, albedo: Any) -> list[Any]:
        """The albedo as each channel sees it under the flash, 1 for a white body."""
        lit = self.channels(albedo * self._at_wavelengths(self.tables.reference))
        return [channel * scale for channel, scale in zip(lit, self.tables.per_white, strict=True)]

    # --- lights -----------------------------------------------------------------------------------------

    def flash(self, si: Any, point: Any, active: Any) -> Any:
        """Radiance towards the viewer from the flash alone, with shadows and without."""
        mi, _ = kernel()
        if self.tables.flash is None:
            return mi.Spectrum(0.0), mi.Spectrum(0.0)
        target, falloff = self.tables.flash.towards(si.p, self.next_2d())
        shadow = si.spawn_ray_to(target)
        reached = active & (falloff > 0.0)
        value, _ = point.eval_pdf(si.to_local(shadow.d))
        unshadowed = (value * self._flash_intensity * falloff) & reached
        lit = ~self.tables.scene.scene.ray_test(shadow, reached)
        return unshadowed & lit, unshadowed

    def sun(self, si: Any, point: Any, active: Any) -> Any:
        """Radiance towards the viewer from the sun's disc alone."""
        mi, _ = kernel()
        sky = self.tables.sky
        if sky is None or self._sun_irradiance is None:
            return mi.Spectrum(0.0)
        towards = sky.sun_frame.to_world(mi.warp.square_to_uniform_cone(self.next_2d(), sky.sun_cosine))
        lit = active & ~self.tables.scene.scene.ray_test(si.spawn_ray(towards), active)
        value, _ = point.eval_pdf(si.to_local(towards))
        return (value * self._sun_irradiance) & lit

    def sky(self, towards: Any, active: Any, *, seen: bool) -> Any:
        """Radiance of the sky from a direction; the sun's disc only where it is seen directly."""
        mi, dr = kernel()
        sky = self.tables.sky
        if sky is None:
            return mi.Spectrum(0.0)
        azimuth = dr.atan2(towards.y, towards.x) * dr.inv_two_pi
        place = mi.Point2f(azimuth - dr.floor(azimuth), dr.safe_acos(towards.z) * dr.inv_pi)
        radiance = mi.Spectrum(0.0)
        for weight, spectrum in zip(sky.weights.eval(place, active), self._sky_radiance, strict=True):
            radiance += weight * spectrum
        if seen and self._sun_irradiance is not None:
            inside = dr.dot(towards, sky.sun_frame.n) > sky.sun_cosine
            radiance += (self._sun_irradiance / (dr.two_pi * (1.0 - sky.sun_cosine))) & inside
        return radiance & active


class FlashMatrix:
    """The flash as discs across the camera's axis, each point of them with the same angular profile."""

    def __init__(self, flash: Flash, view: View, intensity: Any) -> None:
        mi, dr = kernel()
        angles = np.linspace(0.0, np.pi / 2.0, 512)
        self.intensity = intensity
        self.profile = mi.Float(flash.profile.at(angles))
        self.steps = 511.0 / (np.pi / 2.0)
        offset = mi.Point3f(*(float(x) for x in flash.offset_m))
        self.radius, self.count = mi.Float(float(flash.radius_m)), mi.Float(len(flash.emitters_m))
        self.emitters = mi.Float(_neighbours_first(flash.emitters_m).astype(np.float32).ravel())
        dr.make_opaque(offset, self.radius, self.count)
        self.rotation = view.rotation
        self.centre = view.origin + view.rotation @ mi.Vector3f(offset)

    def towards(self, p: Any, sample: Any) -> Any:
        """A point of the flash, and its falloff (profile over squared distance, m-2) seen from `p`."""
        mi, dr = kernel()
        # One coordinate takes the emitter and, in what is left of it, a place on its disc.
        turn = sample.x * self.count
        chosen = dr.minimum(dr.floor(turn), self.count - 1.0)
        emitter = dr.gather(mi.Point2f, self.emitters, mi.UInt32(chosen))
        within = mi.Point2f(dr.clip(turn - chosen, 0.0, 1.0), sample.y)
        on_disc = emitter + self.radius * mi.warp.square_to_uniform_disk_concentric(within)
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


def _neighbours_first(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places `(k, 2)` along a Z-order curve (Morton 1966): an even share of them is a compact block.

    So an even spread of samples over the list is one over the plane as well.
    """
    extent = max(float(np.ptp(places, axis=0).max()), 1e-12)
    cells = np.rint((places - places.min(axis=0)) / extent * 255.0).astype(np.int64)
    bits = np.arange(8)
    spread = ((cells[:, None, :] >> bits[:, None]) & 1) << (2 * bits[:, None] + np.arange(2))
    return places[np.argsort(spread.sum(axis=(1, 2)), kind="stable")]

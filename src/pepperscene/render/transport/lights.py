"""The lights inside the kernel: points on the flash, and the emission of all lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.arrays import channel_array, device_array, device_float, local_coordinates
from pepperscene.render.kernel.camera import CameraRays, RayPose, SpectralResponse
from pepperscene.render.kernel.scene import LightScene, SkyTables
from pepperscene.render.surface.optics import Optics
from pepperscene.render.transport.lamps import LampSampler
from pepperscene.render.variant import mitsuba_modules

_MIN_DISTANCE: Final = 1e-4
"""Local units: chosen, no emitter is smaller, and its light stays within single precision."""
_LEAST_WHITE: Final = 1e-12
"""Light of a white body in one colour over that in another. Chosen: squares of its inverse are far from where
single precision ends."""
_VISIBLE_SUN: Final = 0.02
"""Chosen: sunlight over flash light on a white body half a metre from the flash. Above, the sun's shadows are
visible and it counts as direct light, below as indirect light."""


_MOST_DIRECT: Final = 8.0
"""Chosen: of more equal lamps, the shadows are as soft as those of the sky. Their light counts as indirect
light, whose noise is filtered; each shadow ray sees one lamp, so it is as noisy as that of the sky."""


class FlashSampler:
    """The flash as discs across the camera's axis, each point of them with the same angular profile."""

    def __init__(self, flash: Flash, rays: CameraRays) -> None:
        mi, dr = mitsuba_modules()
        angles = np.linspace(0.0, np.pi / 2.0, 512)
        # `sample_point` divides the profile by squared distances in local units.
        self.profile = device_array(flash.profile.at(angles) / rays.unit_m**2)
        self.steps = 511.0 / (np.pi / 2.0)
        offset = mi.Point3f(*(float(x / rays.unit_m) for x in flash.offset_m))
        self.radius = device_float(flash.radius_m / rays.unit_m)
        self.min_square = device_float(_MIN_DISTANCE**2)
        self.count = device_float(len(flash.emitters_m))
        self.emitters = device_array(_z_order(flash.emitters_m) / rays.unit_m)
        dr.make_opaque(offset)
        self.offset = mi.Vector3f(offset)
        self.turn = None if flash.rotation is None else mi.Matrix3f(flash.rotation.astype(np.float32))
        self.centre = rays.origin + rays.rotation @ self.offset  # at time 0

    def sample_point(self, p: Any, sample: Any, pose: RayPose) -> Any:
        """A point on the flash of a camera at a pose, and its falloff seen from `p`.

        The falloff is the profile over the squared distance, m-2.
        """
        mi, dr = mitsuba_modules()
        # One coordinate selects the emitter; its remainder and the other one select a point on the disc.
        scaled = sample.x * self.count
        chosen = dr.minimum(dr.floor(scaled), self.count - 1.0)
        emitter = dr.gather(mi.Point2f, self.emitters, mi.UInt32(chosen))
        remainder = mi.Point2f(dr.clip(scaled - chosen, 0.0, 1.0), sample.y)
        on_disc = emitter + self.radius * mi.warp.square_to_uniform_disk_concentric(remainder)
        centre = self.centre if pose.motion is None else pose.centre + pose.to_world(self.offset)
        point = centre + self._to_world(pose, mi.Vector3f(on_disc.x, on_disc.y, 0.0))
        offset = p - point
        # Closer than the minimum distance, light no longer increases, and at distance 0 it is 0.
        square = dr.maximum(dr.squared_norm(offset), self.min_square)
        distance = dr.sqrt(square)
        forward = self._to_world(pose, mi.Vector3f(0.0, 0.0, 1.0))
        cosine = dr.dot(offset, forward) / distance
        position = dr.safe_acos(cosine) * self.steps
        # Written like this, the NaN of an inactive lane reads entry 0, not an address outside the table.
        x = dr.select(position > 0.0, dr.minimum(position, 510.999), 0.0)
        left = dr.floor(x)
        index = mi.UInt32(left)
        profile = dr.lerp(
            dr.gather(mi.Float, self.profile, index), dr.gather(mi.Float, self.profile, index + 1), x - left
        )
        return point, dr.select(cosine > 0.0, profile / square, 0.0)

    def _to_world(self, pose: RayPose, vector: Any) -> Any:
        """A vector in the flash's axes in world axes."""
        return pose.to_world(vector if self.turn is None else self.turn @ vector)


def _z_order(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sort positions `(k, 2)` along a Z-order curve (Morton 1966), so that any part of it is a compact block.

    Samples that are spread evenly over the list are then spread evenly over the plane.
    """
    extent = max(float(np.ptp(positions, axis=0).max()), 1e-12)
    cells = np.rint((positions - positions.min(axis=0)) / extent * 255.0).astype(np.int64)
    bits = np.arange(8)
    codes = ((cells[:, None, :] >> bits[:, None]) & 1) << (2 * bits[:, None] + np.arange(2))
    return positions[np.argsort(codes.sum(axis=(1, 2)), kind="stable")]


@dataclass(frozen=True, eq=False)
class LightSpectra:
    """Emission of the lights: by sensor channel, at the wavelengths of samples, or as tables."""

    flash: Any | None  # radiant intensity on the axis; None without a flash
    sun: Any | None  # irradiance across its beam; None without a sun
    sky: Sequence[Any]  # radiance of each of the sky's spectra
    lamps: Sequence[Any] = ()  # of 1 W of each of the lamps' spectra


@dataclass(frozen=True, eq=False)
class FrameTables:
    """Kernel data shared by all samples of a frame; `frame_tables` makes it.

    Light that meets one surface only is carried by channel: its integrals over wavelength are taken in
    advance, by the trapezoidal rule, which light carried at wavelengths follows as well.

    Attributes:
        scene, rays: geometry and spectra of the surfaces, and the camera's rays.
        flash, sky, lamps: None without a flash, sky or lamps.
        flash_optics, sun_optics: the surfaces' channel colours under the flash and the sun; None for the sun
            unless its light at first hits is direct light.
        lamp_optics: the same under each spectrum of the lamps; empty unless their light is direct light.
        colours: the lights by channel.
        first_nm: first wavelength of the spectral tables, whose entries are `STEP_NM` apart.
        last_entry: a little less than the index of their last entry.
        wavelengths: distribution that wavelengths are sampled from.
        electrons_per_joule: spectral table of each channel.
        spectra: spectral tables of the lights.
        source: spectral table of their sum, each over its mean.
        white: `(c,)` see `SampleVariance`.
        per_white: its inverse, one opaque number for each channel.
        roulette: whether paths may end, and shadow rays choose one of two lights, with a probability that
            depends on the light. Such decisions are discontinuous in the surfaces' parameters.
    """

    scene: LightScene
    rays: Any  # `CameraRays`; None for meters on surfaces
    flash: FlashSampler | None
    sky: SkyTables | None
    lamps: LampSampler | None
    flash_optics: Optics
    sun_optics: Optics | None
    lamp_optics: Sequence[Optics]
    colours: LightSpectra
    first_nm: Any
    last_entry: Any
    wavelengths: Any
    electrons_per_joule: Sequence[Any]
    spectra: LightSpectra
    source: Any
    white: NDArray[np.float64]
    per_white: Sequence[Any]
    roulette: bool = True

    @property
    def channels(self) -> int:
        """Number of sensor channels."""
        return len(self.white)

    @property
    def has_lights(self) -> bool:
        """Whether anything sends out light."""
        return self.flash is not None or self.sky is not None or self.lamps is not None


def frame_tables(
    scene: LightScene,
    rays: CameraRays | None,
    response: SpectralResponse,
    flash: Flash | None,
    sky: SkyTables | None,
    *,
    roulette: bool = True,
) -> FrameTables:
    """Transfer the data that all samples of a frame share to the device; see `FrameTables`."""
    mi, dr = mitsuba_modules()
    grid, electrons = response.grid_nm, response.electrons_per_joule
    has_flash = flash is not None and response.flash.any()
    sun = None if sky is None or sky.sun_frame is None else np.asarray(sky.sun_irradiance)

    def weights(spectrum: NDArray[np.floating]) -> NDArray[np.float64]:
        """`(n, c)` contribution of each wavelength of a light to each channel."""
        return np.asarray(electrons * (response.trapezoid_nm * spectrum)[:, None])

    def integral(spectrum: NDArray[np.floating]) -> NDArray[np.float64]:
        return weights(spectrum).sum(axis=0)

    def colour(spectrum: NDArray[np.floating]) -> Any:
        values = integral(spectrum)
        result = channel_array(len(values))(*(float(x) for x in values))
        dr.make_opaque(result)
        return result

    reference = response.flash if response.flash.any() else np.ones(grid.size)
    white = integral(reference)
    # A colour may detect none of the flash, and then has no white of its own.
    white = np.maximum(white, (_LEAST_WHITE * white.max()) or 1.0)
    # A flash of intensity I gives an irradiance of I / .25 m2 at half a metre.
    sun_is_direct = sun is not None and (
        not has_flash or integral(sun).sum() > _VISIBLE_SUN * (integral(response.flash).sum() / 0.25)
    )
    lights, lamps, lamp_optics = response.lamps, None, list[Optics]()
    if lights is not None:
        powers = np.array([(integral(spectrum) / white).sum() for spectrum in lights.spectra])
        powers = powers[lights.group] * lights.flux_W
        lamps = LampSampler(lights, powers, local_coordinates(scene.mesh))
        if lamps_are_direct(powers):
            lamp_optics = [scene.optics.by_channel(weights(spectrum)) for spectrum in lights.spectra]
    return FrameTables(
        scene=scene,
        rays=rays,
        lamps=lamps,
        lamp_optics=lamp_optics,
        flash=FlashSampler(flash, rays) if flash and rays and has_flash else None,
        sky=sky,
        flash_optics=scene.optics.by_channel(weights(reference)),
        sun_optics=scene.optics.by_channel(weights(sun)) if sun is not None and sun_is_direct else None,
        colours=LightSpectra(
            flash=colour(response.flash) if has_flash else None,
            sun=None if sun is None else colour(sun),
            sky=[] if sky is None else [colour(np.asarray(table)[: grid.size]) for table in sky.radiance],
            lamps=[] if lights is None else [colour(spectrum) for spectrum in lights.spectra],
        ),
        first_nm=device_float(grid[0]),
        last_entry=device_float(grid.size - 1.001),
        wavelengths=mi.ContinuousDistribution(
            mi.ScalarVector2f(grid[0], grid[-1]), device_array(response.density)
        ),
        electrons_per_joule=[device_array(column) for column in electrons.T],
        spectra=LightSpectra(
            flash=device_array(response.flash) if has_flash else None,
            sun=None if sky is None else sky.sun_irradiance,
            sky=() if sky is None else sky.radiance,
            lamps=() if lights is None else [device_array(spectrum) for spectrum in lights.spectra],
        ),
        source=device_array(_mean_source(response, sky)),
        white=white,
        per_white=[device_float(1.0 / value) for value in white],
        roulette=roulette,
    )


def lamps_are_direct(powers: NDArray[np.float64]) -> bool:
    """Whether lamps with some powers `(k,)` are few, so that the shadows of each are visible.

    Of k equal lamps, the square of the sum of powers over the sum of squares is k.
    """
    return bool(powers.sum() ** 2 <= _MOST_DIRECT * np.square(powers).sum())


def _mean_source(response: SpectralResponse, sky: SkyTables | None) -> NDArray[np.float64]:
    """Sum of the lights' spectra, each over its mean; above 0 at all wavelengths."""
    size = response.grid_nm.size
    lights = [response.flash]
    if response.lamps is not None:
        lights += list(response.lamps.emitted)
    if sky is not None:
        tables = [*sky.radiance] + ([] if sky.sun_frame is None else [sky.sun_irradiance])
        lights += [np.asarray(table, float)[:size] for table in tables]
    return np.sum([light / light.mean() for light in lights if light.any()] or [np.ones(size)], axis=0) + 1e-3

"""Daylight below the greenhouse's cover: a partly cloudy sky as maps of radiance, and the sun's disc.

A sky map is an image of the whole sphere in equal steps of polar angle (rows, zenith first) and azimuth
(columns, counter-clockwise from +x). It gives the weights of a few spectra, whose sum is the radiance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.scene.cover import Cover, directions, row_geometry, tabulate_haze
from pepperscene.spectra import Spectrum, illuminance, scale_to_illuminance, sky_spectrum, sun_spectrum

SUN_ANGULAR_RADIUS: Final = 0.004654
"""Radians; the solar radius of 695,700 km at one astronomical unit (IAU 2015 resolution B3)."""

_ROWS: Final = 256  # chosen: 0.7 degrees a texel, finer than clouds seen out of focus
_GROUND_ALBEDO: Final = 0.3  # chosen: white floor film, mostly in the crop's shade
_HORIZON: Final = 0.25  # chosen: sine of the elevation over which sky and floor blend; far rows hide it
_MAX_SUN_FRACTION: Final = 0.99  # the floor lights the horizon with at least the rest
_WAVES: Final = 256  # chosen: enough plane waves that their sum is Gaussian and shows no pattern
_BLOCK: Final = 1024  # chosen: points whose waves fit into a core's cache together


@dataclass(frozen=True, eq=False)
class Sun:
    """The sun's disc.

    Attributes:
        direction: `(3,)` unit vector towards it.
        irradiance: on a plane that faces it, W m-2 nm-1.
        angular_radius: radians.
    """

    direction: NDArray[np.float64]
    irradiance: Spectrum
    angular_radius: float = SUN_ANGULAR_RADIUS

    def __post_init__(self) -> None:
        if not abs(float(np.linalg.norm(self.direction)) - 1.0) < 1e-6:
            raise ValueError("the direction towards the sun must be a unit vector")
        if not (self.irradiance.values.min() >= 0 and 0 < self.angular_radius <= np.pi / 2):
            raise ValueError("the sun's irradiance must be at least 0, its radius in (0, pi/2]")


@dataclass(frozen=True, eq=False)
class Sky:
    """Radiance from all directions.

    Attributes:
        weights: `(k, rows, columns)` float32 >= 0, the weight of each spectrum by direction.
        radiance: `(k, n)` W m-2 sr-1 nm-1 at weight 1.
        sun: the sun's disc, or None.
    """

    weights: NDArray[np.float32]
    radiance: Spectrum
    sun: Sun | None = None

    def __post_init__(self) -> None:
        # Written so that nan fails too.
        if not (self.weights.min() >= 0 and self.weights.max() < np.inf and self.radiance.values.min() >= 0):
            raise ValueError("a sky's weights and radiance must be finite and at least 0")

    def horizontal_illuminance(self) -> float:
        """Lux on an unobstructed level plane, from sky and sun together."""
        rows, columns = self.weights.shape[1:]
        received = (self.weights * _projected_solid_angles(rows, columns)).sum((1, 2))
        lux = float(illuminance(Spectrum(self.radiance.wavelength_nm, received @ self.radiance.values)))
        if self.sun is not None:
            lux += max(0.0, float(self.sun.direction[2])) * float(illuminance(self.sun.irradiance))
        return lux


def _projected_solid_angles(rows: int, columns: int) -> NDArray[np.float64]:
    """`(rows, 1)` projected solid angle of a texel above the horizon, 0 below."""
    cosines, solid_angles = row_geometry(rows, columns)
    return (np.maximum(cosines, 0.0) * solid_angles)[:, None]


def uniform_sky(spectrum: Spectrum, illuminance_lx: float) -> Sky:
    """A sky with the same radiance in every direction of the sphere; any plane receives `illuminance_lx`."""
    irradiance = scale_to_illuminance(spectrum, illuminance_lx)
    radiance = Spectrum(irradiance.wavelength_nm, irradiance.values[None] / np.pi)
    return Sky(np.ones((1, 2, 4), np.float32), radiance)


def partly_cloudy_sky(
    rng: np.random.Generator,
    *,
    illuminance_lx: float,
    sun_azimuth_rad: float,
    sun_elevation_rad: float,
    sun_fraction: float,
    cloud_cover: float,
    cover: Cover | None = None,
) -> Sky:
    """A blue sky with cumulus clouds and the sun's disc, over a pale floor.

    A cover filters the light of sky and sun. A hazy cover scatters a fraction of both: it smooths the sky
    map, and light scattered out of the sun's disc forms a lobe around it, a third map with its spectrum.

    Args:
        rng: places the clouds.
        illuminance_lx: illuminance of a level plane below the cover, from sky and sun together.
        sun_azimuth_rad: counter-clockwise from +x seen from above; pi/2 is behind the crop.
        sun_elevation_rad: above the horizon; must be > 0 if `sun_fraction` is.
        sun_fraction: fraction of the illuminance from the sun, in [0, 0.99]: from its disc and, below a hazy
            cover, from the lobe around it.
        cloud_cover: fraction of the sky that clouds hide, in [0, 1].
        cover: the cover between sky and crop; None in the open.

    Raises:
        ValueError: an argument is out of range.
    """
    _check_arguments(illuminance_lx, sun_elevation_rad, sun_fraction, cloud_cover)
    level = np.cos(sun_elevation_rad)
    direction = np.array(
        [level * np.cos(sun_azimuth_rad), level * np.sin(sun_azimuth_rad), np.sin(sun_elevation_rad)]
    )
    towards = directions(_ROWS, 2 * _ROWS)
    above = np.clip(towards[..., 2] / _HORIZON + 0.5, 0.0, 1.0)
    weights = _blue_and_clouds(towards, direction, rng, cloud_cover)

    # Scatter a fraction of the light from sky and sun.
    sun_lx = illuminance_lx * sun_fraction
    scattered = cover.haze if cover is not None else 0.0
    lobe = None
    if cover is not None and scattered > 0.0:
        haze = tabulate_haze(cover.haze_width_rad, _ROWS, 2 * _ROWS, int((above[:, 0] > 0.0).sum()))
        weights += scattered * (haze.scatter(weights) - weights)
        if sun_lx > 0.0:
            lobe = above * haze.lobe(towards, direction)

    # Filter blue and clouds; from here every spectrum has 1 lux below the cover.
    lights = (sky_spectrum("d75"), sky_spectrum("d65"), sun_spectrum())
    spectra = [scale_to_illuminance(light, 1.0) for light in lights]
    if cover is not None:
        spectra = [spectrum.times(cover.transmittance) for spectrum in spectra]
    transmitted = np.array([illuminance(spectrum) for spectrum in spectra])
    spectra = [spectrum.times(1.0 / lux) for spectrum, lux in zip(spectra, transmitted, strict=True)]
    weights *= above * transmitted[:2, None, None]

    # The floor reflects part of the light that reaches it, in the clouds' white; it blends with the sky.
    projected = _projected_solid_angles(_ROWS, 2 * _ROWS)
    floor = (1.0 - above) * illuminance_lx * _GROUND_ALBEDO / np.pi
    # Scale the sky to the illuminance that floor and sun leave for it.
    weights *= (illuminance_lx - sun_lx - (floor * projected).sum()) / (weights * projected).sum()
    weights[1] += floor
    if lobe is not None:
        weights = np.concatenate([weights, lobe[None] * (scattered * sun_lx / (lobe * projected).sum())])
    sun = None
    if sun_lx > 0.0 and scattered < 1.0:
        sun = Sun(direction, spectra[2].times((1.0 - scattered) * sun_lx / np.sin(sun_elevation_rad)))

    # Put the spectra on their common nodes.
    spectra = spectra[: len(weights)]
    nm = np.unique(np.concatenate([spectrum.wavelength_nm for spectrum in spectra]))
    radiance = Spectrum(nm, np.stack([spectrum.at(nm) for spectrum in spectra]))
    return Sky(weights.astype(np.float32), radiance, sun)


def _check_arguments(
    illuminance_lx: float, sun_elevation_rad: float, sun_fraction: float, cloud_cover: float
) -> None:
    if not 0.0 <= illuminance_lx < np.inf:
        raise ValueError(f"illuminance_lx must be at least 0, not {illuminance_lx}")
    if not 0.0 <= sun_fraction <= _MAX_SUN_FRACTION:
        raise ValueError(f"sun_fraction must be in [0, {_MAX_SUN_FRACTION}], not {sun_fraction}")
    if not 0.0 <= cloud_cover <= 1.0:
        raise ValueError(f"cloud_cover must be in [0, 1], not {cloud_cover}")
    if sun_fraction > 0.0 and not 0.0 < sun_elevation_rad <= np.pi / 2.0:
        raise ValueError(f"sun_elevation_rad must be in (0, pi/2] if there is a sun, not {sun_elevation_rad}")


def _blue_and_clouds(
    towards: NDArray[np.float64], sun: NDArray[np.float64], rng: np.random.Generator, cloud_cover: float
) -> NDArray[np.float64]:
    """`(2, rows, columns)` relative luminance of the blue sky and of the clouds in front of it."""
    angle_to_sun = np.arccos(np.clip(towards @ sun, -1.0, 1.0))
    # Blue brightens towards the horizon and the sun (shape after the CIE's clear skies, numbers chosen).
    horizon = 1.0 + 1.5 * np.exp(-6.0 * np.maximum(towards[..., 2], 0.0))
    blue = horizon * (1.0 + 4.0 * np.exp(-4.0 * angle_to_sun))
    # Clouds are brighter than the blue, and brightest near the sun.
    clouds = _cloud_opacity(towards, rng, cloud_cover)
    white = 3.0 * (1.0 + 3.0 * np.exp(-3.0 * angle_to_sun)) * clouds
    return np.stack([blue * (1.0 - clouds), white])


def _cloud_opacity(
    towards: NDArray[np.float64], rng: np.random.Generator, cloud_cover: float
) -> NDArray[np.float64]:
    """Opacity in [0, 1] by direction: a thresholded Gaussian random field on a plane overhead."""
    if cloud_cover <= 0.0:
        return np.zeros(towards.shape[:2])
    # Waves of amplitude ~ 1/frequency: large heaps with frayed edges.
    frequency = np.exp(rng.uniform(np.log(1.0), np.log(24.0), _WAVES))
    heading, phase = rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
    is_sky = towards[..., 2] > -_HORIZON / 2.0
    height = towards[is_sky][:, 2:]
    plane = towards[is_sky][:, :2] / (np.maximum(height, 0.0) + 0.15)
    field = np.zeros(towards.shape[:2])
    field[is_sky] = _sum_of_waves(plane, frequency * np.stack([np.cos(heading), np.sin(heading)]), phase)
    # The threshold hides the given fraction of the solid angle above the horizon, with soft edges.
    solid_angle = (height[:, 0] > 0.0) * np.sqrt(np.maximum(0.0, 1.0 - height[:, 0] ** 2))
    order = np.argsort(-field[is_sky], kind="stable")
    hidden = np.cumsum(solid_angle[order]) / solid_angle.sum()
    threshold = field[is_sky][order][min(int(np.searchsorted(hidden, cloud_cover)), order.size - 1)]
    softness = 0.3 * field[is_sky].std()
    ramp = np.clip((field - threshold) / softness + 0.5, 0.0, 1.0)
    return np.where(is_sky, ramp * ramp * (3.0 - 2.0 * ramp), 0.0)


def _sum_of_waves(
    points: NDArray[np.float64], vectors: NDArray[np.float64], phases: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sum of plane waves of amplitude 1 / frequency at `(n, 2)` points, for `(2, w)` wave vectors.

    Single precision is twenty times as fast: arguments stay below 200, so a wave errs by 1e-5 at most.
    """
    amplitudes = (1.0 / np.linalg.norm(vectors, axis=0)).astype(np.float32)
    (x, y), (kx, ky) = points.T.astype(np.float32)[:, :, None], vectors.astype(np.float32)
    phases = phases.astype(np.float32)
    total = np.empty(len(points))
    # `einsum`, because the threads of a matrix product would cost more than they save.
    for start in range(0, len(points), _BLOCK):
        block = slice(start, start + _BLOCK)
        waves = np.cos(x[block] * kx + y[block] * ky + phases)
        total[block] = np.einsum("ij,j->i", waves, amplitudes)
    return total

"""Daylight: a partly cloudy sky as maps of radiance, and the sun's disc, seen through the greenhouse's roof.

The sky is an image of the whole sphere in equal steps of polar angle (rows, zenith first) and azimuth
(columns, counter-clockwise from +x), once for each of a few spectra whose weighted sum is the radiance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.scene.cover import Cover, directions, haze, row_geometry
from pepperscene.spectra import Spectrum, illuminance, sky_spectrum, sun_spectrum, with_illuminance

SUN_ANGULAR_RADIUS: Final = 0.004654
"""Radians; the solar radius of 695,700 km at one astronomical unit (IAU 2015 resolution B3)."""

_ROWS: Final = 256  # chosen: 0.7 degrees a texel, finer than clouds seen out of focus
_GROUND_ALBEDO: Final = 0.3  # chosen: white floor film, mostly in the crop's shade
_HORIZON: Final = 0.25  # chosen: sine of elevation over which sky and floor blend, rows far off hide it
_MOST_SUN: Final = 0.99  # the floor shines on the horizon by at least the rest
_WAVES: Final = 256  # chosen: enough plane waves that their sum is Gaussian and shows no pattern
_AT_ONCE: Final = 1024  # chosen: places whose waves fit into a core's cache together


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
        weights: `(k, rows, columns)` float32 >= 0, the share of each spectrum by direction.
        radiance: `(k, n)` W m-2 sr-1 nm-1 at weight 1.
        sun: or None.
    """

    weights: NDArray[np.float32]
    radiance: Spectrum
    sun: Sun | None = None

    def __post_init__(self) -> None:
        # So asked, what is no number fails as well.
        if not (self.weights.min() >= 0 and self.weights.max() < np.inf and self.radiance.values.min() >= 0):
            raise ValueError("a sky's weights and radiance must be finite and at least 0")

    def horizontal_illuminance(self) -> float:
        """Lux on an unobstructed level plane, sky and sun together."""
        rows, columns = self.weights.shape[1:]
        cosines, solid_angles = row_geometry(rows, columns)
        received = (self.weights * (np.maximum(cosines, 0.0) * solid_angles)[None, :, None]).sum((1, 2))
        lux = float(illuminance(Spectrum(self.radiance.wavelength_nm, received @ self.radiance.values)))
        if self.sun is not None:
            lux += max(0.0, float(self.sun.direction[2])) * float(illuminance(self.sun.irradiance))
        return lux


def uniform_sky(spectrum: Spectrum, illuminance_lx: float) -> Sky:
    """The same radiance from every direction of the whole sphere; `illuminance_lx` falls on any plane."""
    irradiance = with_illuminance(spectrum, illuminance_lx)
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
    """Blue sky with cumulus clouds and the sun's disc, over a pale floor.

    A cover filters the light of sky and sun. A hazy one spreads its share of both: it smooths the map of the
    sky, and what the sun's disc loses lies in a lobe around it, a third map in the sun's own spectrum.

    Args:
        rng: places the clouds.
        illuminance_lx: on a level plane below the cover, from sky and sun together.
        sun_azimuth_rad: counter-clockwise from +x seen from above; pi/2 is behind the crop.
        sun_elevation_rad: above the horizon, > 0 where `sun_fraction` is.
        sun_fraction: share of the illuminance that is the sun's, in [0, 0.99]; from the disc and, below a
            hazy cover, from the lobe around it.
        cloud_cover: share of the sky that clouds hide, in [0, 1].
        cover: between the sky and the crop; None in the open.

    Raises:
        ValueError: an argument lies outside its range.
    """
    _check(illuminance_lx, sun_elevation_rad, sun_fraction, cloud_cover)
    direction = np.array(
        [
            np.cos(sun_elevation_rad) * np.cos(sun_azimuth_rad),
            np.cos(sun_elevation_rad) * np.sin(sun_azimuth_rad),
            np.sin(sun_elevation_rad),
        ]
    )
    towards = directions(_ROWS, 2 * _ROWS)
    above = np.clip(towards[..., 2] / _HORIZON + 0.5, 0.0, 1.0)
    weights = _blue_and_clouds(towards, direction, rng, cloud_cover)

    # The cover spreads its share of the light from the sky, and of the sun's.
    sun_lx = illuminance_lx * sun_fraction
    spread = cover.haze if cover is not None else 0.0
    lobe = None
    if cover is not None and spread > 0.0:
        scattering = haze(cover.haze_width_rad, _ROWS, 2 * _ROWS, int((above[:, 0] > 0.0).sum()))
        weights += spread * (scattering.spread(weights) - weights)
        if sun_lx > 0.0:
            lobe = above * scattering.lobe(towards, direction)

    # It filters blue and clouds, each as it is; from here every spectrum stands for 1 lux below the cover.
    spectra = [
        with_illuminance(kind, 1.0) for kind in (sky_spectrum("d75"), sky_spectrum("d65"), sun_spectrum())
    ]
    if cover is not None:
        spectra = [cover.through(spectrum) for spectrum in spectra]
    passed = np.array([illuminance(spectrum) for spectrum in spectra])
    spectra = [spectrum.times(1.0 / lux) for spectrum, lux in zip(spectra, passed, strict=True)]
    weights *= above * passed[:2, None, None]

    # The floor sends back a part of all that falls on it, in the clouds' white; haze hides where it ends.
    cosines, solid_angles = row_geometry(_ROWS, 2 * _ROWS)
    level = (np.maximum(cosines, 0.0) * solid_angles)[:, None]
    floor = (1.0 - above) * illuminance_lx * _GROUND_ALBEDO / np.pi
    # All to scale: what is wanted on a level plane, less what floor and sun send there.
    weights *= (illuminance_lx - sun_lx - (floor * level).sum()) / (weights * level).sum()
    weights[1] += floor
    if lobe is not None:
        weights = np.concatenate([weights, lobe[None] * (spread * sun_lx / (lobe * level).sum())])
    sun = None
    if sun_lx > 0.0 and spread < 1.0:
        sun = Sun(direction, spectra[2].times((1.0 - spread) * sun_lx / np.sin(sun_elevation_rad)))
    return Sky(weights.astype(np.float32), _side_by_side(spectra[: len(weights)]), sun)


def _blue_and_clouds(
    towards: NDArray[np.float64], sun: NDArray[np.float64], rng: np.random.Generator, cloud_cover: float
) -> NDArray[np.float64]:
    """`(2, rows, columns)` relative luminance of blue sky and of the clouds before it."""
    angle_to_sun = np.arccos(np.clip(towards @ sun, -1.0, 1.0))
    # Blue sky brightens to the horizon and round the sun (shape after the CIE's clear skies, numbers chosen).
    horizon = 1.0 + 1.5 * np.exp(-6.0 * np.maximum(towards[..., 2], 0.0))
    blue = horizon * (1.0 + 4.0 * np.exp(-4.0 * angle_to_sun))
    # Clouds lie on a plane overhead, are brighter than the blue and shine near the sun.
    clouds = _cloud_density(towards, rng, cloud_cover)
    white = 3.0 * (1.0 + 3.0 * np.exp(-3.0 * angle_to_sun)) * clouds
    return np.stack([blue * (1.0 - clouds), white])


def _side_by_side(spectra: list[Spectrum]) -> Spectrum:
    """`(k, n)` values on the nodes of all `k` spectra."""
    grid = np.unique(np.concatenate([spectrum.wavelength_nm for spectrum in spectra]))
    return Spectrum(grid, np.stack([spectrum.at(grid) for spectrum in spectra]))


def _check(illuminance_lx: float, sun_elevation_rad: float, sun_fraction: float, cloud_cover: float) -> None:
    """Refuse what no sky can be."""
    if not 0.0 <= illuminance_lx < np.inf:
        raise ValueError(f"illuminance_lx must be at least 0, not {illuminance_lx}")
    if not 0.0 <= sun_fraction <= _MOST_SUN:
        raise ValueError(f"sun_fraction must lie in [0, {_MOST_SUN}], not {sun_fraction}")
    if not 0.0 <= cloud_cover <= 1.0:
        raise ValueError(f"cloud_cover must lie in [0, 1], not {cloud_cover}")
    if sun_fraction > 0.0 and not 0.0 < sun_elevation_rad <= np.pi / 2.0:
        raise ValueError(
            f"sun_elevation_rad must lie in (0, pi/2] where there is a sun, not {sun_elevation_rad}"
        )


def _sum_of_waves(
    places: NDArray[np.float64], vectors: NDArray[np.float64], phases: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sum of plane waves of amplitude 1 / frequency at `(n, 2)` places, for `(2, w)` wave vectors.

    In single precision, twenty times as fast: phases stay below 200, so that a wave errs by 1e-5 at most.
    """
    amplitudes = (1.0 / np.linalg.norm(vectors, axis=0)).astype(np.float32)
    (x, y), turns = places.T.astype(np.float32)[:, :, None], vectors.astype(np.float32)
    starts = phases.astype(np.float32)
    found = np.empty(len(places))
    # Plain sums: the threads of a matrix product would cost more than they save.
    for first in range(0, len(places), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        waves = np.cos(x[part] * turns[0] + y[part] * turns[1] + starts)
        found[part] = np.einsum("ij,j->i", waves, amplitudes)
    return found


def _cloud_density(
    towards: NDArray[np.float64], rng: np.random.Generator, cloud_cover: float
) -> NDArray[np.float64]:
    """Cover in [0, 1] by direction: a thresholded Gaussian random field on a plane overhead."""
    if cloud_cover <= 0.0:
        return np.zeros(towards.shape[:2])
    # Waves of amplitude ~ 1/frequency: large heaps with frayed rims.
    frequency = np.exp(rng.uniform(np.log(1.0), np.log(24.0), _WAVES))
    heading, phase = rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
    above = towards[..., 2] > -_HORIZON / 2.0
    counted = towards[above][:, 2] > 0.0
    plane = towards[above][:, :2] / (np.maximum(towards[above][:, 2:], 0.0) + 0.15)
    field = np.zeros(towards.shape[:2])
    field[above] = _sum_of_waves(plane, frequency * np.stack([np.cos(heading), np.sin(heading)]), phase)
    # The threshold that hides the share asked for, weighted by solid angle, with a soft rim.
    share = counted * np.sqrt(np.maximum(0.0, 1.0 - towards[above][:, 2] ** 2))
    order = np.argsort(-field[above], kind="stable")
    hidden = np.cumsum(share[order]) / share.sum()
    threshold = field[above][order][min(int(np.searchsorted(hidden, cloud_cover)), order.size - 1)]
    rim = 0.3 * field[above].std()
    ramp = np.clip((field - threshold) / rim + 0.5, 0.0, 1.0)
    return np.where(above, ramp * ramp * (3.0 - 2.0 * ramp), 0.0)

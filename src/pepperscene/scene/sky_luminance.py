"""Luminance and colour of blue sky and of clouds by direction.

The pattern of luminance is that of standard skies (ISO 15469:2004, CIE S 011/E:2003), its level that of the
IES (Lighting Handbook, daylight availability), and the colour of the blue follows from its luminance.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.spectra import D65_K, daylight_mixture

_STANDARD_SKIES: Final = {
    "overcast": (4.0, -0.70, 0.0, -1.0, 0.0),  # type 1: overcast, steep gradation
    "partly cloudy": (0.0, -1.0, 5.0, -2.5, 0.30),  # type 7: no gradation, brighter around the sun
    "clear": (-1.0, -0.32, 10.0, -3.0, 0.45),  # type 12: clear, low turbidity
}
"""Parameters a to e of ISO 15469:2004: a, b of the gradation, c to e of the indicatrix."""

_DIFFUSE_KLX: Final = {
    "overcast": (0.3, 21.0, 1.0),
    "partly cloudy": (0.3, 45.0, 1.0),
    "clear": (0.8, 15.5, 0.5),
}
"""A, B, C of the sky's illuminance of a level plane, A + B sin^C(elevation of the sun), klx (IES)."""

LOWEST_SKY: Final = 0.125
"""Chosen: sine of the angle below the horizon down to which the sky blends with the floor."""

_WAVES: Final = 256  # chosen: enough plane waves that their sum is Gaussian and shows no pattern
_BLOCK: Final = 1024  # chosen: points whose waves fit into a core's cache together

Floats = NDArray[np.float64]


def standard_sky(kind: str, towards: Floats, sun: Floats) -> Floats:
    """Relative luminance of a standard sky, `(...)`, in directions `(..., 3)`; that of the horizon below it.

    `kind` is a key of the standard's skies here: "overcast", "partly cloudy" or "clear".
    """
    a, b, c, d, e = _STANDARD_SKIES[kind]
    cosine = np.clip(towards @ sun, -1.0, 1.0)
    angle_to_sun = np.arccos(cosine)
    indicatrix = 1.0 + c * (np.exp(d * angle_to_sun) - np.exp(d * np.pi / 2.0)) + e * cosine**2
    gradation = 1.0 + a * np.exp(b / np.maximum(towards[..., 2], 1e-6))
    return np.asarray(gradation * indicatrix)


def diffuse_lux(kind: str, sun_elevation_rad: float) -> float:
    """Illuminance of a level plane by a sky without the sun's disc (IES)."""
    a, b, c = _DIFFUSE_KLX[kind]
    return float(1e3 * (a + b * max(np.sin(sun_elevation_rad), 0.0) ** c))


def clear_sky_temperature(luminance: Floats) -> Floats:
    """Correlated colour temperature of a clear sky by its luminance, cd/m2.

    Measured in Lyon (Chain, Dumortier & Fontoynont 1999, Solar Energy 65:285): the blue is darkest about 90
    degrees from the sun, and pale where aerosols or a long path through the air add light.
    """
    mired = -132.1 + 59.77 * np.log10(np.maximum(luminance, 1.0))
    return np.asarray(1e6 / np.maximum(mired, 1.0))


def partly_cloudy_weights(
    towards: Floats,
    projected: Floats,
    sun_direction: Floats,
    rng: np.random.Generator,
    cloud_cover: float,
) -> Floats:
    """`(3, rows, columns)` luminance in each spectrum of `daylight_basis`, cd/m2, of blue sky and clouds.

    Args:
        towards: `(rows, columns, 3)` directions.
        projected: `(rows, 1)` their projected solid angles, 0 below the horizon.
        sun_direction: `(3,)` unit vector.
        rng: places the clouds.
        cloud_cover: fraction of the sky that clouds hide.
    """
    elevation = float(np.arcsin(np.clip(sun_direction[2], -1.0, 1.0)))

    def sky(kind: str, lux: float) -> Floats:
        pattern = standard_sky(kind, towards, sun_direction)
        return np.asarray(pattern * (lux / (pattern * projected).sum()))

    clear_lux, partly_lux, overcast_lux = (
        diffuse_lux(kind, elevation) for kind in ("clear", "partly cloudy", "overcast")
    )
    blue = sky("clear", clear_lux)
    # The standard's skies are averages over clouds and gaps. Single clouds are as bright as makes a sky
    # whose half they hide "partly cloudy"; near the horizon they are never darker than an overcast sky.
    broken_lux = max(4.0 * partly_lux - 2.0 * clear_lux - overcast_lux, overcast_lux)
    clouds = (1.0 - cloud_cover) * sky("partly cloudy", broken_lux) + cloud_cover * sky(
        "overcast", overcast_lux
    )
    opacity = cloud_opacity(towards, rng, cloud_cover)
    mixture = daylight_mixture(clear_sky_temperature(blue))
    return np.asarray(
        mixture * (blue * (1.0 - opacity)) + daylight_mixture(D65_K)[:, None, None] * (clouds * opacity)
    )


def cloud_opacity(
    towards: NDArray[np.float64], rng: np.random.Generator, cloud_cover: float
) -> NDArray[np.float64]:
    """Opacity in [0, 1] by direction: a thresholded Gaussian random field on a plane overhead."""
    if cloud_cover <= 0.0:
        return np.zeros(towards.shape[:2])
    # Waves of amplitude ~ 1/frequency: large heaps with frayed edges.
    frequency = np.exp(rng.uniform(np.log(1.0), np.log(24.0), _WAVES))
    heading, phase = rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
    is_sky = towards[..., 2] > -LOWEST_SKY
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

"""How a hazy sheet overhead spreads light: reciprocal, and what comes in goes out.

Light from one direction of the upper half of the sphere leaves as radiance over all of it,

    f(out, in) = a(out) a(in) exp((cos angle(out, in) - 1) / width^2)

per unit of irradiance on the sheet, which is level. The exponential is the normal distribution on a sphere
(von Mises and Fisher); the factors `a`, functions of the height alone, are those for which the integral of
f(out, in) cos(out) over the upper half is 1 for every `in`. So no light is lost, and since f is symmetric
(Helmholtz), a sky that is the same everywhere stays so.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

_BALANCED: Final = 1e-12  # chosen: rounding of doubles, well below that of the float32 sky
_TURNS: Final = 1000  # chosen: ten times what the narrowest lobe takes


def directions(rows: int, columns: int) -> NDArray[np.float64]:
    """`(rows, columns, 3)` unit directions through the centres of a map of the whole sphere."""
    polar = (np.arange(rows) + 0.5) / rows * np.pi
    azimuth = (np.arange(columns) + 0.5) / columns * 2.0 * np.pi
    flat = np.sin(polar)[:, None]
    up = np.broadcast_to(np.cos(polar)[:, None], (rows, columns))
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=-1)


def row_geometry(rows: int, columns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean cosine to the zenith and solid angle of a texel, by row; both exact for the row's band."""
    edges = np.arange(rows + 1) / rows * np.pi
    top, bottom = np.cos(edges[:-1]), np.cos(edges[1:])
    return (top + bottom) / 2.0, (top - bottom) * 2.0 * np.pi / columns


@dataclass(frozen=True, eq=False)
class Haze:
    """The scattering tabulated for maps of `rows` by `columns`.

    Attributes:
        width_rad: of the lobe.
        columns: of the maps.
        waves: `(out rows, in rows, m)` real, the exponential as a Fourier series in the azimuth between.
        balance: `(out rows,)` the factors `a`; rows below the horizon continue them and receive no light.
        level: `(in rows,)` projected solid angle of a texel.
    """

    width_rad: float
    columns: int
    waves: NDArray[np.float64]
    balance: NDArray[np.float64]
    level: NDArray[np.float64]

    def spread(self, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Maps `(k, rows, columns)` of radiance below the sheet for those above it; 0 beyond `out rows`."""
        lowest, upper = self.waves.shape[:2]
        entering = radiance[:, :upper] * (self.balance[:upper] * self.level)[:, None]
        series = np.fft.rfft(entering, axis=-1)[..., : self.waves.shape[-1]]
        leaving = np.einsum("ijm,kjm->kim", self.waves, series) * self.balance[:, None]
        below = np.zeros_like(radiance)
        # What rounding leaves where all is dark must not be negative.
        below[:, :lowest] = np.maximum(np.fft.irfft(leaving, self.columns, axis=-1), 0.0)
        return below

    def lobe(self, towards: NDArray[np.float64], source: NDArray[np.float64]) -> NDArray[np.float64]:
        """Such a map of a beam from `source` `(3,)`, up to a factor; `towards` are the map's directions."""
        lowest = self.balance.size
        below = np.zeros(towards.shape[:2])
        facing = towards[:lowest] @ source
        below[:lowest] = self.balance[:, None] * np.exp((facing - 1.0) / self.width_rad**2)
        return below


@lru_cache(maxsize=4)
def haze(width_rad: float, rows: int, columns: int, lowest: int) -> Haze:
    """The scattering of a lobe of this width.

    Args:
        width_rad: standard deviation of the scattered light's direction along each of two axes, where small.
        rows: of the maps of the whole sphere, even.
        columns: of the maps.
        lowest: the last row that is wanted below the sheet, at least the horizon's.
    """
    upper = rows // 2
    cosines, solid_angles = row_geometry(rows, columns)
    level = (cosines * solid_angles)[:upper]
    polar = (np.arange(lowest) + 0.5) / rows * np.pi
    turn = np.arange(columns) / columns * 2.0 * np.pi
    waves = np.empty((lowest, upper, columns // 2 + 1))
    for row, angle in enumerate(polar):
        across = np.sin(angle) * np.sin(polar[:upper, None]) * np.cos(turn)
        facing = across + np.cos(angle) * np.cos(polar[:upper, None])
        # Even in the azimuth, so that its series is real.
        waves[row] = np.fft.rfft(np.exp((facing - 1.0) / width_rad**2)).real
    # A smooth lobe needs few waves; what is left out is below rounding.
    strongest = np.abs(waves).max(axis=(0, 1))
    waves = np.ascontiguousarray(waves[..., : int(np.flatnonzero(strongest > 1e-13 * strongest[0])[-1]) + 1])
    return Haze(width_rad, columns, waves, _balance(waves[..., 0], level), level)


def _balance(mean: NDArray[np.float64], level: NDArray[np.float64]) -> NDArray[np.float64]:
    """The factors `a` by row: Sinkhorn's iteration, its steps halved so that rows and columns share factors.

    Args:
        mean: `(out rows, in rows)` the exponential summed over the azimuth.
        level: `(in rows,)` projected solid angle of a texel.
    """
    upper = level.size
    factors = np.ones(upper)
    for _ in range(_TURNS):
        wanted = 1.0 / (mean[:upper] @ (factors * level))
        if np.abs(wanted / factors - 1.0).max() < _BALANCED:
            break
        factors = np.sqrt(factors * wanted)
    return np.asarray(1.0 / (mean @ (factors * level)))

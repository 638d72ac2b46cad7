"""CIE daylight of any correlated colour temperature, as a mixture of three fixed spectra.

CIE 015:2018 gives the spectrum of daylight as S0 + M1 S1 + M2 S2, where M1 and M2 follow from its
chromaticity on the daylight locus. S1 and S2 have negative values, so a light cannot be a sum of them. All
daylight from `WARMEST_K` to `BLUEST_K` is a mixture of three spectra without negative values: those of both
ends of the locus, and that whose chromaticity is where the locus' tangents at the ends meet. The locus is a
parabola, which is inside this triangle.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.spectra.files import read_spectra
from pepperscene.spectra.lights import (
    astm_g173,
    continue_spectrum,
    diffuse_spectrum,
    illuminance,
    scale_to_illuminance,
)
from pepperscene.spectra.spectrum import FloatArray, Spectrum

WARMEST_K: Final = 5000.0
"""Chosen: below all skies of this program. With the 4,000 K to which CIE 015:2018 defines daylight, one of
the three spectra would have negative values."""
BLUEST_K: Final = 25_000.0
"""The highest temperature for which CIE 015:2018 defines daylight."""
D65_K: Final = 6503.6
"""Colour temperature of D65: its nominal 6500 K times 1.4388 / 1.4380 (CIE 015:2018)."""


def daylight_chromaticity(temperature_k: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """CIE 1931 x and y of daylight of a correlated colour temperature, clipped to 5,000 to 25,000 K."""
    t = 1e3 / np.clip(np.asarray(temperature_k, dtype=float), WARMEST_K, BLUEST_K)
    warm = 0.244063 + 0.09911 * t + 2.9678 * t**2 - 4.6070 * t**3
    blue = 0.237040 + 0.24748 * t + 1.9018 * t**2 - 2.0064 * t**3
    x = np.where(t >= 1.0 / 7.0, warm, blue)
    return x, _locus(x)


@lru_cache(maxsize=1)
def daylight_basis() -> Spectrum:
    """The three spectra, `(3, n)` W m-2 nm-1 from 300 to 1100 nm, each of 1 lux.

    Beyond 830 nm, where the CIE's tables end, they are continued as those of `sky_spectrum`: a MODEL.
    """
    components = read_spectra("light/cie_daylight_components")
    s0, s1, s2 = (components[name] for name in ("s0", "s1", "s2"))
    spectra = []
    for (m1, m2), shape in zip(
        _corners(), (diffuse_spectrum(), *[astm_g173("global_tilt_W_m2_nm")] * 2), strict=True
    ):
        table = Spectrum(s0.wavelength_nm, s0.values + m1 * s1.values + m2 * s2.values)
        spectra.append(scale_to_illuminance(continue_spectrum(table, shape), 1.0))
    return Spectrum(spectra[0].wavelength_nm, np.stack([spectrum.values for spectrum in spectra]))


def daylight_mixture(temperature_k: ArrayLike) -> FloatArray:
    """Lux of each spectrum of `daylight_basis` in 1 lux of daylight of a temperature, `(3, ...)`.

    Temperatures are clipped to `WARMEST_K` and `BLUEST_K`.
    """
    m1, m2 = _factors(*daylight_chromaticity(temperature_k))
    corners = np.vstack([_corners().T, np.ones(3)])
    shares = np.tensordot(np.linalg.inv(corners), np.stack([m1, m2, np.ones_like(m1)]), 1)
    # On the locus' ends two of the shares are 0, and rounding must not make them negative.
    lux = np.maximum(shares, 0.0) * _corner_lux().reshape(3, *[1] * m1.ndim)
    return np.asarray(lux / lux.sum(axis=0))


def _locus(x: FloatArray) -> FloatArray:
    return np.asarray(-3.0 * x**2 + 2.870 * x - 0.275)


def _factors(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """M1 and M2 of CIE 015:2018."""
    divisor = 0.0241 + 0.2562 * x - 0.7341 * y
    m1 = (-1.3515 - 1.7703 * x + 5.9114 * y) / divisor
    return m1, (0.0300 - 31.4424 * x + 30.0717 * y) / divisor


@lru_cache(maxsize=1)
def _corners() -> FloatArray:
    """`(3, 2)` M1 and M2 of the blue end, of the tangents' intersection, and of the warm end."""
    ends, _ = daylight_chromaticity([BLUEST_K, WARMEST_K])
    # The tangents of a parabola at two points meet half-way between them.
    x = np.array([ends[0], ends.mean(), ends[1]])
    y = _locus(x)
    y[1] = y[0] + (-6.0 * x[0] + 2.870) * (x[1] - x[0])
    return np.stack(_factors(x, y), axis=1)


@lru_cache(maxsize=1)
def _corner_lux() -> FloatArray:
    """`(3,)` illuminance of S0 + M1 S1 + M2 S2 of the corners."""
    components = read_spectra("light/cie_daylight_components")
    s0, s1, s2 = (illuminance(components[name]) for name in ("s0", "s1", "s2"))
    m1, m2 = _corners().T
    return np.asarray(s0 + m1 * s1 + m2 * s2)

"""Spectral power distributions (SPDs) of daylight, illuminance, and photon numbers.

CIE 015:2018 gives the spectrum of daylight as S0 + M1 S1 + M2 S2, where M1 and M2 follow from its
chromaticity on the daylight locus. S1 and S2 have negative values, so a light cannot be a sum of them. All
daylight from `WARMEST_K` to `BLUEST_K` is a mixture of three spectra without negative values: those of both
ends of the locus, and that whose chromaticity is where the locus' tangents at the ends meet. The locus is a
parabola, which is inside this triangle.
"""

from __future__ import annotations

import warnings
from functools import cache, lru_cache
from types import ModuleType
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.errors import InputError
from pepperscene.spectra.files import read_spectra, read_spectrum
from pepperscene.spectra.spectrum import FloatArray, Spectrum

LUMINOUS_EFFICACY: Final = 683.002  # lm W-1, maximum for photopic vision (CIE 018:2019)
_PLANCK: Final = 6.62607015e-34  # J s, exact in the SI of 2019
_LIGHT_SPEED: Final = 299_792_458.0  # m s-1 in vacuum, exact
_AVOGADRO: Final = 6.02214076e23  # mol-1, exact in the SI of 2019
ANCHOR_NM: Final = 560.0  # relative spectra have the value 1 here, as in CIE tables
SkyKind = Literal["d50", "d55", "d65", "d75"]
WARMEST_K: Final = 5000.0
"""Chosen: below all skies of this program. With the 4,000 K to which CIE 015:2018 defines daylight, one of
the three spectra would have negative values."""
BLUEST_K: Final = 25_000.0
"""The highest temperature for which CIE 015:2018 defines daylight."""
D65_K: Final = 6503.6
"""Colour temperature of D65: its nominal 6500 K times 1.4388 / 1.4380 (CIE 015:2018)."""


@cache
def colour_science() -> ModuleType:
    """Import and return the package `colour`.

    It warns if matplotlib is missing, which only its plots need. The warning is suppressed here.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", '"Matplotlib" related API features are not available')
        import colour
    return colour


def photons_per_joule(wavelength_nm: ArrayLike) -> FloatArray:
    """Photons per joule of light at each wavelength: lambda / (h c)."""
    return np.asarray(wavelength_nm, dtype=float) * 1e-9 / (_PLANCK * _LIGHT_SPEED)


def umol_per_joule(wavelength_nm: ArrayLike) -> FloatArray:
    """Micromoles of photons per joule of light at each wavelength."""
    return photons_per_joule(wavelength_nm) / _AVOGADRO * 1e6


@lru_cache(maxsize=1)
def photopic_efficiency() -> Spectrum:
    """CIE 1924 photopic luminous efficiency V(lambda), 360 to 830 nm."""
    # A copy of the table in colour-science: importing colour-science would add a second to every first frame.
    return read_spectrum("light/cie_1924_photopic", "v")


def illuminance(irradiance: Spectrum) -> float:
    """Illuminance, lux, of a spectral irradiance in W m-2 nm-1: 683.002 times its integral with V(lambda).

    The integral is exact for the two piecewise linear functions, over the range of the irradiance.
    """
    return LUMINOUS_EFFICACY * float(irradiance.integral(photopic_efficiency()))


def scale_to_illuminance(relative: Spectrum, lux: float) -> Spectrum:
    """Scale a relative SPD to a spectral irradiance, W m-2 nm-1, of the illuminance `lux`.

    Raises:
        ValueError: the spectrum has no visible light, or `lux` is negative.
    """
    current = illuminance(relative)
    if not (current > 0 and lux >= 0):
        raise ValueError(f"cannot scale a spectrum of {current:g} lx to {lux:g} lx")
    return relative.times(lux / current)


def sun_spectrum(elevation_rad: float | None = None) -> Spectrum:
    """Direct sunlight at the ground, relative, 300 to 1100 nm.

    At the elevation of air mass 1.5, 41.8 degrees, it is ASTM G173-03 direct normal; None for this one. The
    attenuation of each wavelength by that standard's atmosphere changes with the air mass m to the power of
    m / 1.5 (Beer's law). Bands of water and oxygen saturate, so that they are too deep for a low sun.

    Args:
        elevation_rad: of the sun above the horizon, at least 0.
    """
    direct = astm_g173("direct_W_m2_nm")
    if elevation_rad is None:
        return _normalise(direct)
    extraterrestrial = astm_g173("extraterrestrial_W_m2_nm")
    transmittance = direct.values / extraterrestrial.values
    values = extraterrestrial.values * transmittance ** (air_mass(elevation_rad) / 1.5)
    return _normalise(Spectrum(direct.wavelength_nm, values))


def air_mass(elevation_rad: float) -> float:
    """Length of the path through the atmosphere over that from the zenith (Kasten & Young 1989)."""
    degrees = float(np.degrees(elevation_rad))
    return float(1.0 / (np.sin(elevation_rad) + 0.50572 * (degrees + 6.07995) ** -1.6364))


@lru_cache(maxsize=4)
def sky_spectrum(kind: SkyKind = "d65") -> Spectrum:
    """Daylight of the sky, relative: a CIE D illuminant, 300 to 1100 nm.

    D55 and D65 represent sunlit and overcast daylight, D75 that of the northern sky (CIE 015:2018). The
    tables end at 830 nm. The continuation for cameras that are sensitive in the near infrared is a MODEL: the
    shape of ASTM G173-03 (for D75 of its diffuse, for the others of its global irradiance), scaled to the
    energy of the table's last 50 nm.

    Raises:
        InputError: `kind` is not one of d50, d55, d65, d75.
    """
    if kind not in get_args(SkyKind):
        raise InputError("sky_spectrum", "must be d50, d55, d65 or d75", key="kind", value=kind)
    table = read_spectrum("light/cie_daylight_300_830", kind)
    shape = diffuse_spectrum() if kind == "d75" else astm_g173("global_tilt_W_m2_nm")
    return _normalise(continue_spectrum(table, shape))


def continue_spectrum(table: Spectrum, shape: Spectrum) -> Spectrum:
    """Continue a spectrum in the shape of another, scaled to the energy of the table's last 50 nm."""
    last = table.wavelength_nm[-1]
    # Match energies, not single values: the shape resolves absorption lines that the table smooths.
    overlap = np.arange(last - 50.0, last + 0.5)
    scale = np.trapezoid(table.at(overlap), overlap) / np.trapezoid(shape.at(overlap), overlap)
    is_beyond = shape.wavelength_nm > last
    nm = np.append(table.wavelength_nm, shape.wavelength_nm[is_beyond])
    return Spectrum(nm, np.append(table.values, scale * shape.values[is_beyond]))


def diffuse_spectrum() -> Spectrum:
    """Diffuse irradiance of ASTM G173-03's tilted plane, W m-2 nm-1, 300 to 1100 nm.

    A clear sky with some light reflected by the ground: global irradiance minus direct normal irradiance
    times the cosine between the beam and the plane's normal.
    """
    total, direct = astm_g173("global_tilt_W_m2_nm"), astm_g173("direct_W_m2_nm")
    # At air mass 1.5 the sun is 48.2 degrees from the zenith; the plane is tilted by 37 degrees towards it.
    cosine = float(np.cos(np.arccos(1.0 / 1.5) - np.radians(37.0)))
    return Spectrum(total.wavelength_nm, total.values - cosine * direct.values)


@lru_cache(maxsize=3)
def astm_g173(column: str) -> Spectrum:
    """A column of ASTM G173-03, W m-2 nm-1, 300 to 1100 nm."""
    return read_spectrum("light/astm_g173_300_1100", column)


def _normalise(spd: Spectrum) -> Spectrum:
    return spd.times(1.0 / float(spd.at(ANCHOR_NM)[0]))


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

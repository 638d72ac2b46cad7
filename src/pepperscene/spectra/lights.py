"""Spectral power distributions of lights, and how bright they look."""

from __future__ import annotations

from functools import lru_cache
from typing import Final, Literal

import numpy as np

from pepperscene.errors import InputError
from pepperscene.spectra.files import read_spectra, read_spectrum
from pepperscene.spectra.spectrum import Spectrum

LUMINOUS_EFFICACY: Final = 683.002
"""Maximum luminous efficacy of radiation for photopic vision, lm W-1 (CIE 018:2019)."""

ANCHOR_NM: Final = 560.0
"""Relative spectra have the value 1 here, as CIE tables do."""

ASTM_INCIDENCE_COSINE: Final = float(np.cos(np.arccos(1.0 / 1.5) - np.radians(37.0)))
"""ASTM G173-03: air mass 1.5 puts the sun 48.2 degrees from the zenith, in front of a plane tilted by 37."""

SkyKind = Literal["d50", "d55", "d65", "d75"]
LED_FILES: Final = (
    "light/houser2013_cool_white_led",
    "light/nist_phosphor_led_colour_science",
    "light/cie_illuminants_colour_science",
)


@lru_cache(maxsize=1)
def photopic_efficiency() -> Spectrum:
    """CIE 1924 photopic luminous efficiency V(lambda), 360 to 830 nm."""
    # A copy of the table in colour-science, whose import takes a second of every first frame.
    return read_spectrum("light/cie_1924_photopic", "v")


def illuminance(irradiance: Spectrum) -> float:
    """Lux of a spectral irradiance in W m-2 nm-1: 683.002 times its integral against V(lambda).

    The integral is exact for the two piecewise linear functions, over the range of the irradiance.
    """
    return LUMINOUS_EFFICACY * float(irradiance.integral(photopic_efficiency()))


def with_illuminance(relative: Spectrum, lux: float) -> Spectrum:
    """The spectral irradiance, W m-2 nm-1, of this relative SPD that gives `lux`.

    Raises:
        ValueError: the spectrum holds no visible light, or `lux` is negative.
    """
    seen = illuminance(relative)
    if not (seen > 0 and lux >= 0):
        raise ValueError(f"cannot scale a spectrum of {seen:g} lx to {lux:g} lx")
    return relative.times(lux / seen)


def sun_spectrum() -> Spectrum:
    """Direct sunlight at the ground, relative: ASTM G173-03 direct normal (air mass 1.5), 300 to 1100 nm."""
    return _anchored(_astm("direct_W_m2_nm"))


def diffuse_spectrum() -> Spectrum:
    """What ASTM G173-03's plane receives beside the direct beam, W m-2 nm-1, 300 to 1100 nm.

    A clear sky, with a little light from the ground: the global less the direct irradiance times the cosine
    between the beam and the plane's normal.
    """
    total, direct = _astm("global_tilt_W_m2_nm"), _astm("direct_W_m2_nm")
    return Spectrum(total.wavelength_nm, total.values - ASTM_INCIDENCE_COSINE * direct.values)


def sky_spectrum(kind: SkyKind = "d65") -> Spectrum:
    """Daylight of a sky, relative: a CIE D illuminant, 300 to 1100 nm.

    D55 and D65 suit sunlit and overcast daylight, D75 that of the northern sky (CIE 015:2018). The tables end
    at 830 nm; what follows is a MODEL for cameras that see the near infrared: the shape of ASTM G173-03, for
    D75 of its diffuse and for the others of its global light, scaled to the energy of the table's last 50 nm.

    Raises:
        InputError: `kind` is not one of d50, d55, d65, d75.
    """
    if kind not in ("d50", "d55", "d65", "d75"):
        raise InputError("sky_spectrum", "must be d50, d55, d65 or d75", key="kind", value=kind)
    return _sky(kind)


@lru_cache(maxsize=4)
def _sky(kind: SkyKind) -> Spectrum:
    table = read_spectrum("light/cie_daylight_300_830", kind)
    shape = diffuse_spectrum() if kind == "d75" else _astm("global_tilt_W_m2_nm")
    last = table.wavelength_nm[-1]
    # Both meet in energy: single wavelengths lie in lines that the table smooths and the shape resolves.
    shared = np.arange(last - 50.0, last + 0.5)
    scale = np.trapezoid(table.at(shared), shared) / np.trapezoid(shape.at(shared), shared)
    beyond = shape.wavelength_nm > last
    return _anchored(
        Spectrum(
            np.append(table.wavelength_nm, shape.wavelength_nm[beyond]),
            np.append(table.values, scale * shape.values[beyond]),
        )
    )


@lru_cache(maxsize=2)
def _astm(column: str) -> Spectrum:
    return read_spectrum("light/astm_g173_300_1100", column)


def led_spectrum(name: str = "lumileds_cool_white") -> Spectrum:
    """A white LED, relative, 380 to 780 nm.

    Args:
        name: a column of one of `LED_FILES`, or its end after an underscore; the default is the cool white
            Lumileds of 5763 K in Houser et al. 2013 (doi 10.1364/OE.21.010393).

    Raises:
        InputError: no shipped LED has this name, or more than one; the message lists them.
    """
    leds = _leds()
    found = [key for key in leds if key == name] or [key for key in leds if key.endswith(f"_{name}")]
    if len(found) != 1:
        raise InputError("led_spectrum", f"must be one of {', '.join(leds)}", key="name", value=name)
    return leds[found[0]]


@lru_cache(maxsize=1)
def _leds() -> dict[str, Spectrum]:
    columns = {name: spd for file in LED_FILES for name, spd in read_spectra(file).items()}
    illuminants = ("d50", "d55", "d65", "d75", "a", "e")
    return {name: _anchored(spd) for name, spd in columns.items() if name not in illuminants}


def _anchored(spd: Spectrum) -> Spectrum:
    return spd.times(1.0 / float(spd.at(ANCHOR_NM)[0]))

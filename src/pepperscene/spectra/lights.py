"""Spectral power distributions of lights, and how bright they look."""

from __future__ import annotations

from functools import lru_cache
from typing import Final, Literal

import numpy as np

from pepperscene.errors import InputError
from pepperscene.spectra.colorimetry import colour_science
from pepperscene.spectra.reading import read_spectra, read_spectrum
from pepperscene.spectra.spectrum import Spectrum

LUMINOUS_EFFICACY: Final = 683.002
"""Maximum luminous efficacy of radiation for photopic vision, lm W-1 (CIE 018:2019)."""

ANCHOR_NM: Final = 560.0
"""Relative spectra have the value 1 here, as CIE tables do."""

SkyKind = Literal["d50", "d55", "d65", "d75"]
LED_FILES: Final = (
    "light/houser2013_cool_white_led",
    "light/nist_phosphor_led_colour_science",
    "light/cie_illuminants_colour_science",
)


@lru_cache(maxsize=1)
def photopic_efficiency() -> Spectrum:
    """CIE 1924 photopic luminous efficiency V(lambda), 360 to 830 nm, from colour-science."""
    table = colour_science().colorimetry.SDS_LEFS_PHOTOPIC["CIE 1924 Photopic Standard Observer"]
    return Spectrum(np.array(table.wavelengths), np.array(table.values))


def illuminance(irradiance: Spectrum) -> float:
    """Lux of a spectral irradiance in W m-2 nm-1: 683.002 times its integral against V(lambda)."""
    efficiency = photopic_efficiency()
    # The product of two piecewise linear functions is sampled on the nodes of both.
    nm = np.union1d(irradiance.wavelength_nm, efficiency.wavelength_nm)
    return LUMINOUS_EFFICACY * float(np.trapezoid(irradiance.at(nm) * efficiency.at(nm), nm))


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
    return _anchored(read_spectrum("light/astm_g173_300_1100", "direct_W_m2_nm"))


def sky_spectrum(kind: SkyKind = "d65") -> Spectrum:
    """Daylight of a sky, relative: a CIE D illuminant, 380 to 780 nm.

    D55 and D65 suit sunlit and overcast daylight, D75 that of the northern sky (CIE 015:2018).

    Raises:
        InputError: `kind` is not one of d50, d55, d65, d75.
    """
    if kind not in ("d50", "d55", "d65", "d75"):
        raise InputError("sky_spectrum", "kind", kind, "must be d50, d55, d65 or d75")
    return _anchored(read_spectrum("light/cie_illuminants_colour_science", kind))


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
        raise InputError("led_spectrum", "name", name, f"must be one of {', '.join(leds)}")
    return leds[found[0]]


@lru_cache(maxsize=1)
def _leds() -> dict[str, Spectrum]:
    columns = {name: spd for file in LED_FILES for name, spd in read_spectra(file).items()}
    illuminants = ("d50", "d55", "d65", "d75", "a", "e")
    return {name: _anchored(spd) for name, spd in columns.items() if name not in illuminants}


def _anchored(spd: Spectrum) -> Spectrum:
    return spd.times(1.0 / float(spd.at(ANCHOR_NM)[0]))

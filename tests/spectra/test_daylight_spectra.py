"""Daylight of any colour temperature is that of CIE 015:2018; low suns follow Beer's law."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from pepperscene.spectra import (
    D65_K,
    daylight_basis,
    daylight_mixture,
    illuminance,
    read_spectra,
    sun_spectrum,
)
from pepperscene.spectra.lights import air_mass
from pepperscene.spectra.spectrum import Spectrum

NM = np.arange(300.0, 831.0, 5.0)


@pytest.mark.parametrize("kelvin", [5001.0, D65_K, 7001.0, 9000.0, 14_000.0, 24_999.0])
def test_mixture_is_the_cie_spectrum(kelvin):
    basis = daylight_basis()
    mixed = Spectrum(basis.wavelength_nm, daylight_mixture(kelvin) @ basis.values)
    xy = colour.temperature.CCT_to_xy_CIE_D(kelvin)
    shape = colour.SpectralShape(300, 830, 5)
    cie = colour.sd_CIE_illuminant_D_series(xy, M1_M2_rounding=False, shape=shape)
    np.testing.assert_allclose(mixed.at(NM) / mixed.at(560.0) * 100, cie.values, atol=0.02)


def test_basis_and_shares_are_never_negative():
    basis = daylight_basis()
    assert basis.values.min() >= 0.0
    assert [illuminance(Spectrum(basis.wavelength_nm, row)) for row in basis.values] == pytest.approx(
        [1.0] * 3
    )
    shares = daylight_mixture(np.geomspace(1000.0, 1e6, 200))
    assert shares.min() >= 0.0
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-12)
    # Temperatures beyond the range are clipped to its ends, which are corners of the triangle.
    np.testing.assert_allclose(shares[:, [-1, 0]], [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]], atol=1e-9)


def test_sunlight_at_air_mass_1_5_is_the_standard():
    # An error of 0.001 in the air mass is one of 0.5 % at 300 nm.
    np.testing.assert_allclose(
        sun_spectrum(np.radians(41.78)).at(NM), sun_spectrum().at(NM), rtol=6e-3, atol=1e-9
    )


def test_attenuation_of_sunlight_grows_with_the_air_mass():
    # Beer's law: logarithms of the transmittances at two elevations are in the ratio of the air masses.
    above = read_spectra("light/astm_g173_300_1100")["extraterrestrial_W_m2_nm"]
    optical_depth = {}
    for degrees in (8.0, 60.0):
        logarithm = np.log(sun_spectrum(np.radians(degrees)).at(NM) / above.at(NM))
        optical_depth[degrees] = logarithm - logarithm[NM == 560]  # the spectra are relative
    ratio = air_mass(np.radians(8.0)) / air_mass(np.radians(60.0))
    np.testing.assert_allclose(optical_depth[8.0], ratio * optical_depth[60.0], rtol=1e-6, atol=1e-9)
    # Rayleigh scattering reddens a low sun: blue falls faster than red.
    assert np.interp([450, 650], NM, optical_depth[8.0])[0] < np.interp([450, 650], NM, optical_depth[8.0])[1]


@pytest.mark.parametrize(("degrees", "expected"), [(90.0, 1.0), (30.0, 1.994), (10.0, 5.58), (0.0, 38.0)])
def test_air_mass_is_that_of_kasten_and_young(degrees, expected):
    # Kasten & Young 1989, table II.
    assert air_mass(np.radians(degrees)) == pytest.approx(expected, rel=5e-3)

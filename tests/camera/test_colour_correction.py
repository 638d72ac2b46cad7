"""Colorimetry against colour-science, and colour corrections under ordinary and extreme lights."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import colour
import numpy as np
import pytest
from camera_colours import chart_delta_e

from pepperscene.camera import load_filter, load_flash, load_sensor
from pepperscene.camera.image.colorimetry import (
    D65_WHITE,
    SRGB_TO_XYZ,
    XYZ_TO_SRGB,
    bradford_adaptation,
    cie_1931_observer,
    d65_spectrum,
    srgb_decode,
    srgb_encode,
    xyz_to_lab,
)
from pepperscene.camera.image.colour_correction import colour_correction, white_balance_gains
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, photopic_efficiency, read_spectra

SENSOR = load_sensor("ueye_ui5250re")


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_srgb_curve_matches_colour_science_and_keeps_the_type(dtype):
    linear = np.linspace(0, 1, 5000, dtype=dtype)
    encoded = srgb_encode(linear)
    assert encoded.dtype == srgb_decode(encoded).dtype == dtype
    exact = np.linspace(0, 1, 5000)
    np.testing.assert_allclose(encoded, colour.cctf_encoding(exact, function="sRGB"), atol=2e-7)
    rounding = 4 * np.finfo(dtype).eps
    np.testing.assert_allclose(srgb_decode(encoded), linear, rtol=rounding, atol=rounding)


def test_srgb_matrices_and_white_match_colour_science():
    space = colour.RGB_COLOURSPACES["sRGB"]
    np.testing.assert_array_equal(XYZ_TO_SRGB, space.matrix_XYZ_to_RGB)
    np.testing.assert_array_equal(SRGB_TO_XYZ, space.matrix_RGB_to_XYZ)
    np.testing.assert_allclose(colour.xy_to_XYZ(space.whitepoint), D65_WHITE, rtol=1e-12)


def test_observer_matches_colour_science_and_v_lambda():
    observer, table = cie_1931_observer(), colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    np.testing.assert_array_equal(observer.wavelength_nm, table.wavelengths)
    np.testing.assert_array_equal(observer.values, table.values.T)
    # CIE 1931 defined y as V(lambda), which has been tabulated with more digits since.
    v = photopic_efficiency()
    np.testing.assert_allclose(observer.at(v.wavelength_nm)[1], v.values, rtol=0, atol=2e-4)


def test_lab_matches_colour_science_and_is_continuous():
    xyz = np.random.default_rng(0).random((1000, 3)) ** 4 * 1.2
    expected = colour.XYZ_to_Lab(xyz, colour.RGB_COLOURSPACES["sRGB"].whitepoint)
    np.testing.assert_allclose(xyz_to_lab(xyz), expected, rtol=1e-9, atol=1e-9)
    assert xyz_to_lab(D65_WHITE) == pytest.approx([100.0, 0.0, 0.0], abs=1e-12)
    assert xyz_to_lab(np.zeros(3)) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    knee = (6 / 29) ** 3
    below, above = (xyz_to_lab(D65_WHITE * knee * factor) for factor in (1 - 1e-9, 1 + 1e-9))
    np.testing.assert_allclose(below, above, atol=1e-6)


@pytest.mark.parametrize("white", [[1.09850, 1.0, 0.35585], D65_WHITE])
def test_adaptation_matches_colour_science_and_maps_white_to_d65(white):
    adaptation = bradford_adaptation(white)
    expected = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        np.array(white), D65_WHITE, transform="Bradford"
    )
    np.testing.assert_allclose(adaptation, expected, rtol=1e-12, atol=1e-14)
    assert adaptation @ white == pytest.approx(D65_WHITE, rel=1e-12)


def narrow_band(nm, width=10.0):
    at = nm + width * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    return Spectrum(at, np.array([0.0, 0.5, 1.0, 0.5, 0.0]))


@pytest.fixture(scope="module")
def infrared_sensor():
    """The MT9V024 without its filter: all colours see infrared."""
    curves = read_spectra("sensors/spectra/onsemi_mt9v024_rgb_qe.csv")
    efficiency = Spectrum(curves["r"].wavelength_nm, np.stack([curves[c].values for c in "rgb"]))
    return replace(SENSOR, quantum_efficiency=efficiency)


def test_corrections_keep_white_and_differ_between_flash_and_daylight():
    flash = colour_correction(SENSOR, load_flash("led_matrix_200klx").spectrum)
    daylight = colour_correction(SENSOR, d65_spectrum())
    for correction in (flash, daylight):
        np.testing.assert_allclose(correction.matrix.sum(axis=1), 1)
        assert min(correction.gains) == 1
    # A phosphor LED has no violet and a gap around 480 nm, so blue needs more gain than in daylight.
    assert flash.gains[2] > daylight.gains[2] * 1.05


def test_infrared_light_can_be_balanced_but_not_corrected(infrared_sensor):
    light = narrow_band(950.0)
    gains = white_balance_gains(infrared_sensor, light)
    assert np.all(np.isfinite(gains))
    assert gains.min() == 1
    with pytest.raises(InputError, match="needs a visible reference light"):
        colour_correction(infrared_sensor, light)
    for correct in (colour_correction, white_balance_gains):
        with pytest.raises(InputError, match="must see the reference light"):
            correct(SENSOR, narrow_band(1050))
    with pytest.raises(InputError, match="of more colours"):
        colour_correction(SENSOR, narrow_band(600, 3))


def test_infrared_cut_improves_the_colours(infrared_sensor):
    cut = load_filter("schott_22022010").transmittance
    filtered = chart_delta_e(infrared_sensor.with_filter(cut), d65_spectrum())
    assert filtered < 2.5 < chart_delta_e(infrared_sensor, d65_spectrum())


@pytest.mark.long
def test_illuminance_and_correction_do_not_import_colour_science():
    code = (
        "import sys; from pepperscene.camera import load_sensor\n"
        "from pepperscene.spectra import illuminance, sun_spectrum; illuminance(sun_spectrum())\n"
        "from pepperscene.camera.image.colorimetry import d65_spectrum\n"
        "from pepperscene.camera.image.colour_correction import colour_correction\n"
        "colour_correction(load_sensor('ueye_ui5250re'), d65_spectrum())\n"
        "assert 'colour' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)

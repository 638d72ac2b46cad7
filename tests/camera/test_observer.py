"""The formulas of colour against colour-science, and against what must hold of them."""

import subprocess
import sys

import numpy as np
import pytest

from pepperscene.camera.colorimetry import (
    D65_WHITE,
    SRGB_TO_XYZ,
    XYZ_TO_SRGB,
    bradford_adaptation,
    cie_1931_observer,
    xyz_to_lab,
)
from pepperscene.spectra import colour_science, photopic_efficiency


def test_the_observer_is_the_table_of_colour_science():
    table = colour_science().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    assert np.array_equal(cie_1931_observer().wavelength_nm, table.wavelengths)
    assert np.array_equal(cie_1931_observer().values, table.values.T)


def test_the_observer_sees_brightness_as_v_lambda_does():
    # CIE 1931 defined y so; V(lambda) has been tabulated with more digits since.
    v = photopic_efficiency()
    assert np.allclose(cie_1931_observer().at(v.wavelength_nm)[1], v.values, atol=2e-4)


def test_lab_is_that_of_colour_science():
    colour = colour_science()
    xyz = np.random.default_rng(0).random((1000, 3)) ** 4 * 1.2
    expected = colour.XYZ_to_Lab(xyz, colour.RGB_COLOURSPACES["sRGB"].whitepoint)
    assert np.allclose(xyz_to_lab(xyz), expected, rtol=1e-9, atol=1e-9)


def test_lab_of_white_and_black_and_no_jump_at_the_knee():
    assert xyz_to_lab(D65_WHITE) == pytest.approx([100.0, 0.0, 0.0], abs=1e-12)
    assert xyz_to_lab(np.zeros(3)) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    knee = (6 / 29) ** 3
    below, above = (xyz_to_lab(D65_WHITE * knee * factor) for factor in (1 - 1e-9, 1 + 1e-9))
    assert np.allclose(below, above, atol=1e-6)


def test_adaptation_is_that_of_colour_science_and_brings_white_to_white():
    colour = colour_science()
    for white in ([1.09850, 1.0, 0.35585], [0.96422, 1.0, 0.82521], D65_WHITE):
        expected = colour.adaptation.matrix_chromatic_adaptation_VonKries(
            np.array(white), D65_WHITE, transform="Bradford"
        )
        assert np.allclose(bradford_adaptation(white), expected, rtol=1e-12, atol=1e-14)
        assert bradford_adaptation(white) @ white == pytest.approx(D65_WHITE, rel=1e-12)
    assert np.allclose(bradford_adaptation(D65_WHITE), np.eye(3), atol=1e-14)


def test_srgb_is_that_of_colour_science():
    space = colour_science().RGB_COLOURSPACES["sRGB"]
    assert np.array_equal(XYZ_TO_SRGB, space.matrix_XYZ_to_RGB)
    assert np.array_equal(SRGB_TO_XYZ, space.matrix_RGB_to_XYZ)
    assert np.allclose(colour_science().xy_to_XYZ(space.whitepoint), D65_WHITE, rtol=1e-12)


def test_correcting_colours_needs_no_slow_import():
    ask = (
        "import sys; from pepperscene.camera import load_sensor\n"
        "from pepperscene.camera.colorimetry import correction, daylight\n"
        "found = correction(load_sensor('ueye_ui5250re'), daylight())\n"
        "assert 'colour' not in sys.modules\n"
        "assert 0 < found.mean_delta_e_2000 < 10 and 'colour' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", ask], check=True)

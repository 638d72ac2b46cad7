"""Colours of a chart that the colour matrix was not fitted to, through the complete camera."""

from __future__ import annotations

import dataclasses

import colour
import numpy as np
import pytest

from pepperscene.camera import Camera, Developing, develop, load_flash, load_lens, load_sensor
from pepperscene.camera.colorimetry import d65_spectrum
from pepperscene.shipped import shipped_folder

NM = np.arange(380.0, 781.0)
D65 = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]


def chart():
    """`(24, n)` BabelColor's average of 30 ColorCheckers, from colour-science; the fit uses ISO 17321-1."""
    patches = colour.SDS_COLOURCHECKERS["BabelColor Average"].values()
    return np.stack([np.interp(NM, patch.wavelengths, patch.values) for patch in patches])


def observer_lab(light):
    """`(24, 3)` Lab under `light`, adapted to D65 by CIECAT02 (the camera uses Bradford)."""
    observer = (
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
        .copy()
        .align(colour.SpectralShape(380, 780, 1))
    )
    weight = light.at(NM)[:, None] * observer.values
    white = weight.sum(0)
    xyz = chart() @ weight / white[1]
    d65 = colour.xy_to_XYZ(D65)
    xyz = colour.chromatic_adaptation(xyz, white / white[1], d65, method="Von Kries", transform="CAT02")
    return colour.XYZ_to_Lab(xyz, D65)


PATCH = 16  # pixels; demosaicing mixes colours only at the borders of patches
SENSORS = [
    name
    for name in sorted(path.stem for path in (shipped_folder("materials") / "sensors").glob("*.toml"))
    if load_sensor(name).channels == 3
]


def photographed_lab(sensor, light, flash, white_balance):
    """`(24, 3)` Lab of the developed 8-bit image of the chart, white at a full well."""
    weight = light.at(NM) * sensor.electrons_per_joule(NM)
    electrons = chart() @ weight.T / weight.sum(axis=1).max() * sensor.full_well_e
    electrons = electrons.reshape(4, 6, 3).repeat(PATCH, axis=0).repeat(PATCH, axis=1)
    small = dataclasses.replace(sensor, columns=6 * PATCH, rows=4 * PATCH)
    developing = Developing(white_balance=white_balance)
    camera = Camera(load_lens("lensagon_cmfa0420nd"), small, flash=flash, developing=developing)
    codes = develop(electrons, camera)[PATCH // 2 :: PATCH, PATCH // 2 :: PATCH].reshape(24, 3)
    rgb = colour.cctf_decoding(codes / 255, function="sRGB")
    xyz = colour.RGB_to_XYZ(rgb, "sRGB", apply_cctf_decoding=False)
    return colour.XYZ_to_Lab(xyz, D65)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("white_balance", ["flash", "daylight"])
def test_chart_colours_are_reproduced(sensor, white_balance):
    flash = load_flash("led_matrix_200klx")
    light = flash.spectrum if white_balance == "flash" else d65_spectrum()
    found = photographed_lab(load_sensor(sensor), light, flash, white_balance)
    difference = colour.delta_E(observer_lab(light), found, method="CIE 2000")
    assert difference.mean() < 3.0
    assert difference.max() < 8.0
    # Greys are close; the worst is the white patch, dark below 420 nm where these sensors still see.
    assert difference[18:].max() < 4.0


@pytest.mark.parametrize("white_balance", ["flash", "daylight"])
def test_demosaiced_chart_has_the_colours_of_a_binned_one(white_balance):
    flash = load_flash("led_matrix_200klx")
    light = flash.spectrum if white_balance == "flash" else d65_spectrum()
    quads, sites = (
        photographed_lab(load_sensor(name), light, flash, white_balance)
        for name in ("ueye_ui5250re", "ueye_ui5250re_full")
    )
    # Both are uniform inside a patch, so only rounding to single precision may change an 8-bit code.
    assert colour.delta_E(quads, sites, method="CIE 2000").max() < 0.5

"""Colours of a chart that the colour matrix was not fitted to, through the complete camera."""

from __future__ import annotations

import dataclasses

import colour
import pytest
from colour_chart import NM, chart, difference, lab_of_rgb, observer_lab

from pepperscene.camera import Camera, Developing, develop, load_flash, load_lens, load_sensor
from pepperscene.camera.image.colorimetry import d65_spectrum
from pepperscene.shipped import shipped_folder

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
    return lab_of_rgb(colour.cctf_decoding(codes / 255, function="sRGB"))


def flash_and_light(white_balance):
    flash = load_flash("led_matrix_200klx")
    return flash, flash.spectrum if white_balance == "flash" else d65_spectrum()


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("white_balance", ["flash", "daylight"])
def test_chart_colours_are_reproduced(sensor, white_balance):
    flash, light = flash_and_light(white_balance)
    lab = photographed_lab(load_sensor(sensor), light, flash, white_balance)
    error = difference(observer_lab(light.at(NM)), lab)
    assert error.mean() < 3.0
    assert error.max() < 8.0
    # Greys are close; the worst is the white patch, dark below 420 nm where these sensors still respond.
    assert error[18:].max() < 4.0


@pytest.mark.parametrize("white_balance", ["flash", "daylight"])
def test_demosaiced_chart_has_the_colours_of_a_binned_one(white_balance):
    flash, light = flash_and_light(white_balance)
    binned, demosaiced = (
        photographed_lab(load_sensor(name), light, flash, white_balance)
        for name in ("ueye_ui5250re", "ueye_ui5250re_full")
    )
    # Both are uniform inside a patch, so only rounding to single precision may change an 8-bit code.
    assert difference(binned, demosaiced).max() < 0.5

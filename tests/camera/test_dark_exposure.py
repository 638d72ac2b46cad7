"""Automatic exposure of dark images: stray light, pedestal and noise are part of the grey that is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.camera import (
    Camera,
    Developing,
    ExposureControl,
    camera_rgb,
    choose_exposure,
    develop,
    image_electrons,
    load_flash,
    load_lens,
    load_sensor,
    with_exposure,
)
from pepperscene.spectra import Spectrum

LENS, FLASH = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
SENSOR = replace(load_sensor("ueye_ui5250re"), columns=160, rows=120)
FULL_WELL_PER_S = SENSOR.full_well_e / (
    SENSOR.pitch_m**2 * np.pi / (4 * LENS.f_number**2) * LENS.transmittance
)


def mono(sensor):
    curves = sensor.quantum_efficiency
    return replace(
        sensor, pattern="mono", quantum_efficiency=Spectrum(curves.wavelength_nm, curves.values[1:2])
    )


SENSORS = {
    "binned": SENSOR,
    "monochrome": mono(SENSOR),
    "a photosite per pixel": replace(SENSOR, binning=1),
    "areas": load_sensor("ueye_ui5250re_full").with_size(160, 112),
    "8 bits": SENSOR.with_settings(bits=8),
    "gain": SENSOR.with_settings(gain=4.0),
    "rolling shutter": replace(SENSOR, line_time_s=1e-6),
}


def plant(camera, level):
    """Light of a bright disc in front of black, in full wells per second; its middle has the level."""
    rows, columns = np.mgrid[: camera.height, : camera.width]
    disc = np.hypot(rows - camera.height / 2, columns - camera.width / 2) < 0.2 * camera.width
    light = np.zeros((camera.height, camera.width, camera.sensor.channels))
    light[disc] = level * FULL_WELL_PER_S
    return light


def stated_and_developed(camera, daylight, flash, control):
    chosen = choose_exposure(camera, daylight, flash, control)
    used = with_exposure(camera, chosen)
    share = used.shutter.flash_fraction(FLASH.pulse_s)[:, None, None]
    signal = daylight + flash * used.flash_duty * share
    image = develop(image_electrons(signal.astype(np.float32), used), used, np.random.default_rng(2))
    return chosen, image.mean()


@pytest.mark.parametrize("pedestal", [0.0, "auto"])
@pytest.mark.parametrize("name", SENSORS)
def test_stated_grey_of_a_plant_before_black_is_the_image_s(name, pedestal):
    developing = Developing(stray_light=True, pedestal=pedestal, white_balance="daylight")
    camera = Camera(LENS, SENSORS[name], flash=FLASH, developing=developing)
    dim, flash = plant(camera, 0.05), plant(camera, 300.0)
    chosen, grey = stated_and_developed(camera, dim, flash, ExposureControl(target_grey=30.0))
    assert abs(chosen.grey - grey) <= 1.5
    assert chosen.limited_by is not None or abs(grey - 30.0) <= 1.5


@pytest.mark.parametrize("target", [30.0, 60.0, 110.0])
@pytest.mark.parametrize("stray_light", [False, True])
def test_stated_grey_of_a_dark_row_is_the_image_s(target, stray_light):
    developing = Developing(stray_light=stray_light, white_balance="daylight")
    camera = Camera(LENS, SENSOR, developing=developing)
    light = np.random.default_rng(3).uniform(0.0, 1.5, (120, 160, 3)) * FULL_WELL_PER_S
    control = ExposureControl(target_grey=target, most_gain=8.0)
    chosen, grey = stated_and_developed(camera, light, 0.0 * light, control)
    assert abs(chosen.grey - grey) <= 1.5


def test_stray_light_brightens_what_is_stated():
    greys = {}
    for stray_light in (False, True):
        developing = Developing(stray_light=stray_light, white_balance="daylight", shot_noise=False)
        camera = Camera(LENS, SENSOR, developing=replace(developing, read_noise=False, quantise=False))
        light = plant(camera, 1e4)  # overexposed
        control = ExposureControl(longest_s=1e-3, most_gain=1.0)
        greys[stray_light] = choose_exposure(camera, light, 0.0 * light, control).grey
    assert greys[True] > greys[False] + 20.0


def test_signal_of_bands_is_stated_with_its_noise():
    camera = Camera(LENS, replace(SENSOR, pattern="bands", binning=1, black_level_dn=0.0))
    control = ExposureControl(target_grey=200.0, longest_s=1e-4, most_gain=8.0)
    light = plant(camera, 1.0)
    chosen = choose_exposure(camera, light, 0.0 * light, control)
    used = with_exposure(camera, chosen)
    measured = camera_rgb(image_electrons(light.astype(np.float32), used), used, np.random.default_rng(2))
    assert chosen.limited_by == "longest exposure and gain"
    assert chosen.grey == pytest.approx(255.0 * measured.mean(), rel=0.02)


def test_little_light_above_the_noise_of_black_is_not_called_saturation():
    camera = Camera(LENS, SENSOR, developing=Developing(white_balance="daylight"))
    light = plant(camera, 1e-3)
    chosen = choose_exposure(camera, light, 0.0 * light, ExposureControl())
    assert chosen.limited_by == "longest exposure and gain"
    dark = choose_exposure(camera, 0.0 * light, 0.0 * light, ExposureControl())
    assert dark.limited_by == "no light"
    assert 0.0 < dark.grey <= chosen.grey


def test_noise_alone_brighter_than_the_target_is_limited():
    camera = Camera(LENS, SENSOR, developing=Developing(white_balance="daylight", pedestal=0.02))
    light = plant(camera, 1.0)
    chosen, grey = stated_and_developed(camera, light, 0.0 * light, ExposureControl(target_grey=10.0))
    assert chosen.limited_by == "shortest exposure"
    assert abs(chosen.grey - grey) <= 1.5

"""Automatic exposure: closed forms for uniform light, limits of exposure and gain, noise of dark images."""

from __future__ import annotations

from dataclasses import replace

import colour
import numpy as np
import pytest

from pepperscene.camera import (
    Camera,
    Developing,
    ExposureControl,
    camera_rgb,
    choose_exposure,
    decode_tone,
    develop,
    expected_electrons,
    image_electrons,
    load_flash,
    load_lens,
    load_sensor,
    metering_camera,
    with_exposure,
)
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum

LENS, FLASH = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
SENSOR = replace(load_sensor("ueye_ui5250re"), columns=160, rows=120)
# Noise brightens dark images; without it, uniform light has closed forms.
PLAIN = Developing(
    falloff=False, white_balance=None, colour_matrix=False, shot_noise=False, read_noise=False, quantise=False
)
CAMERA = Camera(LENS, SENSOR, developing=PLAIN)
SMALL = metering_camera(CAMERA)
NONE = np.zeros((SMALL.height, SMALL.width, 3))
FULL_WELL_PER_S = SENSOR.full_well_e / (
    SENSOR.pitch_m**2 * np.pi / (4 * LENS.f_number**2) * LENS.transmittance
)
"""The signal that fills a photosite of `CAMERA` in a second, by the camera equation."""


def grey_card(full_wells_per_s, shape=NONE.shape):
    return np.full(shape, full_wells_per_s * FULL_WELL_PER_S)


def linear_value(grey):
    return float(colour.cctf_decoding(grey / 255, function="sRGB"))


@pytest.mark.parametrize("exposure_s", [1e-5, 0.1])
def test_exposure_of_a_grey_card_is_the_analytic_one(exposure_s):
    linear = replace(CAMERA, developing=replace(PLAIN, tone="linear"))
    # Whatever the camera's own exposure.
    for camera, target, value in (
        (CAMERA, 40.0, linear_value(40.0)), (CAMERA, 200.0, linear_value(200.0)), (linear, 51.0, 0.2)
    ):  # fmt: skip
        camera = replace(camera, exposure_s=exposure_s)
        chosen = choose_exposure(camera, grey_card(100.0), NONE, ExposureControl(target_grey=target))
        # Of a full well per 10 ms, the linear value is the fraction of 10 ms.
        assert chosen.exposure_s == pytest.approx(value / 100.0, rel=5e-3)
        assert chosen.grey == pytest.approx(target, rel=1.1e-3)
        assert (chosen.gain, chosen.limited_by) == (1.0, None)


def mono(sensor):
    curves = sensor.quantum_efficiency
    green = Spectrum(curves.wavelength_nm, curves.values[1:2])
    return replace(sensor, pattern="mono", quantum_efficiency=green)


@pytest.mark.parametrize("sensor", [replace(SENSOR, binning=1), mono(SENSOR), replace(SENSOR, binning=4)])
def test_predicted_grey_is_that_of_the_full_image(sensor):
    # A gradient with the lens' fall-off; photosites of every binning, demosaiced or not.
    sensor = replace(sensor, columns=640, rows=480, pitch_m=9e-6 / sensor.binning)
    camera = Camera(LENS, sensor, developing=Developing(white_balance="daylight"))
    slope = np.linspace(20.0, 300.0, 640) * FULL_WELL_PER_S * (4.5e-6 / sensor.pitch_m) ** 2
    full = np.broadcast_to(slope[None, :, None], (480, 640, sensor.channels))
    light = full.reshape(240, 2, 320, 2, -1).mean(axis=(1, 3))
    chosen = choose_exposure(camera, light, np.zeros_like(light), ExposureControl())
    used = with_exposure(camera, chosen)
    assert chosen.limited_by is None
    assert develop(expected_electrons(full, used), used).mean() == pytest.approx(110.0, rel=5e-3)


def test_detail_that_the_reduced_image_lacks_is_accounted_for():
    # Rectangles of all sizes in front of each other, as leaves are, with edges inside most reduced pixels.
    rng = np.random.default_rng(4)
    full = np.full((600, 800), 5.0)
    for _ in range(3000):
        row, column = rng.integers(0, (600, 800))
        height, width = rng.integers(8, 80, 2)
        full[row : row + height, column : column + width] = rng.choice([2.0, 20.0, 100.0, 600.0])
    full = np.repeat(full[..., None] * FULL_WELL_PER_S, 3, axis=-1)
    light = full.reshape(120, 5, 160, 5, 3).mean(axis=(1, 3))
    camera = replace(CAMERA, sensor=replace(SENSOR, columns=800, rows=600))
    for target in (60.0, 160.0):
        control = ExposureControl(target_grey=target)
        used = with_exposure(camera, choose_exposure(camera, light, np.zeros_like(light), control))
        assert develop(expected_electrons(full, used), used).mean() == pytest.approx(target, rel=0.02)
        without = replace(metering_camera(camera, (160, 120)), exposure_s=used.exposure_s)
        area = (camera.sensor.pitch_m / without.sensor.pitch_m) ** 2
        assert develop(area * expected_electrons(light, without), without).mean() > 1.03 * target


def test_gain_is_raised_only_at_the_longest_exposure():
    control = ExposureControl(longest_s=1e-3, most_gain=8.0)
    bright = choose_exposure(CAMERA, grey_card(1.001 * linear_value(110.0) / 1e-3), NONE, control)
    assert (bright.gain, bright.limited_by) == (1.0, None)
    dim = choose_exposure(CAMERA, grey_card(linear_value(110.0) / 1e-3 / 5.0), NONE, control)
    assert (dim.exposure_s, dim.limited_by) == (1e-3, None)
    assert dim.gain == pytest.approx(5.0, rel=5e-3)
    used = with_exposure(CAMERA, dim)
    assert used.sensor.gain == dim.gain
    assert used.sensor.gain_e_per_dn == pytest.approx(SENSOR.gain_e_per_dn / dim.gain)
    assert used.sensor.read_noise_e == SENSOR.read_noise_e
    # The lowest gain is the camera's own.
    camera = replace(CAMERA, sensor=SENSOR.with_settings(gain=2.0))
    chosen = choose_exposure(camera, grey_card(100.0), NONE, ExposureControl())
    assert chosen.gain == 2.0
    assert chosen.exposure_s == pytest.approx(linear_value(110.0) / 200.0, rel=5e-3)
    with pytest.raises(InputError, match=r"most_gain = 1.5: must be at least the camera's own gain, 2"):
        choose_exposure(camera, grey_card(100.0), NONE, ExposureControl(most_gain=1.5))


def test_light_that_is_too_bright_or_too_dark_is_limited():
    control = ExposureControl(shortest_s=1e-4, longest_s=1e-3, most_gain=2.0)
    bright = choose_exposure(CAMERA, grey_card(5000.0), NONE, control)
    assert (bright.exposure_s, bright.gain, bright.limited_by) == (1e-4, 1.0, "shortest exposure")
    assert bright.grey == pytest.approx(255.0 * 0.735, rel=0.01)  # sRGB of one half
    dark = choose_exposure(CAMERA, grey_card(1.0), NONE, control)
    assert (dark.exposure_s, dark.gain, dark.limited_by) == (1e-3, 2.0, "longest exposure and gain")
    assert decode_tone(dark.grey) == pytest.approx(2e-3, rel=5e-3)


def test_an_image_whose_lit_part_is_saturated_is_reported():
    # A quarter of the image has light, so its mean cannot exceed a quarter of 255.
    light = NONE.copy()
    light[:, :40] = grey_card(100.0)[:, :40]
    chosen = choose_exposure(CAMERA, light, NONE, ExposureControl())
    assert chosen.limited_by == "saturation"
    assert chosen.grey == pytest.approx(63.75, rel=2.5e-3)
    # The shortest exposure that saturates it, not the longest.
    assert chosen.exposure_s == pytest.approx(0.01, rel=0.01)
    assert chosen.gain == 1.0
    assert choose_exposure(CAMERA, 100.0 * light, NONE, ExposureControl()).exposure_s < 1.01e-4


def test_clipped_highlights_count_as_white():
    # A tenth of the image is far above white at every exposure in question.
    light = grey_card(100.0)
    light[:, :16] *= 1e4
    chosen = choose_exposure(CAMERA, light, NONE, ExposureControl())
    rest = (110.0 - 0.1 * 255.0) / 0.9
    assert chosen.exposure_s == pytest.approx(linear_value(rest) / 100.0, rel=5e-3)


def test_grey_of_a_flash_does_not_depend_on_the_exposure_beyond_its_pulse():
    camera = replace(CAMERA, flash=FLASH)
    flash = grey_card(linear_value(80.0) / FLASH.pulse_s)
    control = ExposureControl(longest_s=1e-3, most_gain=4.0)
    # Only the gain can brighten it.
    chosen = choose_exposure(camera, NONE, flash, control)
    assert (chosen.exposure_s, chosen.limited_by) == (1e-3, None)
    assert chosen.gain == pytest.approx(linear_value(110.0) / linear_value(80.0), rel=5e-3)
    # With a target below, the exposure ends within the pulse.
    darker = choose_exposure(camera, NONE, flash, replace(control, target_grey=60.0))
    fraction = linear_value(60.0) / linear_value(80.0)
    assert darker.exposure_s == pytest.approx(fraction * FLASH.pulse_s, rel=5e-3)
    # Daylight adds after the pulse.
    day = grey_card(10.0)
    mixed = choose_exposure(camera, day, flash, replace(control, longest_s=1.0))
    assert mixed.exposure_s == pytest.approx((linear_value(110.0) - linear_value(80.0)) / 10.0, rel=1e-2)


def test_centre_metering_exposes_the_middle():
    light = grey_card(20.0)
    light[40:80, 56:104] *= 5.0  # a tenth of the area
    greys = {}
    for metering in ("average", "centre"):
        chosen = choose_exposure(CAMERA, light, NONE, ExposureControl(metering=metering))
        used = with_exposure(CAMERA, chosen)
        image = develop(expected_electrons(light, used), used)
        greys[metering] = image[40:80, 56:104].mean() - 110.0, image.mean() - 110.0
    assert abs(greys["average"][1]) < 1.0
    assert abs(greys["centre"][0]) < abs(greys["average"][0])


SUBJECT = np.zeros(NONE.shape[:2], bool)
SUBJECT[40:80, 56:104] = True  # a tenth of the area


def metered(light, metering, subject=SUBJECT, **control):
    """The choice, and the developed image with it."""
    chosen = choose_exposure(CAMERA, light, NONE, ExposureControl(metering=metering, **control), subject)
    used = with_exposure(CAMERA, chosen)
    return chosen, develop(expected_electrons(light, used), used)


def test_uniform_light_is_exposed_the_same_with_all_weights():
    light = grey_card(100.0)
    chosen = [metered(light, metering)[0] for metering in ("average", "centre", "subject")]
    assert {round(one.exposure_s / chosen[0].exposure_s, 3) for one in chosen} == {1.0}
    assert chosen[0].grey == pytest.approx(110.0, rel=1.1e-3)


@pytest.mark.parametrize("factor", [0.05, 5.0])
def test_subject_has_the_wanted_grey_before_any_background(factor):
    light = grey_card(20.0)
    light[SUBJECT] *= factor
    chosen, image = metered(light, "subject", longest_s=1.0)
    assert chosen.exposure_s == pytest.approx(linear_value(110.0) / (20.0 * factor), rel=5e-3)
    assert image[SUBJECT].mean() == pytest.approx(110.0, abs=0.6)
    assert (chosen.metering, chosen.limited_by) == ("subject", None)
    assert chosen.saturated == 0.0


def test_without_a_subject_the_average_is_metered():
    light = grey_card(20.0)
    light[SUBJECT] *= 5.0
    average = metered(light, "average")[0]
    assert average.to_json().keys() == {"exposure_s", "gain", "grey", "limited_by"}
    for subject in (None, np.zeros_like(SUBJECT)):
        chosen, _ = metered(light, "subject", subject)
        assert chosen.to_json() == average.to_json() | {"metering": "average", "saturated": 0.0}


def ramp():
    """Light that rises from 0 to 100 full wells per second over the subject; 1000 elsewhere."""
    light = grey_card(1000.0)
    rise = np.linspace(0.0, 100.0, SUBJECT.sum())
    light[SUBJECT] = rise[:, None] * FULL_WELL_PER_S
    return light


@pytest.mark.parametrize("gain", [1.0, 4.0])
def test_highlights_of_the_subject_are_as_bright_as_may_be(gain):
    # The value below which all but 0.3 % of the subject is has the code 250, at any gain.
    chosen, image = metered(ramp(), "highlights", longest_s=8e-3 if gain > 1 else 0.1, most_gain=gain + 1.0)
    expected = linear_value(250.0) / (100.0 * (1 - 0.003))
    assert chosen.exposure_s * chosen.gain == pytest.approx(expected, rel=3e-3)
    assert 0.001 < chosen.saturated <= 0.003
    assert (image[SUBJECT] == 255).any(axis=-1).mean() <= 0.003
    assert chosen.limited_by is None
    # Without a subject, all pixels count, of which the background is brighter.
    darker, image = metered(ramp(), "highlights", None)
    assert darker.exposure_s == pytest.approx(linear_value(250.0) / 1000.0, rel=3e-3)
    assert image.max() < 255


def test_subject_with_highlights_is_darker_than_the_target():
    chosen, image = metered(ramp(), "subject", target_grey=220.0)
    assert chosen.limited_by == "highlights"
    assert replace(chosen, limited_by=None, metering="highlights") == metered(ramp(), "highlights")[0]
    assert (image[SUBJECT] == 255).any(axis=-1).mean() <= 0.003
    assert image[SUBJECT].mean() == pytest.approx(chosen.grey, abs=1.0)


def test_highlights_keep_to_the_limits():
    at = {"metering": "highlights", "subject": None}
    dim = metered(grey_card(1.0), **at)[0]
    assert (dim.exposure_s, dim.gain, dim.limited_by) == (10e-3, 4.0, "longest exposure and gain")
    bright = metered(grey_card(1e6), **at)[0]
    assert (bright.exposure_s, bright.limited_by) == (10e-6, "shortest exposure")
    assert metered(NONE, **at)[0].limited_by == "no light"
    with pytest.raises(ValueError, match=r"subject must be an image \(120, 160\), not \(2, 2\)"):
        metered(grey_card(1.0), "subject", np.ones((2, 2)))


@pytest.mark.parametrize(
    ("shape", "reduced"),
    [((800, 600), (320, 240)), ((64, 48), (64, 48)), ((2000, 2), (2000, 2))],
)
def test_metering_camera_has_the_field_of_view_of_the_camera(shape, reduced):
    camera = replace(CAMERA, sensor=replace(SENSOR, columns=shape[0], rows=shape[1]))
    if shape[0] == 2000:
        camera = replace(camera, lens=replace(LENS, focal_length_m=2.0 * LENS.focal_length_m))
    small = metering_camera(camera)
    assert (small.width, small.height) == reduced
    corners = camera.ray_slopes()[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert small.ray_slopes()[[0, 0, -1, -1], [0, -1, 0, -1]] == pytest.approx(corners, abs=1e-9)
    assert metering_camera(camera).sensor is small.sensor


def test_wrong_values_of_a_control_and_light_that_does_not_fit_are_rejected():
    for key, value in (
        ("target_grey", 0.0), ("target_grey", 256.0), ("target_grey", float("nan")), ("shortest_s", 0.0),
        ("longest_s", 1e-6), ("longest_s", float("inf")), ("most_gain", 0.5), ("metering", "spot"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=f"exposure_control: {key} = "):
            ExposureControl(**{key: value})
    with pytest.raises(ValueError, match="one shape"):
        choose_exposure(CAMERA, NONE, NONE[:4], ExposureControl())
    with pytest.raises(ValueError, match="needs a camera with a flash"):
        choose_exposure(CAMERA, NONE, NONE + 1.0, ExposureControl())


ROWS = 480


def chosen_with_a_rolling_shutter(line_time_s):
    """The choice by flash and dim daylight, and the mean grey of the full image with it."""
    sensor = replace(SENSOR, columns=64, rows=ROWS, line_time_s=line_time_s)
    camera = replace(CAMERA, sensor=sensor, flash=FLASH)
    # Four rows are one of the reduced image.
    levels = linear_value(200.0) / FLASH.pulse_s, linear_value(90.0) / 5e-3
    flash, day = (grey_card(level, (ROWS // 4, 16, 3)) for level in levels)
    chosen = choose_exposure(camera, day, flash, ExposureControl())
    used = with_exposure(camera, chosen)
    share = used.shutter.flash_fraction(FLASH.pulse_s)
    light = day[0, 0] + flash[0, 0] * used.flash_duty * share[:, None, None]
    full = np.broadcast_to(light, (ROWS, 64, 3))
    return chosen, develop(expected_electrons(full, used), used).mean()


# With a readout as long as the pulse, and with one in which only the first rows see it.
@pytest.mark.parametrize("line_time_s", [1e-7, 30e-6])
def test_rows_of_a_rolling_shutter_that_miss_the_flash_are_accounted_for(line_time_s):
    chosen, grey = chosen_with_a_rolling_shutter(line_time_s)
    assert chosen.limited_by is None
    assert grey == pytest.approx(110.0, rel=5e-3)


def test_rolling_shutter_keeps_the_flash_on_all_rows_where_no_exposure_reaches_the_target():
    # Up to the readout, the flash lights a few rows and the image is too dark; beyond, it is too bright.
    chosen, grey = chosen_with_a_rolling_shutter(2e-6)
    assert chosen.limited_by == "shortest exposure"
    assert chosen.exposure_s == pytest.approx(2e-6 * (ROWS - 1), rel=1e-6)
    assert grey == pytest.approx(chosen.grey, rel=5e-3)
    assert grey > 190.0


# --- dark images: stray light, pedestal and noise are part of the grey that is stated -----------------------

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


@pytest.mark.parametrize("name", SENSORS)
def test_stated_grey_of_a_plant_before_black_is_the_image_s(name):
    pedestal = "auto" if name in ("binned", "areas", "gain") else 0.0
    developing = Developing(stray_light=True, pedestal=pedestal, white_balance="daylight")
    camera = Camera(LENS, SENSORS[name], flash=FLASH, developing=developing)
    dim, flash = plant(camera, 0.05), plant(camera, 300.0)
    chosen, grey = stated_and_developed(camera, dim, flash, ExposureControl(target_grey=30.0))
    assert abs(chosen.grey - grey) <= 1.5
    assert chosen.limited_by is not None or abs(grey - 30.0) <= 1.5


@pytest.mark.parametrize(("target", "stray_light"), [(30.0, True), (110.0, False)])
def test_stated_grey_of_a_dark_row_is_the_image_s(target, stray_light):
    developing = Developing(stray_light=stray_light, white_balance="daylight")
    camera = Camera(LENS, SENSOR, developing=developing)
    light = np.random.default_rng(3).uniform(0.0, 1.5, (120, 160, 3)) * FULL_WELL_PER_S
    control = ExposureControl(target_grey=target, most_gain=8.0)
    chosen, grey = stated_and_developed(camera, light, 0.0 * light, control)
    assert abs(chosen.grey - grey) <= 1.5


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

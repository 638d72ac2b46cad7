"""Developing: each step alone, and the picture that they make."""

from __future__ import annotations

import dataclasses

import colour
import numpy as np
import pytest

from pepperscene.camera import (
    Camera,
    Developing,
    camera_rgb,
    correct_colours,
    develop,
    encode_tone,
    expected_electrons,
    load_filter,
    load_flash,
    load_lens,
    load_sensor,
    reference_correction,
    relative_illumination,
)
from pepperscene.camera.colorimetry import colour_correction, d65_spectrum, white_balance_gains
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, read_spectra

SENSOR = dataclasses.replace(load_sensor("ueye_ui5250re"), columns=40, rows=30)
LENS, FLASH = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
CAMERA = Camera(LENS, SENSOR, flash=FLASH)
NM = np.arange(380.0, 781.0)


def flat(rgb):
    return np.broadcast_to(np.asarray(rgb, float), (30, 40, 3))


def white_under_flash(level):
    """Electrons of a white diffuser under the flash, green at `level` of the full well."""
    response = np.trapezoid(FLASH.spectrum.at(NM) * SENSOR.electrons_per_joule(NM), NM, axis=-1)
    return flat(response / response[1] * level * SENSOR.full_well_e)


def with_developing(**choices):
    return dataclasses.replace(CAMERA, developing=Developing(**choices))


@pytest.mark.parametrize("level", [0.01, 0.05, 0.2, 0.5, 0.9])
def test_white_under_the_flash_is_neutral_within_a_code(level):
    picture = develop(white_under_flash(level), with_developing(quantise=False)).astype(int)
    assert np.ptp(picture, axis=-1).max() <= 1
    # The codes are those of the light: sRGB of the level.
    assert abs(picture[0, 0, 1] - 255 * colour.cctf_encoding(level, function="sRGB")) <= 1


@pytest.mark.parametrize("level", [1.0, 3.0, 1000.0])
def test_blown_out_white_is_white(level):
    assert np.all(develop(white_under_flash(level), CAMERA) == 255)


@pytest.mark.parametrize("gain", [0.25, 0.5, 2.0])
def test_blown_out_white_is_neutral_at_every_gain(gain):
    camera = dataclasses.replace(CAMERA, sensor=SENSOR.with_settings(gain=gain))
    # Below a gain of 1 a full well does not reach full scale, and the picture stays that much darker.
    code = round(255 * float(colour.cctf_encoding(min(gain, 1.0), function="sRGB")))
    picture = develop(white_under_flash(5.0), camera).astype(int)
    assert np.abs(picture - code).max() <= 1


def test_a_gain_brightens_as_much_light_would():
    twice = dataclasses.replace(CAMERA, sensor=SENSOR.with_settings(gain=2.0, bits=16))
    once = dataclasses.replace(CAMERA, sensor=SENSOR.with_settings(bits=16))
    dim, bright = (white_under_flash(level) * [0.2, 0.6, 0.9] for level in (0.3, 0.6))
    one, two = develop(bright, once).astype(int), develop(dim, twice).astype(int)
    assert np.abs(one - two).max() <= 1


def test_without_saturation_light_beyond_the_full_well_counts():
    free = with_developing(saturation=False, quantise=False, tone="linear")
    electrons = white_under_flash(3.0)
    np.testing.assert_allclose(camera_rgb(electrons, free), electrons / SENSOR.full_well_e, rtol=1e-5)
    np.testing.assert_allclose(correct_colours(camera_rgb(electrons, free), free), 3.0, rtol=1e-4)
    assert np.all(develop(electrons, free) == 255)


def test_darkness_is_black():
    assert not develop(flat(0), CAMERA).any()
    assert not develop(flat(-5), CAMERA).any()


def test_more_light_never_darkens_a_grey():
    codes = [develop(white_under_flash(level), CAMERA)[0, 0].astype(int) for level in np.linspace(0, 1.2, 60)]
    assert np.all(np.diff(codes, axis=0) >= 0)


def test_daylight_balance_differs_from_the_flash_s():
    daylight = reference_correction(with_developing(white_balance="daylight"))
    flash = reference_correction(CAMERA)
    assert min(daylight.gains) == min(flash.gains) == 1
    # A cool white LED has less red for its green than daylight has, so red needs more gain.
    assert flash.gains[0] > daylight.gains[0] * 1.05


def test_colour_matrices_keep_white():
    for which in ("flash", "daylight"):
        np.testing.assert_allclose(
            reference_correction(with_developing(white_balance=which)).matrix.sum(1), 1
        )


def test_each_step_can_be_left_out():
    electrons = white_under_flash(0.3)
    bare = with_developing(quantise=False, white_balance=None, colour_matrix=False, tone="linear")
    np.testing.assert_allclose(
        develop(electrons, bare), np.rint(electrons / SENSOR.full_well_e * 255), atol=1
    )
    steps = camera_rgb(electrons, with_developing(quantise=True))[0, 0] * (1023 - 16)
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)
    still = with_developing(shot_noise=False, read_noise=False)
    np.testing.assert_array_equal(
        develop(electrons, still, np.random.default_rng(0)), develop(electrons, CAMERA, None)
    )
    raw = camera_rgb(electrons, bare)
    np.testing.assert_array_equal(correct_colours(raw, bare), raw)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not():
    electrons = white_under_flash(0.1)
    one, same, other = (develop(electrons, CAMERA, np.random.default_rng(seed)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, same)
    assert np.any(one != other)


def test_the_tone_curve_is_srgb():
    value = np.linspace(-0.2, 1.2, 5000)
    curve = colour.cctf_encoding(np.clip(value, 0, 1), function="sRGB") * 255
    codes = encode_tone(value.astype(np.float32))
    assert np.abs(codes - curve).max() <= 0.5 + 1e-4
    np.testing.assert_allclose(
        encode_tone(value.astype(np.float32), "linear"), np.clip(value, 0, 1) * 255, atol=0.5001
    )


def test_exposure_scales_as_the_camera_equation_says():
    light = np.ones((30, 40, 3))
    base = expected_electrons(light, CAMERA)
    stopped = dataclasses.replace(CAMERA, lens=dataclasses.replace(LENS, f_number=4.0))
    longer = dataclasses.replace(CAMERA, exposure_s=150e-6)
    np.testing.assert_allclose(expected_electrons(light, stopped), base / 4)
    np.testing.assert_allclose(expected_electrons(light, longer), base * 3)
    np.testing.assert_allclose(expected_electrons(2 * light, CAMERA), base * 2)


def test_the_corners_of_the_whole_picture_are_darker_by_cos4():
    fall_off = relative_illumination(Camera(LENS, load_sensor("ueye_ui5250re")))
    # Half the diagonal of 7.2 x 5.4 mm behind 4.16 mm: cos^4 = (1 + (4.5 / 4.16)^2)^-2 = 0.212.
    assert fall_off[0, 0] == pytest.approx((1 + (4.5 / 4.16) ** 2) ** -2, rel=0.01)
    assert fall_off[299:301, 399:401].min() > 0.99999
    np.testing.assert_allclose(fall_off, fall_off[::-1, ::-1])


def test_what_is_not_a_picture_is_refused():
    with pytest.raises(ValueError, match="needed"):
        develop(np.zeros((30, 40)), CAMERA)
    with pytest.raises(ValueError, match="finite"):
        develop(flat(np.nan), CAMERA)
    with pytest.raises(ValueError, match="needed"):
        expected_electrons(np.zeros((3, 40, 30)), CAMERA)
    with pytest.raises(ValueError, match="needs a flash"):
        develop(flat(1), Camera(LENS, SENSOR))
    assert develop(flat(1), Camera(LENS, SENSOR, developing=Developing(white_balance="daylight"))).shape == (
        30,
        40,
        3,
    )


def line(nm, width=10.0):
    """Light of one narrow band."""
    at = nm + width * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    return Spectrum(at, np.array([0.0, 0.5, 1.0, 0.5, 0.0]))


def test_a_light_that_a_colour_does_not_see_is_refused():
    with pytest.raises(InputError, match="must see the reference light"):
        colour_correction(SENSOR, line(1050))
    with pytest.raises(InputError, match="must see the reference light"):
        white_balance_gains(SENSOR, line(1050))


def without_filter():
    """The MT9V024 that sees infrared in all colours."""
    curves = read_spectra("sensors/spectra/onsemi_mt9v024_rgb_qe.csv")
    efficiency = Spectrum(curves["r"].wavelength_nm, np.stack([curves[c].values for c in "rgb"]))
    return dataclasses.replace(SENSOR, quantum_efficiency=efficiency)


@pytest.mark.parametrize("nm", [850.0, 950.0, 1050.0])
def test_light_beyond_the_visible_can_be_balanced_but_has_no_colours(nm):
    sensor = without_filter()
    gains = white_balance_gains(sensor, line(nm))
    assert np.all(np.isfinite(gains))
    assert gains.min() == 1
    with pytest.raises(InputError, match="needs a visible reference light"):
        colour_correction(sensor, line(nm))


def test_a_colour_of_light_that_shows_no_colours_is_refused():
    with pytest.raises(InputError, match="of more colours"):
        colour_correction(SENSOR, line(600, 3))


def test_a_sensor_that_sees_infrared_keeps_white_and_pays_in_colour():
    sensor, cut = without_filter(), load_filter("schott_22022010").transmittance
    seen, filtered = (
        colour_correction(sensor, d65_spectrum()),
        colour_correction(sensor.with_filter(cut), d65_spectrum()),
    )
    for found in (seen, filtered):
        np.testing.assert_allclose(found.matrix.sum(axis=1), 1)
        assert np.isfinite(found.matrix).all()
    assert filtered.mean_delta_e_2000 < 2.5 < seen.mean_delta_e_2000

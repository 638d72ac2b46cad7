"""Developing: each step alone, and the image of all steps."""

from __future__ import annotations

from dataclasses import replace

import colour
import numpy as np
import pytest

from pepperscene.camera import (
    Camera,
    Developing,
    add_pedestal,
    camera_rgb,
    correct_colours,
    decode_tone,
    develop,
    encode_tone,
    expected_electrons,
    load_flash,
    load_lens,
    load_sensor,
    pedestal,
    relative_illumination,
)

SENSOR = replace(load_sensor("ueye_ui5250re"), columns=40, rows=30)
LENS, FLASH = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
CAMERA = Camera(LENS, SENSOR, flash=FLASH)
NM = np.arange(380.0, 781.0)
CODES = np.arange(256, dtype=np.uint8)


def uniform(rgb):
    return np.broadcast_to(np.asarray(rgb, float), (30, 40, 3))


def white_under_flash(level):
    """Electrons of a white diffuser under the flash, green at `level` of the full well."""
    response = np.trapezoid(FLASH.spectrum.at(NM) * SENSOR.electrons_per_joule(NM), NM, axis=-1)
    return uniform(response / response[1] * level * SENSOR.full_well_e)


def with_developing(**choices):
    return replace(CAMERA, developing=Developing(**choices))


@pytest.mark.parametrize("level", [0.01, 0.2, 0.9])
def test_white_under_the_flash_is_neutral_within_a_code(level):
    image = develop(white_under_flash(level), with_developing(quantise=False)).astype(int)
    assert np.ptp(image, axis=-1).max() <= 1
    assert abs(image[0, 0, 1] - 255 * colour.cctf_encoding(level, function="sRGB")) <= 1


@pytest.mark.parametrize(
    ("gain", "level", "tolerance"),
    [(1.0, 1.0, 0), (1.0, 1000.0, 0), (0.25, 5.0, 1), (2.0, 5.0, 1)],
)
def test_overexposed_white_is_neutral_at_every_gain(gain, level, tolerance):
    camera = replace(CAMERA, sensor=SENSOR.with_settings(gain=gain))
    # With a gain below 1 a full well does not reach full scale, and the image stays that much darker.
    code = round(255 * float(colour.cctf_encoding(min(gain, 1.0), function="sRGB")))
    assert np.abs(develop(white_under_flash(level), camera).astype(int) - code).max() <= tolerance


def test_without_saturation_light_beyond_the_full_well_counts():
    camera = with_developing(saturation=False, quantise=False, tone="linear")
    electrons = white_under_flash(3.0)
    rgb = camera_rgb(electrons, camera)
    np.testing.assert_allclose(rgb, electrons / SENSOR.full_well_e, rtol=1e-5)
    np.testing.assert_allclose(correct_colours(rgb, camera), 3.0, rtol=1e-4)
    assert np.all(develop(electrons, camera) == 255)


def test_darkness_and_negative_electrons_are_black():
    assert not develop(uniform(0), CAMERA).any()
    assert not develop(uniform(-5), CAMERA).any()


def test_each_step_can_be_left_out():
    electrons = white_under_flash(0.3)
    bare = with_developing(quantise=False, white_balance=None, colour_matrix=False, tone="linear")
    expected = np.rint(electrons / SENSOR.full_well_e * 255)
    np.testing.assert_allclose(develop(electrons, bare), expected, atol=1)
    steps = camera_rgb(electrons, with_developing(quantise=True))[0, 0] * (1023 - 16)
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)
    noiseless = with_developing(shot_noise=False, read_noise=False)
    np.testing.assert_array_equal(
        develop(electrons, noiseless, np.random.default_rng(0)), develop(electrons, CAMERA, None)
    )
    rgb = camera_rgb(electrons, bare)
    np.testing.assert_array_equal(correct_colours(rgb, bare), rgb)


def test_image_depends_on_the_seed():
    electrons = white_under_flash(0.1)
    one, same, other = (develop(electrons, CAMERA, np.random.default_rng(seed)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, same)
    assert np.any(one != other)


def test_raises_on_invalid_electrons_or_missing_flash():
    with pytest.raises(ValueError, match="must have the shape"):
        develop(np.zeros((30, 40)), CAMERA)
    with pytest.raises(ValueError, match="finite"):
        develop(uniform(np.nan), CAMERA)
    with pytest.raises(ValueError, match="must have the shape"):
        expected_electrons(np.zeros((3, 40, 30)), CAMERA)
    with pytest.raises(ValueError, match="needs a flash"):
        develop(uniform(1), Camera(LENS, SENSOR))
    daylight = Camera(LENS, SENSOR, developing=Developing(white_balance="daylight"))
    assert develop(uniform(1), daylight).shape == (30, 40, 3)


def test_electrons_scale_with_aperture_exposure_and_light():
    light = np.ones((30, 40, 3))
    base = expected_electrons(light, CAMERA)
    stopped = replace(CAMERA, lens=replace(LENS, f_number=4.0))
    longer = replace(CAMERA, exposure_s=150e-6)
    np.testing.assert_allclose(expected_electrons(light, stopped), base / 4)
    np.testing.assert_allclose(expected_electrons(light, longer), base * 3)
    np.testing.assert_allclose(expected_electrons(2 * light, CAMERA), base * 2)


def test_image_corners_are_darker_by_cos4():
    falloff = relative_illumination(Camera(LENS, load_sensor("ueye_ui5250re")))
    # Half the diagonal of 7.2 x 5.4 mm behind 4.16 mm: cos^4 = (1 + (4.5 / 4.16)^2)^-2 = 0.212.
    assert falloff[0, 0] == pytest.approx((1 + (4.5 / 4.16) ** 2) ** -2, rel=0.01)
    assert falloff[299:301, 399:401].min() > 0.99999
    np.testing.assert_allclose(falloff, falloff[::-1, ::-1])


def test_encoding_is_srgb_or_linear():
    value = np.linspace(-0.2, 1.2, 5000)
    curve = colour.cctf_encoding(np.clip(value, 0, 1), function="sRGB") * 255
    assert np.abs(encode_tone(value.astype(np.float32)) - curve).max() <= 0.5 + 1e-4
    linear = encode_tone(value.astype(np.float32), "linear")
    np.testing.assert_allclose(linear, np.clip(value, 0, 1) * 255, atol=0.5001)


@pytest.mark.parametrize("tone", ["srgb", "linear"])
def test_every_code_survives_decoding_and_encoding(tone):
    light = decode_tone(CODES, tone)
    assert light.dtype == np.float64
    assert (light[0], light[-1]) == (0.0, 1.0)
    assert np.all(np.diff(light) > 0)
    # In single precision, in which images are developed, too; and for any type of the codes.
    np.testing.assert_array_equal(encode_tone(light, tone), CODES)
    np.testing.assert_array_equal(encode_tone(light.astype(np.float32), tone), CODES)
    np.testing.assert_allclose(decode_tone(CODES.astype(np.float32), tone), light, rtol=1e-14)
    expected = CODES / 255 if tone == "linear" else colour.cctf_decoding(CODES / 255, function="sRGB")
    np.testing.assert_allclose(light, expected, rtol=1e-12)
    np.testing.assert_array_equal(decode_tone([[-1.0, 256.0]], tone), [[0.0, 1.0]])
    light[:] = 7.0
    assert decode_tone(CODES, tone).max() == 1.0


BLACK = replace(CAMERA, sensor=replace(SENSOR, columns=200, rows=150))


def black_codes(camera):
    """`(n, 3)` codes of unlit pixels with noise."""
    electrons = np.zeros((camera.height, camera.width, camera.sensor.channels))
    return develop(electrons, camera, np.random.default_rng(4)).reshape(-1, 3).astype(float)


def lifted(camera, value):
    return replace(camera, developing=replace(camera.developing, pedestal=value))


@pytest.mark.parametrize(("name", "white_balance"), [("ueye_ui5250re", "flash"), ("nikon_d5100", "daylight")])
def test_automatic_pedestal_makes_black_neutral(name, white_balance):
    sensor = load_sensor(name)
    camera = replace(BLACK, sensor=replace(sensor, columns=200, rows=150))
    camera = replace(camera, developing=Developing(white_balance=white_balance))
    means = black_codes(lifted(camera, "auto")).mean(axis=0)
    # 30,000 pixels of a deviation below 20 codes: 0.12 in the mean, and 1 for the choice of the pedestal.
    assert np.ptp(means) < 1.4
    before = black_codes(camera)
    assert white_balance == "daylight" or np.ptp(before.mean(axis=0)) > 4
    # Not brighter than needed: the mean light of black is that of the pedestal and of less noise than before.
    light = decode_tone(black_codes(lifted(camera, "auto"))).mean(axis=0)
    assert light.max() < pedestal(lifted(camera, "auto")) + decode_tone(before).mean(axis=0).max()


def test_pedestal_lifts_black_keeps_white_and_is_invertible():
    camera = replace(CAMERA, developing=Developing(pedestal=0.1, quantise=False, tone="linear"))
    assert np.all(np.abs(develop(uniform(0), camera) - 255 * 0.1 / 1.1) <= 0.5 + 1e-4)
    assert np.all(develop(white_under_flash(1.0), camera) == 255)
    rgb = camera_rgb(white_under_flash(0.3), camera)
    light = correct_colours(rgb, camera)
    p = pedestal(camera)
    np.testing.assert_allclose((1 + p) * add_pedestal(light, camera) - p, light, atol=1e-6)


def test_automatic_pedestal_is_the_noise_of_black_and_0_without_noise():
    camera = lifted(CAMERA, "auto")
    black = replace(BLACK, developing=camera.developing)
    rgb = camera_rgb(np.zeros((150, 200, 3)), black, np.random.default_rng(5))
    linear = correct_colours(rgb, camera)
    assert pedestal(camera) == pytest.approx(0.7 * linear.std(axis=(0, 1)).max(), rel=0.03)
    # Twice the gain shows twice the read noise.
    doubled = replace(camera, sensor=SENSOR.with_settings(gain=2.0, bits=16))
    single = replace(camera, sensor=SENSOR.with_settings(bits=16))
    assert pedestal(doubled) == pytest.approx(2 * pedestal(single), rel=1e-3)
    silent = replace(CAMERA, developing=Developing(pedestal="auto", read_noise=False, quantise=False))
    assert pedestal(silent) == 0.0
    mono = replace(load_sensor("onsemi_mt9v024_mono"), columns=40, rows=30)
    assert pedestal(replace(camera, sensor=mono)) == 0.0
    for value in (-0.01, 0.26, float("nan")):
        with pytest.raises(ValueError, match=r'a pedestal must be "auto", or 0 to 0\.25'):
            Developing(pedestal=value)

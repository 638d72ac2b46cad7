"""White balance and colour matrix told in numbers, and codes led back to light."""

from __future__ import annotations

import dataclasses
import json

import colour
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.camera import (
    Camera,
    Developing,
    camera_rgb,
    colour_transform,
    correct_colours,
    decode_tone,
    develop,
    encode_tone,
    load_flash,
    load_lens,
    load_sensor,
    reference_correction,
)

SENSOR = dataclasses.replace(load_sensor("ueye_ui5250re"), columns=12, rows=8)
LENS, FLASH = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
GAINS = (1.9, 1.0, 1.5)
MATRIX = ((1.6, -0.4, -0.1), (-0.2, 1.5, -0.4), (0.1, -0.6, 1.7))
ANY_GAINS = st.tuples(*3 * [st.floats(0.1, 10.0)])
ANY_MATRIX = st.tuples(*3 * [st.tuples(*3 * [st.floats(-3.0, 3.0)])])


def a_camera(*, flash=None, gain=1.0, **choices):
    return Camera(LENS, SENSOR.with_settings(gain=gain), flash=flash, developing=Developing(**choices))


def light(most=2.0, seed=0):
    """Electrons of all colours, up to `most` full wells."""
    return np.random.default_rng(seed).uniform(0, most * SENSOR.full_well_e, (8, 12, 3))


def linear(electrons, camera):
    return correct_colours(camera_rgb(electrons, camera), camera)


# --- the numbers in use -------------------------------------------------------------------------------------


def test_what_is_told_is_what_is_used():
    gains, matrix = colour_transform(a_camera(white_balance=GAINS, colour_matrix=MATRIX))
    assert gains.dtype == matrix.dtype == np.float64
    np.testing.assert_array_equal(gains, GAINS)
    np.testing.assert_array_equal(matrix, MATRIX)


def test_steps_left_out_change_nothing():
    camera = a_camera(white_balance=None, colour_matrix=False)
    gains, matrix = colour_transform(camera)
    np.testing.assert_array_equal(gains, np.ones(3))
    np.testing.assert_array_equal(matrix, np.eye(3))
    told = a_camera(white_balance=tuple(gains), colour_matrix=matrix)
    np.testing.assert_array_equal(linear(light(0.9), told), linear(light(0.9), camera))


def test_the_caller_s_numbers_are_the_caller_s():
    camera = a_camera(flash=FLASH)
    gains, matrix = colour_transform(camera)
    gains *= 2
    matrix *= 2
    np.testing.assert_array_equal(2 * reference_correction(camera).matrix, matrix)
    np.testing.assert_array_equal(2 * colour_transform(camera)[0], gains)


@pytest.mark.parametrize("balance", ["flash", "daylight"])
@pytest.mark.parametrize("gain", [0.5, 1.0, 3.0])
def test_the_reference_light_s_numbers_told_give_the_same_picture(balance, gain):
    named = a_camera(flash=FLASH, gain=gain, white_balance=balance)
    found = reference_correction(named)
    # No flash: no light is asked for any more.
    told = a_camera(gain=gain, white_balance=tuple(found.gains), colour_matrix=found.matrix)
    for rng in (None, 4):
        one, two = (develop(light(), camera, rng and np.random.default_rng(rng)) for camera in (named, told))
        np.testing.assert_array_equal(one, two)
    for name, number in zip(colour_transform(named), colour_transform(told), strict=True):
        np.testing.assert_array_equal(name, number)


@pytest.mark.parametrize(("flash", "named"), [(FLASH, "flash"), (None, "daylight")])
def test_with_gains_alone_the_matrix_is_the_reference_light_s(flash, named):
    expected = reference_correction(a_camera(flash=flash, white_balance=named)).matrix
    gains, matrix = colour_transform(a_camera(flash=flash, white_balance=GAINS))
    np.testing.assert_array_equal(matrix, expected)
    np.testing.assert_array_equal(gains, GAINS)


def test_a_named_light_goes_with_a_matrix_that_is_told():
    camera = a_camera(flash=FLASH, colour_matrix=MATRIX)
    np.testing.assert_array_equal(colour_transform(camera)[0], reference_correction(camera).gains)
    np.testing.assert_array_equal(colour_transform(camera)[1], MATRIX)
    with pytest.raises(ValueError, match="needs a flash"):
        colour_transform(a_camera(colour_matrix=MATRIX))


def test_a_sensor_without_colours_has_none_to_tell():
    mono = dataclasses.replace(load_sensor("onsemi_mt9v024_mono"), columns=12, rows=8)
    camera = Camera(LENS, mono, developing=Developing(white_balance=GAINS, colour_matrix=MATRIX))
    electrons = light()[..., :1]
    rgb = camera_rgb(electrons, camera)
    np.testing.assert_array_equal(correct_colours(rgb, camera), rgb)
    with pytest.raises(ValueError, match="sees no colours"):
        colour_transform(camera)


# --- the picture --------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(gains=ANY_GAINS, matrix=ANY_MATRIX)
def test_below_saturation_the_picture_is_the_matrix_times_gained_light(gains, matrix):
    camera = a_camera(white_balance=gains, colour_matrix=matrix, saturation=False)
    rgb = camera_rgb(light(), camera)
    expected = np.einsum("ij,hwj->hwi", np.array(matrix), np.array(gains) * rgb.astype(float))
    size = np.abs(matrix).sum() * max(gains) * rgb.max()
    np.testing.assert_allclose(correct_colours(rgb, camera), expected, atol=1e-6 * size)


@settings(max_examples=50, deadline=None)
@given(gains=ANY_GAINS, factor=st.sampled_from([0.25, 0.5, 2.0, 4.0]))
def test_larger_gains_are_as_much_more_light_in_the_picture(gains, factor):
    """Clipped light included: powers of two, so to the last bit."""
    one = a_camera(white_balance=gains, colour_matrix=MATRIX)
    other = a_camera(white_balance=tuple(factor * gain for gain in gains), colour_matrix=MATRIX)
    np.testing.assert_array_equal(linear(light(), other), np.float32(factor) * linear(light(), one))


@settings(max_examples=50, deadline=None)
@given(gains=ANY_GAINS, gain=st.sampled_from([0.5, 1.0, 3.0]))
def test_blown_out_light_is_neutral_whatever_the_gains(gains, gain):
    camera = a_camera(gain=gain, white_balance=gains, colour_matrix=False)
    found = linear(np.full((8, 12, 3), 10 * SENSOR.full_well_e), camera)
    # The converter rounds: half a step of a range of some hundred.
    np.testing.assert_allclose(found, min(gain, 1.0) * min(gains), rtol=5e-3)
    assert np.ptp(found, axis=-1).max() <= 5e-3 * min(gains)


@given(matrix=ANY_MATRIX)
@settings(max_examples=20, deadline=None)
def test_any_matrix_gives_a_picture(matrix):
    camera = a_camera(white_balance=GAINS, colour_matrix=matrix)
    picture = develop(light(), camera, np.random.default_rng(1))
    assert picture.dtype == np.uint8
    assert picture.shape == (8, 12, 3)


# --- the values ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [tuple, list, np.array])
def test_any_sequence_becomes_plain_numbers(form):
    choice = Developing(white_balance=form(GAINS), colour_matrix=form([form(row) for row in MATRIX]))
    assert choice == Developing(white_balance=GAINS, colour_matrix=MATRIX)
    assert hash(choice) == hash(Developing(white_balance=GAINS, colour_matrix=MATRIX))
    assert dataclasses.replace(choice, tone="linear").white_balance == GAINS
    camera = Camera(LENS, SENSOR, developing=choice)
    facts = json.loads(json.dumps(camera.metadata(), allow_nan=False))["developing"]
    # And back from a frame's JSON.
    assert Developing(**facts) == choice


def test_switches_stay_switches():
    assert Developing(colour_matrix=np.bool_(False)).colour_matrix is False
    assert Developing() == Developing(white_balance="flash", colour_matrix=True)


@pytest.mark.parametrize(
    "gains",
    [(), (1.0, 1.0), (1.0, 0.0, 1.0), (1.0, -1.0, 1.0), (1.0, np.nan, 1.0), (1.0, np.inf, 1.0), (1e-3, 1, 1),
     (1e3, 1, 1), 1.0, True, [(1.0, 1.0, 1.0)], "tungsten", ""],
)  # fmt: skip
def test_gains_that_are_none_are_refused(gains):
    with pytest.raises(ValueError, match="white balance"):
        Developing(white_balance=gains)


@pytest.mark.parametrize(
    "matrix",
    [(), np.eye(2), np.eye(4), np.ones(9), np.full((3, 3), np.nan), np.diag([1, 1, np.inf]), 1.0, None,
     np.diag([1, 1, 101.0])],
)  # fmt: skip
def test_matrices_that_are_none_are_refused(matrix):
    with pytest.raises(ValueError, match="colour matrix"):
        Developing(colour_matrix=matrix)


# --- codes back to light ------------------------------------------------------------------------------------

CODES = np.arange(256, dtype=np.uint8)


@pytest.mark.parametrize("tone", ["srgb", "linear"])
def test_every_code_comes_back(tone):
    light = decode_tone(CODES, tone)
    assert light.dtype == np.float64
    assert (light[0], light[-1]) == (0.0, 1.0)
    assert np.all(np.diff(light) > 0)
    np.testing.assert_array_equal(encode_tone(light, tone), CODES)
    # Single precision, as pictures are developed in, as well; and whichever number type holds the codes.
    np.testing.assert_array_equal(encode_tone(light.astype(np.float32), tone), CODES)
    for form in (np.uint16, np.float32, np.float64):
        np.testing.assert_allclose(decode_tone(CODES.astype(form), tone), light, rtol=1e-14)


def test_decoding_is_srgb_s():
    np.testing.assert_allclose(
        decode_tone(CODES), colour.cctf_decoding(CODES / 255, function="sRGB"), rtol=1e-12
    )
    between = np.linspace(0, 255, 5000)
    np.testing.assert_allclose(
        decode_tone(between), colour.cctf_decoding(between / 255, function="sRGB"), rtol=1e-6
    )
    np.testing.assert_array_equal(decode_tone(between, "linear"), between / 255)


def test_decoding_keeps_shapes_and_clips_what_is_no_code():
    assert decode_tone(CODES.reshape(4, 64)).shape == (4, 64)
    np.testing.assert_array_equal(decode_tone([[-1.0, 256.0]]), [[0.0, 1.0]])
    table = decode_tone(CODES)
    table[:] = 7.0
    assert decode_tone(CODES).max() == 1.0

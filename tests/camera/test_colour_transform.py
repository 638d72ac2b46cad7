"""White balance and colour matrix given in numbers."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.camera import (
    Camera,
    Developing,
    camera_rgb,
    colour_transform,
    correct_colours,
    develop,
    load_flash,
    load_lens,
    load_sensor,
    reference_correction,
)

SENSOR = replace(load_sensor("ueye_ui5250re"), columns=12, rows=8)
LENS, FLASH = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
GAINS = (1.9, 1.0, 1.5)
MATRIX = ((1.6, -0.4, -0.1), (-0.2, 1.5, -0.4), (0.1, -0.6, 1.7))
ANY_GAINS = st.tuples(*3 * [st.floats(0.1, 10.0)])
ANY_MATRIX = st.tuples(*3 * [st.tuples(*3 * [st.floats(-3.0, 3.0)])])


def camera_with(*, flash=None, gain=1.0, **choices):
    return Camera(LENS, SENSOR.with_settings(gain=gain), flash=flash, developing=Developing(**choices))


def electrons_up_to(wells=2.0):
    """Random electrons of all colours, up to some full wells."""
    return np.random.default_rng(0).uniform(0, wells * SENSOR.full_well_e, (8, 12, 3))


def linear(electrons, camera):
    return correct_colours(camera_rgb(electrons, camera), camera)


def test_result_can_be_modified_without_side_effects():
    camera = camera_with(flash=FLASH)
    gains, matrix = colour_transform(camera)
    gains *= 2
    matrix *= 2
    np.testing.assert_array_equal(2 * reference_correction(camera).matrix, matrix)
    np.testing.assert_array_equal(2 * colour_transform(camera)[0], gains)


@pytest.mark.parametrize(("balance", "gain"), [("flash", 0.5), ("daylight", 3.0)])
def test_numbers_of_the_reference_light_give_the_same_image(balance, gain):
    named = camera_with(flash=FLASH, gain=gain, white_balance=balance)
    correction = reference_correction(named)
    # Without a flash, because no reference light is needed any more.
    explicit = camera_with(gain=gain, white_balance=tuple(correction.gains), colour_matrix=correction.matrix)
    for seed in (None, 4):
        one, two = (
            develop(electrons_up_to(), camera, seed and np.random.default_rng(seed))
            for camera in (named, explicit)
        )
        np.testing.assert_array_equal(one, two)
    for one, two in zip(colour_transform(named), colour_transform(explicit), strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize(("flash", "named"), [(FLASH, "flash"), (None, "daylight")])
def test_given_gains_with_the_matrix_of_the_reference_light(flash, named):
    expected = reference_correction(camera_with(flash=flash, white_balance=named)).matrix
    gains, matrix = colour_transform(camera_with(flash=flash, white_balance=GAINS))
    np.testing.assert_array_equal(matrix, expected)
    np.testing.assert_array_equal(gains, GAINS)


def test_given_matrix_with_the_gains_of_the_reference_light():
    camera = camera_with(flash=FLASH, colour_matrix=MATRIX)
    gains, matrix = colour_transform(camera)
    np.testing.assert_array_equal(gains, reference_correction(camera).gains)
    np.testing.assert_array_equal(matrix, MATRIX)
    with pytest.raises(ValueError, match="needs a flash"):
        colour_transform(camera_with(colour_matrix=MATRIX))
    gains, matrix = colour_transform(camera_with(white_balance=None, colour_matrix=False))
    np.testing.assert_array_equal(gains, np.ones(3))
    np.testing.assert_array_equal(matrix, np.eye(3))


def test_monochrome_sensor_ignores_colours():
    mono = replace(load_sensor("onsemi_mt9v024_mono"), columns=12, rows=8)
    camera = Camera(LENS, mono, developing=Developing(white_balance=GAINS, colour_matrix=MATRIX))
    rgb = camera_rgb(electrons_up_to()[..., :1], camera)
    np.testing.assert_array_equal(correct_colours(rgb, camera), rgb)
    with pytest.raises(ValueError, match="is monochrome"):
        colour_transform(camera)


@given(gains=ANY_GAINS, matrix=ANY_MATRIX)
def test_below_saturation_the_image_is_matrix_times_gained_light(gains, matrix):
    camera = camera_with(white_balance=gains, colour_matrix=matrix, saturation=False)
    rgb = camera_rgb(electrons_up_to(), camera)
    expected = np.einsum("ij,hwj->hwi", np.array(matrix), np.array(gains) * rgb.astype(float))
    size = np.abs(matrix).sum() * max(gains) * rgb.max()
    tolerance = 1e-6 * size + np.finfo(np.float32).tiny
    np.testing.assert_allclose(correct_colours(rgb, camera), expected, atol=tolerance)


@given(gains=ANY_GAINS, gain=st.sampled_from([0.5, 3.0]))
def test_overexposed_light_is_neutral_for_any_gains(gains, gain):
    camera = camera_with(gain=gain, white_balance=gains, colour_matrix=False)
    image = linear(np.full((8, 12, 3), 10 * SENSOR.full_well_e), camera)
    # The converter rounds: half a step of a range of some hundred.
    np.testing.assert_allclose(image, min(gain, 1.0) * min(gains), rtol=5e-3)
    assert np.ptp(image, axis=-1).max() <= 5e-3 * min(gains)


@pytest.mark.parametrize("form", [list, np.array])
def test_sequences_become_tuples_of_floats(form):
    developing = Developing(white_balance=form(GAINS), colour_matrix=form([form(row) for row in MATRIX]))
    assert developing == Developing(white_balance=GAINS, colour_matrix=MATRIX)
    assert hash(developing) == hash(Developing(white_balance=GAINS, colour_matrix=MATRIX))
    metadata = Camera(LENS, SENSOR, developing=developing).to_metadata()
    # And back from a frame's JSON.
    assert Developing(**json.loads(json.dumps(metadata, allow_nan=False))["developing"]) == developing


def test_raises_on_invalid_gains_and_matrices():
    for gains in (
        (1.0, 1.0), (1.0, 0.0, 1.0), (1.0, -1.0, 1.0), (1.0, np.nan, 1.0), (1.0, np.inf, 1.0), (1e-3, 1, 1),
        (1e3, 1, 1), 1.0, True, [(1.0, 1.0, 1.0)], "tungsten",
    ):  # fmt: skip
        with pytest.raises(ValueError, match="white balance"):
            Developing(white_balance=gains)
    for matrix in (np.eye(2), np.ones(9), np.full((3, 3), np.nan), 1.0, None, np.diag([1, 1, 101.0])):
        with pytest.raises(ValueError, match="colour matrix"):
            Developing(colour_matrix=matrix)

"""The yardsticks against closed forms and an independent development of the picture."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pepperscene.bench import reference as metrics
from pepperscene.bench.reference import REGULARISER, codes, errors, relative_mse, rms
from pepperscene.camera import develop
from pepperscene.errors import SetupError


def picture(camera, level=2_000.0, seed=0):
    shape = (camera.height, camera.width, camera.sensor.channels)
    return np.random.default_rng(seed).uniform(0.7, 1.0, shape) * level


def test_no_difference_is_no_error(camera):
    image = picture(camera)
    found = errors(image, image, camera)
    assert (found.rmse_codes, found.relative_mse, found.flip) == (0.0, 0.0, 0.0)


def test_codes_are_the_developed_picture_before_rounding(camera):
    image = picture(camera)
    # Without the converter's steps the two differ by rounding alone: half a code.
    exact = dataclasses.replace(camera, developing=dataclasses.replace(camera.developing, quantise=False))
    found = codes(image, camera)
    assert np.abs(found - develop(image, exact)).max() <= 0.5 + 1e-3
    assert 50.0 < found.mean() < 250.0


def test_codes_go_on_the_linear_tone_and_end_at_white(camera):
    linear = dataclasses.replace(camera, developing=dataclasses.replace(camera.developing, tone="linear"))
    dim = picture(camera, 500.0)
    np.testing.assert_allclose(codes(2 * dim, linear), 2 * codes(dim, linear), atol=1e-3)
    assert np.abs(codes(picture(camera, 1e9), camera) - 255.0).max() < 30.0


def test_an_even_error_has_the_relative_error_of_the_formula():
    # x = (1 + a) r with r even: (a r)^2 / (r^2 + 0.01 r^2).
    reference = np.full((4, 5, 3), 7.0)
    assert relative_mse(1.1 * reference, reference) == pytest.approx(0.01 / (1 + REGULARISER), rel=1e-12)


def test_half_black_reference_is_regularised():
    # r = 0 and 2: the mean is 1; an error of e everywhere gives the mean of e^2/0.01 and e^2/4.01.
    reference = np.array([0.0, 2.0])
    assert relative_mse(reference + 0.1, reference) == pytest.approx((1.0 + 0.01 / 4.01) / 2, rel=1e-12)


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e18])
def test_the_relative_error_does_not_depend_on_the_unit(scale):
    rng = np.random.default_rng(1)
    x, r = rng.uniform(1, 2, (2, 6, 5, 3))
    scaled = relative_mse((x * scale).astype(np.float32), (r * scale).astype(np.float32))
    assert scaled == pytest.approx(relative_mse(x, r), rel=1e-5)


def test_black_against_black_and_against_light():
    black = np.zeros((2, 2, 3))
    assert relative_mse(black, black) == 0.0
    assert relative_mse(black + 1, black) == np.inf


def test_rms_of_a_sine():
    assert rms(3.0 * np.sin(np.arange(1000) * 2 * np.pi / 1000)) == pytest.approx(3.0 / np.sqrt(2), rel=1e-12)


def test_flip_orders_errors_and_is_no_more_than_one(camera):
    image = picture(camera)
    rng = np.random.default_rng(2)
    noisy = [
        errors(image * (1 + share * rng.standard_normal(image.shape)), image, camera).flip
        for share in (0.01, 0.05, 0.2)
    ]
    assert 0.0 < noisy[0] < noisy[1] < noisy[2] < 1.0
    assert np.isnan(errors(image, image, camera, flip=False).flip)


def test_flip_of_black_and_white_is_nearly_one():
    shape = (16, 16, 3)
    assert metrics.flip_of(np.full(shape, 255.0), np.zeros(shape)) > 0.9


def test_a_missing_extra_is_told_in_one_sentence(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        SetupError, match=r"flip-evaluator and matplotlib.*pip install 'pepperscene\[bench\]'"
    ):
        metrics.check_extra()

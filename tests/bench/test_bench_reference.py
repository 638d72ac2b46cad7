"""Error measures against closed forms; converged pictures and their cache."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pepperscene.bench import reference
from pepperscene.bench.reference import (
    check_packages,
    develop_codes,
    mean_flip,
    measure_errors,
    relative_mse,
    render_reference,
    rms,
)
from pepperscene.camera import develop
from pepperscene.errors import SetupError


def random_picture(camera, level=2_000.0):
    shape = (camera.height, camera.width, camera.sensor.channels)
    return np.random.default_rng(0).uniform(0.7, 1.0, shape) * level


def test_codes_equal_the_developed_picture_before_rounding(camera):
    image = random_picture(camera)
    exact = dataclasses.replace(camera, developing=dataclasses.replace(camera.developing, quantise=False))
    codes = develop_codes(image, camera)
    assert np.abs(codes - develop(image, exact)).max() <= 0.5 + 1e-3
    assert 50.0 < codes.mean() < 250.0
    linear = dataclasses.replace(
        camera, developing=dataclasses.replace(camera.developing, tone="linear", pedestal=0.0)
    )
    dark = random_picture(camera, 500.0)
    np.testing.assert_allclose(develop_codes(2 * dark, linear), 2 * develop_codes(dark, linear), atol=1e-3)
    assert np.abs(develop_codes(random_picture(camera, 1e9), camera) - 255.0).max() < 30.0


def test_relative_error_equals_its_formula():
    # x = (1 + a) r with constant r: (a r)^2 / (r^2 + 0.01 r^2).
    constant = np.full((4, 5, 3), 7.0)
    assert relative_mse(1.1 * constant, constant) == pytest.approx(0.01 / 1.01, rel=1e-12)
    # r = 0 and 2 have a mean of 1; an error of e everywhere gives the mean of e^2/0.01 and e^2/4.01.
    half_black = np.array([0.0, 2.0])
    assert relative_mse(half_black + 0.1, half_black) == pytest.approx((1.0 + 0.01 / 4.01) / 2, rel=1e-12)
    black = np.zeros((2, 2, 3))
    assert relative_mse(black, black) == 0.0
    assert relative_mse(black + 1, black) == np.inf
    assert rms(3.0 * np.sin(np.arange(1000) * 2 * np.pi / 1000)) == pytest.approx(3 / np.sqrt(2), rel=1e-12)


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e18])
def test_relative_error_does_not_depend_on_the_unit(scale):
    x, r = np.random.default_rng(1).uniform(1, 2, (2, 6, 5, 3))
    scaled = relative_mse((x * scale).astype(np.float32), (r * scale).astype(np.float32))
    assert scaled == pytest.approx(relative_mse(x, r), rel=1e-5)


def test_flip_orders_errors(camera):
    image = random_picture(camera)
    same = measure_errors(image, image, camera)
    assert (same.rmse_codes, same.relative_mse, same.flip) == (0.0, 0.0, 0.0)
    rng = np.random.default_rng(2)
    flips = [
        measure_errors(image * (1 + noise * rng.standard_normal(image.shape)), image, camera).flip
        for noise in (0.01, 0.05, 0.2)
    ]
    assert 0.0 < flips[0] < flips[1] < flips[2] < 1.0
    assert mean_flip(np.full((16, 16, 3), 255.0), np.zeros((16, 16, 3))) > 0.9


def test_missing_packages_are_named(monkeypatch):
    monkeypatch.setattr(reference, "find_spec", lambda name: None)
    with pytest.raises(
        SetupError, match=r"flip-evaluator and matplotlib.*pip install 'pepperscene\[bench\]'"
    ):
        check_packages()


def test_reference_estimates_its_own_error(subject, tmp_path):
    converged = render_reference(subject, tmp_path, target_codes=0.05)
    truth = np.full_like(converged.electrons, subject.renderer.level_e)
    error = rms(develop_codes(converged.electrons, subject.camera) - develop_codes(truth, subject.camera))
    assert converged.error_codes <= 0.05
    assert converged.error_codes == pytest.approx(error, rel=0.15)
    relative = np.mean((converged.electrons / subject.renderer.level_e - 1) ** 2) / 1.01
    assert converged.relative_mse == pytest.approx(relative, rel=0.2)


def test_reference_is_cached_and_refined(subject, tmp_path):
    first = render_reference(subject, tmp_path, target_codes=0.2)
    calls = subject.renderer.calls
    count = len(calls)
    again = render_reference(subject, tmp_path, target_codes=0.2)
    assert len(calls) == count
    np.testing.assert_array_equal(again.electrons, first.electrons)
    # A finer one adds pictures to the cached ones.
    finer = render_reference(subject, tmp_path, target_codes=0.1)
    assert len(calls) == finer.renders
    assert len({seed for *_, seed in calls}) == len(calls)


def test_cache_key_depends_on_scene_and_camera_only(subject):
    moved = dataclasses.replace(subject, camera=dataclasses.replace(subject.camera, exposure_s=1e-3))
    assert moved.digest() != subject.digest()
    assert subject.digest() == dataclasses.replace(subject, renderer=None, scene=None).digest()


def test_damaged_cache_is_ignored_and_a_time_limit_still_gives_two_pictures(subject, tmp_path):
    assert render_reference(subject, tmp_path, target_codes=1e-9, limit_s=0.0).renders == 2
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:100])
    assert render_reference(subject, tmp_path, target_codes=1e-9, limit_s=0.0).renders == 2

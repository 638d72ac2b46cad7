"""Error measures against closed forms; converged pictures and their cache."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pepperscene.bench import image_errors, reference
from pepperscene.bench.image_errors import (
    Errors,
    Reference,
    SquaredError,
    check_packages,
    develop_codes,
    mean_flip,
    measure_errors,
    rms,
)
from pepperscene.bench.reference import render_reference
from pepperscene.bench.scenes import resize_camera
from pepperscene.camera import develop
from pepperscene.errors import SetupError
from pepperscene.render import QUALITIES

SEEDS = 200


@pytest.fixture(autouse=True)
def without_flip(monkeypatch, request):
    """FLIP takes most of the time of errors, and has one test."""
    if request.function is not test_flip_orders_errors:
        monkeypatch.setattr(image_errors, "mean_flip", lambda *_: 0.0)


@pytest.fixture(scope="module")
def wide_camera(full_camera):
    """A camera with more pixels, for statistics."""
    return resize_camera(full_camera, (96, 64))


def ramp(camera, low, high):
    """Electrons that rise from left to right, the same in all channels."""
    shape = (camera.height, camera.width, camera.sensor.channels)
    return np.broadcast_to(np.linspace(low, high, camera.width)[None, :, None], shape)


def noisy(image, noise_e, rng):
    return image + noise_e * rng.standard_normal(image.shape)


def errors_over_seeds(camera, truth, noise_e, reference_noise_e):
    """Errors in codes of images with noise against references with noise, over seeds of both."""
    results = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        halves = np.stack([noisy(truth, reference_noise_e, rng) for _ in range(2)])
        results.append(measure_errors([noisy(truth, noise_e, rng)], Reference(halves, camera)).codes)
    return results


def true_error(camera, truth, noise_e):
    """RMSE in codes of noise, by the derivative of developing: a thousandth of the noise, times 1000."""
    rng, exact = np.random.default_rng(999), develop_codes(truth, camera)
    return 1000 * rms([develop_codes(noisy(truth, noise_e / 1000, rng), camera) - exact for _ in range(40)])


def random_picture(camera, level=2_000.0):
    shape = (camera.height, camera.width, camera.sensor.channels)
    return np.random.default_rng(0).uniform(0.7, 1.0, shape) * level


def test_codes_equal_the_developed_picture_before_rounding(camera):
    image = random_picture(camera)
    exact = dataclasses.replace(camera, developing=dataclasses.replace(camera.developing, quantise=False))
    codes = develop_codes(image, camera)
    assert np.abs(codes - develop(image, exact)).max() <= 0.5 + 1e-3
    assert 50.0 < codes.mean() < 250.0
    steps = dataclasses.replace(camera.developing, tone="linear", pedestal=0.0)
    linear, dark = dataclasses.replace(camera, developing=steps), random_picture(camera, 500.0)
    np.testing.assert_allclose(develop_codes(2 * dark, linear), 2 * develop_codes(dark, linear), atol=1e-3)
    assert np.abs(develop_codes(random_picture(camera, 1e9), camera) - 255.0).max() < 30.0


@pytest.mark.parametrize("reference_noise", [pytest.param(0.0, marks=pytest.mark.long), 3.0])
def test_error_is_that_of_the_noise_however_noisy_the_reference_is(wide_camera, reference_noise):
    noise_e = 30.0
    truth = ramp(wide_camera, 600.0, 3_000.0)
    results = errors_over_seeds(wide_camera, truth, noise_e, reference_noise * noise_e)
    expected = true_error(wide_camera, truth, noise_e) ** 2
    assert expected**0.5 > 0.5
    squares = np.array([result.mean for result in results])
    # The mean over seeds has the expected value, which is known to half a per cent itself.
    tolerance = 3 * squares.std(ddof=1) / SEEDS**0.5 + 0.01 * expected
    assert squares.mean() == pytest.approx(expected, abs=tolerance)
    assert tolerance < 0.05 * expected
    # A normal distribution is within three standard errors in 99.7 % of the cases.
    outside = [abs(result.mean - expected) > 3 * result.standard_error for result in results]
    assert sum(outside) <= 0.02 * SEEDS


@pytest.mark.long
def test_standard_error_is_the_spread_over_seeds(wide_camera):
    # On a uniform image; otherwise differences between its parts are included.
    truth = ramp(wide_camera, 2_000.0, 2_000.0)
    results = errors_over_seeds(wide_camera, truth, 30.0, 30.0)
    spread = np.std([result.mean for result in results], ddof=1)
    stated = np.mean([result.standard_error for result in results])
    # The spread of 200 values is known to 5 %, the mean of 200 standard errors of 24 blocks to 1 %.
    assert stated == pytest.approx(spread, rel=0.15)
    roots = np.std([result.root for result in results], ddof=1)
    assert np.mean([result.root_uncertainty for result in results]) == pytest.approx(roots, rel=0.15)


@pytest.mark.long
def test_noise_of_the_reference_adds_no_bias_in_the_dark(wide_camera):
    # Dark, where the tone curve is most concave; the image has no error.
    truth, noise_e = ramp(wide_camera, 20.0, 120.0), 20.0
    results = errors_over_seeds(wide_camera, truth, 0.0, noise_e)
    squares = np.array([result.mean for result in results])
    error = squares.std(ddof=1) / SEEDS**0.5
    assert abs(squares.mean()) < 3 * error
    # Codes that are not linearised are too low in both halves, and their product is not 0.
    exact = develop_codes(truth, wide_camera)
    biased = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        first, second = (develop_codes(noisy(truth, noise_e, rng), wide_camera) - exact for _ in range(2))
        biased.append((first * second).mean())
    assert np.mean(biased) > 10 * error


@pytest.mark.long
def test_small_errors_are_upper_limits(wide_camera):
    truth = ramp(wide_camera, 600.0, 3_000.0)
    # No error at all: two standard errors are exceeded in 2 % of the cases.
    results = errors_over_seeds(wide_camera, truth, 0.0, 60.0)
    assert sum(result.is_measurable for result in results) <= 0.1 * SEEDS
    for result in results:
        assert (result.root is None) == (result.root_uncertainty is None) == (not result.is_measurable)
    # A small error is below its limit in at least 95 % of the cases.
    small = true_error(wide_camera, truth, 5.0)
    results = errors_over_seeds(wide_camera, truth, 5.0, 60.0)
    assert sum(not result.is_measurable for result in results) > 0.3 * SEEDS
    assert sum(result.root_limit < small for result in results) <= 0.1 * SEEDS


def test_limits_and_uncertainties_follow_from_mean_and_standard_error():
    error = SquaredError(4.0, 0.4)
    assert error.is_measurable
    # The derivative of the root: 0.4 / (2 * 2).
    assert (error.root, error.root_uncertainty) == (2.0, pytest.approx(0.1))
    for mean, limit in ((0.5, 1.3**0.5), (-3.0, 0.8**0.5)):
        unknown = SquaredError(mean, 0.4)
        assert (unknown.root, unknown.root_uncertainty) == (None, None)
        assert unknown.root_limit == pytest.approx(limit)
    assert not SquaredError(0.0, 0.0).is_measurable
    assert Errors.from_json(dataclasses.asdict(Errors(error, error, 0.1))) == Errors(error, error, 0.1)


def test_errors_of_several_images_are_averaged_as_squares(wide_camera):
    truth = ramp(wide_camera, 600.0, 3_000.0)
    exact = Reference(np.stack([truth, truth]), wide_camera)
    images = [noisy(truth, noise_e, np.random.default_rng(3)) for noise_e in (10.0, 40.0)]
    single = [measure_errors([image], exact).codes.mean for image in images]
    assert measure_errors(images, exact).codes.mean == pytest.approx(np.mean(single))
    with pytest.raises(ValueError, match="at least one image"):
        measure_errors([], exact)
    # Light above the full well counts as the full well.
    bright = 2 * truth / truth.min() * wide_camera.sensor.full_well_e
    errors = measure_errors([10 * bright], Reference(np.stack([bright, bright]), wide_camera))
    assert errors.codes.mean == 0.0
    errors = measure_errors([0 * truth], Reference(0 * exact.halves, wide_camera))
    assert (errors.codes.mean, errors.relative.mean, errors.codes.root_limit) == (0.0, 0.0, 0.0)


def test_relative_error_equals_its_formula_in_any_unit(camera):
    # x = (1 + a) r with constant r: (a r)^2 / (r^2 + 0.01 r^2).
    for scale in (1e-30, 1.0, 1e18):
        constant = scale * ramp(camera, 7.0, 7.0)
        relative = measure_errors([1.1 * constant], Reference(np.stack([constant] * 2), camera)).relative
        assert relative.mean == pytest.approx(0.01 / 1.01, rel=1e-6)
        assert relative.standard_error == pytest.approx(0.0, abs=1e-12)


def test_flip_orders_errors(camera):
    image = random_picture(camera)
    exact = Reference(np.stack([image, image]), camera)
    assert measure_errors([image], exact).flip == 0.0
    rng = np.random.default_rng(2)
    noisier = (image * (1 + noise * rng.standard_normal(image.shape)) for noise in (0.01, 0.05, 0.2))
    flips = [measure_errors([one], exact).flip for one in noisier]
    assert 0.0 < flips[0] < flips[1] < flips[2] < 1.0
    assert mean_flip(np.full((16, 16, 3), 255.0), np.zeros((16, 16, 3))) > 0.9


def test_missing_packages_are_named(monkeypatch):
    monkeypatch.setattr(image_errors, "find_spec", lambda name: None)
    with pytest.raises(SetupError, match=r"flip-evaluator and matplotlib.*'pepperscene\[bench\]'"):
        check_packages()


def test_reference_estimates_its_own_error(subject, tmp_path):
    converged = render_reference(subject, tmp_path, target_codes=0.05)
    truth = np.full_like(converged.electrons, subject.renderer.level_e)
    error = rms(develop_codes(converged.electrons, subject.camera) - develop_codes(truth, subject.camera))
    assert converged.error_codes <= 0.05
    assert converged.error_codes == pytest.approx(error, rel=0.15)


def test_images_are_weighted_by_their_samples(subject, tmp_path):
    best = QUALITIES["reference"]
    qualities = [dataclasses.replace(best, samples=n, soft=n, most=n) for n in (4, 16)]
    render_reference(subject, tmp_path, qualities[0], 1e-9, limit_s=0.0)
    result = render_reference(subject, tmp_path, qualities[1], 1e-9, limit_s=0.0)
    assert result.renders == 2  # there was no time for more
    result = render_reference(subject, tmp_path, qualities[1], 1e-9, limit_s=0.0)
    (file,) = tmp_path.iterdir()
    with np.load(file) as arrays:
        assert arrays["weights"].tolist() == [4.0, 4.0]
    halves = reference._Halves(np.zeros((2, 1, 1, 1)))
    for electrons, samples in ((1.0, 4), (2.0, 4), (4.0, 16), (8.0, 16)):
        halves.add(np.full((1, 1, 1), electrons), samples, 0.0)
    # Each image goes to the half with less weight.
    assert halves.reference(subject.camera).halves.ravel() == pytest.approx([(4 + 64) / 20, (8 + 128) / 20])


def test_reference_is_cached_by_scene_and_camera_and_refined(subject, tmp_path):
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
    moved = dataclasses.replace(subject, camera=dataclasses.replace(subject.camera, exposure_s=1e-3))
    assert moved.digest() != subject.digest()
    assert subject.digest() == dataclasses.replace(subject, renderer=None, scene=None).digest()


def test_damaged_cache_is_ignored_and_a_time_limit_still_gives_two_pictures(subject, tmp_path):
    assert render_reference(subject, tmp_path, target_codes=1e-9, limit_s=0.0).renders == 2
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:100])
    assert render_reference(subject, tmp_path, target_codes=1e-9, limit_s=0.0).renders == 2

"""Noise against its closed forms. Every bound is 5 standard errors: a right one fails once in a million."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import stats

from pepperscene.camera import Camera, Developing, camera_rgb, load_flash, load_lens, load_sensor
from pepperscene.camera.readout import shot_noise

SENSOR = dataclasses.replace(load_sensor("ueye_ui5250re"), columns=400, rows=300)
CAMERA = Camera(load_lens("lensagon_cmfa0420nd"), SENSOR, flash=load_flash("led_matrix_200klx"))
N = 400 * 300
SIGMAS = 5.0


@pytest.mark.parametrize("mean", [0.3, 5.0, 31.0, 33.0, 80.0, 1000.0, 6000.0])
def test_shot_noise_has_the_mean_variance_and_skewness_of_poisson(mean):
    n = 1_000_000
    counts = shot_noise(np.full(n, mean, np.float32), np.random.default_rng(11)).astype(float)
    assert counts.min() >= 0
    assert abs(counts.mean() - mean) < SIGMAS * np.sqrt(mean / n)
    # Var of the sample variance: (mu4 - sigma^4) / n with mu4 = 3 m^2 + m.
    assert abs(counts.var() - mean) < SIGMAS * np.sqrt((2 * mean**2 + mean) / n)
    if mean > 30:
        assert abs(stats.skew(counts) - mean**-0.5) < SIGMAS * np.sqrt(6 / n) + 0.02 * mean**-0.5


def test_few_electrons_are_counted_one_by_one():
    counts = shot_noise(np.full(200_000, 4.0, np.float32), np.random.default_rng(12))
    assert np.all(counts == np.rint(counts))
    seen = np.bincount(counts.astype(int), minlength=13)
    expected = stats.poisson.pmf(np.arange(12), 4.0) * counts.size
    found = np.append(seen[:12], seen[12:].sum())
    assert stats.chisquare(found, np.append(expected, counts.size - expected.sum())).pvalue > 1e-6


@pytest.mark.parametrize("mean", [32.5, 100.0, 3000.0])
def test_many_electrons_follow_the_poisson_law(mean):
    # With the continuity correction, the largest gap of the distribution functions stays below 2e-3, which is
    # less than what one step of the converter (6.75 electrons) can tell.
    counts = np.sort(shot_noise(np.full(400_000, mean, np.float32), np.random.default_rng(13)))
    at = np.arange(int(mean - 5 * mean**0.5), int(mean + 5 * mean**0.5))
    empirical = np.searchsorted(counts, at + 0.5) / counts.size
    assert np.abs(empirical - stats.poisson.cdf(at, mean)).max() < 2e-3 + SIGMAS * 0.5 / np.sqrt(counts.size)


def digital_numbers(electrons, seed):
    """Digital numbers above black, `(N, 3)`, of an evenly lit sensor."""
    lit = np.full((300, 400, 3), float(electrons))
    rgb = camera_rgb(lit, CAMERA, np.random.default_rng(seed)).reshape(-1, 3).astype(float)
    return rgb * (SENSOR.full_scale_dn - SENSOR.black_level_dn)


@pytest.mark.parametrize("electrons", [0.0, 80.0, 1500.0, 5000.0])
def test_mean_and_variance_of_the_digital_numbers(electrons):
    gain = SENSOR.gain_e_per_dn
    numbers = digital_numbers(electrons, 21)
    # Shot noise, read noise and the converter's rounding; green is the mean of two photosites.
    variance = (electrons + SENSOR.read_noise_e**2) / gain**2 + 1 / 12
    for channel, sites in enumerate((1, 2, 1)):
        found = numbers[:, channel]
        assert abs(found.mean() - electrons / gain) < SIGMAS * np.sqrt(variance / sites / N)
        assert abs(found.var() / (variance / sites) - 1) < SIGMAS * np.sqrt(2 / N)


def test_photon_transfer_gives_gain_and_read_noise_back():
    # Janesick: the variance rises with the mean by 1/K, and meets zero light at (read noise / K)^2 + 1/12.
    levels = np.linspace(200, 5500, 12)
    numbers = [digital_numbers(level, 30 + i)[:, 0] for i, level in enumerate(levels)]
    mean, variance = np.array([[x.mean(), x.var()] for x in numbers]).T
    slope, intercept = np.polyfit(mean, variance, 1, w=1 / variance)
    assert 1 / slope == pytest.approx(SENSOR.gain_e_per_dn, rel=0.01)
    assert np.sqrt(intercept - 1 / 12) / slope == pytest.approx(SENSOR.read_noise_e, rel=0.05)


def test_a_full_well_is_full_scale_and_no_more():
    assert np.all(camera_rgb(np.full((300, 400, 3), 6800.0), CAMERA) == 1)
    drenched = camera_rgb(np.full((300, 400, 3), 1e6), CAMERA, np.random.default_rng(1))
    assert drenched.max() == 1
    # The well holds no shot noise any more; read noise alone is left, and cut above.
    assert drenched.min() > 1 - 7 * SENSOR.read_noise_e / SENSOR.full_well_e
    quiet = dataclasses.replace(CAMERA, developing=Developing(noise=False))
    np.testing.assert_array_equal(camera_rgb(np.full((300, 400, 3), 99.0), quiet, np.random.default_rng(1)),
                                  camera_rgb(np.full((300, 400, 3), 99.0), quiet))  # fmt: skip

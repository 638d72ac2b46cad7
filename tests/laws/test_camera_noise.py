"""Noise, full wells and converters against closed forms, for a sensor of each kind.

A bound of SIGMAS standard errors fails a correct program once in a million runs; seeds are fixed, so every
run has the same result.
"""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from pepperscene.camera import Camera, Developing, camera_rgb, load_flash, load_lens, load_sensor, raw_frame
from pepperscene.camera.sensor.readout import shot_noise

SENSORS = ("ueye_ui5250re", "onsemi_mt9v024", "onsemi_mt9v024_mono")  # binned, demosaiced, without colours
AVERAGED = ("ueye_ui5250re", "onsemi_mt9v024_mono")
LENS, FLASH = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
SIGMAS = 5.0


def cropped_sensor(name, sites=400, **settings):
    """A shipped sensor with `sites` x `sites` photosites or a few less.

    Its converter resolves the read noise, by more bits if it needs them: rounding adds 1/12 to the variance
    only of a deviation above one step.
    """
    sensor = load_sensor(name).with_settings(**settings)
    while "bits" not in settings and sensor.read_noise_e < sensor.gain_e_per_dn:
        sensor = sensor.with_settings(bits=sensor.bits + 1)
    size = sites // sensor.binning // 2 * 2
    return dataclasses.replace(sensor, columns=size, rows=size)


def flat_frame(sensor, electrons, seed=None, **choices):
    """The raw frame `(site rows, columns)` for the same expected electrons in all photosites."""
    camera = Camera(LENS, sensor, flash=FLASH, developing=Developing(**choices))
    flat = np.full((sensor.rows, sensor.columns, sensor.channels), float(electrons))
    return raw_frame(flat, camera, None if seed is None else np.random.default_rng(seed)).astype(float)


# --- shot noise ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mean", [0.3, 31.0, 33.0, 6000.0])
def test_shot_noise_has_the_mean_variance_and_skewness_of_poisson(mean):
    n = 1_000_000
    counts = shot_noise(np.full(n, mean, np.float32), np.random.default_rng(11)).astype(float)
    assert counts.min() >= 0
    assert abs(counts.mean() - mean) < SIGMAS * np.sqrt(mean / n)
    # Var of the sample variance: (mu4 - sigma^4) / n with mu4 = 3 m^2 + m.
    assert abs(counts.var() - mean) < SIGMAS * np.sqrt((2 * mean**2 + mean) / n)
    if mean > 30:
        assert abs(stats.skew(counts) - mean**-0.5) < SIGMAS * np.sqrt(6 / n) + 0.02 * mean**-0.5


@pytest.mark.parametrize("mean", [32.5, 3000.0])
def test_many_electrons_follow_the_poisson_distribution(mean):
    # With the continuity correction, the distribution functions differ by less than 2e-3, which is less than
    # one step of the converter (2 electrons and more) can resolve.
    counts = np.sort(shot_noise(np.full(400_000, mean, np.float32), np.random.default_rng(13)))
    at = np.arange(int(mean - 5 * mean**0.5), int(mean + 5 * mean**0.5))
    empirical = np.searchsorted(counts, at + 0.5) / counts.size
    assert np.abs(empirical - stats.poisson.cdf(at, mean)).max() < 2e-3 + SIGMAS * 0.5 / np.sqrt(counts.size)


def test_noise_of_photosites_is_uncorrelated():
    # Neighbours, and photosites as far apart as the strips in which the mosaic is processed.
    sensor = dataclasses.replace(load_sensor("ueye_ui5250re_full"), columns=512, rows=1536)
    noise = flat_frame(sensor, 2000.0, 14)
    noise -= noise.mean()
    for down, right in ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (512, 0), (1024, 0)):
        a, b = noise[down:, right:], noise[: noise.shape[0] - down, : noise.shape[1] - right]
        assert abs((a * b).mean()) / noise.var() < SIGMAS / np.sqrt(a.size)


# --- photon transfer ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", AVERAGED)
@pytest.mark.parametrize("level", [0.0, 0.2])
def test_mean_and_variance_of_binned_pixels(name, level):
    # A pixel is the mean of its photosites of a colour; demosaiced ones are not independent and left out.
    sensor = cropped_sensor(name)
    electrons, gain = level * sensor.full_well_e, sensor.gain_e_per_dn
    camera = Camera(LENS, sensor, flash=FLASH)
    flat = np.full((sensor.rows, sensor.columns, sensor.channels), electrons)
    rgb = camera_rgb(flat, camera, np.random.default_rng(21)).reshape(-1, sensor.channels).astype(float)
    numbers = rgb * (sensor.full_scale_dn - sensor.black_level_dn)
    # Shot noise, read noise and the converter's rounding.
    variance = (electrons + sensor.read_noise_e**2) / gain**2 + 1 / 12
    n = len(numbers)
    for channel, sites in enumerate(sensor.photosites):
        values = numbers[:, channel]
        # Rounding a Gaussian of a deviation above 1 moves its mean by less than 1e-8, and its variance too.
        assert abs(values.mean() - electrons / gain) < SIGMAS * np.sqrt(variance / sites / n)
        assert abs(values.var() / (variance / sites) - 1) < SIGMAS * np.sqrt(2 / n)


# --- full well ----------------------------------------------------------------------------------------------


def clipped_mean(mean, full):
    """Mean of a Poisson count clipped at a full well, by summing the distribution's tail."""
    count = np.arange(np.floor(full) + 1)
    return float(
        stats.poisson.sf(count[:-1], mean).sum() + (full - count[-1]) * stats.poisson.sf(count[-1], mean)
    )


@pytest.mark.parametrize("name", SENSORS)
def test_mean_saturates_at_the_full_well(name):
    # From three deviations below the full well to three above. Power: 160,000 photosites give the mean to a
    # 400th of the shot noise's deviation; a well 1 % too large or too small is at least 0.8 deviations off
    # (6,800 electrons: 68 against 82), hundreds of standard errors.
    sensor = cropped_sensor(name, bits=16)
    full, deviation = sensor.full_well_e, np.sqrt(sensor.full_well_e)
    for steps in (-3, -1, 0, 1, 3):
        frame = flat_frame(sensor, full + steps * deviation, 40, read_noise=False)
        mean = (frame.mean() - sensor.black_level_dn) * sensor.gain_e_per_dn
        error = deviation / np.sqrt(frame.size) * SIGMAS + 0.5 * sensor.gain_e_per_dn
        assert mean == pytest.approx(clipped_mean(full + steps * deviation, full), abs=error)


@pytest.mark.parametrize("name", SENSORS)
def test_saturated_photosites_have_no_shot_noise(name):
    sensor = cropped_sensor(name)
    for electrons in (1.5 * sensor.full_well_e, 1e6, 1e30):
        assert np.all(flat_frame(sensor, electrons, 41, read_noise=False) == sensor.full_scale_dn)
    # Read noise remains; with the full well in the middle of the range it is not clipped.
    low = dataclasses.replace(sensor, gain=0.5)
    frame = flat_frame(low, 1e6, 42)
    deviation = np.hypot(low.read_noise_e / low.gain_e_per_dn, np.sqrt(1 / 12))
    middle = low.black_level_dn + (low.full_scale_dn - low.black_level_dn) / 2
    assert abs(frame.mean() - middle) < SIGMAS * deviation / np.sqrt(frame.size)
    assert abs(frame.std() / deviation - 1) < SIGMAS / np.sqrt(2 * frame.size) + 0.01


# --- converter ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bits", "gain"), [(1, 1.0), (8, 0.5), (12, 2.0), (16, 1.0)])
def test_converter_rounds_to_its_steps(bits, gain):
    sensor = load_sensor("onsemi_mt9v024_mono").with_settings(bits=bits, gain=gain)
    sensor = dataclasses.replace(sensor, columns=1000, rows=200)
    electrons = np.linspace(0, 1.1 * sensor.full_well_e, 200_000)
    camera = Camera(LENS, sensor, flash=FLASH)
    raw = raw_frame(electrons.reshape(200, 1000, 1), camera).ravel()
    assert raw.dtype == np.uint16
    assert np.all(np.diff(raw.astype(int)) >= 0)
    # Each number represents the electrons within half a step on both sides (to single precision).
    back = (raw - sensor.black_level_dn) * sensor.gain_e_per_dn
    top = min(sensor.full_well_e, sensor.full_well_e / gain)
    assert np.abs(back - np.minimum(electrons, top)).max() <= sensor.gain_e_per_dn * (
        0.5 + 2.0 ** (bits - 22)
    )
    # Every number of the range occurs: from the black level to saturation.
    highest = round(sensor.black_level_dn + top / sensor.gain_e_per_dn)
    assert set(raw) == set(range(round(sensor.black_level_dn), highest + 1))
    # Steps and upper end can be left out.
    free = dataclasses.replace(camera, developing=Developing(quantise=False, saturation=False))
    rgb = camera_rgb(electrons.reshape(200, 1000, 1), free).ravel()
    np.testing.assert_allclose(rgb, electrons / sensor.full_well_e * gain, atol=2e-6)


@pytest.mark.parametrize("choice", ["shot_noise", "read_noise"])
def test_each_noise_can_be_disabled(choice):
    sensor = cropped_sensor("ueye_ui5250re")
    alone = {"shot_noise": sensor.read_noise_e**2, "read_noise": 3000.0}[choice]
    frame = flat_frame(sensor, 3000.0, 50, **{choice: False})
    variance = alone / sensor.gain_e_per_dn**2 + 1 / 12
    assert abs(frame.var() / variance - 1) < SIGMAS * np.sqrt(2 / frame.size)
    still = flat_frame(sensor, 3000.0, 50, shot_noise=False, read_noise=False)
    np.testing.assert_array_equal(still, flat_frame(sensor, 3000.0))

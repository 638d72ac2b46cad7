"""Colour observables and their derivatives, and the sensor model compared with the camera."""

from __future__ import annotations

import colorsys
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, f, norm
from simulated_fits import FEW_SAMPLES, no_patches

from pepperscene.camera import (
    Camera,
    Developing,
    add_pedestal,
    camera_rgb,
    correct_colours,
    decode_tone,
    encode_tone,
    load_lens,
    load_sensor,
)
from pepperscene.colour import linear_srgb_to_lab
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.spectra import colour_science
from pepperscene.tuning.observables import (
    OBSERVABLE_COUNT,
    SensorModel,
    hue_vectors,
    lab_derivatives,
    observables,
    observables_and_derivatives,
    standardised_noise,
)
from pepperscene.tuning.target import TuningTarget

SIGNIFICANCE = 1e-4
"""Of each statistical test, for all its comparisons together: a correct camera fails once in ten thousand."""

COLOURS = np.concatenate(
    [
        np.random.default_rng(3).random((300, 3)),
        1e-3 * np.random.default_rng(4).random((100, 3)),  # below the knees of CIELAB and of the sRGB curve
        [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.2, 0.2, 0.2]],
    ]
)


def finite_differences(function, at, step):
    """`(..., 3)` central differences with respect to red, green and blue."""
    axes = np.eye(3) * step
    return np.stack([(function(at + axis) - function(at - axis)) / (2.0 * step) for axis in axes], axis=-1)


def encode(linear):
    """The sRGB curve of colour-science."""
    return np.asarray(colour_science().cctf_encoding(linear, function="sRGB"))


def test_derivatives_of_lab_match_finite_differences():
    inside = np.clip(COLOURS, 1e-5, 1.0)
    knee = np.abs(inside @ np.array([0.2126, 0.7152, 0.0722]) - (6.0 / 29.0) ** 3) < 1e-4
    expected = finite_differences(linear_srgb_to_lab, inside, 1e-7)
    assert lab_derivatives(inside)[~knee] == pytest.approx(expected[~knee], rel=1e-4, abs=1e-3)


def test_hues_agree_with_hsv():
    """The hexagon of HSV and the circle differ by 1.2 degrees at most, and agree on pure colours."""
    bright = COLOURS[:300]
    bright = bright[np.ptp(encode(bright), axis=1) > 0.1]
    vectors, _ = hue_vectors(bright)
    hues = np.degrees(np.arctan2(vectors[:, 1], vectors[:, 0]))
    expected = 360.0 * np.array([colorsys.rgb_to_hsv(*codes)[0] for codes in encode(bright)])
    assert np.abs((hues - expected + 180.0) % 360.0 - 180.0).max() < 1.25
    pure, _ = hue_vectors(np.eye(3))
    assert np.degrees(np.arctan2(pure[:, 1], pure[:, 0])) % 360.0 == pytest.approx([0.0, 120.0, 240.0])


def test_grey_has_no_hue_and_equal_pixels_no_spread():
    vectors, _ = hue_vectors(np.full((5, 3), 0.3))
    assert vectors == pytest.approx(np.zeros((5, 2)))
    length = np.linalg.norm(hue_vectors(np.array([[0.3, 0.3, 0.31], [0.3, 0.2, 0.1]]))[0], axis=1)
    assert length[0] < 0.99 < length[1] < 1.0
    values, derivatives = observables_and_derivatives(np.full((9, 3), 0.3), np.ones((2, 9, 3)))
    assert values[3:6] == pytest.approx(0.0, abs=1e-9)
    assert np.isfinite(derivatives).all()


def test_derivatives_of_hue_match_finite_differences():
    inside = np.clip(COLOURS, 1e-4, 0.999)
    inside = inside[(np.abs(inside - 0.0031308) > 1e-5).all(axis=1)]
    expected = finite_differences(lambda at: hue_vectors(at)[0], inside, 1e-7)
    assert hue_vectors(inside)[1] == pytest.approx(expected, rel=1e-4, abs=1e-3)


def test_observables_are_mean_spread_and_hue():
    pixels = COLOURS[:50]
    values = observables(pixels)
    assert values.shape == (OBSERVABLE_COUNT,)
    assert values[:3] == pytest.approx(linear_srgb_to_lab(pixels.mean(axis=0)))
    assert values[3:6] == pytest.approx(linear_srgb_to_lab(pixels).std(axis=0))
    assert values[6:] == pytest.approx(hue_vectors(pixels)[0].mean(axis=0))
    # Neither order nor repetition of pixels matters.
    assert observables(pixels[::-1]) == pytest.approx(values)
    assert observables(np.repeat(pixels, 3, axis=0)) == pytest.approx(values)


def test_derivatives_of_observables_match_finite_differences():
    rng = np.random.default_rng(8)
    pixels, of_pixels = 0.1 + 0.7 * rng.random((60, 3)), rng.standard_normal((4, 60, 3))
    values, derivatives = observables_and_derivatives(pixels, of_pixels)
    assert values == pytest.approx(observables(pixels))
    h = 1e-6
    expected = [
        (observables(pixels + h * one) - observables(pixels - h * one)) / (2.0 * h) for one in of_pixels
    ]
    assert derivatives == pytest.approx(np.array(expected).T, rel=1e-5, abs=1e-5)


def test_standardised_noise_has_mean_0_and_sd_1():
    noise = standardised_noise(500, 3, np.random.default_rng(1))
    assert noise.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    assert noise.std(axis=0) == pytest.approx(np.ones(3))
    assert np.array_equal(noise, standardised_noise(500, 3, np.random.default_rng(1)))


SIDE = 120
GAINS, MATRIX = (1.9, 1.0, 1.4), ((1.6, -0.5, -0.1), (-0.25, 1.4, -0.15), (0.1, -0.6, 1.5))
LOW_GAINS = (0.9, 0.5, 0.7)
"""Light that fills the well then stays below white."""

LIGHTS = {
    "dim leaf": (1.0, (400.0, 900.0, 300.0), GAINS),
    "bright fruit": (1.0, (1500.0, 3500.0, 900.0), GAINS),
    "four times the gain": (4.0, (300.0, 900.0, 250.0), GAINS),
    "gains below 1": (1.0, (1500.0, 3500.0, 2500.0), LOW_GAINS),
    "saturated with gains below 1": (1.0, (20_000.0, 30_000.0, 15_000.0), LOW_GAINS),
    "full wells at half the gain": (0.5, (20_000.0, 30_000.0, 15_000.0), GAINS),
    "red alone saturated": (2.0, (12_000.0, 900.0, 500.0), GAINS),
}
"""Sensor gain, electrons and white balance."""
SATURATED = ("saturated with gains below 1", "full wells at half the gain")


def camera_of(gain=1.0, gains=GAINS, sensor="ueye_ui5250re", matrix=MATRIX, **steps) -> Camera:
    return Camera(
        lens=load_lens("lensagon_cmfa0420nd"),
        sensor=replace(load_sensor(sensor).with_settings(gain=gain), columns=SIDE, rows=SIDE),
        developing=Developing(white_balance=gains, colour_matrix=matrix, **steps),
    )


def photograph(camera: Camera, electrons) -> np.ndarray:
    """`(n, 3)` linear sRGB of a uniform field by the camera."""
    field = np.broadcast_to(np.asarray(electrons, float), (SIDE, SIDE, 3))
    rgb = camera_rgb(field, camera, np.random.default_rng(1))
    return np.clip(correct_colours(rgb, camera), 0.0, 1.0).reshape(-1, 3).astype(float)


def modelled(camera: Camera, electrons, **noise_kinds) -> np.ndarray:
    """`(n, 3)` linear sRGB of a uniform field by the sensor model."""
    noise = standardised_noise(SIDE**2, 3, np.random.default_rng(2))
    model = SensorModel(camera.sensor, camera.developing.saturation, noise, **noise_kinds)
    field = np.broadcast_to(np.asarray(electrons, float), (SIDE**2, 3))
    matrix = camera.developing.colour_matrix
    gains = np.array(camera.developing.white_balance)
    return model.linear(field, 1.0, gains, np.eye(3) if matrix is False else np.array(matrix))


@pytest.mark.parametrize("sensor", ["ueye_ui5250re", "nikon_d5100"])
@pytest.mark.parametrize("light", LIGHTS)
def test_means_agree_with_the_camera(light, sensor):
    gain, electrons, gains = LIGHTS[light]
    camera = camera_of(gain, gains, sensor)
    electrons = np.array(electrons) * camera.sensor.full_well_e / 6800.0
    taken, model = photograph(camera, electrons), modelled(camera, electrons)
    codes = 255.0 * (encode(taken.mean(axis=0)) - encode(model.mean(axis=0)))
    if light in SATURATED:
        # The camera adds the amplifier's noise to a full well; the model clips it with the rest.
        assert np.abs(codes).max() < 0.3, codes
    else:
        error = np.sqrt((taken.var(axis=0) + model.var(axis=0)) / len(taken)) + 1e-6
        deviations = (taken.mean(axis=0) - model.mean(axis=0)) / error
        comparisons = 2 * (len(LIGHTS) - len(SATURATED)) * 3
        assert np.abs(deviations).max() < norm.isf(SIGNIFICANCE / comparisons / 2.0), deviations


@pytest.mark.parametrize("fraction", [0.97, 1.0, 1.03])
def test_means_near_saturation_agree_within_the_noise(fraction):
    """The camera clips single photosites, the model clips the resulting pixel."""
    camera = camera_of(gains=(1, 1, 1), matrix=False)
    electrons = np.full(3, fraction * camera.sensor.full_well_e)
    difference = photograph(camera, electrons).mean(axis=0) - modelled(camera, electrons).mean(axis=0)
    sd = np.sqrt(electrons + camera.sensor.read_noise_e**2) / camera.sensor.full_well_e
    assert (np.abs(difference) < 0.25 * sd).all(), difference / sd


@pytest.mark.parametrize(("shot", "read"), [(True, False), (False, True)])
@pytest.mark.parametrize("sensor", ["ueye_ui5250re", "nikon_d5100"])
def test_noise_agrees_with_the_camera(sensor, shot, read):
    """In each channel; greens are means of more photosites."""
    kinds = {"shot_noise": shot, "read_noise": read}
    camera = camera_of(sensor=sensor, gains=(1.0, 1.0, 1.0), matrix=False, quantise=False, **kinds)
    electrons = np.array([700.0, 1500.0, 300.0])
    # The model's deviates have a variance of exactly 1.
    degrees = SIDE**2 - 1
    taken, model = photograph(camera, electrons), modelled(camera, electrons, **kinds)
    ratio = degrees * taken.var(axis=0, ddof=1) / model.var(axis=0)
    tail = SIGNIFICANCE / (4 * 3) / 2.0
    assert ((ratio > chi2.ppf(tail, degrees)) & (ratio < chi2.isf(tail, degrees))).all(), ratio / degrees


def test_saturation_clips_full_wells_and_codes_end_at_1():
    unlimited = SensorModel(load_sensor("ueye_ui5250re"), False, None)
    bright, ones = np.full((1, 3), 9000.0), np.ones(3)
    assert unlimited.linear(bright, 0.5, ones, np.eye(3)) == pytest.approx(0.5 * 9000.0 / 6800.0)
    assert unlimited.linear(bright, 1.0, ones, np.eye(3)) == pytest.approx(1.0)
    limited = replace(unlimited, saturation=True)
    assert limited.linear(bright, 0.5, ones, np.eye(3)) == pytest.approx(0.5)  # the well is full


def test_exposure_scales_gain_or_time():
    """Twice the gain doubles the reading of a full well; in twice the time more wells are full."""
    sensor = load_sensor("ueye_ui5250re")
    gain, time = (SensorModel(sensor, True, None, scales_time=scales_time) for scales_time in (False, True))
    ones, dim, bright = np.ones(3), np.full((1, 3), 1000.0), np.full((1, 3), 10_000.0)
    for model in (gain, time):
        assert model.linear(dim, 2.0, ones, np.eye(3)) == pytest.approx(2000.0 / 6800.0)
    assert gain.linear(bright, 0.5, ones, np.eye(3)) == pytest.approx(0.5)
    assert time.linear(bright, 0.5, ones, np.eye(3)) == pytest.approx(5000.0 / 6800.0)


@pytest.mark.parametrize("pedestal", [0.0, 0.02])
@pytest.mark.parametrize("scales_time", [False, True])
@pytest.mark.parametrize("exposure", [0.6, 1.7])
def test_slopes_of_the_sensor_model_match_finite_differences(exposure, scales_time, pedestal):
    """With respect to electrons, in random directions, where a step crosses no limit."""
    rng = np.random.default_rng(5)
    sensor = load_sensor("ueye_ui5250re")
    electrons, direction = 7000.0 * rng.random((400, 3)), rng.standard_normal((400, 3))
    model = SensorModel(sensor, True, standardised_noise(400, 3, rng), scales_time=scales_time)
    model = replace(model, pedestal=pedestal)
    gains, matrix, h = np.array(GAINS), np.array(MATRIX), 1e-3
    steps = (0.0, h, -h)
    here, above, below = (
        model.linear_and_slopes(electrons + step * direction, exposure, gains, matrix) for step in steps
    )
    derivative = here[2] * ((here[1] * direction) @ matrix.T)
    expected = (above[0] - below[0]) / (2.0 * h)
    saturated = [(slope == 0.0).any(axis=1) for _, slope, _ in (here, above, below)]
    same = (above[2] == below[2]) & (saturated[1] == saturated[2])[:, None]
    assert same.mean() > 0.95
    assert derivative[same] == pytest.approx(expected[same], rel=1e-5, abs=1e-9)
    assert 0.05 < saturated[0].mean() < 0.95
    assert 0.05 < here[2].mean() < 0.95


@pytest.mark.long
def test_standard_errors_of_a_view_are_those_of_camera_images():
    """Images of the same light, by the camera's steps down to 8-bit codes."""
    patches = no_patches(["leaf"])
    target = TuningTarget(load_recipe("barth2018"), patches, organs=1, pixels=24, quality=FEW_SAMPLES)
    (model,) = target.view_models
    parts, camera, mask = target.tuned_parts({}), model.view.camera, model.view.mask
    electrons = np.zeros((camera.height, camera.width, 3))
    electrons[mask] = model.electrons(parts)
    samples = []
    for seed in range(40):
        linear = correct_colours(camera_rgb(electrons, camera, np.random.default_rng(seed)), camera)
        linear = add_pedestal(linear, camera)
        samples.append(observables(decode_tone(encode_tone(linear)[mask])))
    ratio = np.var(samples, axis=0, ddof=1) / model.standard_errors(parts) ** 2
    # The observables are correlated: each has its part of the significance.
    tail = SIGNIFICANCE / OBSERVABLE_COUNT / 2.0
    assert ((ratio > f.ppf(tail, 39, 23)) & (ratio < f.isf(tail, 39, 23))).all(), ratio

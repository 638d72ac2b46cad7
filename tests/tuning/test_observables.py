"""Colours that a fit compares, their derivatives, and a camera in formulas: against the camera itself."""

from __future__ import annotations

import colorsys
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, f, norm
from simulated_fits import no_patches

from pepperscene.camera import (
    Camera,
    Developing,
    camera_rgb,
    correct_colours,
    decode_tone,
    encode_tone,
    load_lens,
    load_sensor,
)
from pepperscene.dataset import load_recipe
from pepperscene.render.quality import Quality
from pepperscene.spectra import colour_science
from pepperscene.tuning.model.observables import (
    OBSERVABLE_COUNT,
    SensorModel,
    hues,
    linear_srgb_to_lab,
    lab_derivatives,
    numbers,
    observables_and_derivatives,
    standardised_noise,
)
from pepperscene.tuning.model.target import TuningTarget

SIGNIFICANCE = 1e-4
"""Of each statistical test, all its comparisons together: a right camera fails once in ten thousand."""

COLOURS = np.concatenate(
    [
        np.random.default_rng(3).random((300, 3)),
        1e-3 * np.random.default_rng(4).random((100, 3)),  # below the knees of CIELAB and of the sRGB curve
        [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.2, 0.2, 0.2]],
    ]
)


def differences(of, at: np.ndarray, step: float) -> np.ndarray:
    """`(..., 3)` central differences by red, green and blue."""
    axes = np.eye(3) * step
    return np.stack([(of(at + axis) - of(at - axis)) / (2.0 * step) for axis in axes], axis=-1)


# --- CIELAB -----------------------------------------------------------------------------------------------


def test_lab_is_that_of_colour_science():
    colour = colour_science()
    encoded = colour.cctf_encoding(COLOURS, function="sRGB")
    wanted = colour.XYZ_to_Lab(colour.sRGB_to_XYZ(encoded))
    # Both round the matrix of the standard, to four digits.
    assert linear_srgb_to_lab(COLOURS) == pytest.approx(wanted, abs=0.05)
    assert linear_srgb_to_lab(np.ones(3)) == pytest.approx([100.0, 0.0, 0.0], abs=0.02)


def test_slopes_of_lab_are_its_differences():
    inside = np.clip(COLOURS, 1e-5, 1.0)
    knee = np.abs(inside @ np.array([0.2126, 0.7152, 0.0722]) - (6.0 / 29.0) ** 3) < 1e-4
    found, wanted = lab_derivatives(inside), differences(linear_srgb_to_lab, inside, 1e-7)
    assert found[~knee] == pytest.approx(wanted[~knee], rel=1e-4, abs=1e-3)


# --- hue --------------------------------------------------------------------------------------------------


def test_hues_are_those_of_hsv():
    """The hexagon of HSV and the circle differ by 1.2 degrees at most, and agree on pure colours."""
    bright = COLOURS[:300]
    bright = bright[np.ptp(encoded_sides(bright), axis=1) > 0.1]
    direction, _ = hue_vectors(bright)
    found = np.degrees(np.arctan2(direction[:, 1], direction[:, 0]))
    wanted = 360.0 * np.array([colorsys.rgb_to_hsv(*codes)[0] for codes in encoded_sides(bright)])
    off = (found - wanted + 180.0) % 360.0 - 180.0
    assert np.abs(off).max() < 1.25
    pure, _ = hue_vectors(np.eye(3))
    assert np.degrees(np.arctan2(pure[:, 1], pure[:, 0])) % 360.0 == pytest.approx([0.0, 120.0, 240.0])


def encoded_sides(linear: np.ndarray) -> np.ndarray:
    """The sRGB curve, by colour-science."""
    return np.asarray(colour_science().cctf_encoding(linear, function="sRGB"))


def test_grey_has_no_hue():
    direction, _ = hue_vectors(np.full((5, 3), 0.3))
    assert direction == pytest.approx(np.zeros((5, 2)))
    length = np.linalg.norm(hue_vectors(np.array([[0.3, 0.3, 0.31], [0.3, 0.2, 0.1]]))[0], axis=1)
    assert length[0] < 0.99 < length[1] < 1.0


def test_slopes_of_hue_are_its_differences():
    inside = np.clip(COLOURS, 1e-4, 0.999)
    inside = inside[(np.abs(inside - 0.0031308) > 1e-5).all(axis=1)]
    found, wanted = hue_vectors(inside)[1], differences(lambda at: hue_vectors(at)[0], inside, 1e-7)
    assert found == pytest.approx(wanted, rel=1e-4, abs=1e-3)


# --- numbers ----------------------------------------------------------------------------------------------


def test_numbers_are_mean_spread_and_hue():
    pixels = COLOURS[:50]
    found = observables(pixels)
    assert found.shape == (OBSERVABLE_COUNT,)
    assert found[:3] == pytest.approx(linear_srgb_to_lab(pixels.mean(axis=0)))
    assert found[3:6] == pytest.approx(linear_srgb_to_lab(pixels).std(axis=0))
    assert found[6:] == pytest.approx(hue_vectors(pixels)[0].mean(axis=0))
    # The order of pixels does not matter, nor how many times the same ones are counted.
    assert observables(pixels[::-1]) == pytest.approx(found)
    assert observables(np.repeat(pixels, 3, axis=0)) == pytest.approx(found)


def test_slopes_of_numbers_are_their_differences():
    rng = np.random.default_rng(8)
    pixels, slopes = 0.1 + 0.7 * rng.random((60, 3)), rng.standard_normal((4, 60, 3))
    found, by_slopes = observables_and_derivatives(pixels, slopes)
    assert found == pytest.approx(observables(pixels))
    h = 1e-6
    wanted = [(observables(pixels + h * one) - observables(pixels - h * one)) / (2.0 * h) for one in slopes]
    assert by_slopes == pytest.approx(np.array(wanted).T, rel=1e-5, abs=1e-5)


def test_pixels_all_alike_have_no_spread_and_finite_slopes():
    found, slopes = observables_and_derivatives(np.full((9, 3), 0.3), np.ones((2, 9, 3)))
    assert found[3:6] == pytest.approx(0.0, abs=1e-9)
    assert np.isfinite(slopes).all()


def test_noise_leaves_means_alone():
    drawn = standardised_noise(500, 3, np.random.default_rng(1))
    assert drawn.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    assert drawn.std(axis=0) == pytest.approx(np.ones(3))
    assert np.array_equal(drawn, standardised_noise(500, 3, np.random.default_rng(1)))


# --- the photograph ---------------------------------------------------------------------------------------

SIDE = 120
GAINS, MATRIX = (1.9, 1.0, 1.4), ((1.6, -0.5, -0.1), (-0.25, 1.4, -0.15), (0.1, -0.6, 1.5))
DIM = (0.9, 0.5, 0.7)
"""Gains below 1: light that fills the well then stays below white."""

SCENES = {
    "dim leaf": (1.0, (400.0, 900.0, 300.0), GAINS),
    "bright fruit": (1.0, (1500.0, 3500.0, 900.0), GAINS),
    "half the gain": (0.5, (1500.0, 3500.0, 900.0), GAINS),
    "four times the gain": (4.0, (300.0, 900.0, 250.0), GAINS),
    "gains below 1": (1.0, (1500.0, 3500.0, 2500.0), DIM),
    "blown out": (1.0, (20_000.0, 30_000.0, 15_000.0), GAINS),
    "blown out with gains below 1": (1.0, (20_000.0, 30_000.0, 15_000.0), DIM),
    "full wells at half the gain": (0.5, (20_000.0, 30_000.0, 15_000.0), GAINS),
    "red alone blown out": (2.0, (12_000.0, 900.0, 500.0), GAINS),
}
FULL = ("blown out", "blown out with gains below 1", "full wells at half the gain")


def bench(gain=1.0, gains=GAINS, sensor="ueye_ui5250re", **steps) -> Camera:
    own = load_sensor(sensor).with_settings(gain=gain)
    return Camera(
        lens=load_lens("lensagon_cmfa0420nd"),
        sensor=replace(own, columns=SIDE, rows=SIDE),
        developing=Developing(white_balance=gains, colour_matrix=MATRIX, **steps),
    )


def taken(camera: Camera, electrons, seed: int) -> np.ndarray:
    """`(n, 3)` linear sRGB of a plain field, as the camera makes it."""
    field = np.broadcast_to(np.asarray(electrons, float), (SIDE, SIDE, 3))
    rgb = camera_rgb(field, camera, np.random.default_rng(seed))
    return np.clip(correct_colours(rgb, camera), 0.0, 1.0).reshape(-1, 3).astype(float)


def in_formulas(camera: Camera, electrons, seed: int, **how) -> np.ndarray:
    """The same by `SensorModel`."""
    noise = standardised_noise(SIDE**2, 3, np.random.default_rng(seed))
    photograph = SensorModel(camera.sensor, camera.developing.saturation, noise, **how)
    field = np.broadcast_to(np.asarray(electrons, float), (SIDE**2, 3))
    gains = np.array(camera.developing.white_balance)
    return photograph.linear(field, 1.0, gains, np.array(camera.developing.colour_matrix))


def deviations(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """`(3,)` how far two means lie apart, in standard errors of both."""
    error = np.sqrt((one.var(axis=0) + other.var(axis=0)) / len(one)) + 1e-6
    return np.asarray((one.mean(axis=0) - other.mean(axis=0)) / error)


@pytest.mark.parametrize("sensor", ["ueye_ui5250re", "nikon_d5100"])
@pytest.mark.parametrize("scene", SCENES)
def test_means_are_those_of_the_camera(scene, sensor):
    gain, electrons, gains = SCENES[scene]
    camera = bench(gain, gains, sensor)
    electrons = np.array(electrons) * camera.sensor.full_well_e / 6800.0
    here, there = taken(camera, electrons, 1), in_formulas(camera, electrons, 2)
    codes = 255.0 * (encoded_sides(here.mean(axis=0)) - encoded_sides(there.mean(axis=0)))
    if scene in FULL:
        # The amplifier's noise comes behind a full well, and is cut with the rest in the formulas.
        assert np.abs(codes).max() < 0.3, codes
    else:
        found, comparisons = deviations(here, there), 2 * (len(SCENES) - len(FULL)) * 3
        assert np.abs(found).max() < norm.isf(SIGNIFICANCE / comparisons / 2.0), found


@pytest.mark.parametrize("share", [0.97, 0.99, 1.0, 1.01, 1.03])
def test_near_the_limit_means_are_those_of_the_camera_to_a_part_of_the_noise(share):
    """There photosites are cut one by one, and the formulas cut the pixel that they make."""
    camera = replace(bench(), developing=Developing(white_balance=(1, 1, 1), colour_matrix=False))
    electrons = np.full(3, share * camera.sensor.full_well_e)
    noise = standardised_noise(SIDE**2, 3, np.random.default_rng(2))
    model = SensorModel(camera.sensor, True, noise).linear(
        np.broadcast_to(electrons, (SIDE**2, 3)), 1.0, np.ones(3), np.eye(3)
    )
    off = taken(camera, electrons, 1).mean(axis=0) - model.mean(axis=0)
    sd = np.sqrt(electrons + camera.sensor.read_noise_e**2) / camera.sensor.full_well_e
    assert (np.abs(off) < 0.25 * sd).all(), off / sd


@pytest.mark.parametrize(("shot", "read"), [(True, True), (True, False), (False, True)])
@pytest.mark.parametrize("sensor", ["ueye_ui5250re", "nikon_d5100"])
def test_noise_is_that_of_the_camera(sensor, shot, read):
    """Channel by channel: greens are means of more photosites."""
    steps = {"shot_noise": shot, "read_noise": read, "quantise": False}
    camera = bench(sensor=sensor, gains=(1.0, 1.0, 1.0), **steps)
    camera = replace(camera, developing=replace(camera.developing, colour_matrix=False))
    electrons = np.array([700.0, 1500.0, 300.0])
    here = taken(camera, electrons, 1)
    noise = standardised_noise(SIDE**2, 3, np.random.default_rng(2))
    photograph = SensorModel(camera.sensor, True, noise, shot, read)
    there = photograph.linear(np.broadcast_to(electrons, (SIDE**2, 3)), 1.0, np.ones(3), np.eye(3))
    # The formulas' deviates have the variance 1 exactly.
    degrees = SIDE**2 - 1
    ratio = degrees * here.var(axis=0, ddof=1) / there.var(axis=0)
    tail = SIGNIFICANCE / (6 * 3) / 2.0
    assert ((ratio > chi2.ppf(tail, degrees)) & (ratio < chi2.isf(tail, degrees))).all(), ratio / degrees


def test_no_noise_and_no_limit_are_told():
    camera = bench(saturation=False)
    bright = np.array([[9000.0, 9000.0, 9000.0]])
    plain = SensorModel(camera.sensor, False, None)
    gains = np.array([1.0, 1.0, 1.0])
    assert plain.linear(bright, 0.5, gains, np.eye(3)) == pytest.approx(0.5 * 9000.0 / 6800.0)
    assert plain.linear(bright, 1.0, gains, np.eye(3)) == pytest.approx(1.0)  # codes end there
    full = replace(plain, saturation=True)
    assert full.linear(bright, 0.5, gains, np.eye(3)) == pytest.approx(0.5)  # the well is full


def test_exposure_is_one_of_gain_or_of_time():
    """Twice the gain doubles what a full well reads; in twice the time more wells fill."""
    sensor = load_sensor("ueye_ui5250re")
    gain, time = (SensorModel(sensor, True, None, scales_time=timed) for timed in (False, True))
    ones, some, much = np.ones(3), np.full((1, 3), 1000.0), np.full((1, 3), 10_000.0)
    for one in (gain, time):
        assert one.linear(some, 2.0, ones, np.eye(3)) == pytest.approx(2000.0 / 6800.0)
    assert gain.linear(much, 0.5, ones, np.eye(3)) == pytest.approx(0.5)
    assert time.linear(much, 0.5, ones, np.eye(3)) == pytest.approx(5000.0 / 6800.0)


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize("exposure", [0.6, 1.0, 1.7])
def test_slopes_of_the_photograph_are_its_differences(exposure, timed):
    """By electrons, in every direction, where a step crosses no limit."""
    rng = np.random.default_rng(5)
    sensor = load_sensor("ueye_ui5250re")
    electrons, along = 7000.0 * rng.random((400, 3)), rng.standard_normal((400, 3))
    photograph = SensorModel(sensor, True, standardised_noise(400, 3, rng), scales_time=timed)
    gains, matrix = np.array(GAINS), np.array(MATRIX)

    def cut(at):
        _, slope, free = photograph.linear_and_slopes(at, exposure, gains, matrix)
        return (slope == 0.0).any(axis=1), free

    h = 1e-3
    ends = [electrons + h * along, electrons - h * along]
    above, below = (photograph.linear(end, exposure, gains, matrix) for end in ends)
    _, slope, free = photograph.linear_and_slopes(electrons, exposure, gains, matrix)
    found = free * ((slope * along) @ matrix.T)
    same = (cut(ends[0])[1] == cut(ends[1])[1]) & (cut(ends[0])[0] == cut(ends[1])[0])[:, None]
    assert same.mean() > 0.95
    assert found[same] == pytest.approx(((above - below) / (2.0 * h))[same], rel=1e-5, abs=1e-9)
    saturated, kept = cut(electrons)
    assert 0.05 < saturated.mean() < 0.95
    assert 0.05 < kept.mean() < 0.95


# --- a view's own noise -----------------------------------------------------------------------------------


def test_numbers_of_one_picture_vary_as_the_view_says():
    """Pictures of the same light, by the camera's own chain down to 8-bit codes."""
    few = Quality(4, 4, 4, 1, target=None, denoise=False)
    subject = TuningTarget(load_recipe("barth2018"), no_patches(["leaf"]), organs=1, pixels=24, quality=few)
    (eye,) = subject.view_models
    parts, camera = subject.tuned({}), eye.view.camera
    electrons = np.zeros((camera.height, camera.width, 3))
    electrons[eye.view.mask] = eye.electrons(parts)
    seen = []
    for seed in range(40):
        linear = correct_colours(camera_rgb(electrons, camera, np.random.default_rng(seed)), camera)
        seen.append(observables(decode_tone(encode_tone(linear)[eye.view.mask])))
    ratio = np.var(seen, axis=0, ddof=1) / eye.noise(parts) ** 2
    # Mean and hue vary together in the eight numbers: each has its share of the significance.
    tail = SIGNIFICANCE / OBSERVABLE_COUNT / 2.0
    assert ((ratio > f.ppf(tail, 39, 23)) & (ratio < f.isf(tail, 39, 23))).all(), ratio

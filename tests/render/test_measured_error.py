"""The error that is measured in some pixels, against errors that are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pepperscene.camera import Camera, Developing, load_lens, load_sensor
from pepperscene.camera.image.electrons import electrons_per_light, image_electrons
from pepperscene.camera.optics.lens import StrayLight
from pepperscene.render.transport.measured_error import measured_error

SENSOR = replace(load_sensor("ueye_ui5250re"), columns=320, rows=240)
CAMERA = Camera(
    load_lens("lensagon_cmfa0420nd"),
    SENSOR,
    np.eye(4),
    1e-3,
    developing=Developing(white_balance=None, tone="linear", colour_matrix=False, falloff=False),
)


def of_fraction(fraction: float) -> float:
    """Light that fills a fraction of the sensor's range."""
    per_code = SENSOR.gain_e_per_dn * (SENSOR.full_scale_dn - SENSOR.black_level_dn)
    return fraction * per_code / float(electrons_per_light(CAMERA)[0, 0])


@pytest.mark.parametrize(("noise", "means"), [(0.0, 4), (0.04, 4), (0.15, 8)])
def test_it_is_the_error_of_the_image_whatever_noise_the_means_have(noise, means):
    rng = np.random.default_rng(6)
    shape = (CAMERA.height, CAMERA.width, 3)
    error = rng.normal(0.0, 0.02, shape)
    image = of_fraction(0.5) * (1.0 + error)
    numbers = []

    def independent(pixels, number):
        numbers.append(number)
        deviations = np.random.default_rng(number).normal(0.0, noise, (len(pixels), 3))
        return (of_fraction(0.5) * (1.0 + deviations)).astype(np.float32)

    # Of 2,304 pixels; with the most noise, the square has a standard error of 13 %.
    measured = measured_error(CAMERA, image.astype(np.float32), independent)
    assert measured == pytest.approx(0.02 * 0.5 * 255.0, rel=0.05 if noise == 0.0 else 0.2)
    # Means are as many as their noise needs.
    assert numbers == list(range(means))


@pytest.mark.parametrize("size", [0.0, 2.0], ids=["independent", "of neighbours"])
def test_stray_light_averages_errors(size):
    """Errors that neighbours share remain; the standard error of the ratio is about 3 %."""
    lens = replace(CAMERA.lens, stray_light=StrayLight(scatter=0.6, scatter_width_m=4e-6))
    camera = replace(CAMERA, lens=lens, developing=replace(CAMERA.developing, stray_light=True))
    error = np.random.default_rng(6).normal(0.0, 0.1, (camera.height, camera.width, 3))
    light = of_fraction(0.5) * np.array(
        [np.ones(error.shape), 1.0 + gaussian_filter(error, (size, size, 0.0))]
    )
    even, image = light.astype(np.float32)
    measured = measured_error(camera, image, lambda pixels, _: even.reshape(-1, 3)[pixels])
    electrons = [image_electrons(part.copy(), camera) for part in (even, image)]
    difference = 0.5 * 255.0 * (electrons[1] / electrons[0] - 1.0)
    assert measured == pytest.approx(np.sqrt(np.mean(np.square(difference))), rel=0.1)


def test_means_that_are_too_noisy_tell_nothing():
    image = np.full((CAMERA.height, CAMERA.width, 3), of_fraction(0.5), np.float32)

    def opposite(pixels, number):
        return image.reshape(-1, 3)[pixels] + np.float32(of_fraction(0.1) * (-1) ** number)

    assert measured_error(CAMERA, image, opposite) is None

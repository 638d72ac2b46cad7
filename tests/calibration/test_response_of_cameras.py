"""The joint fit of white balance, matrix and tone curve against cameras whose processing is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden_cameras import HiddenCamera, balanced, chart_corners, natural_reflectances, photographed_chart

from pepperscene.calibration.photographs import ChartPhotograph, measure_chart
from pepperscene.calibration.response import card_response, fit_response
from pepperscene.camera import decode_tone, load_sensor
from pepperscene.camera.image.colorimetry import (
    NM,
    colour_checker_reflectances,
    colour_correction,
    d65_spectrum,
    srgb_encode,
)
from pepperscene.colour import delta_e_2000, linear_srgb_to_lab

CHART = colour_checker_reflectances().at(NM)
CAMERAS = {
    "plain": HiddenCamera(),
    "contrasty": HiddenCamera(contrast=0.4, saturation=1.2, balance=(1.05, 1, 0.93), lift=0.02, quality=90),
    "dull": HiddenCamera(gamma=0.8, white=0.55, balance=(0.9, 1, 1.1), saturation=0.8, quality=85),
    "dark corners": HiddenCamera(contrast=0.45, white=0.8, saturation=1.2, vignetting=0.35),
    "flat": HiddenCamera(gamma=1.15, white=0.8, contrast=-0.3, lift=0.05, sharpening=0.8, quality=85),
}


def start_matrix(sensor):
    return colour_correction(load_sensor(sensor), d65_spectrum()).matrix


def fitted(camera, pictures):
    photographs = [measure_chart(picture, corners, "x") for picture, corners in pictures]
    rgb = balanced(camera.sensor, CHART)
    return fit_response(photographs, rgb, start_matrix(camera.sensor), np.random.default_rng(0))


def differences(first, second):
    """CIEDE2000 of codes in 0 to 1."""
    return delta_e_2000(*(linear_srgb_to_lab(decode_tone(255.0 * codes)) for codes in (first, second)))


@pytest.mark.parametrize("name", CAMERAS)
def test_colours_of_natural_surfaces_are_those_of_the_camera(name):
    camera = CAMERAS[name]
    response = fitted(camera, [photographed_chart(camera)])
    for reflectance in (CHART, natural_reflectances()):
        shown = response.codes(balanced(camera.sensor, reflectance), response.exposures[0])
        error = differences(shown, camera.codes(reflectance))
        assert np.median(error) < 0.5
        assert np.quantile(error, 0.95) < 1.5
    assert response.gains == pytest.approx(np.array(camera.balance) / camera.balance[1], abs=0.01)


def test_charts_at_several_positions_give_the_vignetting_and_their_exposures():
    camera = replace(CAMERAS["contrasty"], vignetting=0.3)
    places = ((0.5, 0.5), (0.38, 0.36), (0.63, 0.62))
    pictures = [
        photographed_chart(replace(camera, white=white), seed=number, middle=middle, pitch=60.0)
        for number, (middle, white) in enumerate(zip(places, (0.7, 0.55, 0.7), strict=True))
    ]
    response = fitted(camera, pictures)
    assert response.vignetting[0] == pytest.approx(-0.3, abs=0.03)
    assert response.exposures[1] / response.exposures[0] == pytest.approx(0.55 / 0.7, rel=0.02)


def drawn_photograph(camera, rng, error):
    """A photograph whose fields deviate from the camera's codes by independent normal errors."""
    codes = camera.codes(CHART) + rng.normal(0.0, error, (24, 3))
    picture = np.zeros((480, 640, 3), np.uint8)
    corners = chart_corners((480, 640))
    centres = np.array([[column + 0.5, row + 0.5] for row in range(4) for column in range(6)])
    place = (corners[0] + centres * 75.0 - [320.0, 240.0]) / 400.0
    return ChartPhotograph(
        "x", picture, corners, np.arange(24), codes, (codes > 0.01) & (codes < 0.99), place, ()
    )


def test_standard_deviations_cover_the_truth():
    """z of gains and matrix over 50 draws; rows of the matrix sum to 1, so that two columns are free."""
    camera, start = HiddenCamera(white=0.7), start_matrix("generic_rgb")
    rgb, rng, scores = balanced(camera.sensor, CHART), np.random.default_rng(7), []
    for _ in range(50):
        response = fit_response([drawn_photograph(camera, rng, 0.006)], rgb, start, rng)
        scores.append(
            np.concatenate([
                (response.gains[[0, 2]] - 1.0) / response.sd["gains"][[0, 2]],
                ((response.matrix - start) / response.sd["matrix"])[:, :2].ravel(),
            ])
        )  # fmt: skip
    scores = np.array(scores)
    assert 0.7 < np.sqrt((scores**2).mean()) < 1.4
    assert 0.85 < (np.abs(scores) < 2.0).mean() <= 0.99


def test_grey_cards_give_the_white_balance():
    camera = HiddenCamera(balance=(1.1, 1.0, 0.85))
    codes = srgb_encode(0.3 * np.ones((16, 3)) @ camera.matrix.T)
    codes = codes + np.random.default_rng(0).normal(0, 1e-4, codes.shape)
    place = np.random.default_rng(1).uniform(-0.5, 0.5, (16, 2))
    card = ChartPhotograph(
        "x", np.zeros((4, 4, 3), np.uint8), np.zeros((4, 2)), np.full(16, -1), codes,
        np.ones((16, 3), bool), place, (),
    )  # fmt: skip
    response = card_response([card], start_matrix(camera.sensor), np.random.default_rng(0))
    assert response.gains == pytest.approx([1.1, 1.0, 0.85], abs=0.005)
    assert (response.sd["gains"] < 0.005).all()

"""Slanted edges against the closed form of a Gaussian blur, and of an unsharp mask."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from pepperscene.calibration.edges import FREQUENCIES, line_spread, mtf50, transfer

MIDDLE = np.array([50.3, 49.6])
UP_TO_NYQUIST = FREQUENCIES <= 0.5


def edge(sigma, angle_deg, noise=0.002):
    """An image `(100, 100)` of an edge, sampled at points, and two points beside it."""
    angle = np.radians(angle_deg)
    along, normal = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    y, x = np.mgrid[:100, :100] + 0.5
    distance = (x - MIDDLE[0]) * normal[0] + (y - MIDDLE[1]) * normal[1]
    image = 0.1 + 0.6 * ndtr(distance / sigma)
    image += np.random.default_rng(1).normal(0.0, noise, image.shape)
    # The given line is turned and displaced against the edge.
    return image, MIDDLE - 20 * along + 0.7 * normal, MIDDLE + 20 * along - 0.3 * normal


@pytest.mark.parametrize("angle_deg", [2.0, -7.0, 30.0, 95.0, 185.0])
@pytest.mark.parametrize("sigma", [0.5, 0.8, 1.2, 2.0])
def test_blurred_edges_have_the_transfer_of_a_gaussian(sigma, angle_deg):
    spread = line_spread(*edge(sigma, angle_deg), 12.0)
    mtf = transfer(spread)
    expected = np.exp(-2.0 * (np.pi * sigma * FREQUENCIES) ** 2)
    assert mtf[UP_TO_NYQUIST] == pytest.approx(expected[UP_TO_NYQUIST], abs=0.025)
    assert mtf50(mtf) == pytest.approx(np.sqrt(np.log(2.0) / 2.0) / (np.pi * sigma), rel=0.02)
    assert abs(spread.sum()) == pytest.approx(0.6, rel=0.02)


def test_sharpened_edges_have_the_transfer_of_the_mask():
    image, start, end = edge(1.0, 6.0, noise=0.001)
    sharpened = image + 0.8 * (image - gaussian_filter(image, 1.5, truncate=6.0))
    mtf = transfer(line_spread(sharpened, start, end, 12.0))
    blur, mask = (np.exp(-2.0 * (np.pi * sd * FREQUENCIES) ** 2) for sd in (1.0, 1.5))
    expected = blur * (1.0 + 0.8 * (1.0 - mask))
    assert mtf[UP_TO_NYQUIST] == pytest.approx(expected[UP_TO_NYQUIST], abs=0.03)


@pytest.mark.parametrize("angle_deg", [0.0, 0.5, 90.0])
def test_edges_along_the_pixels_are_not_measured(angle_deg):
    assert line_spread(*edge(0.8, angle_deg), 12.0) is None


def test_edges_without_contrast_or_outside_the_image_are_not_measured():
    image, start, end = edge(0.8, 5.0)
    assert line_spread(np.full_like(image, 0.5), start, end, 12.0) is None
    assert line_spread(image, start + np.array([0.0, 45.0]), end + np.array([0.0, 45.0]), 12.0) is None

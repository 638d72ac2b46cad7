from __future__ import annotations

import colorsys

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.truth import HUE_BINS, centre_crop, hue_bins, hue_counts, hue_spectrum_correlation, mean_hue

BYTE = st.integers(0, 255)


@given(BYTE, BYTE, BYTE)
def test_the_bin_holds_the_hue_of_the_standard_library(red, green, blue):
    found = int(hue_bins(np.array([red, green, blue], np.uint8)))
    hue, saturation, _ = colorsys.rgb_to_hsv(red / 255, green / 255, blue / 255)
    if saturation == 0:
        assert found == -1
    else:
        away = abs(360.0 * hue - 2.0 * found) % 360.0
        assert min(away, 360.0 - away) <= 1.0 + 1e-9


def test_bins_are_those_of_opencv():
    colour = np.random.default_rng(1).integers(0, 256, (400, 500, 3)).astype(np.uint8)
    theirs = cv2.cvtColor(colour, cv2.COLOR_RGB2HSV)[..., 0].astype(int)
    ours = hue_bins(colour).astype(int)
    away = np.abs(ours - theirs)[ours >= 0] % HUE_BINS
    # OpenCV divides by a table of 12 bits: what lies on a border may fall on the other side.
    assert np.minimum(away, HUE_BINS - away).max() <= 1
    assert (away > 0).mean() < 0.03


def test_pixels_are_counted_once_under_their_class():
    rng = np.random.default_rng(2)
    colour = rng.integers(0, 4, (40, 30, 3)).astype(np.uint8)
    class_id = rng.choice(np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 255], np.uint8), (40, 30))
    counts = hue_counts(colour, class_id)
    assert counts.shape == (8, HUE_BINS + 1)
    bins = hue_bins(colour)
    for organ_class in range(8):
        there = bins[class_id == organ_class]
        assert counts[organ_class].sum() == there.size
        assert counts[organ_class, HUE_BINS] == (there == -1).sum()
        assert all(counts[organ_class, k] == (there == k).sum() for k in range(HUE_BINS))


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="three channels"):
        hue_bins(np.zeros((2, 2, 4), np.uint8))
    with pytest.raises(ValueError, match="uint8"):
        hue_bins(np.zeros((2, 2, 3)))
    with pytest.raises(ValueError, match="one size"):
        hue_counts(np.zeros((2, 2, 3), np.uint8), np.zeros((2, 3), np.uint8))


@pytest.mark.parametrize(
    ("shape", "kept"), [((600, 800), (300, 300)), ((346, 613), (300, 300)), ((200, 900), (200, 300))]
)
def test_the_middle_is_the_middle(shape, kept):
    image = np.arange(shape[0] * shape[1]).reshape(shape)
    middle = centre_crop(image)
    assert middle.shape == kept
    rows, columns = np.divmod(middle, shape[1])
    for places, length in ((rows, shape[0]), (columns, shape[1])):
        # As much is left on both sides, to a pixel.
        assert abs(places.min() - (length - 1 - places.max())) <= 1


@given(st.floats(0.0, 359.0), st.floats(5.0, 40.0))
def test_the_mean_hue_of_a_bell_is_its_middle(middle, width):
    away = (2.0 * np.arange(HUE_BINS) - middle + 180.0) % 360.0 - 180.0
    found = mean_hue(np.exp(-0.5 * (away / width) ** 2))
    assert abs((found - middle + 180.0) % 360.0 - 180.0) < 0.01


def test_an_even_spectrum_has_no_mean_hue_and_no_correlation():
    even = np.full(HUE_BINS, 0.5)
    assert np.isnan(mean_hue(even))
    assert np.isnan(mean_hue(np.zeros(HUE_BINS)))
    assert np.isnan(hue_spectrum_correlation(even, np.arange(HUE_BINS)))


def test_correlation_knows_no_scale():
    spectrum = np.random.default_rng(3).random(HUE_BINS)
    assert hue_spectrum_correlation(spectrum, 3.0 * spectrum + 1.0) == pytest.approx(1.0)
    assert hue_spectrum_correlation(spectrum, 2.0 - spectrum) == pytest.approx(-1.0)

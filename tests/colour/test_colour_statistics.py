"""CIELAB and hue statistics of pixels: against colour-science, and their invariances."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest

from pepperscene.colour import ColourStatistics, linear_srgb_to_lab
from pepperscene.colour.statistics import mean_hue_fractions
from pepperscene.spectra import colour_science
from pepperscene.truth.statistics import hue_counts

RNG = np.random.default_rng(20180102)
CODES = RNG.integers(0, 256, (500, 3), dtype=np.uint8)
LINEAR = RNG.beta(2.0, 4.0, (400, 3))


def test_lab_agrees_with_colour_science():
    colour = colour_science()
    xyz = colour.RGB_to_XYZ(LINEAR, "sRGB")
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    # The matrix of IEC 61966-2-1 has four digits.
    assert linear_srgb_to_lab(LINEAR) == pytest.approx(colour.XYZ_to_Lab(xyz, white), abs=0.02)


def test_mean_is_linear_and_spread_is_in_lab():
    statistics = ColourStatistics.from_pixels(LINEAR)
    lab = linear_srgb_to_lab(LINEAR)
    assert statistics.n == 400
    assert statistics.mean_lab == pytest.approx(linear_srgb_to_lab(LINEAR.mean(axis=0)))
    assert statistics.lab_of_pixels == pytest.approx(lab.mean(axis=0))
    assert statistics.covariance == pytest.approx(np.cov(lab.T, ddof=0))
    assert statistics.sd == pytest.approx(lab.std(axis=0))
    # Lightness is concave: the mean colour is lighter than the mean lightness.
    assert statistics.mean_lab[0] > statistics.lab_of_pixels[0]


def test_equal_pixels_have_no_spread():
    statistics = ColourStatistics.from_pixels(np.tile([[0.1, 0.3, 0.05]], (7, 1)))
    assert statistics.mean_lab == pytest.approx(statistics.lab_of_pixels)
    assert statistics.sd == pytest.approx(np.zeros(3), abs=1e-12)
    assert statistics.resultant_length == pytest.approx(1.0)
    assert statistics.circular_sd_deg == pytest.approx(0.0, abs=1e-5)


def test_hue_spectrum_agrees_with_truth_and_mean_hue_with_hsv():
    statistics = ColourStatistics.from_pixels(LINEAR, CODES)
    counts = hue_counts(CODES[None], np.ones((1, 500), np.uint8))[1]
    assert statistics.hue_spectrum == pytest.approx(100.0 * counts[:180] / counts.sum())
    assert statistics.hue_spectrum.sum() == pytest.approx(100.0 * (1.0 - statistics.grey_share))
    hues = np.array([colorsys.rgb_to_hsv(*(pixel / 255.0))[0] for pixel in CODES if np.ptp(pixel) > 0])
    direction = np.exp(2j * np.pi * hues).mean()
    # Bins are two degrees wide.
    assert statistics.resultant_length == pytest.approx(abs(direction), abs=0.005)
    deviation = abs(statistics.mean_hue_deg - np.degrees(np.angle(direction)) % 360.0)
    assert deviation < 1.0 / abs(direction) / 5.0


def test_order_of_pixels_does_not_matter():
    shuffled = LINEAR[RNG.permutation(len(LINEAR))]
    a, b = ColourStatistics.from_pixels(LINEAR), ColourStatistics.from_pixels(shuffled)
    assert (a.hue_spectrum == b.hue_spectrum).all()
    assert (a.mean_hue_deg, a.kappa) == (b.mean_hue_deg, b.kappa)
    for name in ("mean_lab", "lab_of_pixels", "sd", "covariance"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), rel=1e-12, abs=1e-10)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_rotating_hues_by_thirds_rotates_their_mean_only(turns):
    # Red to green to blue is a third of the circle.
    codes = RNG.integers((150, 20, 10), (250, 120, 60), (300, 3)).astype(np.uint8)
    a, b = (
        ColourStatistics.from_pixels(LINEAR, codes),
        ColourStatistics.from_pixels(LINEAR, np.roll(codes, turns, axis=1)),
    )
    assert (b.mean_hue_deg - a.mean_hue_deg) % 360.0 == pytest.approx(120.0 * turns % 360.0)
    assert b.circular_sd_deg == pytest.approx(a.circular_sd_deg)
    assert b.kappa == pytest.approx(a.kappa)
    assert (b.hue_spectrum == np.roll(a.hue_spectrum, 60 * turns)).all()


@pytest.mark.parametrize("bins", [1, 37, 179, 180])
def test_rotating_a_spectrum_by_bins_rotates_its_mean_by_two_degrees_each(bins):
    counts = np.append(np.bincount(RNG.integers(30, 90, 1000), minlength=180), 12)
    a = ColourStatistics.from_pixels(LINEAR, hues=counts)
    b = ColourStatistics.from_pixels(LINEAR, hues=np.append(np.roll(counts[:180], bins), 12))
    assert (b.mean_hue_deg - a.mean_hue_deg - 2.0 * bins + 180.0) % 360.0 == pytest.approx(180.0)
    assert b.grey_share == a.grey_share


def test_grey_pixels_and_no_pixels_have_no_hue():
    grey = ColourStatistics.from_pixels(np.full((5, 3), 0.2))
    assert grey.grey_share == 1.0
    assert np.isnan(grey.mean_hue_deg)
    assert grey.mean_lab[1:] == pytest.approx([0.0, 0.0], abs=0.02)
    empty = ColourStatistics.from_pixels(np.empty((0, 3)))
    assert empty.n == 0
    assert np.isnan(empty.mean_lab).all()
    assert np.isnan(empty.hue_spectrum).all()


def test_rejects_arrays_of_other_shapes():
    with pytest.raises(ValueError, match="must be"):
        ColourStatistics.from_pixels(np.zeros((3, 4)))
    with pytest.raises(ValueError, match="hues must be"):
        ColourStatistics.from_pixels(np.zeros((3, 3)), hues=np.ones(180))


def test_pictures_have_equal_weight_in_any_order():
    counts = {f"p{k}": [RNG.multinomial(50 * 10**k, np.full(181, 1 / 181))] for k in range(4)}
    fractions = mean_hue_fractions(counts)
    assert fractions.sum() == pytest.approx(1.0)
    assert fractions == pytest.approx(np.mean([one[0] / one[0].sum() for one in counts.values()], axis=0))
    assert (mean_hue_fractions(dict(reversed(counts.items()))) == fractions).all()

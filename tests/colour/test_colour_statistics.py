"""CIELAB and hue statistics of pixels: against colour-science, and in what must not change them."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest

from pepperscene.colour import ColourStatistics, linear_srgb_to_lab
from pepperscene.colour.statistics.colours import mean_hue_shares
from pepperscene.spectra import colour_science
from pepperscene.truth.statistics import hue_counts

RNG = np.random.default_rng(20180102)
CODES = RNG.integers(0, 256, (500, 3), dtype=np.uint8)
LINEAR = RNG.beta(2.0, 4.0, (400, 3))


def test_lab_is_colour_sciences() -> None:
    colour = colour_science()
    xyz = colour.RGB_to_XYZ(LINEAR, "sRGB")
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    # The matrix of IEC 61966-2-1 has four digits.
    assert linear_srgb_to_lab(LINEAR) == pytest.approx(colour.XYZ_to_Lab(xyz, white), abs=0.02)


def test_the_mean_is_that_of_light_and_the_spread_that_of_what_is_seen() -> None:
    found = ColourStatistics.of(LINEAR)
    pixels = linear_srgb_to_lab(LINEAR)
    assert found.n == 400
    assert found.mean_lab == pytest.approx(linear_srgb_to_lab(LINEAR.mean(axis=0)))
    assert found.lab_of_pixels == pytest.approx(pixels.mean(axis=0))
    assert found.covariance == pytest.approx(np.cov(pixels.T, ddof=0))
    assert found.sd == pytest.approx(pixels.std(axis=0))
    # Lightness is concave in light, so that the mean colour is lighter than the mean of the lightnesses.
    assert found.mean_lab[0] > found.lab_of_pixels[0]


def test_equal_pixels_have_no_spread() -> None:
    found = ColourStatistics.of(np.tile([[0.1, 0.3, 0.05]], (7, 1)))
    assert found.mean_lab == pytest.approx(found.lab_of_pixels)
    assert found.sd == pytest.approx(np.zeros(3), abs=1e-12)
    assert found.resultant_length == pytest.approx(1.0)
    assert found.circular_sd_deg == pytest.approx(0.0, abs=1e-5)


def test_the_hue_spectrum_is_that_of_a_picture_with_one_class() -> None:
    found = ColourStatistics.of(LINEAR, CODES)
    counts = hue_counts(CODES[None], np.ones((1, 500), np.uint8))[1]
    assert found.hue_spectrum == pytest.approx(100.0 * counts[:180] / counts.sum())
    assert found.hue_spectrum.sum() == pytest.approx(100.0 * (1.0 - found.grey_share))


def test_the_mean_hue_is_that_of_the_pixels_hsv() -> None:
    hues = np.array([colorsys.rgb_to_hsv(*(pixel / 255.0))[0] for pixel in CODES if np.ptp(pixel) > 0])
    direction = np.exp(2j * np.pi * hues).mean()
    found = ColourStatistics.of(LINEAR, CODES)
    # Bins are two degrees wide.
    assert found.resultant_length == pytest.approx(abs(direction), abs=0.005)
    assert abs(found.mean_hue_deg - np.degrees(np.angle(direction)) % 360.0) < 1.0 / abs(direction) / 5.0


def test_the_order_of_pixels_does_not_matter() -> None:
    mixed = RNG.permutation(len(LINEAR))
    one, other = ColourStatistics.of(LINEAR), ColourStatistics.of(LINEAR[mixed])
    assert (one.hue_spectrum == other.hue_spectrum).all()
    assert (one.mean_hue_deg, one.kappa) == (other.mean_hue_deg, other.kappa)
    for name in ("mean_lab", "lab_of_pixels", "sd", "covariance"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-12, abs=1e-10)


def test_turning_the_hue_turns_its_mean_and_nothing_else() -> None:
    # Red to green to blue is a third of the circle.
    codes = RNG.integers((150, 20, 10), (250, 120, 60), (300, 3)).astype(np.uint8)
    one = ColourStatistics.of(LINEAR, codes)
    for turns in (1, 2, 3):
        other = ColourStatistics.of(LINEAR, np.roll(codes, turns, axis=1))
        assert (other.mean_hue_deg - one.mean_hue_deg) % 360.0 == pytest.approx(120.0 * turns % 360.0)
        assert other.circular_sd_deg == pytest.approx(one.circular_sd_deg)
        assert other.kappa == pytest.approx(one.kappa)
        assert (other.hue_spectrum == np.roll(one.hue_spectrum, 60 * turns)).all()


@pytest.mark.parametrize("bins", [1, 37, 179, 180])
def test_a_spectrum_turned_by_bins_turns_the_mean_by_twice_so_many_degrees(bins: int) -> None:
    counts = np.append(np.bincount(RNG.integers(30, 90, 1000), minlength=180), 12)
    one = ColourStatistics.of(LINEAR, hues=counts)
    other = ColourStatistics.of(LINEAR, hues=np.append(np.roll(counts[:180], bins), 12))
    assert (other.mean_hue_deg - one.mean_hue_deg - 2.0 * bins + 180.0) % 360.0 == pytest.approx(180.0)
    assert other.grey_share == one.grey_share


def test_grey_has_no_hue() -> None:
    grey = ColourStatistics.of(np.full((5, 3), 0.2))
    assert grey.grey_share == 1.0
    assert np.isnan(grey.mean_hue_deg)
    assert grey.mean_lab[1:] == pytest.approx([0.0, 0.0], abs=0.02)


def test_no_pixels_have_no_colour() -> None:
    none = ColourStatistics.of(np.empty((0, 3)))
    assert none.n == 0
    assert np.isnan(none.mean_lab).all()
    assert np.isnan(none.hue_spectrum).all()
    with pytest.raises(ValueError, match="must be"):
        ColourStatistics.of(np.zeros((3, 4)))
    with pytest.raises(ValueError, match="hues must be"):
        ColourStatistics.of(np.zeros((3, 3)), hues=np.ones(180))


def test_each_picture_counts_the_same_in_any_order() -> None:
    counts = {f"p{k}": [RNG.multinomial(50 * 10**k, np.full(181, 1 / 181))] for k in range(4)}
    shares = mean_hue_shares(counts)
    assert shares.sum() == pytest.approx(1.0)
    assert shares == pytest.approx(np.mean([found[0] / found[0].sum() for found in counts.values()], axis=0))
    assert (mean_hue_shares(dict(reversed(counts.items()))) == shares).all()

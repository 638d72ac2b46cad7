"""CIELAB, CIEDE2000 and hue statistics of pixels: published values, colour-science, and invariances."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest

from pepperscene.colour import ColourStatistics, delta_e_2000, linear_srgb_to_lab
from pepperscene.colour.statistics import mean_hue_fractions
from pepperscene.spectra import colour_science
from pepperscene.truth.statistics import hue_counts

RNG = np.random.default_rng(20180102)
CODES = RNG.integers(0, 256, (500, 3), dtype=np.uint8)
LINEAR = RNG.beta(2.0, 4.0, (400, 3))


def test_lab_agrees_with_colour_science():
    colour = colour_science()
    # With dark colours below the knee of the curve, black and white.
    linear = np.concatenate([LINEAR, 1e-3 * LINEAR, [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]])
    xyz = colour.RGB_to_XYZ(linear, "sRGB")
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    # The matrix of IEC 61966-2-1 has four digits.
    assert linear_srgb_to_lab(linear) == pytest.approx(colour.XYZ_to_Lab(xyz, white), abs=0.02)


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


SHARMA_2005 = np.array(
    [
        [50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425],
        [50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615],
        [50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412],
        [50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, -1.1848, -84.8006, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, -0.9009, -85.5211, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669],
        [50.0000, -1.0000, 2.0000, 50.0000, 0.0000, 0.0000, 2.3669],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0010, 7.1792],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0012, 7.2195],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0010, -2.4900, 4.8045],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461],
        [50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065],
        [50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492],
        [50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977],
        [50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030],
        [50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.1736, 0.5854, 1.0000],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.2972, 0.0000, 1.0000],
        [50.0000, 2.5000, 0.0000, 50.0000, 1.8634, 0.5757, 1.0000],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.2592, 0.3350, 1.0000],
        [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
        [63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630],
        [61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731],
        [35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645],
        [22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373],
        [36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146],
        [90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441],
        [90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381],
        [6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377],
        [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
    ]
)
"""L1, a1, b1, L2, a2, b2, CIEDE2000 of the 34 pairs that reveal errors in implementations.

G. Sharma, W. Wu, E. N. Dalal 2005, "The CIEDE2000 color-difference formula: implementation notes,
supplementary test data, and mathematical observations", Color Res. Appl. 30:21-30, Table 1.
"""


def test_delta_e_2000_has_the_published_values_and_is_symmetric():
    assert SHARMA_2005.shape == (34, 7)
    first, second, expected = SHARMA_2005[:, :3], SHARMA_2005[:, 3:6], SHARMA_2005[:, 6]
    assert delta_e_2000(first, second) == pytest.approx(expected, abs=1e-4)
    assert delta_e_2000(second, first) == pytest.approx(delta_e_2000(first, second), abs=1e-10)
    assert delta_e_2000(first, first) == pytest.approx(np.zeros(34), abs=1e-12)

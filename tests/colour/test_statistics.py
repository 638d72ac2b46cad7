"""Circular statistics, CIELAB and hues of pixels: SciPy, colour-science, a linear programme, invariances."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest
from scipy import optimize, stats

from pepperscene.colour import ColourStatistics, delta_e_2000, linear_srgb_to_lab
from pepperscene.colour.statistics import (
    bin_angles,
    circular_emd,
    circular_mean,
    circular_sd,
    mean_hue_fractions,
    resultant_length,
    von_mises_kappa,
)
from pepperscene.spectra import colour_science
from pepperscene.truth.statistics import hue_counts

RNG = np.random.default_rng(20180101)


def angle_between(first, second):
    return abs((first - second + 180.0) % 360.0 - 180.0)


@pytest.mark.parametrize("kappa", [0.3, 50.0])
def test_mean_and_spread_equal_scipys(kappa):
    angles = np.degrees(RNG.vonmises(3.0, kappa, 400))
    assert angle_between(circular_mean(angles), stats.circmean(angles, high=360.0)) < 1e-9
    assert circular_sd(angles) == pytest.approx(stats.circstd(angles, high=360.0), rel=1e-12)
    assert resultant_length(angles) == pytest.approx(1.0 - stats.circvar(angles, high=360.0), rel=1e-12)
    # Weights count like repeated angles.
    weights = RNG.integers(0, 4, angles.size)
    assert circular_sd(angles, weights) == pytest.approx(circular_sd(np.repeat(angles, weights)), rel=1e-9)


@pytest.mark.parametrize("kappa", [1e-7, 0.3, 50.0, 1e5])
def test_von_mises_kappa_inverts_the_mean_cosine(kappa):
    angle = np.linspace(-np.pi, np.pi, 100_000, endpoint=False)
    density = np.exp(kappa * (np.cos(angle) - 1.0))
    length = float((density * np.cos(angle)).sum() / density.sum())
    assert von_mises_kappa(length) == pytest.approx(kappa, rel=1e-6)


def test_limits_of_one_direction_and_of_no_direction():
    assert circular_sd([17.0, 17.0]) == pytest.approx(0.0, abs=1e-5)
    assert von_mises_kappa(1.0) == np.inf
    assert resultant_length(bin_angles(180)) < 1e-15
    assert np.isnan(circular_mean(bin_angles(180)))
    assert np.isnan(circular_mean([]))
    assert np.isnan(resultant_length([]))
    assert angle_between(circular_mean([359.0, 1.0]), 0.0) < 1e-9
    assert np.isnan(circular_emd(np.zeros(4), np.ones(4)))


def optimal_transport(first, second):
    """Earth mover's distance by its definition: a linear programme over all pairs of bins."""
    n = first.size
    centres = bin_angles(n)
    costs = np.abs((centres[:, None] - centres[None, :] + 180.0) % 360.0 - 180.0)
    outgoing = np.kron(np.eye(n), np.ones(n))
    incoming = np.kron(np.ones(n), np.eye(n))
    totals = np.concatenate([first / first.sum(), second / second.sum()])
    # The default tolerance, 1e-7, is larger than some of the masses.
    tolerances = dict.fromkeys(("primal_feasibility_tolerance", "dual_feasibility_tolerance"), 1e-10)
    constraints = np.vstack([outgoing, incoming])[:-1]
    plan = optimize.linprog(costs.ravel(), A_eq=constraints, b_eq=totals[:-1], options=tolerances)
    assert plan.status == 0
    return float(plan.fun)


@pytest.mark.parametrize("bins", [5, 18])
def test_earth_movers_distance_equals_optimal_transport(bins):
    rng = np.random.default_rng(bins)
    for _ in range(10):
        first, second = rng.gamma(0.3, size=(2, bins))
        assert circular_emd(first, second) == pytest.approx(optimal_transport(first, second), abs=1e-6)


def test_rejects_invalid_histograms_and_weights():
    with pytest.raises(ValueError, match="one length"):
        circular_emd(np.ones(3), np.ones(4))
    with pytest.raises(ValueError, match="negative"):
        circular_emd([-1.0, 2.0], [1.0, 1.0])
    with pytest.raises(ValueError, match="weights"):
        circular_mean([1.0, 2.0], [1.0])


PIXEL_RNG = np.random.default_rng(20180102)
CODES = PIXEL_RNG.integers(0, 256, (500, 3), dtype=np.uint8)
LINEAR = PIXEL_RNG.beta(2.0, 4.0, (400, 3))


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


def test_rotating_hues_by_a_third_rotates_their_mean_only():
    # Red to green is a third of the circle.
    codes = PIXEL_RNG.integers((150, 20, 10), (250, 120, 60), (300, 3)).astype(np.uint8)
    a, b = (ColourStatistics.from_pixels(LINEAR, np.roll(codes, turns, axis=1)) for turns in (0, 1))
    assert (b.mean_hue_deg - a.mean_hue_deg) % 360.0 == pytest.approx(120.0)
    assert b.circular_sd_deg == pytest.approx(a.circular_sd_deg)
    assert b.kappa == pytest.approx(a.kappa)
    assert (b.hue_spectrum == np.roll(a.hue_spectrum, 60)).all()


def test_grey_pixels_and_no_pixels_have_no_hue():
    grey = ColourStatistics.from_pixels(np.full((5, 3), 0.2))
    assert grey.grey_share == 1.0
    assert np.isnan(grey.mean_hue_deg)
    assert grey.mean_lab[1:] == pytest.approx([0.0, 0.0], abs=0.02)
    empty = ColourStatistics.from_pixels(np.empty((0, 3)))
    assert empty.n == 0
    assert np.isnan(empty.mean_lab).all()
    assert np.isnan(empty.hue_spectrum).all()
    with pytest.raises(ValueError, match="must be"):
        ColourStatistics.from_pixels(np.zeros((3, 4)))
    with pytest.raises(ValueError, match="hues must be"):
        ColourStatistics.from_pixels(np.zeros((3, 3)), hues=np.ones(180))


def test_pictures_have_equal_weight_in_any_order():
    counts = {f"p{k}": [PIXEL_RNG.multinomial(50 * 10**k, np.full(181, 1 / 181))] for k in range(4)}
    fractions = mean_hue_fractions(counts)
    assert fractions.sum() == pytest.approx(1.0)
    assert fractions == pytest.approx(np.mean([one[0] / one[0].sum() for one in counts.values()], axis=0))
    assert (mean_hue_fractions(dict(reversed(counts.items()))) == fractions).all()


def test_delta_e_2000_has_the_published_values():
    # G. Sharma, W. Wu, E. N. Dalal 2005, Color Res. Appl. 30:21-30, Table 1: pairs 1, 10, 17 and 34.
    pairs = [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.49, -0.001), (50.0, -2.49, 0.001), 7.1792),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((2.0776, 0.0795, -1.135), (0.9033, -0.0636, -0.5514), 0.9082),
    ]
    first, second, expected = (np.array(part) for part in zip(*pairs, strict=True))
    assert delta_e_2000(first, second) == pytest.approx(expected, abs=1e-4)

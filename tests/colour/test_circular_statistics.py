"""Circular statistics against SciPy, a linear programme and their invariances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from pepperscene.colour.statistics import (
    bin_angles,
    circular_emd,
    circular_mean,
    circular_sd,
    resultant_length,
    von_mises_kappa,
)

RNG = np.random.default_rng(20180101)


def angle_between(first, second):
    return abs((first - second + 180.0) % 360.0 - 180.0)


@pytest.mark.parametrize("kappa", [0.3, 2.0, 50.0])
def test_mean_and_spread_equal_scipys(kappa):
    angles = np.degrees(RNG.vonmises(3.0, kappa, 400))
    assert angle_between(circular_mean(angles), stats.circmean(angles, high=360.0)) < 1e-9
    assert circular_sd(angles) == pytest.approx(stats.circstd(angles, high=360.0), rel=1e-12)
    assert resultant_length(angles) == pytest.approx(1.0 - stats.circvar(angles, high=360.0), rel=1e-12)
    # Weights count like repeated angles.
    weights = RNG.integers(0, 4, angles.size)
    assert circular_sd(angles, weights) == pytest.approx(circular_sd(np.repeat(angles, weights)), rel=1e-9)


@pytest.mark.parametrize("kappa", [1e-7, 0.01, 0.3, 2.0, 50.0, 1e5])
def test_von_mises_kappa_inverts_the_mean_cosine(kappa):
    angle = np.linspace(-np.pi, np.pi, 2_000_000, endpoint=False)
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


@settings(max_examples=40, deadline=None)
@given(
    angles=st.lists(st.integers(0, 719), min_size=2, max_size=9),
    rotation=st.integers(-720, 720),
    seed=st.integers(0, 1000),
)
def test_mean_rotates_with_the_angles_and_ignores_their_order(angles, rotation, seed):
    angles = np.array(angles) / 2.0
    shuffled = np.random.default_rng(seed).permutation(angles)
    mean = circular_mean(angles)
    for same in (circular_mean(angles + 360.0), circular_mean(shuffled)):
        assert np.isnan(mean) == np.isnan(same)
        assert np.isnan(mean) or angle_between(mean, same) < 1e-6
    rotated = circular_mean(angles + rotation)
    assert np.isnan(rotated) or angle_between(rotated, mean + rotation) < 1e-6
    assert resultant_length(angles + rotation) == pytest.approx(resultant_length(shuffled), abs=1e-12)


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


@pytest.mark.parametrize("bins", [5, 12, 18])
def test_earth_movers_distance_equals_optimal_transport(bins):
    rng = np.random.default_rng(bins)
    for _ in range(40):
        first, second = rng.gamma(0.3, size=(2, bins))
        assert circular_emd(first, second) == pytest.approx(optimal_transport(first, second), abs=1e-6)


def test_earth_movers_distance_of_two_points_is_their_arc():
    for i, j in ((0, 0), (0, 90), (3, 177), (179, 1), (40, 75)):
        first, second = np.zeros((2, 180))
        first[i] = second[j] = 1.0
        steps = abs(i - j)
        assert circular_emd(first, second) == pytest.approx(2.0 * min(steps, 180 - steps), abs=1e-9)


def test_earth_movers_distance_is_a_metric_and_invariant_to_rotation_and_scale():
    a, b, c = RNG.gamma(0.5, size=(3, 180))
    distance = circular_emd(a, b)
    assert circular_emd(a, a) == 0.0
    assert circular_emd(b, a) == pytest.approx(distance, rel=1e-12)
    assert distance <= circular_emd(a, c) + circular_emd(c, b) + 1e-12
    assert circular_emd(7.0 * a, b) == pytest.approx(distance, rel=1e-12)
    for turn in (1, 90, 180):
        assert circular_emd(np.roll(a, turn), np.roll(b, turn)) == pytest.approx(distance, abs=1e-9)
    # A rotation by one bin moves the mass by at most two degrees.
    assert circular_emd(np.roll(a, 1), a) <= 2.0 + 1e-9


def test_rejects_invalid_histograms_and_weights():
    assert np.isnan(circular_emd(np.zeros(4), np.ones(4)))
    with pytest.raises(ValueError, match="one length"):
        circular_emd(np.ones(3), np.ones(4))
    with pytest.raises(ValueError, match="negative"):
        circular_emd([-1.0, 2.0], [1.0, 1.0])
    with pytest.raises(ValueError, match="weights"):
        circular_mean([1.0, 2.0], [1.0])

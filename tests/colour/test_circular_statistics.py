"""Circular statistics against SciPy, numerical integrals and a linear programme."""

from __future__ import annotations

import numpy as np
import pytest
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

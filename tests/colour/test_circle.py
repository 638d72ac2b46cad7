"""Statistics of angles against SciPy, against a linear programme, and against what turning must do."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from pepperscene.colour.statistics.circular import (
    bin_angles,
    circular_emd,
    circular_mean,
    circular_median,
    circular_sd,
    concentration,
    resultant_length,
)

RNG = np.random.default_rng(20180101)


def _turned_alike(one: float, other: float) -> bool:
    return abs((one - other + 180.0) % 360.0 - 180.0) < 1e-9


@pytest.mark.parametrize("kappa", [0.3, 2.0, 50.0])
def test_mean_and_spread_are_scipys(kappa: float) -> None:
    angles = np.degrees(RNG.vonmises(3.0, kappa, 400))
    assert _turned_alike(circular_mean(angles), stats.circmean(angles, high=360.0))
    assert circular_sd(angles) == pytest.approx(stats.circstd(angles, high=360.0), rel=1e-12)
    assert resultant_length(angles) == pytest.approx(1.0 - stats.circvar(angles, high=360.0), rel=1e-12)


@pytest.mark.parametrize("kappa", [1e-7, 0.01, 0.3, 2.0, 50.0, 1e5])
def test_the_concentration_undoes_the_ratio_of_bessel_functions(kappa: float) -> None:
    length = _length(kappa)
    assert concentration(length) == pytest.approx(kappa, rel=1e-6)


def _length(kappa: float) -> float:
    """Mean cosine of the von Mises distribution, by its integral."""
    angle = np.linspace(-np.pi, np.pi, 2_000_000, endpoint=False)
    density = np.exp(kappa * (np.cos(angle) - 1.0))
    return float((density * np.cos(angle)).sum() / density.sum())


def test_a_single_direction_has_no_spread_and_no_direction_has_all() -> None:
    assert circular_sd([17.0, 17.0]) == pytest.approx(0.0, abs=1e-5)
    assert concentration(1.0) == np.inf
    assert resultant_length(bin_angles(180)) < 1e-15
    assert np.isnan(circular_mean(bin_angles(180)))
    assert np.isnan(circular_mean([]))
    assert np.isnan(resultant_length([]))
    assert np.isnan(circular_median([]))


def test_the_median_is_between_neighbours_across_zero() -> None:
    assert _turned_alike(circular_median([359.0, 1.0, 3.0]), 1.0)
    assert _turned_alike(circular_median([359.0, 1.0]), 0.0)
    assert _turned_alike(circular_median([10.0, 200.0], [3.0, 1.0]), 10.0)


def test_the_median_has_the_least_mean_arc_of_all_angles() -> None:
    angles = np.degrees(RNG.vonmises(0.0, 1.0, 41)) % 360.0

    def mean_arc(place: float) -> float:
        return float(np.abs((angles - place + 180.0) % 360.0 - 180.0).mean())

    best = min(mean_arc(place) for place in np.arange(0.0, 360.0, 0.25))
    assert mean_arc(circular_median(angles)) <= best + 1e-12


@settings(max_examples=40, deadline=None)
@given(
    angles=st.lists(st.integers(0, 719), min_size=2, max_size=9),
    turn=st.integers(-720, 720),
    seed=st.integers(0, 1000),
)
def test_all_turn_with_the_angles_and_none_minds_their_order(angles: list[int], turn: int, seed: int) -> None:
    given_deg = np.array(angles) / 2.0
    mixed = np.random.default_rng(seed).permutation(given_deg)
    for centre in (circular_mean, circular_median):
        before = centre(given_deg)
        # A full turn changes nothing; without a direction there is nothing to turn.
        for same in (centre(given_deg + 360.0), centre(mixed)):
            assert np.isnan(before) == np.isnan(same)
            assert np.isnan(before) or abs((before - same + 180.0) % 360.0 - 180.0) < 1e-6
        after = centre(given_deg + turn)
        assert np.isnan(after) or abs((after - before - turn + 180.0) % 360.0 - 180.0) < 1e-6
    assert resultant_length(given_deg + turn) == pytest.approx(resultant_length(mixed), abs=1e-12)


def _cheapest_transport(one: np.ndarray, other: np.ndarray) -> float:
    """Earth mover's distance by its definition: a linear programme over all pairs of bins."""
    n = one.size
    middles = bin_angles(n)
    arcs = np.abs((middles[:, None] - middles[None, :] + 180.0) % 360.0 - 180.0)
    leaves = np.kron(np.eye(n), np.ones(n))
    arrives = np.kron(np.ones(n), np.eye(n))
    totals = np.concatenate([one / one.sum(), other / other.sum()])
    found = optimize.linprog(arcs.ravel(), A_eq=np.vstack([leaves, arrives])[:-1], b_eq=totals[:-1])
    assert found.status == 0
    return float(found.fun)


@pytest.mark.parametrize("bins", [5, 12, 18])
def test_the_earth_movers_distance_is_the_linear_programmes(bins: int) -> None:
    for _ in range(4):
        one, other = RNG.gamma(0.3, size=(2, bins))
        assert circular_emd(one, other) == pytest.approx(_cheapest_transport(one, other), abs=1e-6)


def test_the_earth_movers_distance_of_two_points_is_their_arc() -> None:
    for first, second in ((0, 0), (0, 90), (3, 177), (179, 1), (40, 75)):
        one, other = np.zeros((2, 180))
        one[first] = other[second] = 1.0
        around = abs(first - second)
        assert circular_emd(one, other) == pytest.approx(2.0 * min(around, 180 - around), abs=1e-9)


def test_the_earth_movers_distance_is_a_metric_and_turns_with_both() -> None:
    one, other, third = RNG.gamma(0.5, size=(3, 180))
    distance = circular_emd(one, other)
    assert circular_emd(one, one) == 0.0
    assert circular_emd(other, one) == pytest.approx(distance, rel=1e-12)
    assert distance <= circular_emd(one, third) + circular_emd(third, other) + 1e-12
    assert circular_emd(7.0 * one, other) == pytest.approx(distance, rel=1e-12)
    for turn in (1, 90, 180):
        assert circular_emd(np.roll(one, turn), np.roll(other, turn)) == pytest.approx(distance, abs=1e-9)
    # Against itself turned by a little, it moves by so much.
    assert circular_emd(np.roll(one, 1), one) <= 2.0 + 1e-9


def test_what_is_no_distribution_is_refused() -> None:
    assert np.isnan(circular_emd(np.zeros(4), np.ones(4)))
    with pytest.raises(ValueError, match="one length"):
        circular_emd(np.ones(3), np.ones(4))
    with pytest.raises(ValueError, match="below 0"):
        circular_emd([-1.0, 2.0], [1.0, 1.0])
    with pytest.raises(ValueError, match="weights"):
        circular_mean([1.0, 2.0], [1.0])

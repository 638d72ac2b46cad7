"""Intervals: that they are as wide as theory says, and hold what they should as often as they should."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from pepperscene.colour.comparison import similarity
from pepperscene.colour.statistics.bootstrap import (
    REPLICATES,
    BootstrapSums,
    estimate_angles,
    estimate_values,
    interval,
    weights_of,
)


def resampled_mean(values):
    sums = BootstrapSums(2)
    for value in values:
        sums.add([value, 1.0], weights_of(np.float64(value).tobytes()))
    totals = sums.totals()
    return totals[:, 0] / totals[:, 1]


def test_weights_are_those_of_the_content_alone():
    one, same, other = (weights_of(text) for text in (b"one", b"one", b"other"))
    assert one[0] == other[0] == 1.0
    assert (one == same).all()
    assert abs(np.corrcoef(one[1:], other[1:])[0, 1]) < 0.3
    every = np.stack([weights_of(bytes([k])) for k in range(200)])[:, 1:]
    # The exponential distribution of mean 1.
    assert every.mean() == pytest.approx(1.0, abs=0.02)
    assert every.std() == pytest.approx(1.0, abs=0.03)


def test_the_interval_of_a_mean_is_that_of_the_central_limit():
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    means = resampled_mean(values)
    assert means[0] == pytest.approx(values.mean(), abs=1e-12)
    low, high = interval(means)
    width = 2 * norm.ppf(0.975) * values.std() / np.sqrt(400)
    assert high - low == pytest.approx(width, rel=0.2)


def test_intervals_hold_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(200):
        low, high = interval(resampled_mean(rng.gamma(4.0, 1.0, 40)))
        held += low <= 4.0 <= high
    # Of 200, 190 with a standard deviation of 3; intervals of 40 values are known to be a bit short.
    assert 176 <= held <= 199


def test_an_interval_whose_replicates_all_lie_on_one_side_still_holds_the_measure():
    replicates = 1.0 + np.random.default_rng(3).uniform(size=REPLICATES)
    low, high = interval(np.concatenate([[0.5], replicates]))
    assert low == 0.5
    assert high < 1.1
    assert interval(np.concatenate([[np.nan], replicates])) is None
    replicates[::5] = np.nan
    assert interval(np.concatenate([[1.5], replicates])) is None


def test_angles_have_intervals_through_zero():
    around = 358.0 + np.linspace(-5.0, 5.0, REPLICATES)
    found = estimate_angles(np.concatenate([[358.0], around % 360.0]), True, "")
    assert found.value == 358.0
    assert 352.0 < found.low < 354.0
    assert 2.0 < found.high < 4.0
    assert estimate_angles(np.full(REPLICATES + 1, np.nan), True, "none").why == "none"
    assert estimate_values(around, resampled=False).low is None


def test_sums_do_not_depend_on_how_many_are_added_at_once():
    rng = np.random.default_rng(4)
    sums, expected = BootstrapSums(3), np.zeros((REPLICATES + 1, 3))
    for k in range(37):
        vector = rng.integers(0, 100, 3)
        weights = weights_of(bytes([k]))
        sums.add(vector, weights)
        expected += weights[:, None] * vector
    np.testing.assert_allclose(sums.totals(), expected, rtol=1e-12)
    assert (sums.totals()[0] == expected[0]).all()
    with pytest.raises(ValueError, match="vector"):
        sums.add([1.0], weights)


def test_structure_is_that_of_wang_for_flat_images():
    """Of two flat images only the term of their levels is left: (2 a b + C1) / (a^2 + b^2 + C1)."""
    one, other = np.full((30, 40), 0.8), np.full((30, 40), 0.4)
    expected = (2 * 0.8 * 0.4 + 1e-4) / (0.8**2 + 0.4**2 + 1e-4)
    assert similarity.structure(one, other) == pytest.approx(expected, abs=1e-9)
    assert similarity.structure(one, one) == 1.0


def test_rows_that_are_not_finite_have_no_measure():
    rows = np.array([[0.0, 1.0, 2.0], [np.nan, 1.0, 2.0], [1.0, 1.0, 1.0]])
    found = similarity.paired(similarity.correlation, rows, np.array([[1.0, 2.0, 3.0]] * 3))
    assert found[0] == pytest.approx(1.0)
    assert np.isnan(found[1:]).all()

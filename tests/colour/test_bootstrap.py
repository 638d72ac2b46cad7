"""Bootstrap weights and confidence intervals; similarity measures of rows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from pepperscene.colour.comparison import similarity
from pepperscene.colour.comparison.bootstrap import (
    REPLICATES,
    BootstrapSums,
    bootstrap_weights,
    confidence_interval,
    estimate_angles,
    estimate_values,
)


def bootstrapped_mean(values):
    sums = BootstrapSums(2)
    for value in values:
        sums.add([value, 1.0], bootstrap_weights(np.float64(value).tobytes()))
    totals = sums.totals()
    return totals[:, 0] / totals[:, 1]


def test_weights_depend_on_content_only_and_are_exponential():
    first, same, other = (bootstrap_weights(text) for text in (b"one", b"one", b"other"))
    assert first[0] == other[0] == 1.0
    assert (first == same).all()
    assert abs(np.corrcoef(first[1:], other[1:])[0, 1]) < 0.3
    weights = np.stack([bootstrap_weights(bytes([k])) for k in range(200)])[:, 1:]
    assert weights.mean() == pytest.approx(1.0, abs=0.02)
    assert weights.std() == pytest.approx(1.0, abs=0.03)


def test_interval_of_a_mean_agrees_with_the_central_limit_theorem():
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    means = bootstrapped_mean(values)
    assert means[0] == pytest.approx(values.mean(), abs=1e-12)
    low, high = confidence_interval(means)
    width = 2 * norm.ppf(0.975) * values.std() / np.sqrt(400)
    assert high - low == pytest.approx(width, rel=0.2)


def test_interval_contains_the_measure_if_all_replicates_are_on_one_side():
    replicates = 1.0 + np.random.default_rng(3).uniform(size=REPLICATES)
    low, high = confidence_interval(np.concatenate([[0.5], replicates]))
    assert low == 0.5
    assert high < 1.1
    assert confidence_interval(np.concatenate([[np.nan], replicates])) is None
    replicates[::5] = np.nan
    assert confidence_interval(np.concatenate([[1.5], replicates])) is None


def test_intervals_of_angles_may_contain_zero():
    angles = 358.0 + np.linspace(-5.0, 5.0, REPLICATES)
    estimate = estimate_angles(np.concatenate([[358.0], angles % 360.0]), True, "")
    assert estimate.value == 358.0
    assert 352.0 < estimate.low < 354.0
    assert 2.0 < estimate.high < 4.0
    assert estimate_angles(np.full(REPLICATES + 1, np.nan), True, "none").why == "none"
    assert estimate_values(angles, resampled=False).low is None


def test_sums_do_not_depend_on_batches():
    rng = np.random.default_rng(4)
    sums, expected = BootstrapSums(3), np.zeros((REPLICATES + 1, 3))
    for k in range(37):
        vector = rng.integers(0, 100, 3)
        weights = bootstrap_weights(bytes([k]))
        sums.add(vector, weights)
        expected += weights[:, None] * vector
    np.testing.assert_allclose(sums.totals(), expected, rtol=1e-12)
    assert (sums.totals()[0] == expected[0]).all()
    with pytest.raises(ValueError, match="vector"):
        sums.add([1.0], weights)


def test_ssim_of_constant_images_is_the_luminance_term():
    """Wang et al. 2004: for constant images only (2 a b + C1) / (a^2 + b^2 + C1) remains."""
    bright, dark = np.full((30, 40), 0.8), np.full((30, 40), 0.4)
    expected = (2 * 0.8 * 0.4 + 1e-4) / (0.8**2 + 0.4**2 + 1e-4)
    assert similarity.ssim(bright, dark) == pytest.approx(expected, abs=1e-9)
    assert similarity.ssim(bright, bright) == 1.0


def test_pairwise_measures_skip_rows_that_are_not_finite():
    rows = np.array([[0.0, 1.0, 2.0], [np.nan, 1.0, 2.0], [1.0, 1.0, 1.0]])
    measures = similarity.pairwise(similarity.correlation, rows, np.array([[1.0, 2.0, 3.0]] * 3))
    assert measures[0] == pytest.approx(1.0)
    assert np.isnan(measures[1:]).all()

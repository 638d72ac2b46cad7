"""Distributions: draws follow them, and the moments after truncation are the stated ones.

Independent reference: scipy.stats. Sampling tests state their significance; seeds are fixed.
"""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from scipy import stats

from pepperscene.cultivar import Distribution
from pepperscene.cultivar.distribution import _truncated_normal, truncated_moments
from pepperscene.cultivar.notation import Angle, Length, Ratio

LENGTH, ANGLE, RATIO = (TypeAdapter(kind) for kind in (Length, Angle, Ratio))


def parse(adapter: TypeAdapter[Distribution], **table: Any) -> Distribution:
    return adapter.validate_python(table | {"chosen": "test"})


DISTRIBUTIONS = {
    "normal": parse(LENGTH, mean_mm=99, sd_mm=14),
    "skewed": parse(LENGTH, mean_mm=48, sd_mm=30, low_mm=8, high_mm=160),
    "uniform": parse(ANGLE, uniform_deg=[-30, 60]),
    "histogram": parse(ANGLE, histogram_deg=[[0, 90, 0.2], [90, 100, 0.0], [100, 140, 0.5], [180, 360, 0.3]]),
}
MIDPOINTS = (np.arange(20_000) + 0.5) / 20_000


def scipy_truncnorm(distribution: Distribution) -> Any:
    low, high = distribution.low, distribution.high
    mean, sd, *_ = _truncated_normal(distribution.mean, distribution.sd, low, high)
    return stats.truncnorm((low - mean) / sd, (high - mean) / sd, loc=mean, scale=sd)


@pytest.mark.parametrize("mean", [-3.0, 0.2, 4.0])
def test_truncated_moments_match_scipy(mean: float) -> None:
    low, high = -0.5, 1.5
    expected = stats.truncnorm(low - mean, high - mean, loc=mean)
    moments = truncated_moments(mean, 1.0, low, high)
    assert moments == pytest.approx((expected.mean(), expected.std()), rel=1e-6)


@given(
    st.floats(0.25, 0.75), st.floats(0.02, 0.2), st.floats(0.1, 100.0)
)  # mean and sd as fractions of the range, the range
def test_stated_moments_are_those_after_truncation(mean: float, sd: float, span: float) -> None:
    normal = parse(RATIO, mean=mean * span, sd=sd * span, low=0.0, high=span)
    parent_mean, parent_sd, *_ = _truncated_normal(normal.mean, normal.sd, normal.low, normal.high)
    moments = truncated_moments(parent_mean, parent_sd, 0.0, span)
    assert moments == pytest.approx((mean * span, sd * span), rel=1e-6)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_quantile_function_has_the_stated_moments(name: str) -> None:
    # Midpoint rule: the mean is the integral of the quantile function, the mean square that of its square.
    distribution = DISTRIBUTIONS[name]
    values = distribution.quantiles(MIDPOINTS)
    assert values.mean() == pytest.approx(distribution.mean, rel=1e-4, abs=1e-5)
    assert values.std() == pytest.approx(distribution.sd, rel=1e-3)
    assert np.all(np.diff(values) >= 0)
    assert values.min() >= distribution.low
    assert values.max() <= distribution.high


def test_draws_and_quantiles_match_scipys_truncated_normal() -> None:
    distribution = DISTRIBUTIONS["skewed"]
    expected = scipy_truncnorm(distribution)
    drawn = distribution.draw(np.random.default_rng(1), 20_000)
    assert stats.kstest(drawn, expected.cdf).pvalue > 1e-3
    probabilities = np.array([[0.0, 1e-4, 0.2], [0.5, 0.9999, 1.0]])
    assert distribution.quantiles(probabilities) == pytest.approx(expected.ppf(probabilities), rel=1e-9)


def test_units_become_metres_and_radians() -> None:
    assert parse(LENGTH, value_mm=99).mean == pytest.approx(0.099)
    assert parse(ANGLE, value_deg=90).mean == pytest.approx(math.pi / 2)
    assert parse(RATIO, value=0.5).draw(np.random.default_rng(0)) == 0.5


def test_a_curve_follows_the_position_with_constant_spread() -> None:
    curve = parse(LENGTH, along_mm=[[0, 110], [0.5, 90], [1, 80]], sd_mm=10)
    values = curve.quantiles(MIDPOINTS, np.array([[0.0], [0.25], [1.0]]))
    assert values.mean(axis=1) == pytest.approx([0.110, 0.100, 0.080], rel=1e-4)
    assert values.std(axis=1) == pytest.approx(0.010, rel=1e-3)
    assert np.abs(values - values.mean(axis=1, keepdims=True)).max() <= 0.030 + 1e-9
    assert curve.mean == pytest.approx(0.0925)
    with pytest.raises(ValueError, match="positions"):
        curve.quantiles(0.5)
    bounded = parse(RATIO, along=[[0, 0.1], [1, 0.9]], sd=0.1, low=0.0, high=1.0)
    values = bounded.quantiles(MIDPOINTS, np.array([[0.0], [1.0]]))
    assert (values.min(), values.max()) == (0, 1)


@pytest.mark.parametrize(("name", "correlation"), [("skewed", -0.4), ("histogram", 0.8)])
def test_correlation_with_height_keeps_the_distribution(name: str, correlation: float) -> None:
    """The marginal distribution is unchanged (Kolmogorov-Smirnov), the rank correlation is the stated one."""
    distribution = DISTRIBUTIONS[name].model_copy(update={"with_height": correlation})
    rng = np.random.default_rng(4)
    # 500 plants of 40 organs, each at the centre of its part of the stem.
    positions = np.tile((np.arange(40) + 0.5) / 40, 500)
    values = distribution.quantiles(rng.random(positions.size), positions)
    marginal = DISTRIBUTIONS[name].quantiles(MIDPOINTS)
    assert stats.ks_2samp(values, marginal).pvalue > 1e-3
    # The standard error of a rank correlation is at most 1 / sqrt(n) = .007; the tolerance is 3.5 of them.
    assert stats.spearmanr(positions, values).statistic == pytest.approx(correlation, abs=0.025)
    # Without positions the correlation has no effect.
    assert distribution.quantiles(MIDPOINTS).tobytes() == marginal.tobytes()


@given(st.sampled_from([*DISTRIBUTIONS, "curve"]), st.floats(-0.99, 0.99), st.floats(0, 1))
def test_quantiles_are_monotonic(name: str, correlation: float, position: float) -> None:
    if name == "curve":
        distribution = parse(RATIO, along=[[0, 2], [1, 3]], sd=0.2)
    else:
        distribution = DISTRIBUTIONS[name].model_copy(update={"with_height": correlation})
    assert np.all(np.diff(distribution.quantiles(np.linspace(0, 1, 200), position)) >= 0)


def test_a_changed_copy_does_not_use_cached_values() -> None:
    for name, change in (("normal", {"mean": 0.1}), ("histogram", {"bins": ((0.0, 1.0, 1.0),), "high": 1.0})):
        before = DISTRIBUTIONS[name].quantiles(0.3)
        assert DISTRIBUTIONS[name].model_copy(update=change).quantiles(0.3) != before


NUMBERS = st.floats() | st.floats(-1e3, 1e3) | st.sampled_from([0.0, 1.0, 1e-300, 5e-324, 1e6])
TABLES = (
    st.fixed_dictionaries({"mean_deg": NUMBERS, "sd_deg": NUMBERS, "low_deg": NUMBERS, "high_deg": NUMBERS})
    | st.fixed_dictionaries({"mean_deg": NUMBERS, "sd_deg": NUMBERS})
    | st.fixed_dictionaries({"uniform_deg": st.tuples(NUMBERS, NUMBERS)})
    | st.fixed_dictionaries(
        {"along_deg": st.lists(st.tuples(NUMBERS, NUMBERS), max_size=3), "sd_deg": NUMBERS}
    )
    | st.fixed_dictionaries({"histogram_deg": st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), max_size=3)})
)


@given(TABLES)
def test_any_numbers_give_a_bounded_distribution_or_a_validation_error(table: dict[str, Any]) -> None:
    try:
        distribution = parse(ANGLE, **table)
    except ValidationError:
        return
    values = distribution.quantiles([0.0, 0.3, 1.0], 0.7)
    # Bins are given by start and width, which rounds.
    slack = 1e-12 * max(abs(distribution.low), abs(distribution.high))
    assert np.all(values >= distribution.low - slack)
    assert np.all(values <= distribution.high + slack)
    assert np.all(np.diff(values) >= 0)

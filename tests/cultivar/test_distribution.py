"""Distributions: draws follow their law, and moments after truncation are the stated ones.

Independent reference: scipy.stats. Sampling tests state their significance; seeds are fixed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from scipy import stats

from pepperscene.cultivar import Angle, Distribution, Length, Ratio, truncated_moments
from pepperscene.cultivar.distribution import _parent

LENGTH, ANGLE, RATIO = (TypeAdapter(kind) for kind in (Length, Angle, Ratio))


def parse(adapter: TypeAdapter[Distribution], **table: Any) -> Distribution:
    return adapter.validate_python(table | {"chosen": "test"})


LAWS = {
    "normal": parse(LENGTH, mean_mm=99, sd_mm=14),
    "skewed": parse(LENGTH, mean_mm=48, sd_mm=30, low_mm=8, high_mm=160),
    "uniform": parse(ANGLE, uniform_deg=[-30, 60]),
    "histogram": parse(ANGLE, histogram_deg=[[0, 90, 0.2], [90, 100, 0.0], [100, 140, 0.5], [180, 360, 0.3]]),
}
MIDDLES = (np.arange(20_000) + 0.5) / 20_000


@pytest.mark.parametrize("mean", [-3.0, 0.2, 4.0])
def test_truncated_moments_are_scipys(mean: float) -> None:
    low, high = -0.5, 1.5
    expected = stats.truncnorm(low - mean, high - mean, loc=mean)
    assert truncated_moments(mean, 1.0, low, high) == pytest.approx(
        (expected.mean(), expected.std()), rel=1e-6
    )


@given(
    st.floats(0.25, 0.75), st.floats(0.02, 0.2), st.floats(0.1, 100.0)
)  # place of the mean, sd in units of the range, the range
def test_stated_moments_hold_after_the_cut(place: float, sd: float, span: float) -> None:
    law = parse(RATIO, mean=place * span, sd=sd * span, low=0.0, high=span)
    parent_mean, parent_sd, *_ = _parent(law.mean, law.sd, law.low, law.high)
    found = truncated_moments(parent_mean, parent_sd, 0.0, span)
    assert found == pytest.approx((place * span, sd * span), rel=1e-6)


@pytest.mark.parametrize("name", LAWS)
def test_moments_of_the_quantile_function_are_the_stated_ones(name: str) -> None:
    # Midpoint rule over shares: the mean is the integral of Q, the mean square that of Q squared.
    law = LAWS[name]
    values = law.quantiles(MIDDLES)
    assert values.mean() == pytest.approx(law.mean, rel=1e-4, abs=1e-5)
    assert values.std() == pytest.approx(law.sd, rel=1e-3)
    assert np.all(np.diff(values) >= 0)
    assert values.min() >= law.low
    assert values.max() <= law.high


def test_draws_follow_the_cut_normal() -> None:
    law = LAWS["skewed"]
    drawn = law.draw(np.random.default_rng(1), 20_000)
    assert stats.kstest(drawn, scipys(law).cdf).pvalue > 1e-3


def scipys(law: Distribution) -> Any:
    mean, sd, *_ = _parent(law.mean, law.sd, law.low, law.high)
    return stats.truncnorm((law.low - mean) / sd, (law.high - mean) / sd, loc=mean, scale=sd)


def test_quantiles_are_scipys() -> None:
    law = LAWS["skewed"]
    shares = np.array([[0.0, 1e-4, 0.2], [0.5, 0.9999, 1.0]])
    assert law.quantiles(shares) == pytest.approx(scipys(law).ppf(shares), rel=1e-9)


def test_draws_follow_the_histogram() -> None:
    law = LAWS["histogram"]
    drawn = np.degrees(law.draw(np.random.default_rng(2), 10_000))
    counts, _ = np.histogram(drawn, [0, 90, 100, 140, 180, 360])
    assert counts[1] == counts[3] == 0
    assert stats.chisquare(counts[[0, 2, 4]], 10_000 * np.array([0.2, 0.5, 0.3])).pvalue > 1e-3
    # Uniform within a bin.
    within = drawn[(drawn >= 180)]
    assert stats.kstest(within, stats.uniform(180, 180).cdf).pvalue > 1e-3


def test_units_become_metres_and_radians() -> None:
    assert parse(LENGTH, value_mm=99).draw(np.random.default_rng(0)) == pytest.approx(0.099)
    assert parse(ANGLE, value_deg=90).draw(np.random.default_rng(0)) == pytest.approx(math.pi / 2)
    assert parse(RATIO, value=0.5).draw(np.random.default_rng(0)) == 0.5


def test_draws_repeat_and_have_the_asked_shape() -> None:
    law = LAWS["normal"]
    first, again = (law.draw(np.random.default_rng(3), (4, 5)) for _ in range(2))
    assert first.shape == (4, 5)
    assert first.tobytes() == again.tobytes()
    assert isinstance(law.draw(np.random.default_rng(3)), float)


def test_a_curve_follows_the_place_and_has_its_spread_everywhere() -> None:
    law = parse(LENGTH, along_mm=[[0, 110], [0.5, 90], [1, 80]], sd_mm=10)
    values = law.quantiles(MIDDLES, np.array([[0.0], [0.25], [1.0]]))
    assert values.mean(axis=1) == pytest.approx([0.110, 0.100, 0.080], rel=1e-4)
    assert values.std(axis=1) == pytest.approx(0.010, rel=1e-3)
    assert np.abs(values - values.mean(axis=1, keepdims=True)).max() <= 0.030 + 1e-9
    assert law.mean == pytest.approx(0.0925)
    with pytest.raises(ValueError, match="places"):
        law.quantiles(0.5)


def test_a_curve_keeps_to_its_bounds() -> None:
    law = parse(RATIO, along=[[0, 0.1], [1, 0.9]], sd=0.1, low=0.0, high=1.0)
    values = law.quantiles(MIDDLES, np.array([[0.0], [1.0]]))
    assert values.min() == 0
    assert values.max() == 1


@pytest.mark.parametrize("correlation", [-0.4, 0.25, 0.8])
@pytest.mark.parametrize("name", ["skewed", "histogram"])
def test_a_law_with_height_is_the_stated_one_as_a_whole(name: str, correlation: float) -> None:
    """The marginal law stays (Kolmogorov and Smirnov), and Spearman's correlation is the stated one."""
    law = LAWS[name].model_copy(update={"with_height": correlation})
    rng = np.random.default_rng(4)
    # 40 organs a plant, each at the middle of its part of the stem, on 500 plants.
    places = np.tile((np.arange(40) + 0.5) / 40, 500)
    values = law.quantiles(rng.random(places.size), places)
    alone = LAWS[name].quantiles(MIDDLES)
    assert stats.ks_2samp(values, alone).pvalue > 1e-3
    # The standard error of a rank correlation is at most 1 / sqrt(n) = .007 (here 3.5 of them).
    assert stats.spearmanr(places, values).statistic == pytest.approx(correlation, abs=0.025)
    # Without places it is the law as a whole.
    assert law.quantiles(MIDDLES).tobytes() == alone.tobytes()


@given(st.sampled_from([*LAWS, "curve"]), st.floats(-0.99, 0.99), st.floats(0, 1))
def test_quantiles_never_fall(name: str, correlation: float, place: float) -> None:
    curve = parse(RATIO, along=[[0, 2], [1, 3]], sd=0.2)
    law = curve if name == "curve" else LAWS[name].model_copy(update={"with_height": correlation})
    assert np.all(np.diff(law.quantiles(np.linspace(0, 1, 200), place)) >= 0)


def test_a_changed_copy_is_another_law() -> None:
    for name, change in (("normal", {"mean": 0.1}), ("histogram", {"bins": ((0.0, 1.0, 1.0),), "high": 1.0})):
        law = LAWS[name]
        before = law.quantiles(0.3)
        copy = law.model_copy(update=change)
        assert copy.quantiles(0.3) != before
        assert copy != law


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
def test_any_numbers_make_a_law_within_its_bounds_or_a_sentence(table: dict[str, Any]) -> None:
    try:
        law = parse(ANGLE, **table)
    except ValidationError:
        return
    values = law.quantiles([0.0, 0.3, 1.0], 0.7)
    # To rounding, as a histogram's bins are given by start and width.
    slack = 1e-12 * max(abs(law.low), abs(law.high))
    assert np.all(values >= law.low - slack)
    assert np.all(values <= law.high + slack)
    assert np.all(np.diff(values) >= 0)

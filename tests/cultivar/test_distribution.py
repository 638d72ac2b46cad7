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

LENGTH, ANGLE, RATIO = (TypeAdapter(kind) for kind in (Length, Angle, Ratio))


def parse(adapter: TypeAdapter[Distribution], **table: Any) -> Distribution:
    return adapter.validate_python(table | {"chosen": "test"})


LAWS = {
    "normal": parse(LENGTH, mean_mm=99, sd_mm=14),
    "skewed": parse(LENGTH, mean_mm=48, sd_mm=30, low_mm=8, high_mm=160),
    "uniform": parse(ANGLE, uniform_deg=[-30, 60]),
    "histogram": parse(ANGLE, histogram_deg=[[0, 90, 0.2], [90, 100, 0.0], [100, 140, 0.5], [180, 360, 0.3]]),
}


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
    normal, *_ = law._parent
    found = truncated_moments(normal.mean, normal.stdev, 0.0, span)
    assert found == pytest.approx((place * span, sd * span), rel=1e-6)


@pytest.mark.parametrize("name", LAWS)
def test_moments_of_the_quantile_function_are_the_stated_ones(name: str) -> None:
    # Midpoint rule over shares: the mean is the integral of Q, the mean square that of Q squared.
    law = LAWS[name]
    values = law.quantiles((np.arange(20_000) + 0.5) / 20_000)
    assert values.mean() == pytest.approx(law.mean, rel=1e-4, abs=1e-5)
    assert values.std() == pytest.approx(law.sd, rel=1e-3)
    assert np.all(np.diff(values) >= 0)
    assert values.min() >= law.low
    assert values.max() <= law.high


def test_draws_follow_the_cut_normal() -> None:
    law = LAWS["skewed"]
    normal, *_ = law._parent
    a, b = (law.low - normal.mean) / normal.stdev, (law.high - normal.mean) / normal.stdev
    drawn = law.draw(np.random.default_rng(1), 20_000)
    expected = stats.truncnorm(a, b, loc=normal.mean, scale=normal.stdev)
    assert stats.kstest(drawn, expected.cdf).pvalue > 1e-3


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


NUMBERS = st.floats() | st.floats(-1e3, 1e3) | st.sampled_from([0.0, 1.0, 1e-300, 5e-324, 1e6])
TABLES = (
    st.fixed_dictionaries({"mean_deg": NUMBERS, "sd_deg": NUMBERS, "low_deg": NUMBERS, "high_deg": NUMBERS})
    | st.fixed_dictionaries({"mean_deg": NUMBERS, "sd_deg": NUMBERS})
    | st.fixed_dictionaries({"uniform_deg": st.tuples(NUMBERS, NUMBERS)})
    | st.fixed_dictionaries({"histogram_deg": st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), max_size=3)})
)


@given(TABLES)
def test_any_numbers_make_a_law_within_its_bounds_or_a_sentence(table: dict[str, Any]) -> None:
    try:
        law = parse(ANGLE, **table)
    except ValidationError:
        return
    values = law.quantiles([0.0, 0.3, 1.0])
    # To rounding, as a histogram's bins are given by start and width.
    slack = 1e-12 * max(abs(law.low), abs(law.high))
    assert np.all(values >= law.low - slack)
    assert np.all(values <= law.high + slack)
    assert np.all(np.diff(values) >= 0)

"""Times at equal error on power laws, tables, and the plot."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.bench.measure import BenchResult
from pepperscene.bench.reference import Errors
from pepperscene.bench.report import (
    MAX_EXTRAPOLATION,
    error_table,
    format_time,
    pareto_front,
    plot_pareto,
    ratio_table,
    time_at_error,
    time_ratios,
)
from pepperscene.bench.settings import ADAPTIVE, NAMED, PLAIN


def power_law(times, level, slope):
    """Points of error = level * seconds^-slope."""
    return [(t, level * t**-slope) for t in times]


def result(family, name, seconds, error):
    return BenchResult("near", family, name, {}, Errors(error, error**2, 0.1), (seconds,), 2 * seconds)


@given(slope=st.floats(0.1, 2.0), level=st.floats(0.01, 100.0), fraction=st.floats(-0.3, 1.3))
def test_power_laws_are_inter_and_extrapolated(slope, level, fraction):
    points = power_law((1.0, 4.0, 16.0, 64.0), level, slope)
    seconds = 64.0**fraction
    error = level * seconds**-slope
    estimate = time_at_error(error, points)
    if not points[-1][1] / MAX_EXTRAPOLATION <= error <= points[0][1] * MAX_EXTRAPOLATION:
        assert estimate is None
        return
    assert estimate[0] == pytest.approx(seconds, rel=1e-6)
    # At the ends of the measured range rounding decides.
    if seconds not in (pytest.approx(1.0), pytest.approx(64.0)):
        assert estimate[1] == (not 1.0 < seconds < 64.0)


def test_measured_points_are_used_as_they_are():
    assert time_at_error(2.0, [(3.0, 2.0)]) == (3.0, False)
    assert time_at_error(1.0, power_law((1.0, 4.0), 1.0, 0.5)) == (1.0, False)
    # A single point says nothing about other errors.
    assert time_at_error(1.0, [(3.0, 2.0)]) is None


def test_front_has_no_point_that_another_beats():
    points = [(1.0, 5.0), (2.0, 6.0), (2.0, 3.0), (3.0, 3.0), (4.0, 1.0)]
    assert pareto_front(points) == [(1.0, 5.0), (2.0, 3.0), (4.0, 1.0)]
    assert time_at_error(6.0, points)[1]


@pytest.mark.parametrize("error", [0.0, -1.0, float("nan")])
def test_rejects_errors_that_are_not_positive(error):
    with pytest.raises(ValueError, match="above 0"):
        time_at_error(error, [(1.0, 1.0), (2.0, 0.5)])


def test_ratios_at_equal_error_of_power_laws():
    results = [
        result(NAMED, "standard", 2.0, 1.0),
        *(result(ADAPTIVE, f"{n}", n / 4, (2.0 / (n / 4)) ** 0.5) for n in (1, 4, 16)),
        *(result(PLAIN, f"{n}", float(n), (90.0 / n) ** 0.5) for n in (1, 4, 16)),
        *(result("Cycles, raw", f"{n}", 2.0 * n, (60.0 / n) ** 0.5) for n in (1, 4, 16)),
        *(result("Cycles, denoised", f"{n}", 5.0 * n, (4.0 / n) ** 0.5) for n in (1, 4, 16)),
    ]
    (plain,) = time_ratios(results)
    assert (plain.error_codes, plain.ours, plain.beyond) == (1.0, "standard", True)
    assert plain.times == pytest.approx(45.0)
    others = {"raw": "Cycles, raw", "denoised": "Cycles, denoised", "best": "Cycles"}
    ratios = {ratio.other: ratio for ratio in time_ratios(results, others)}
    assert ratios["raw"].times == pytest.approx(60.0)
    assert ratios["denoised"].times == pytest.approx(10.0)
    assert not ratios["denoised"].beyond
    assert ratios["best"].times == pytest.approx(10.0)
    assert "| 1.00 codes | standard | 2,000 ms | plain path | 90.0 s | 45.0 * |" in ratio_table([plain])
    # Without a second point on the front there is no ratio.
    assert time_ratios([result(NAMED, "draft", 1.0, 2.0), result(PLAIN, "1", 3.0, 5.0)]) == []


def test_error_table_and_times():
    lines = error_table([result(PLAIN, "4 spp", 12.0, 2.0)]).splitlines()
    assert len({line.count("|") for line in lines}) == 1
    assert lines[2] == "| plain path | 4 spp | 2.00 | 4 | 0.1000 | 12.0 s | 12.0 s | 12.0 s | 1 |"
    times = [format_time(seconds) for seconds in (0.0321, 9.9994, 10.0, 1234.5)]
    assert times == ["32 ms", "9,999 ms", "10.0 s", "1,234.5 s"]


def test_plot_is_reproducible_with_few_points():
    results = [result(PLAIN, "1 spp", 1.0, 2.0), result(ADAPTIVE, "exact", 0.1, 0.0)]
    files = plot_pareto(results, "title", "subtitle")
    assert files["png"].startswith(b"\x89PNG")
    assert files == plot_pareto(results, "title", "subtitle")
    assert "plain path" in files["svg"].decode()

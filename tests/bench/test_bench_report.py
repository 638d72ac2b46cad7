"""Times at equal error on power laws, tables, and the plot."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.bench.image_errors import Errors, SquaredError
from pepperscene.bench.measure import BenchResult
from pepperscene.bench.plot import Panel, plot_pareto
from pepperscene.bench.report import (
    format_error,
    format_time,
    pareto_front,
    ratio_table,
    relative_path_time,
    result_table,
    time_at_error,
    time_ratios,
)
from pepperscene.bench.settings import ADAPTIVE, FIXED, NAMED, PATH, PLAIN


def power_law(times, level, slope):
    """Points of error = level * seconds^-slope."""
    return [(t, level * t**-slope) for t in times]


def result(family, name, seconds, error, standard_error=0.0, scene="near"):
    """A result with an error in codes and the standard error of its square."""
    errors = Errors(SquaredError(error**2, standard_error), SquaredError(error**2, standard_error), 0.1)
    return BenchResult(scene, family, name, {}, errors, (seconds,), 2 * seconds)


@given(slope=st.floats(0.1, 2.0), level=st.floats(0.01, 100.0), fraction=st.floats(-0.3, 1.3))
def test_power_laws_are_interpolated_and_nothing_is_stated_beyond(slope, level, fraction):
    points = power_law((1.0, 4.0, 16.0, 64.0), level, slope)
    seconds = 64.0**fraction
    estimate = time_at_error(level * seconds**-slope, points)
    # At the ends of the measured range rounding decides.
    if seconds in (pytest.approx(1.0), pytest.approx(64.0)):
        assert estimate in (None, pytest.approx(seconds))
    elif 1.0 < seconds < 64.0:
        assert estimate == pytest.approx(seconds, rel=1e-6)
    else:
        assert estimate is None


def test_measured_points_are_used_as_they_are():
    assert time_at_error(2.0, [(3.0, 2.0)]) == 3.0
    assert time_at_error(1.0, power_law((1.0, 4.0), 1.0, 0.5)) == 1.0
    # A single point says nothing about other errors, and none says nothing at all.
    assert time_at_error(1.0, [(3.0, 2.0)]) is None
    assert time_at_error(1.0, []) is None
    for error in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="above 0"):
            time_at_error(error, [(1.0, 1.0), (2.0, 0.5)])


def test_front_has_no_point_that_another_beats():
    points = [(1.0, 5.0), (2.0, 6.0), (2.0, 3.0), (3.0, 3.0), (4.0, 1.0)]
    assert pareto_front(points) == [(1.0, 5.0), (2.0, 3.0), (4.0, 1.0)]
    assert time_at_error(6.0, points) is None


def test_ratios_at_equal_error_of_power_laws():
    results = [
        result(NAMED, "standard", 2.0, 1.0),
        *(result(ADAPTIVE, f"{n}", n / 4, (2.0 / (n / 4)) ** 0.5) for n in (1, 4, 16)),
        *(result(PLAIN, f"{n}", float(n), (90.0 / n) ** 0.5) for n in (16, 64, 256)),
        *(result(f"{PATH}stratified", f"{n}", float(n), (10.0 / n) ** 0.5) for n in (4, 16)),
        *(result("Cycles, raw", f"{n}", 2.0 * n, (60.0 / n) ** 0.5) for n in (1, 4, 16, 64)),
        *(result("Cycles, denoised", f"{n}", 5.0 * n, (4.0 / n) ** 0.5) for n in (1, 4, 16)),
    ]
    (plain,) = time_ratios(results)
    assert (plain.error_codes, plain.ours, plain.other) == (1.0, "standard", PLAIN)
    assert plain.times == pytest.approx(45.0)
    others = {"raw": "Cycles, raw", "denoised": "Cycles, denoised", "best": "Cycles"}
    ratios = {ratio.other: ratio for ratio in time_ratios(results, others)}
    assert ratios["raw"].times == pytest.approx(60.0)
    assert ratios["denoised"].times == pytest.approx(10.0)
    assert ratios["best"].times == pytest.approx(10.0)
    assert "| 1.00 codes | standard | 2,000 ms | path tracer | 90.0 s | 45.0 |" in ratio_table([plain])


def test_no_ratio_is_stated_outside_the_measured_range():
    ours = [result(NAMED, "draft", 1.0, 4.0), result(NAMED, "standard", 2.0, 1.5)]
    # The path tracer's smallest error is twice that of the standard quality: the draft alone is compared.
    path = [result(PLAIN, f"{n}", float(n), (576.0 / n) ** 0.5) for n in (4, 16, 64)]
    (ratio,) = time_ratios([*ours, *path])
    assert (ratio.ours, ratio.times) == ("draft", pytest.approx(36.0))
    assert relative_path_time(ours[0], [*ours, *path]) == "36 ×"
    # With its most accurate setting it takes 32 times as long, and its error is still larger.
    assert relative_path_time(ours[1], [*ours, *path]) == "> 32 ×"
    rows = result_table([*ours, *path]).splitlines()
    assert rows[2].endswith("| 36 × |")
    assert rows[3].endswith("| > 32 × |")
    # A bound below 1 says nothing, and nothing is known of errors above those of the path tracer.
    assert relative_path_time(result(NAMED, "target 0.1", 99.0, 1.5), path) == "–"
    assert relative_path_time(result(NAMED, "draft", 1.0, 13.0), path) == "–"
    # One code is compared only if both have measured around it.
    below = result(ADAPTIVE, "target 0.1", 4.0, 0.5)
    assert {ratio.ours for ratio in time_ratios([*ours, below, *path])} == {"draft"}
    reaching = result(PLAIN, "1024", 1024.0, 0.75)
    assert {ratio.ours for ratio in time_ratios([*ours, below, *path, reaching])} == {
        "draft", "standard", "best",
    }  # fmt: skip


def test_upper_limits_and_other_scenes_are_left_out_of_ratios():
    standard = result(NAMED, "standard", 2.0, 1.0)
    elsewhere = [result(PLAIN, f"{n}", float(n), (16.0 / n) ** 0.5, scene="flash") for n in (4, 64)]
    assert relative_path_time(standard, [standard, *elsewhere]) == "–"
    unknown = result(NAMED, "standard", 2.0, 1.0, standard_error=0.6)
    path = [result(PLAIN, f"{n}", float(n), (16.0 / n) ** 0.5) for n in (4, 64)]
    assert relative_path_time(unknown, [unknown, *path]) == "–"
    assert time_ratios([unknown, *path]) == []
    # And a limit of the path tracer is no point of its line.
    uncertain = result(PLAIN, "64", 64.0, 0.5, standard_error=0.2)
    assert relative_path_time(standard, [standard, path[0], uncertain]) == "> 2 ×"


def test_errors_have_an_uncertainty_or_are_limits():
    for mean, standard_error, text in (
        (1.2544, 0.0448, "1.12 ± 0.02"),
        (900.0, 12.0, "30.0 ± 0.2"),
        (900.0, 120.0, "30 ± 2"),
        (4.0, 1e-9, "2.000 ± 0.001"),
        (4.0, 0.0, "2.000 ± 0.000"),
        (0.01, 0.03, "< 0.3"),
        (-1.0, 0.02, "< 0.2"),
        (-1.0, 8.0, "< 4"),
        (0.0, 0.0, "< 0"),
        (0.0, float("inf"), "< inf"),
    ):
        assert format_error(SquaredError(mean, standard_error)) == text


@given(mean=st.floats(-10.0, 10.0), standard_error=st.floats(1e-6, 10.0))
def test_printed_limits_and_uncertainties_are_not_too_low(mean, standard_error):
    error = SquaredError(mean, standard_error)
    text = format_error(error)
    if mean < 2 * standard_error:
        assert text.startswith("< ")
        assert float(text[2:]) >= error.root_limit * (1 - 1e-9)
    else:
        assert float(text.split(" ± ")[1]) >= error.root_uncertainty * (1 - 1e-9)


def test_result_table_and_times():
    results = [
        result(NAMED, "draft", 0.5, 6.0, 0.12),
        result(PLAIN, "4 spp", 12.0, 2.0, 0.4, scene="flash"),
        result(FIXED, "4 spp", 1.0, 0.1, 0.1),
    ]
    lines = result_table(results).splitlines()
    assert len({line.count("|") for line in lines}) == 1
    assert lines[2] == "| near | draft | 6.00 ± 0.01 | 500 ms | 500 ms | 500 ms | 1 | – |"
    assert lines[3] == "| flash | path tracer, 4 spp | 2.0 ± 0.1 | 12.0 s | 12.0 s | 12.0 s | 1 | – |"
    assert lines[4].startswith("| near | fixed samples, 4 spp | < 0.5 | 1,000 ms |")
    times = [format_time(seconds) for seconds in (0.0321, 9.9994, 10.0, 1234.5)]
    assert times == ["32 ms", "9,999 ms", "10.0 s", "1,234.5 s"]


def test_plot_has_a_panel_for_each_scene_and_is_reproducible():
    results = [result(PLAIN, "1 spp", 1.0, 2.0), result(ADAPTIVE, "exact", 0.1, 0.0)]
    panels = [
        Panel("near", "a view", results),
        Panel("flash", "another view", [result(NAMED, "draft", 1.0, 0.5, 1.0)]),
        Panel("nir", "without a measurable error", [result(NAMED, "draft", 1.0, 0.0, float("inf"))]),
    ]
    files = plot_pareto(panels, "title")
    assert files["png"].startswith(b"\x89PNG")
    assert files == plot_pareto(panels, "title")
    svg = files["svg"].decode()
    for text in ("near", "another view", "1 spp", "no denoiser", "upper limit"):
        assert text in svg
    # One x axis for each scene; the fourth place is empty.
    assert svg.count("seconds (median") == 3

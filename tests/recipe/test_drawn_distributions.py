"""Drawn values follow their distributions, from a plan of 2,000 frames without rendering."""

from __future__ import annotations

import datetime
import json

import numpy as np
import pytest
from scipy import stats

from pepperscene.recipe.plan import Plan
from pepperscene.recipe.variation.notation import parse_varied
from pepperscene.recipe.variation.recorded import (
    as_number,
    distinct_draws,
    goodness_of_fit,
    read_variation,
    recorded_draws,
    same_value,
)
from pepperscene.recipe.variation.varied import as_json, draw_values

PLAN = Plan(sets=1, rotations=1, frames=2000)
SEED = 1234
DAYS = {"low": datetime.date(2026, 3, 1), "high": datetime.date(2026, 9, 30)}

KINDS = {
    "normal": ("number", {"mean": 10.0, "sd": 2.0}),
    "truncated": ("number", {"mean": 0.3, "sd": 0.2, "low": 0.0, "high": 1.0}),
    "uniform": ("number", {"uniform": [-3.0, 5.0]}),
    "log": ("number", {"low": 20.0, "high": 20_000.0, "scale": "log"}),
    "histogram": ("number", {"histogram": [[0.0, 1.0, 0.2], [1.0, 5.0, 0.5], [8.0, 9.0, 0.3]]}),
    "integer": ("integer", {"low": 1, "high": 6}),
    "wide_integer": ("integer", {"mean": 1000, "sd": 200}),
    "date": ("date", DAYS),
    "choice": (None, {"red": 0.7, "green": 0.25, "blue": 0.05}),
    "switch": (None, {"true": 0.9, "false": 0.1}),
    "number_choice": ("number", {"2.8": 0.5, "5.6": 0.5}),
    "turns": ("number", {"in_turn": [1.0, 2.5, 4.0]}),
    "reversed": ("number", {"mean": 10.0, "sd": 2.0, "draw": "shared", "reversed": True}),
}


def varied_values(**changes):
    """All kinds of varied values, by name, some with another table."""
    tables = {name: (kind, changes.get(name, table)) for name, (kind, table) in KINDS.items()}
    return [parse_varied((name,), table, kind, "frame") for name, (kind, table) in tables.items()]


def drawn(varied, plan=PLAN, seed=SEED):
    """The values of a varied value in all frames, in the terms of JSON."""
    return [as_json(draw_values([varied], seed, plan.frame(i)))[varied.name] for i in range(plan.count)]


def numbers(varied, values):
    return np.array([as_number(varied, value) for value in values])


@pytest.fixture(scope="module")
def draws():
    """Two thousand values of each kind."""
    return {varied.name: drawn(varied) for varied in varied_values()}


@pytest.mark.parametrize("varied", varied_values(), ids=lambda varied: varied.name)
def test_draws_fit_their_own_distribution(varied, draws):
    p = goodness_of_fit(varied, numbers(varied, draws[varied.name]))
    assert p is None if varied.name == "turns" else p > 1e-4


def test_numbers_follow_distributions_of_scipy(draws):
    # Independent of this package: scipy's own distribution functions.
    expected = {
        "normal": stats.truncnorm(*parent_bounds(10, 2, 4, 16)),
        "uniform": stats.uniform(-3, 8),
        "log": stats.loguniform(20, 20_000),
    }
    for name, distribution in expected.items():
        assert stats.ks_1samp(draws[name], distribution.cdf).pvalue > 1e-4, name
    for name, mean, sd in (("normal", 10, 2), ("truncated", 0.3, 0.2)):
        error = np.mean(draws[name]) - mean
        assert abs(error) < 4 * sd / np.sqrt(2000)
        assert np.std(draws[name]) == pytest.approx(sd, rel=0.08)


def parent_bounds(mean, sd, low, high):
    """Arguments of scipy's `truncnorm` of a symmetric truncated normal distribution with this sd."""
    from scipy.optimize import brentq

    half = (high - low) / 2
    parent = brentq(lambda s: stats.truncnorm(-half / s, half / s, scale=s).std() - sd, 0.5 * sd, 5 * sd)
    return -half / parent, half / parent, mean, parent


def test_discrete_values_occur_as_often_as_asked(draws):
    faces = np.array(draws["integer"])
    counts = [np.count_nonzero(faces == face) for face in range(1, 7)]
    assert stats.chisquare(counts).pvalue > 1e-4
    counts = [draws["choice"].count(name) for name in ("red", "green", "blue")]
    assert stats.chisquare(counts, [1400, 500, 100]).pvalue > 1e-4
    assert draws["switch"].count(True) / 2000 == pytest.approx(0.9, abs=0.03)
    days = {datetime.date.fromisoformat(day) for day in draws["date"]}
    assert DAYS["low"] <= min(days)
    assert max(days) <= DAYS["high"]
    assert draws["turns"][:4] == [1.0, 2.5, 4.0, 1.0]


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("normal", {"mean": 10.3, "sd": 2.0}),
        ("truncated", {"mean": 0.3, "sd": 0.15, "low": 0.0, "high": 1.0}),
        ("uniform", {"uniform": [-3.0, 5.5]}),
        ("log", {"low": 20.0, "high": 20_000.0}),
        ("histogram", {"histogram": [[0.0, 1.0, 0.3], [1.0, 5.0, 0.4], [8.0, 9.0, 0.3]]}),
        ("integer", {"low": 0, "high": 6}),
        ("wide_integer", {"mean": 1000, "sd": 170}),
        ("date", {"low": datetime.date(2026, 3, 1), "high": datetime.date(2026, 10, 30)}),
        ("choice", {"red": 0.6, "green": 0.25, "blue": 0.15}),
        ("switch", {"true": 0.8, "false": 0.2}),
    ],
)
def test_draws_of_another_distribution_are_found(name, other, draws):
    kind, _ = KINDS[name]
    varied = parse_varied((name,), other, kind, "frame")
    assert goodness_of_fit(varied, numbers(varied, draws[name])) < 1e-4


@pytest.mark.long
def test_p_values_of_right_draws_are_even():
    # A test that is too strict or too lax has p values that are not uniform.
    plan = Plan(sets=1, rotations=1, frames=100)
    for name in ("normal", "wide_integer", "choice"):
        kind, table = KINDS[name]
        varied = parse_varied((name,), table, kind, "frame")
        p = [goodness_of_fit(varied, numbers(varied, drawn(varied, plan, seed))) for seed in range(60)]
        assert stats.kstest(p, "uniform").pvalue > 1e-4, name


def test_shared_draws_rise_and_fall_together():
    def ranks(**table):
        varied = parse_varied(("a",), table, "number", "frame")
        return stats.rankdata(drawn(varied))

    first = ranks(mean=10.0, sd=2.0, draw="shared")
    other = ranks(low=1.0, high=1e6, scale="log", draw="shared")
    falling = ranks(uniform=[0.0, 1.0], draw="shared", reversed=True)
    alone = ranks(mean=10.0, sd=2.0)
    assert (first == other).all()
    assert (first == 2001 - falling).all()
    assert abs(stats.spearmanr(first, alone).statistic) < 0.1


def test_a_changed_distribution_leaves_all_other_draws_as_they_were(draws):
    changed = varied_values(normal={"low": 1.0, "high": 2.0}, choice={"red": 0.5, "green": 0.5})
    after = {varied.name: drawn(varied) for varied in changed}
    assert {name for name in after if after[name] != draws[name]} == {"normal", "choice"}


def test_each_set_scene_and_moment_has_one_draw():
    plan = Plan(sets=3, rotations=4, frames=5, twins=2, cameras=3)
    for per, count in (("set", 3), ("scene", 12), ("frame", 60)):
        varied = parse_varied(("a",), {"mean": 1.0, "sd": 0.1}, "number", per)
        values = np.array(drawn(varied, plan))
        distinct = distinct_draws(varied, plan, range(plan.count), values)
        assert len(set(values)) == count
        assert sorted(distinct) == sorted(set(values))


def test_recorded_values_draw_what_the_recipe_draws():
    values = [*varied_values(), parse_varied(("table", 0, "key"), {"low": 0, "high": 1}, "number", "scene")]
    record = {varied.name: varied.identity() for varied in values}
    # As in the file, where entries are sorted.
    recipe = {"seed": SEED, "variation": json.loads(json.dumps(record, sort_keys=True, default=str))}
    variation = read_variation(recipe)
    assert {varied.name: varied.identity() for varied in variation} == recipe["variation"]
    for index in range(20):
        spec = PLAN.frame(index)
        assert recorded_draws(recipe, variation, spec) == as_json(draw_values(values, SEED, spec))


@pytest.mark.parametrize(
    "identity",
    [
        None, {"per": "frame"}, {"per": "day", "in_turn": [1]}, {"per": "set", "outcomes": [1]},
        {"per": "set", "draw": "x", "family": "normal"},
    ],
)  # fmt: skip
def test_a_record_that_is_not_valid_is_a_value_error(identity):
    with pytest.raises(ValueError):  # noqa: PT011 - any message
        read_variation({"variation": {"camera.gain": identity}})


def test_values_are_equal_up_to_rounding_and_folders():
    assert same_value(0.1, 0.1 + 1e-17)
    assert same_value(2.0, 2)
    assert same_value("kaite", "/home/me/kaite.toml")
    assert not same_value(0.1, 0.1001)
    assert not same_value(1.0, True)
    assert not same_value("kaite", "red_blocky")
    assert not same_value(True, "true")

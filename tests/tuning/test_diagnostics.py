"""What is said of a fit: how sure each parameter is, and what was not fitted and is missed.

On linear models with normal errors everything is known in closed form, and what is said can be counted.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import kstest

from pepperscene.cultivar import Distribution
from pepperscene.tuning.fit.diagnostics import (
    STRONG_EVIDENCE,
    MIN_VARIANCE_REDUCTION,
    HIGH_CORRELATION,
    OmittedGroup,
    is_consistent,
    uncertainty,
    chi_squared,
    describe_fit,
    omitted_groups,
    undetermined,
)
from pepperscene.tuning.model.problem import FitProblem
from pepperscene.tuning.model.view_model import entries_of
from pepperscene.tuning.parameters.parameter import Parameter


def parameter(name, group="pigments", *, entries=1, default=0.0, sd=1.0, low=-10.0, high=10.0) -> Parameter:
    law = Distribution(law="normal", mean=0.0, sd=sd, low=low, high=high, chosen="for a test")
    labels = ("",) if entries == 1 else tuple(f"n{i}" for i in range(entries))
    values = np.full(entries, float(default))
    return Parameter(name, "", "for a test", labels, values, (law,) * entries, group)


class Linear:
    """Stands where a fit has its measured reflectances: data that are columns times values, and no picture.

    Args:
        columns: `(m, k)` of each parameter by name.
        data: `(m,)`, in units of their errors.
    """

    def __init__(self, columns, data):
        self.columns = {name: np.asarray(column, float) for name, column in columns.items()}
        self.data = np.asarray(data, float)
        self.independent = float(self.data.size)

    def residuals(self, values):
        found = -self.data
        for name, value in values.items():
            found = found + self.columns[name] @ value
        return found

    def jacobian(self, values, entries):
        return np.stack([self.columns[one.parameter.name][:, one.index] for one in entries], axis=1)


def fit(parameters, columns, data) -> tuple[FitProblem, np.ndarray]:
    """A linear problem and its minimum."""
    problem = FitProblem(parameters, lambda values: None, (), Linear(columns, data))
    start = np.zeros(len(problem.sd))
    jacobian, residuals = problem.jacobian(start), problem.residuals(start)
    best = -np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
    return problem, np.clip(best, problem.low, problem.high)


RNG = np.random.default_rng(11)
COLUMNS = RNG.standard_normal((60, 3))


# --- how sure ---------------------------------------------------------------------------------------------


def test_certainty_is_the_closed_form():
    """One column of the length l: the data alone say 1 / l, the bounds 1."""
    for length in (0.1, 1.0, 30.0):
        column = COLUMNS[:, :1] / np.linalg.norm(COLUMNS[:, 0]) * length
        problem, best = fit([parameter("leaf.a")], {"leaf.a": column}, np.zeros(60))
        known = uncertainty(problem, best)
        assert known.sd[0] == pytest.approx(1.0 / np.hypot(1.0, length))
        assert known.variance_reduction[0] == pytest.approx(length**2 / (1.0 + length**2))
        assert known.correlation == pytest.approx(np.eye(1))


def test_errors_are_as_large_as_certainty_says():
    """Over a hundred draws of truth and noise, errors in units of the sd follow the normal law."""
    names, rng, off = ("leaf.a", "leaf.b", "leaf.c"), np.random.default_rng(2), []
    parameters = [parameter(name) for name in names]
    columns = {name: 0.4 * COLUMNS[:, i : i + 1] for i, name in enumerate(names)}
    columns["leaf.b"] = columns["leaf.a"] + 0.3 * columns["leaf.b"]  # no two of them alone
    for _ in range(100):
        truth = rng.standard_normal(3)
        data = sum(columns[name] @ truth[i : i + 1] for i, name in enumerate(names))
        problem, best = fit(parameters, columns, data + rng.standard_normal(60))
        # The law that is tested is the one without the Birge ratio, which draws of noise move about 1.
        known = uncertainty(problem, best)
        excess = max(1.0, chi_squared(problem, best) / (problem.data - 3))
        covariance = known.correlation * np.outer(known.sd, known.sd)
        off.append(np.linalg.solve(np.linalg.cholesky(covariance), best - truth) * np.sqrt(excess))
    assert kstest(np.concatenate(off), "norm").pvalue > 1e-3


def test_errors_grow_with_what_the_model_misses():
    """By the Birge ratio: ten times the noise that was expected is ten times the error."""
    noise = np.random.default_rng(5).standard_normal(60)
    column = {"leaf.a": COLUMNS[:, :1]}
    wide = [parameter("leaf.a", sd=1e6, low=-1e9, high=1e9)]
    one, ten = (fit(wide, column, size * noise) for size in (2.0, 20.0))
    assert uncertainty(*ten).sd[0] == pytest.approx(10.0 * uncertainty(*one).sd[0], rel=1e-6)
    # Less than expected makes nothing surer than the errors allow.
    tenth, none = fit(wide, column, 0.1 * noise), fit(wide, column, 0.0 * noise)
    assert uncertainty(*tenth).sd[0] == pytest.approx(uncertainty(*none).sd[0])


def test_what_is_expected():
    assert is_consistent(100.0, 100)
    assert is_consistent(100.0 + 3.0 * np.sqrt(200.0), 100)
    assert not is_consistent(100.0 + 3.1 * np.sqrt(200.0), 100)
    assert is_consistent(0.0, 0)


def test_nothing_is_said_of_what_is_known():
    problem, best = fit([parameter("leaf.a")], {"leaf.a": COLUMNS[:, :1]}, 0.5 * COLUMNS[:, 0])
    assert best[0] == pytest.approx(0.5, abs=0.05)
    assert undetermined_entries(problem, best, uncertainty(problem, best)) == ()


def test_what_nothing_depends_on_is_open():
    problem, best = fit([parameter("leaf.a", sd=0.3)], {"leaf.a": np.zeros((60, 1))}, np.zeros(60))
    known = uncertainty(problem, best)
    (said,) = undetermined_entries(problem, best, known)
    assert known.variance_reduction[0] == 0.0 < MIN_VARIANCE_REDUCTION
    assert said == "leaf.a cannot be determined: it is known to ± 0.3, the bounds alone say ± 0.3"


def test_two_that_do_the_same_are_known_together_only():
    """As twice the light and twice the gain: their sum is known, their difference is not."""
    columns = dict.fromkeys(("flash.power", "exposure"), COLUMNS[:, :1])
    problem, best = fit([parameter("flash.power"), parameter("exposure")], columns, COLUMNS[:, 0])
    known = uncertainty(problem, best)
    assert known.correlation[0, 1] < -HIGH_CORRELATION
    said = undetermined_entries(problem, best, known)
    assert len(said) == 2
    assert "only a combination with exposure is known (correlation -0.9" in said[0]
    assert "only a combination with flash.power is known (correlation -0.9" in said[1]
    assert best.sum() == pytest.approx(1.0, abs=0.05)


def test_an_entry_at_an_end_is_told():
    """Data that ask for 5 where at most 1 can be."""
    columns = {"leaf.a": np.hstack([COLUMNS[:, :1], COLUMNS[:, 1:2]])}
    narrow = [parameter("leaf.a", entries=2, high=1.0)]
    problem, best = fit(narrow, columns, 5.0 * COLUMNS[:, 0])
    (said,) = undetermined_entries(problem, best, uncertainty(problem, best))
    assert said.startswith("leaf.a (n0) lies at an end of its bounds, 1:")


# --- what is missed ---------------------------------------------------------------------------------------

MANY = 40
CHANCE = np.random.default_rng(7).standard_normal((60, MANY))
"""Columns of so many parameters that they could explain most of anything."""

OTHERS = {
    "pigments": (parameter("leaf.many", entries=MANY),),
    "light": (parameter("flash.colour", "light", entries=2),),
    "exposure": (parameter("exposure", "exposure"),),
}


def blamed(data, *, own=None) -> dict[str, OmittedGroup]:
    """Who is suspected where one other parameter was fitted."""
    columns = {
        "stem.a": np.random.default_rng(9).standard_normal((60, 1)) if own is None else own,
        "leaf.many": CHANCE,
        "flash.colour": COLUMNS[:, :2],
        "exposure": COLUMNS[:, 2:],
    }
    problem, best = fit([parameter("stem.a")], columns, data)
    return omitted_groups(problem, best, OTHERS)


@pytest.mark.parametrize(
    ("group", "missed"),
    [
        ("light", 3.0 * COLUMNS[:, 0] - 2.0 * COLUMNS[:, 1]),
        ("exposure", 4.0 * COLUMNS[:, 2]),
        ("pigments", CHANCE @ (1.5 * np.random.default_rng(3).standard_normal(MANY))),
    ],
)
def test_the_group_that_is_missed_comes_first(group, missed):
    """Though two of three times there is another that could take away nearly as much."""
    noise = np.random.default_rng(4).standard_normal(60)
    found = blamed(missed + noise)
    assert next(iter(found)) == group, found
    evidence = [one.evidence for one in found.values()]
    assert evidence == sorted(evidence, reverse=True)
    assert found[group].share > 0.75
    assert evidence[0] - evidence[1] > STRONG_EVIDENCE
    assert evidence[0] > 0.0


def test_many_parameters_take_away_much_and_are_blamed_for_little():
    found = blamed(3.0 * COLUMNS[:, 0] + np.random.default_rng(4).standard_normal(60))
    assert found["pigments"].share > 0.25
    assert found["pigments"].evidence < found["light"].evidence - STRONG_EVIDENCE


def test_one_among_many_is_named():
    """Forty pigments together promise too much to be likely; the one that is missed does not."""
    each = tuple(parameter(f"leaf.p{i}") for i in range(MANY))
    columns = {one.name: CHANCE[:, i : i + 1] for i, one in enumerate(each)}
    columns |= {"stem.a": np.zeros((60, 1)), "flash.colour": COLUMNS[:, :2]}
    data = 2.0 * CHANCE[:, 17] + np.random.default_rng(4).standard_normal(60)
    problem, best = fit([parameter("stem.a")], columns, data)
    found = omitted_groups(problem, best, {"light": OTHERS["light"], "pigments": each})
    assert next(iter(found)) == "pigments"
    assert found["pigments"].alone == "leaf.p17"
    assert found["pigments"].evidence > STRONG_EVIDENCE
    (told, *_) = said(3600.0, found, leaf=4.0)[1:]
    assert told.startswith("Most likely the fit lacks the pigments (leaf.p17), which could take away ")


def test_noise_alone_speaks_for_no_one():
    """Three times what is expected, and at random: each group explains less than its number promises."""
    for seed in range(5):
        noise = 3.0 * np.random.default_rng(100 + seed).standard_normal(60)
        assert max(one.evidence for one in blamed(noise).values()) < STRONG_EVIDENCE


def test_groups_stay_within_their_bounds():
    """What would need twenty times what can be is not taken away."""
    tight = {"light": (parameter("flash.colour", "light", entries=2, low=-0.1, high=0.1),)}
    data = 8.0 * COLUMNS[:, 0]
    columns = {"stem.a": np.zeros((60, 1)), "flash.colour": COLUMNS[:, :2]}
    problem, best = fit([parameter("stem.a")], columns, data)
    free = omitted_groups(problem, best, {"light": OTHERS["light"]})["light"]
    held = omitted_groups(problem, best, tight)["light"]
    assert free.share > 0.95
    assert held.share == pytest.approx(1.0 - (1.0 - 0.1 / 8.0) ** 2, rel=0.2)
    assert held.evidence < free.evidence


def test_on_an_end_of_the_bounds_there_is_a_way_in():
    """A content that the recipe has nothing of lies there."""
    nothing = (parameter("leaf.capsanthin", default=0.0, low=0.0),)
    columns = {"stem.a": np.zeros((60, 1)), "leaf.capsanthin": COLUMNS[:, :1]}
    for sign, much in ((1.0, True), (-1.0, False)):
        problem, best = fit([parameter("stem.a")], columns, sign * 5.0 * COLUMNS[:, 0])
        found = omitted_groups(problem, best, {"pigments": nothing})["pigments"]
        assert (found.share > 0.8) == much


def test_what_fitted_parameters_do_too_is_not_counted_twice():
    """A group whose columns are those of the fitted ones can add nothing but room within the bounds."""
    data = 5.0 * COLUMNS[:, 1] + np.random.default_rng(4).standard_normal(60)
    wide = [parameter("stem.a", sd=100.0, low=-1e4, high=1e4)]
    columns = {"stem.a": COLUMNS[:, 2:], "exposure": COLUMNS[:, 2:]}
    problem, best = fit(wide, columns, data)
    assert omitted_groups(problem, best, {"exposure": OTHERS["exposure"]})["exposure"].share < 0.01


def test_nothing_left_and_no_one_left():
    problem, best = fit([parameter("stem.a")], {"stem.a": np.zeros((60, 1))}, np.zeros(60))
    assert omitted_groups(problem, best, OTHERS) == {}
    problem, best = fit([parameter("stem.a")], {"stem.a": np.zeros((60, 1))}, COLUMNS[:, 0])
    assert omitted_groups(problem, best, {"light": ()}) == {}


def test_entries_are_those_of_the_parameters():
    labels = [one.label for one in entries_of(OTHERS["light"])]
    assert labels == ["flash.colour (n0)", "flash.colour (n1)"]


# --- in describe_fit -----------------------------------------------------------------------------------------


def said(value, left=None, open_entries=(), **off) -> tuple[str, ...]:
    """Of a problem of 100 data."""
    kinds = {kind: SimpleNamespace(delta_e_after=delta) for kind, delta in off.items()}
    return describe_fit(SimpleNamespace(data=100), value, open_entries, left or {}, kinds)


def test_a_fit_that_meets_its_patches():
    (only,) = said(81.0, leaf=0.2)
    assert only == "The model meets the patches: what is left is 0.90 times what is expected."
    assert said(81.0, open_entries=("leaf.a cannot be determined",))[-1] == "leaf.a cannot be determined"


def test_one_likely_cause():
    left = {"light": OmittedGroup(0.91, 80.0), "pigments": OmittedGroup(0.76, 20.0), "cuticle": OmittedGroup(0.4, -3.0)}
    told = said(3600.0, left, leaf=4.0)
    assert told[0] == "The model misses the patches by 6.0 times what is expected."
    assert told[1] == ("Most likely the fit lacks the light, which could take away 91 % of what is left.")
    assert told[2] == "Far less likely, though some of it goes with them: the pigments (76 %)."
    assert told[3].startswith("Mean colours still lie off: leaf (dE2000 4.0).")
    assert not any("cuticle" in one for one in told)


def test_two_causes_that_cannot_be_told_apart():
    left = {"camera": OmittedGroup(0.92, 104.0, "white_balance"), "light": OmittedGroup(0.9, 101.0)}
    assert said(3600.0, left, leaf=4.0)[1] == (
        "Most likely the fit lacks the camera (white_balance) or the light, which could take away 92 % or "
        "90 % of what is left."
    )


def test_no_likely_cause():
    for left in ({"light": OmittedGroup(0.1, 30.0)}, {"pigments": OmittedGroup(0.8, -2.0)}):
        told = said(3600.0, left, leaf=4.0)
        assert told[1].startswith("No parameter that was left out takes away a quarter of it")


def test_what_is_missed_and_not_seen():
    told = said(3600.0, {"light": OmittedGroup(0.91, 80.0)}, leaf=0.2, stem=0.4)
    assert "No mean colour lies further off than dE2000 0.4, which is not seen." in told
    assert not any("not seen" in one for one in said(3600.0, leaf=0.2, stem=1.4))
    assert not any("not seen" in one for one in said(3600.0))  # of reflectances alone there are no colours

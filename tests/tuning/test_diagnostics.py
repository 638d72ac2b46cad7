"""Diagnostics of a fit: uncertainty of its parameters, omitted parameters, and sentences.

For linear models with normal errors everything is known in closed form.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import kstest

from pepperscene.cultivar import Distribution
from pepperscene.tuning.bounds import Parameter
from pepperscene.tuning.diagnostics import (
    HIGH_CORRELATION,
    MIN_VARIANCE_REDUCTION,
    STRONG_EVIDENCE,
    OmittedGroup,
    chi_squared,
    describe_fit,
    is_consistent,
    omitted_groups,
    uncertainty,
    undetermined_entries,
)
from pepperscene.tuning.problem import FitProblem


def parameter(name, group="pigments", *, entries=1, default=0.0, sd=1.0, low=-10.0, high=10.0) -> Parameter:
    prior = Distribution(family="normal", mean=0.0, sd=sd, low=low, high=high, chosen="for a test")
    labels = ("",) if entries == 1 else tuple(f"n{i}" for i in range(entries))
    values = np.full(entries, float(default))
    return Parameter(name, "", "for a test", group, values, labels=labels, prior=(prior,) * entries)


class LinearData:
    """Replaces the model of reflectances in a fit: residuals are columns times values minus data.

    Args:
        columns: `(m, k)` of each parameter by name.
        data: `(m,)`, in units of their errors.
    """

    def __init__(self, columns, data):
        self.columns = {name: np.asarray(column, float) for name, column in columns.items()}
        self.data = np.asarray(data, float)
        self.independent = float(self.data.size)

    def residuals(self, values):
        return sum((self.columns[name] @ value for name, value in values.items()), -self.data)

    def jacobian(self, values, entries):
        return np.stack([self.columns[one.parameter.name][:, one.index] for one in entries], axis=1)


def fit(parameters, columns, data) -> tuple[FitProblem, np.ndarray]:
    """A linear problem and its minimum."""
    problem = FitProblem(parameters, lambda values: None, (), LinearData(columns, data))
    start = np.zeros(len(problem.sd))
    best = -np.linalg.lstsq(problem.jacobian(start), problem.residuals(start), rcond=None)[0]
    return problem, np.clip(best, problem.low, problem.high)


COLUMNS = np.random.default_rng(11).standard_normal((60, 3))
NOISE = np.random.default_rng(4).standard_normal(60)


def test_uncertainty_has_the_closed_form():
    """For one column of length l, the sd is 1 / l from the data alone and 1 from the prior."""
    for length in (0.1, 1.0, 30.0):
        column = COLUMNS[:, :1] / np.linalg.norm(COLUMNS[:, 0]) * length
        posterior = uncertainty(*fit([parameter("leaf.a")], {"leaf.a": column}, np.zeros(60)))
        assert posterior.sd[0] == pytest.approx(1.0 / np.hypot(1.0, length))
        assert posterior.variance_reduction[0] == pytest.approx(length**2 / (1.0 + length**2))
        assert posterior.correlation == pytest.approx(np.eye(1))


def test_errors_are_normal_with_the_stated_covariance():
    """Over a hundred draws of truth and noise."""
    names, rng, errors = ("leaf.a", "leaf.b", "leaf.c"), np.random.default_rng(2), []
    parameters = [parameter(name) for name in names]
    columns = {name: 0.4 * COLUMNS[:, i : i + 1] for i, name in enumerate(names)}
    columns["leaf.b"] = columns["leaf.a"] + 0.3 * columns["leaf.b"]  # correlated
    for _ in range(100):
        truth = rng.standard_normal(3)
        data = sum(columns[name] @ truth[i : i + 1] for i, name in enumerate(names))
        problem, best = fit(parameters, columns, data + rng.standard_normal(60))
        # Without the Birge ratio, which varies about 1 with the noise.
        posterior = uncertainty(problem, best)
        birge = max(1.0, chi_squared(problem, best) / (problem.data_count - 3))
        covariance = posterior.correlation * np.outer(posterior.sd, posterior.sd)
        errors.append(np.linalg.solve(np.linalg.cholesky(covariance), best - truth) * np.sqrt(birge))
    assert kstest(np.concatenate(errors), "norm").pvalue > 1e-3


def test_uncertainty_grows_with_large_residuals():
    """By the Birge ratio: ten times the noise gives ten times the error."""
    noise = np.random.default_rng(5).standard_normal(60)
    column = {"leaf.a": COLUMNS[:, :1]}
    wide = [parameter("leaf.a", sd=1e6, low=-1e9, high=1e9)]
    sd = [uncertainty(*fit(wide, column, size * noise)).sd[0] for size in (20.0, 2.0, 0.1, 0.0)]
    assert sd[0] == pytest.approx(10.0 * sd[1], rel=1e-6)
    # Residuals that are smaller than expected do not reduce it.
    assert sd[2] == pytest.approx(sd[3])


def test_consistency_allows_three_standard_deviations():
    assert is_consistent(100.0, 100)
    assert is_consistent(100.0 + 3.0 * np.sqrt(200.0), 100)
    assert not is_consistent(100.0 + 3.1 * np.sqrt(200.0), 100)
    assert is_consistent(0.0, 0)


def test_reports_entries_that_data_do_not_determine():
    problem, best = fit([parameter("leaf.a")], {"leaf.a": COLUMNS[:, :1]}, 0.5 * COLUMNS[:, 0])
    assert best[0] == pytest.approx(0.5, abs=0.05)
    assert undetermined_entries(problem, best, uncertainty(problem, best)) == ()
    problem, best = fit([parameter("leaf.a", sd=0.3)], {"leaf.a": np.zeros((60, 1))}, np.zeros(60))
    posterior = uncertainty(problem, best)
    (sentence,) = undetermined_entries(problem, best, posterior)
    assert posterior.variance_reduction[0] == 0.0 < MIN_VARIANCE_REDUCTION
    assert sentence == "leaf.a cannot be determined: its posterior sd is 0.3, its prior sd 0.3"
    # Data that need a value of 5 for a parameter of at most 1.
    narrow = [parameter("leaf.a", entries=2, high=1.0)]
    problem, best = fit(narrow, {"leaf.a": COLUMNS[:, :2]}, 5.0 * COLUMNS[:, 0])
    (sentence,) = undetermined_entries(problem, best, uncertainty(problem, best))
    assert sentence.startswith("leaf.a (n0) is at a limit of its bounds, 1:")


def test_reports_entries_that_are_known_in_combination_only():
    """Such as power and gain: their product is known, their ratio is not."""
    columns = dict.fromkeys(("flash.power", "exposure"), COLUMNS[:, :1])
    problem, best = fit([parameter("flash.power"), parameter("exposure")], columns, COLUMNS[:, 0])
    posterior = uncertainty(problem, best)
    assert posterior.correlation[0, 1] < -HIGH_CORRELATION
    sentences = undetermined_entries(problem, best, posterior)
    assert len(sentences) == 2
    assert "only a combination with exposure is known (correlation -0.9" in sentences[0]
    assert "only a combination with flash.power is known (correlation -0.9" in sentences[1]
    assert best.sum() == pytest.approx(1.0, abs=0.05)


MANY = 40
MANY_COLUMNS = np.random.default_rng(7).standard_normal((60, MANY))
"""Columns of so many parameters that they could explain most of anything."""

UNFITTED = {
    "pigments": (parameter("leaf.many", entries=MANY),),
    "light": (parameter("flash.colour", "light", entries=2),),
    "exposure": (parameter("exposure", "exposure"),),
}


def omitted(data, unfitted=UNFITTED, *, fitted=None, **more) -> dict[str, OmittedGroup]:
    """Causes of the residuals of a fit of another parameter, which data depend on by the given column."""
    columns = {
        "stem.a": np.zeros((60, 1)) if fitted is None else fitted,
        "leaf.many": MANY_COLUMNS,
        "flash.colour": COLUMNS[:, :2],
        "exposure": COLUMNS[:, 2:],
        **more,
    }
    return omitted_groups(*fit([parameter("stem.a")], columns, data), unfitted)


RANDOM = np.random.default_rng(9).standard_normal((60, 1))


@pytest.mark.parametrize(
    ("group", "cause"),
    [
        ("light", 3.0 * COLUMNS[:, 0] - 2.0 * COLUMNS[:, 1]),
        ("exposure", 4.0 * COLUMNS[:, 2]),
        ("pigments", MANY_COLUMNS @ (1.5 * np.random.default_rng(3).standard_normal(MANY))),
    ],
)
def test_the_true_cause_is_first(group, cause):
    """Although for two of three there is another that could explain nearly as much."""
    groups = omitted(cause + NOISE, fitted=RANDOM)
    assert next(iter(groups)) == group, groups
    evidence = [one.evidence for one in groups.values()]
    assert evidence == sorted(evidence, reverse=True)
    assert groups[group].explained > 0.75
    assert groups["pigments"].explained > 0.25
    assert evidence[0] - evidence[1] > STRONG_EVIDENCE
    assert evidence[0] > 0.0


def test_names_one_parameter_of_many():
    """Forty pigments together are unlikely; the one that is missing is not."""
    each = tuple(parameter(f"leaf.p{i}") for i in range(MANY))
    columns = {one.name: MANY_COLUMNS[:, i : i + 1] for i, one in enumerate(each)}
    unfitted = {"light": UNFITTED["light"], "pigments": each}
    groups = omitted(2.0 * MANY_COLUMNS[:, 17] + NOISE, unfitted, **columns)
    assert next(iter(groups)) == "pigments"
    assert groups["pigments"].parameter == "leaf.p17"
    assert groups["pigments"].evidence > STRONG_EVIDENCE
    assert "point to pigments, especially leaf.p17 (could explain " in describe(3600.0, groups, leaf=4.0)[1]


def test_noise_is_no_evidence():
    """Three times the expected noise: each group explains less than its number of parameters would."""
    for seed in range(5):
        noise = 3.0 * np.random.default_rng(100 + seed).standard_normal(60)
        groups = omitted(noise, fitted=RANDOM)
        assert max(one.evidence for one in groups.values()) < STRONG_EVIDENCE


def test_groups_stay_within_their_bounds():
    """Residuals that would need twenty times the largest value are not explained."""
    data = 8.0 * COLUMNS[:, 0]
    tight = parameter("flash.colour", "light", entries=2, low=-0.1, high=0.1)
    free, bounded = (omitted(data, {"light": (one,)})["light"] for one in (*UNFITTED["light"], tight))
    assert free.explained > 0.95
    assert bounded.explained == pytest.approx(1.0 - (1.0 - 0.1 / 8.0) ** 2, rel=0.2)
    assert bounded.evidence < free.evidence


def test_parameter_at_a_bound_can_move_inwards():
    """Such as a content that the recipe has none of."""
    absent = {"pigments": (parameter("leaf.capsanthin", default=0.0, low=0.0),)}
    for sign, explains in ((1.0, True), (-1.0, False)):
        data = sign * 5.0 * COLUMNS[:, 0]
        group = omitted(data, absent, **{"leaf.capsanthin": COLUMNS[:, :1]})["pigments"]
        assert (group.explained > 0.8) == explains


def test_effect_of_fitted_parameters_is_not_counted_twice():
    """A group with the columns of fitted parameters adds nothing but space within the bounds."""
    data = 5.0 * COLUMNS[:, 1] + NOISE
    wide = [parameter("stem.a", sd=100.0, low=-1e4, high=1e4)]
    problem, best = fit(wide, {"stem.a": COLUMNS[:, 2:], "exposure": COLUMNS[:, 2:]}, data)
    assert omitted_groups(problem, best, {"exposure": UNFITTED["exposure"]})["exposure"].explained < 0.01


def test_no_causes_without_residuals_or_parameters():
    assert omitted(np.zeros(60)) == {}
    assert omitted(COLUMNS[:, 0], {"light": ()}) == {}


def describe(chi2, causes=None, undetermined=(), **delta_e) -> tuple[str, ...]:
    """Of a problem with 100 data."""
    return describe_fit(SimpleNamespace(data_count=100), chi2, undetermined, causes or {}, delta_e)


def test_describes_good_fits_and_likely_causes():
    sentence = "The model fits the patches: RMS residuals are 0.90 times the expected size."
    assert describe(81.0, leaf=0.2) == (sentence,)
    undetermined = ("leaf.a cannot be determined",)
    assert describe(81.0, undetermined=undetermined)[1:] == undetermined
    causes = {
        "light": OmittedGroup(0.91, 80.0),
        "pigments": OmittedGroup(0.76, 20.0),
        "cuticle": OmittedGroup(0.4, -3.0),
    }
    assert describe(3600.0, causes, leaf=4.0) == (
        "The model does not fit the patches: RMS residuals are 6.0 times the expected size.",
        "The unexplained residuals point to light (could explain 91 % of chi-squared).",
        "Other groups could explain part of it, but are much less likely: pigments (76 %).",
        "Mean colours still differ visibly: leaf (dE2000 4.0).",
    )
    causes = {"camera": OmittedGroup(0.92, 104.0, "white_balance"), "light": OmittedGroup(0.9, 101.0)}
    assert describe(3600.0, causes, leaf=4.0)[1] == (
        "The unexplained residuals point to camera, especially white_balance (could explain 92 % of "
        "chi-squared), or light (90 %)."
    )
    for causes in ({"light": OmittedGroup(0.1, 30.0)}, {"pigments": OmittedGroup(0.8, -2.0)}):
        sentence = describe(3600.0, causes, leaf=4.0)[1]
        assert sentence.startswith("No omitted parameter could explain a quarter of the residuals")


def test_describes_differences_that_are_not_visible():
    causes = {"light": OmittedGroup(0.91, 80.0)}
    sentence = "No mean colour differs by more than dE2000 0.4, which is not visible."
    assert sentence in describe(3600.0, causes, leaf=0.2, stem=0.4)
    assert not any("not visible" in one for one in describe(3600.0, leaf=0.2, stem=1.4))
    assert not any("not visible" in one for one in describe(3600.0))  # reflectances alone have no colours

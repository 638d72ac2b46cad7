"""Uncertainty of a fit's parameters, and groups of omitted parameters that could explain its residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.tuning.bounds import Parameter
from pepperscene.tuning.problem import FitProblem
from pepperscene.tuning.view_model import entries_of

Array = NDArray[np.float64]
MIN_VARIANCE_REDUCTION: Final = 0.75  # chosen: below, half of the prior sd or more remains
HIGH_CORRELATION: Final = 0.95  # chosen: above, two entries are reported as known in combination only
MIN_EXPLAINED: Final = 0.25  # chosen: fraction of chi-squared from which a group is reported as a cause
STRONG_EVIDENCE: Final = 10.0
"""Difference in twice the log evidence from which one group is far likelier than another: 150 to 1, "very
strong" evidence in Kass & Raftery 1995 (J. Am. Stat. Assoc. 90:773)."""
INVISIBLE_DELTA_E: Final = 1.0  # CIEDE2000 below which two colours look the same
VISIBLE_DELTA_E: Final = 3.0  # chosen: CIEDE2000 above which a difference is visible at a glance
_AT_BOUND: Final = 1e-3  # fraction of the width of the bounds
_MIN_SPACE: Final = 1e-9  # in prior standard deviations


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Posterior uncertainty of the entries in the Laplace approximation."""

    sd: Array  # (p,) posterior standard deviations
    variance_reduction: Array  # (p,) 1 - posterior variance / prior variance: 0 if the data add nothing
    correlation: Array  # (p, p) posterior correlations


def uncertainty(problem: FitProblem, vector: Array) -> Uncertainty:
    """Compute the uncertainty of the entries from the curvature of the cost at its minimum.

    If the residuals are larger than expected, the errors of the data are assumed to be larger by the same
    factor (the Birge ratio; Birge 1932, Phys. Rev. 40:207).
    """
    # The curvature of data and priors is the inverse of the posterior covariance.
    slopes = problem.data_jacobian(problem.values(vector), problem.entries)
    curvature = slopes.T @ slopes / _squared_birge_ratio(problem, vector) + np.diag(problem.sd**-2.0)
    covariance = np.linalg.inv(curvature)
    sd = np.sqrt(np.diag(covariance))
    return Uncertainty(sd, 1.0 - (sd / problem.sd) ** 2, covariance / np.outer(sd, sd))


def chi_squared(problem: FitProblem, vector: Array) -> float:
    """Sum of the squared residuals of the data."""
    return float((problem.data_residuals(problem.values(vector)) ** 2).sum())


def is_consistent(chi2: float, data_count: int) -> bool:
    """Whether chi-squared is at most three standard deviations above its expectation."""
    return chi2 <= data_count + 3.0 * np.sqrt(2.0 * data_count)


def _squared_birge_ratio(problem: FitProblem, vector: Array) -> float:
    """Chi-squared per degree of freedom; 1 if it is smaller."""
    return max(1.0, chi_squared(problem, vector) / max(problem.data_count - len(vector), 1))


def undetermined_entries(problem: FitProblem, vector: Array, posterior: Uncertainty) -> tuple[str, ...]:
    """Return a sentence, with the reason, for each entry that the data do not determine."""
    sentences = []
    for i, entry in enumerate(problem.entries):
        width = problem.high[i] - problem.low[i]
        if min(vector[i] - problem.low[i], problem.high[i] - vector[i]) < _AT_BOUND * width:
            sentences.append(
                f"{entry.label} is at a limit of its bounds, {vector[i]:.4g}: the data call for a value "
                "outside of the bounds, or another parameter is missing from the fit"
            )
        elif posterior.variance_reduction[i] < MIN_VARIANCE_REDUCTION:
            sds = f"its posterior sd is {posterior.sd[i]:.3g}, its prior sd {problem.sd[i]:.3g}"
            sentence = f"{entry.label} cannot be determined: {sds}"
            correlations = np.abs(posterior.correlation[i]).copy()
            correlations[i] = 0.0
            partner = int(np.argmax(correlations))
            if correlations[partner] >= HIGH_CORRELATION:
                label, correlation = problem.entries[partner].label, posterior.correlation[i, partner]
                sentence += f"; only a combination with {label} is known (correlation {correlation:+.2f})"
            sentences.append(sentence)
    return tuple(sentences)


# --- omitted parameters -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class OmittedGroup:
    """A group of parameters that was not fitted, as a possible cause of the residuals."""

    explained: float  # fraction of chi-squared that it could remove within its bounds
    evidence: float  # twice the logarithm of its Bayes factor
    parameter: str = ""  # the one that explains the data better than the whole group; or ""


def omitted_groups(
    problem: FitProblem, vector: Array, unfitted: Mapping[str, Sequence[Parameter]]
) -> dict[str, OmittedGroup]:
    """Rank groups of parameters that were not fitted as causes of the residuals, the likeliest first.

    The fraction that a group could explain follows from a linear step of fitted and further parameters
    together, within their bounds (the score test; Rao 1948, Proc. Camb. Phil. Soc. 44:50). Dozens of pigments
    can explain almost anything, so the groups are ranked by evidence, which also accounts for the prior
    probability of the step and for everything else that the group could have explained (MacKay 1992, Neural
    Comput. 4:415). Errors of the data are as in `uncertainty`. The cause is a whole group or one of its
    parameters, each of which is equally likely beforehand.
    """
    values = problem.values(vector)
    residuals = problem.data_residuals(values)
    if not np.any(residuals):
        return {}
    error_scale = np.sqrt(_squared_birge_ratio(problem, vector))
    # In units of the prior sd, so that the rows of the priors are ones.
    fitted_slopes = problem.data_jacobian(values, problem.entries) * problem.sd
    deviation = (vector - problem.mean) / problem.sd
    low, high = (problem.low - vector) / problem.sd, (problem.high - vector) / problem.sd
    groups = {}
    for group, parameters in unfitted.items():
        entries = entries_of(parameters)
        if not entries:
            continue
        scales, lows, highs, start = np.array(
            [(entry.prior.sd, entry.prior.low, entry.prior.high, entry.value({})) for entry in entries]
        ).T
        model = _LinearModel(
            np.hstack([fitted_slopes, problem.data_jacobian(values, entries) * scales]),
            residuals,
            np.concatenate([deviation, np.zeros(len(entries))]),
            np.concatenate([low, (lows - start) / scales]),
            np.concatenate([high, (highs - start) / scales]),
        )
        names = [entry.parameter.name for entry in entries]
        groups[group] = model.omitted_group(len(vector), names, error_scale)
    return dict(sorted(groups.items(), key=lambda item: -item[1].evidence))


@dataclass(frozen=True, eq=False)
class _LinearModel:
    """Linear model of fitted and further entries, in units of their prior sd."""

    slopes: Array  # (m, p) derivatives of the residuals
    residuals: Array  # (m,) residuals of the data
    deviation: Array  # (p,) distance of the entries from their prior means
    low: Array  # (p,) limits of a step
    high: Array  # (p,) limits of a step

    def omitted_group(self, fitted: int, names: Sequence[str], error_scale: float) -> OmittedGroup:
        """Residuals that the entries after the `fitted` ones, of parameters `names`, explain.

        `error_scale` is a factor on the errors of the data.
        """
        all_entries, fitted_entries = np.arange(len(self.deviation)), np.arange(fitted)
        explained = 1.0 - self._costs(all_entries, 1.0)[0] / float(self.residuals @ self.residuals)
        # With larger errors, the fitted entries alone would move towards their prior means as well.
        before = self._deviance(fitted_entries, error_scale)
        evidence = {"": before - self._deviance(all_entries, error_scale)}
        # Each parameter alone: one of so many possible causes, which its prior probability pays for.
        for name in dict.fromkeys(names):
            selected = np.concatenate(
                [fitted_entries, fitted + np.flatnonzero([entry_name == name for entry_name in names])]
            )
            gain = before - self._deviance(selected, error_scale)
            evidence[name] = gain - 2.0 * np.log(len(set(names)))
        best = max(evidence, key=lambda name: evidence[name])
        return OmittedGroup(float(np.clip(explained, 0.0, 1.0)), float(evidence[best]), best)

    def _deviance(self, selected: NDArray[np.intp], error_scale: float) -> float:
        """Minus twice the log evidence if only the chosen entries change, up to a constant."""
        slopes = self.slopes[:, selected] / error_scale
        # Log of the squared ratio of prior to posterior volume: the Occam factor.
        occam = float(np.linalg.slogdet(np.eye(slopes.shape[1]) + slopes.T @ slopes)[1])
        return sum(self._costs(selected, error_scale)) + occam

    def _costs(self, selected: NDArray[np.intp], error_scale: float) -> tuple[float, float]:
        """Costs of data and priors after the best step of the chosen entries."""
        from scipy.optimize import lsq_linear

        slopes, deviation = self.slopes[:, selected] / error_scale, self.deviation[selected]
        residuals = self.residuals / error_scale
        rows = np.vstack([slopes, np.eye(len(deviation))])
        # An entry on a bound has no space; rounding must not make it negative.
        bounds = np.minimum(self.low[selected], -_MIN_SPACE), np.maximum(self.high[selected], _MIN_SPACE)
        step = lsq_linear(rows, -np.concatenate([residuals, deviation]), bounds).x
        left = residuals + slopes @ step
        return float(left @ left), float(((deviation + step) ** 2).sum())


# --- sentences ----------------------------------------------------------------------------------------------


def describe_fit(
    problem: FitProblem,
    chi2: float,
    undetermined: Sequence[str],
    omitted: Mapping[str, OmittedGroup],
    delta_e: Mapping[str, float],
) -> tuple[str, ...]:
    """Describe a fit in sentences; `delta_e` is CIEDE2000 of the mean colours after the fit, by kind."""
    ratio, consistent = np.sqrt(chi2 / max(problem.data_count, 1)), is_consistent(chi2, problem.data_count)
    if consistent:
        sentences = [f"The model fits the patches: RMS residuals are {ratio:.2f} times the expected size."]
    else:
        conclusion = (
            f"The model does not fit the patches: RMS residuals are {ratio:.1f} times the expected size."
        )
        sentences = [conclusion, *_describe_causes(omitted)]
        if (largest := max(delta_e.values(), default=np.inf)) < INVISIBLE_DELTA_E:
            sentences.append(
                f"No mean colour differs by more than dE2000 {largest:.1f}, which is not visible."
            )
    visible = [f"{kind} (dE2000 {value:.1f})" for kind, value in delta_e.items() if value > VISIBLE_DELTA_E]
    if visible:
        sentences.append(f"Mean colours still differ visibly: {', '.join(visible)}.")
        if consistent:
            sentences.append("Patches of the same kind vary too much to determine the mean colour better.")
    return (*sentences, *undetermined)


def _describe_causes(omitted: Mapping[str, OmittedGroup]) -> list[str]:
    if not omitted:
        return []
    causes = {
        group: cause
        for group, cause in omitted.items()
        if cause.explained >= MIN_EXPLAINED and cause.evidence > 0.0
    }
    if not causes:
        reason = "No omitted parameter could explain a quarter of the residuals"
        return [f"{reason}: check the patches, their labels and their light."]
    percent = {group: f"{100 * cause.explained:.0f} %" for group, cause in causes.items()}
    best, *_ = causes.values()
    likely = [group for group in causes if best.evidence - causes[group].evidence < STRONG_EVIDENCE]
    parts: list[str] = []
    for group in likely:
        single = f", especially {causes[group].parameter}" if causes[group].parameter else ""
        fraction = percent[group] if parts else f"could explain {percent[group]} of chi-squared"
        parts.append(f"{group}{single} ({fraction})")
    sentences = [f"The unexplained residuals point to {', or '.join(parts)}."]
    others = [f"{group} ({percent[group]})" for group in causes if group not in likely]
    if others:
        names = ", ".join(others)
        sentences.append(f"Other groups could explain part of it, but are much less likely: {names}.")
    return sentences

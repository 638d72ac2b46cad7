"""How sure a fit can be: what curvature says of each parameter, and who could take away what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.tuning.model.problem import FitProblem
from pepperscene.tuning.model.view_model import entries_of

if TYPE_CHECKING:
    from pepperscene.tuning.fit.result import KindFit
    from pepperscene.tuning.parameters.parameter import Parameter


Array = NDArray[np.float64]

LEAST_GAIN: Final = 0.75
"""Chosen: below, half of the bounds' sd or more is left, and the data do not determine a parameter."""
TIED: Final = 0.95
"""Chosen: correlation from which two entries are told to be known together only."""
WORTH_TELLING: Final = 0.25
"""Chosen: share of what is left from which a group of parameters is named."""
ALIKE: Final = 10.0
"""Twice the logarithm of the odds from which one group is far likelier than another: 150 to 1, "very strong"
evidence to Kass & Raftery 1995 (J. Am. Stat. Assoc. 90:773)."""
UNSEEN: Final = 1.0
"""CIEDE2000 below which two colours look the same."""

SEEN: Final = 3.0
"""Chosen: CIEDE2000 from which a difference is seen at a glance."""

_AT_AN_END: Final = 1e-3  # of a bound's width
_LEAST_ROOM: Final = 1e-9  # of the bounds' sd


@dataclass(frozen=True, eq=False)
class Certainty:
    """What the curvature at the best values says.

    Attributes:
        sd: `(p,)` of each entry, by data and bounds together (the Laplace approximation).
        gained: `(p,)` share of the bounds' variance that the data take away.
        correlation: `(p, p)`.
    """

    sd: Array
    gained: Array
    correlation: Array


def certainty(problem: FitProblem, vector: Array) -> Certainty:
    """Standard deviations and correlations of the entries at a minimum.

    Where the data miss the model by more than expected, their errors are taken to be as much larger (the
    Birge ratio; Birge 1932, Phys. Rev. 40:207).
    """
    slopes = problem.data_jacobian(problem.values(vector), problem.entries)
    curvature = slopes.T @ slopes / _excess(problem, vector) + np.diag(problem.sd**-2.0)
    covariance = np.linalg.inv(curvature)
    sd = np.sqrt(np.diag(covariance))
    return Certainty(sd, 1.0 - (sd / problem.sd) ** 2, covariance / np.outer(sd, sd))


def chi_squared(problem: FitProblem, vector: Array) -> float:
    """Sum of the data's squared residuals."""
    return float((problem.data_residuals(problem.values(vector)) ** 2).sum())


def as_expected(value: float, data: int) -> bool:
    """Whether a sum of squares is within three standard deviations of what `data` residuals should give."""
    return value <= data + 3.0 * np.sqrt(2.0 * data)


def undetermined(problem: FitProblem, vector: Array, known: Certainty) -> tuple[str, ...]:
    """A sentence for each entry that the data leave open, and why."""
    found = []
    for i, entry in enumerate(problem.entries):
        width = problem.high[i] - problem.low[i]
        at_end = min(vector[i] - problem.low[i], problem.high[i] - vector[i]) < _AT_AN_END * width
        label = entry.label
        if at_end:
            found.append(
                f"{label} lies at an end of its bounds, {vector[i]:.4g}: the data ask for more than they "
                "allow, or for something else"
            )
        elif known.gained[i] < LEAST_GAIN:
            found.append(_open(problem, known, i))
    return tuple(found)


def _open(problem: FitProblem, known: Certainty, i: int) -> str:
    """Why the data do not determine an entry: nothing depends on it, or another does the same."""
    others = np.abs(known.correlation[i]).copy()
    others[i] = 0.0
    tied = int(np.argmax(others))
    what = (
        f"{problem.entries[i].label} cannot be determined: it is known to ± {known.sd[i]:.3g}, the bounds "
        f"alone say ± {problem.sd[i]:.3g}"
    )
    if others[tied] < TIED:
        return what
    with_it = f"{problem.entries[tied].label} is known (correlation {known.correlation[i, tied]:+.2f})"
    return f"{what}; only a combination with {with_it}"


@dataclass(frozen=True)
class Suspect:
    """A group of parameters that was not fitted, as the cause of what is left.

    Attributes:
        share: of the data's squared residuals that it could take away within its bounds.
        evidence: twice the logarithm of how many times likelier it makes the data.
        alone: the one parameter that explains them better by itself than all of the group do; or "".
    """

    share: float
    evidence: float
    alone: str = ""


def suspects(
    problem: FitProblem, vector: Array, others: Mapping[str, Sequence[Parameter]]
) -> dict[str, Suspect]:
    """Who could have caused what is left, the likeliest first.

    A linear step of the fitted and the further parameters together, within their bounds, tells what they
    could take away (the score test of whether they are missed; Rao 1948, Proc. Camb. Phil. Soc. 44:50).
    Dozens of pigments can take away nearly anything, so the groups are ordered by the evidence: it asks in
    addition how well the step goes with what is known beforehand, and how much else the group could have
    explained (MacKay 1992, Neural Comput. 4:415). For that the data's errors are as large as in `certainty`,
    and the cause is all of a group, or one parameter of it, each as likely beforehand as any other one.

    Args:
        problem: with the fitted parameters.
        vector: at the minimum.
        others: further parameters, at the recipe's own values, by group.
    """
    values = problem.values(vector)
    residuals = problem.data_residuals(values)
    if not np.any(residuals):
        return {}
    wider = np.sqrt(_excess(problem, vector))
    # In units of the bounds' sd, so that those are rows of ones.
    own = problem.data_jacobian(values, problem.entries) * problem.sd
    pull = (vector - problem.mean) / problem.sd
    room = [(problem.low - vector) / problem.sd, (problem.high - vector) / problem.sd]
    found = {}
    for group, parameters in others.items():
        entries = entries_of(parameters)
        if not entries:
            continue
        scales = np.array([entry.scale for entry in entries])
        laws = [entry.parameter.prior[entry.place] for entry in entries]
        start = np.array([entry.parameter.default[entry.place] for entry in entries])
        low, high = (np.array([getattr(law, end) for law in laws]) for end in ("low", "high"))
        step = _Step(
            np.hstack([own, problem.data_jacobian(values, entries) * scales]),
            residuals,
            np.concatenate([pull, np.zeros(len(entries))]),
            np.concatenate([room[0], (low - start) / scales]),
            np.concatenate([room[1], (high - start) / scales]),
        )
        names = [entry.parameter.name for entry in entries]
        found[group] = step.suspect(len(vector), names, wider)
    return dict(sorted(found.items(), key=lambda item: -item[1].evidence))


@dataclass(frozen=True, eq=False)
class _Step:
    """A linear model of fitted and further parameters, in units of their bounds' sd."""

    slopes: Array
    residuals: Array
    pull: Array
    low: Array
    high: Array

    def suspect(self, fitted: int, names: Sequence[str], wider: float) -> Suspect:
        """What those behind the fitted ones explain, where errors may be wider than expected.

        Args:
            fitted: how many are.
            names: of the parameters that the further ones belong to.
            wider: by how much.
        """
        every, own = np.arange(len(self.pull)), np.arange(fitted)
        share = 1.0 - self._costs(every, 1.0)[0] / float(self.residuals @ self.residuals)
        # Where errors are wider, the fitted ones alone would give way to their bounds as well.
        before = self._badness(own, wider)
        evidence = {"": before - self._badness(every, wider)}
        for name in dict.fromkeys(names):
            chosen = np.concatenate([own, fitted + np.flatnonzero([one == name for one in names])])
            gained = before - self._badness(chosen, wider)
            evidence[name] = gained - 2.0 * np.log(len(set(names)))
        alone = max(evidence, key=lambda name: evidence[name])
        return Suspect(float(np.clip(share, 0.0, 1.0)), float(evidence[alone]), alone)

    def _badness(self, chosen: NDArray[np.intp], wider: float) -> float:
        """Minus twice the logarithm of how likely the data are if no others change, up to a constant."""
        return sum(self._costs(chosen, wider)) + _freedom(self.slopes[:, chosen] / wider)

    def _costs(self, chosen: NDArray[np.intp], wider: float) -> tuple[float, float]:
        """Of data and bounds after the best step of some."""
        from scipy.optimize import lsq_linear

        slopes, residuals, pull = self.slopes[:, chosen] / wider, self.residuals / wider, self.pull[chosen]
        rows = np.vstack([slopes, np.eye(len(pull))])
        # What lies on a bound has no room there, and rounding must not make it less than none.
        room = np.minimum(self.low[chosen], -_LEAST_ROOM), np.maximum(self.high[chosen], _LEAST_ROOM)
        step = lsq_linear(rows, -np.concatenate([residuals, pull]), room).x
        left = residuals + slopes @ step
        return float(left @ left), float(((pull + step) ** 2).sum())


def _freedom(slopes: Array) -> float:
    """How much parameters with these slopes could explain: logarithm of the volume of the bounds over that of
    what data of unit errors leave of it, squared.
    """
    return float(np.linalg.slogdet(np.eye(slopes.shape[1]) + slopes.T @ slopes)[1])


def _excess(problem: FitProblem, vector: Array) -> float:
    """By how much the data's squared errors are larger than expected; 1 where they are not."""
    return max(1.0, chi_squared(problem, vector) / max(problem.data - len(vector), 1))


def _causes(left: Mapping[str, Suspect]) -> list[str]:
    """Which of the groups that were not fitted is missed, the likeliest first."""
    if not left:
        return []
    named = [group for group, one in left.items() if one.share >= WORTH_TELLING and one.evidence > 0.0]
    if not named:
        return [
            "No parameter that was left out takes away a quarter of it: look at the patches themselves, "
            "their labels and their light."
        ]
    shares = {group: f"{100 * left[group].share:.0f} %" for group in named}
    likely = [group for group in named if left[named[0]].evidence - left[group].evidence < ALIKE]
    causes = [f"the {group}" + f" ({left[group].alone})" * bool(left[group].alone) for group in likely]
    found = [
        f"Most likely the fit lacks {' or '.join(causes)}, which could take away "
        f"{' or '.join(shares[group] for group in likely)} of what is left."
    ]
    others = [f"the {group} ({shares[group]})" for group in named if group not in likely]
    if others:
        found.append(f"Far less likely, though some of it goes with them: {', '.join(others)}.")
    return found


def sentences(
    problem: FitProblem,
    value: float,
    open_entries: Sequence[str],
    left: Mapping[str, Suspect],
    kinds: Mapping[str, KindFit],
) -> tuple[str, ...]:
    """What was found, for people."""
    ratio = np.sqrt(value / max(problem.data, 1))
    if as_expected(value, problem.data):
        told = [f"The model meets the patches: what is left is {ratio:.2f} times what is expected."]
    else:
        told = [f"The model misses the patches by {ratio:.1f} times what is expected."]
        told += _causes(left)
        most = max((one.delta_e_after for one in kinds.values()), default=np.inf)
        if most < UNSEEN:
            told.append(f"No mean colour lies further off than dE2000 {most:.1f}, which is not seen.")
    far = [
        f"{kind} (dE2000 {one.delta_e_after:.1f})" for kind, one in kinds.items() if one.delta_e_after > SEEN
    ]
    if far:
        told.append(f"Mean colours still lie off: {', '.join(far)}.")
        if as_expected(value, problem.data):
            told.append("Patches of a kind differ so much among themselves that they tell no more.")
    return (*told, *open_entries)

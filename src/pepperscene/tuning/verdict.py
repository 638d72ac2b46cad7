"""How sure a fit can be: what curvature says of each parameter, and who could take away what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.tuning.model import Entry, entries_of
from pepperscene.tuning.problem import Problem

if TYPE_CHECKING:
    from pepperscene.tuning.outcome import KindFit
    from pepperscene.tuning.parameter import Parameter

Array = NDArray[np.float64]

LEAST_GAIN: Final = 0.75
"""Chosen: below, half of the bounds' sd or more is left, and the data do not determine a parameter."""
TIED: Final = 0.95
"""Chosen: correlation from which two entries are told to be known together only."""
WORTH_TELLING: Final = 0.25
"""Chosen: share of what is left from which a group of parameters is named."""

SEEN: Final = 3.0
"""Chosen: CIEDE2000 from which a difference is seen at a glance."""

_AT_AN_END: Final = 1e-3  # of a bound's width


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


def certainty(problem: Problem, vector: Array) -> Certainty:
    """Standard deviations and correlations of the entries at a minimum.

    Where the data miss the model by more than expected, their errors are taken to be as much larger (the
    Birge ratio; Birge 1932, Phys. Rev. 40:207).
    """
    slopes = problem.data_jacobian(problem.values(vector), problem.entries)
    free = max(problem.data - len(vector), 1)
    excess = max(1.0, chi_squared(problem, vector) / free)
    curvature = slopes.T @ slopes / excess + np.diag(problem.sd**-2.0)
    covariance = np.linalg.inv(curvature)
    sd = np.sqrt(np.diag(covariance))
    return Certainty(sd, 1.0 - (sd / problem.sd) ** 2, covariance / np.outer(sd, sd))


def chi_squared(problem: Problem, vector: Array) -> float:
    """Sum of the data's squared residuals."""
    return float((problem.data_residuals(problem.values(vector)) ** 2).sum())


def as_expected(value: float, data: int) -> bool:
    """Whether a sum of squares is within three standard deviations of what `data` residuals should give."""
    return value <= data + 3.0 * np.sqrt(2.0 * data)


def undetermined(problem: Problem, vector: Array, known: Certainty) -> tuple[str, ...]:
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


def _open(problem: Problem, known: Certainty, i: int) -> str:
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
    with_it = f"{problem.entries[tied].label} only (correlation {known.correlation[i, tied]:+.2f})"
    return f"{what}; it is known together with {with_it}"


def leftover(problem: Problem, vector: Array, others: Mapping[str, Sequence[Parameter]]) -> dict[str, float]:
    """Share of the data's squared residuals that groups of further parameters could still take away.

    A linear step of the fitted and the further parameters together, within their bounds' sd: the score test
    of whether they are missed (Rao 1948, Proc. Camb. Phil. Soc. 44:50).

    Args:
        problem: with the fitted parameters.
        vector: at the minimum.
        others: further parameters, at their defaults, by group.
    """
    values = problem.values(vector)
    residuals = problem.data_residuals(values)
    before = float(residuals @ residuals)
    own = problem.data_jacobian(values, problem.entries)
    found = {}
    for group, parameters in others.items():
        entries = entries_of(parameters)
        if not entries or before == 0.0:
            continue
        further = problem.data_jacobian(values, entries)
        step = _step(problem, vector, residuals, np.hstack([own, further]), entries)
        after = residuals + np.hstack([own, further]) @ step
        found[group] = float(np.clip(1.0 - after @ after / before, 0.0, 1.0))
    return found


def _step(
    problem: Problem, vector: Array, residuals: Array, slopes: Array, further: Sequence[Entry]
) -> Array:
    """The best linear step: data and bounds in one least-squares system."""
    sd = np.concatenate([problem.sd, [entry.scale for entry in further]])
    pull = np.concatenate([(vector - problem.mean) / problem.sd, np.zeros(len(further))])
    rows = np.vstack([slopes, np.diag(1.0 / sd)])
    return np.linalg.lstsq(rows, -np.concatenate([residuals, pull]), rcond=None)[0]


def sentences(
    problem: Problem,
    value: float,
    open_entries: Sequence[str],
    left: Mapping[str, float],
    kinds: Mapping[str, KindFit],
) -> tuple[str, ...]:
    """What was found, for people."""
    ratio = np.sqrt(value / max(problem.data, 1))
    if as_expected(value, problem.data):
        told = [f"The model meets the patches: what is left is {ratio:.2f} times what is expected."]
    else:
        told = [f"The model misses the patches by {ratio:.1f} times what is expected."]
        named = [group for group in sorted(left, key=lambda one: -left[one]) if left[group] >= WORTH_TELLING]
        told += [
            f"Parameters of the {group}, which were not fitted, could take away {100 * left[group]:.0f} % of "
            "what is left."
            for group in named
        ]
        if left and not named:
            told.append(
                "No parameter that was left out takes away a quarter of it: look at the patches themselves, "
                "their labels and their light."
            )
    far = [
        f"{kind} (dE2000 {one.delta_e_after:.1f})" for kind, one in kinds.items() if one.delta_e_after > SEEN
    ]
    if far:
        told.append(
            f"Mean colours still lie off: {', '.join(far)}. Where the model meets the patches all the same, "
            "these differ so much among themselves that they tell no more."
        )
    return (*told, *open_entries)

"""The fit itself: bounded least squares with the renderer's derivatives, from several starts.

Steps are those of a trust region around Gauss and Newton's (Branch, Coleman & Li 1999, SIAM J. Sci. Comput.
21:1, as SciPy has it). A derivative by one number costs about one picture of a small view, and ten steps are
enough, where an optimiser that knows the slope of the cost alone needs hundreds (benchmarks/tuning.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.tuning.fit.diagnostics import (
    Suspect,
    as_expected,
    certainty,
    chi_squared,
    sentences,
    suspects,
    undetermined,
)
from pepperscene.tuning.fit.result import FitResult, KindFit, SpectrumFit, Start
from pepperscene.tuning.model.observables import lab_of
from pepperscene.tuning.model.problem import FitProblem

if TYPE_CHECKING:
    from pepperscene.tuning.model.subject import TuningTarget


Array = NDArray[np.float64]
Told = Callable[[str], None]

STARTS: Final = 4
_DRAWN: Final = 12  # chosen: points of the bounds that are looked at for each further start
_EVALUATIONS: Final = 30  # chosen: of a start; ten are usual
_TOLERANCE: Final = 1e-5  # chosen: relative change of the cost at which a start ends
_SHOWN: Final = 4000  # pixels of a kind that are kept to be shown


@dataclass(frozen=True, eq=False)
class _Run:
    vector: Array
    start: Start


def fit_parameters(
    subject: TuningTarget,
    problem: FitProblem,
    *,
    starts: int = STARTS,
    seed: int = 0,
    on_progress: Told | None = None,
) -> FitResult:
    """The best values of a problem, and what is known of them.

    The first start is the recipe itself; further ones are the best of a dozen points drawn from the bounds.
    Once a start ends as near to the data as their errors allow, no further one is run.

    Args:
        subject: the recipe's parts.
        problem: what is fitted, to what.
        starts: at most.
        seed: of the drawn points.
        on_progress: is called with a line after each start.
    """
    rng = np.random.default_rng(seed)
    runs: list[_Run] = []
    for number in range(starts):
        start = problem.default if number == 0 else _drawn(problem, rng)
        runs.append(_run(problem, problem.inside(start)))
        best = min(runs, key=lambda run: run.start.cost)
        chi = chi_squared(problem, best.vector)
        if on_progress is not None:
            on_progress(
                f"start {number + 1} of {starts}: misses the patches by "
                f"{np.sqrt(chi / max(problem.data, 1)):.2f} times what is expected, "
                f"after {runs[-1].start.evaluations} evaluations"
            )
        if as_expected(chi, problem.data):
            break
    return _outcome(subject, problem, best.vector, tuple(run.start for run in runs))


def _drawn(problem: FitProblem, rng: np.random.Generator) -> Array:
    """The best of some points drawn from the bounds."""
    points = [
        np.array([entry.parameter.prior[entry.place].draw(rng) for entry in problem.entries])
        for _ in range(_DRAWN)
    ]
    return min(points, key=lambda point: float((problem.residuals(problem.inside(point)) ** 2).sum()))


def _run(problem: FitProblem, start: Array) -> _Run:
    from scipy.optimize import least_squares

    done = least_squares(
        problem.residuals,
        start,
        problem.jacobian,
        bounds=(problem.low, problem.high),
        x_scale=problem.sd,
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        max_nfev=_EVALUATIONS,
    )
    begun = {name: tuple(value.tolist()) for name, value in problem.values(start).items()}
    return _Run(done.x, Start(begun, float(done.cost), int(done.nfev), str(done.message)))


def _outcome(
    subject: TuningTarget, problem: FitProblem, vector: Array, starts: tuple[Start, ...]
) -> FitResult:
    """Everything that is known at the best values."""
    known, chi = certainty(problem, vector), chi_squared(problem, vector)
    values, before = problem.values(vector), problem.values(problem.default)
    left: dict[str, Suspect] = {}
    if not as_expected(chi, problem.data):
        left = suspects(problem, vector, subject.others([one.name for one in problem.parameters]))
    open_entries = undetermined(problem, vector, known)
    kinds = _kinds(problem, before, values, subject.targets)
    return FitResult(
        parameters=problem.parameters,
        values=values,
        sd=problem.values(known.sd),
        gained=problem.values(known.gained),
        correlation=known.correlation,
        undetermined=open_entries,
        kinds=kinds,
        spectra=_spectra(problem, before, values),
        starts=starts,
        chi_squared=chi,
        data=problem.data,
        leftover={group: one.share for group, one in left.items()},
        diagnostics=sentences(problem, chi, open_entries, left, kinds),
        tuned=subject.tuned(values),
    )


def _kinds(
    problem: FitProblem, before: Mapping[str, Array], after: Mapping[str, Array], targets: Mapping[str, Array]
) -> dict[str, KindFit]:
    """Colours of each kind, all its views together."""
    found = {}
    for kind, target in targets.items():
        cells = [cell for cell in problem.cells if any(eye.view.kind == kind for eye in cell.eyes)]
        if not cells:
            continue
        made = [problem.tuned(values) for values in (before, after)]
        pixels = [np.concatenate([cell.linear(one) for cell in cells]) for one in made]
        sides = (target, *pixels)
        both = [np.stack([lab_of(one.mean(axis=0)), lab_of(one).std(axis=0)]) for one in sides]
        # Views' colours as they are among their neighbours.
        offset = np.mean([cell.around.offset for cell in cells], axis=0)[:6].reshape(2, 3)
        both[1:] = [one + offset for one in both[1:]]
        away = _delta_e(np.array([one[0] for one in both[1:]]), both[0][0])
        shown = [one[:: max(1, -(-len(one) // _SHOWN))] for one in sides]
        found[kind] = KindFit(
            target=both[0],
            before=both[1],
            after=both[2],
            delta_e_before=float(away[0]),
            delta_e_after=float(away[1]),
            pixels_target=shown[0],
            pixels_before=shown[1],
            pixels_after=shown[2],
        )
    return found


def _spectra(
    problem: FitProblem, before: Mapping[str, Array], after: Mapping[str, Array]
) -> dict[str, SpectrumFit]:
    """Reflectances, where there are any."""
    model = problem.spectra
    if model is None:
        return {}
    target, one, other = model.measured, model.predicted(before), model.predicted(after)
    found = {}
    for (name, part), nm in zip(model.parts.items(), model.wavelength_nm, strict=True):
        off = [_rms((made - target)[part]) for made in (one, other)]
        found[name] = SpectrumFit(nm, target[part], one[part], other[part], *off)
    return found


def _rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(difference**2)))


def _delta_e(lab: Array, other: Array) -> Array:
    from pepperscene.colour import delta_e_2000

    return np.asarray(delta_e_2000(lab, np.broadcast_to(other, lab.shape)))

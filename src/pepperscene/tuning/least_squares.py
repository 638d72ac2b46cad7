"""Bounded least-squares fit with the renderer's derivatives, from several starts, and its result.

The optimiser is a trust-region Gauss-Newton method with bounds (Branch, Coleman & Li 1999, SIAM J. Sci.
Comput. 21:1, as in SciPy). A derivative with respect to one number costs about one image of a small view, and
ten steps are enough; optimisers that use only the gradient of the cost need hundreds (benchmarks/tuning.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.colour import delta_e_2000, linear_srgb_to_lab
from pepperscene.tuning.bounds import Parameter
from pepperscene.tuning.diagnostics import (
    OmittedGroup,
    chi_squared,
    describe_fit,
    is_consistent,
    omitted_groups,
    uncertainty,
    undetermined_entries,
)
from pepperscene.tuning.problem import FitProblem
from pepperscene.tuning.target import TuningTarget
from pepperscene.tuning.tuned import TunedParts

Array = NDArray[np.float64]
STARTS: Final = 4  # chosen
_CANDIDATES: Final = 12  # chosen: random points that are evaluated for each further start
_EVALUATIONS: Final = 30  # chosen: maximum of a start; ten are usual
_TOLERANCE: Final = 1e-5  # chosen: relative change of the cost at which a start ends
_PLOTTED: Final = 4000  # chosen: pixels of a kind that are kept for the figure


@dataclass(frozen=True, eq=False)
class KindFit:
    """Colours of one kind of organ, before and after a fit.

    Attributes:
        target: `(2, 3)` CIELAB of the patches' mean colour, and sd of their pixels' L*, a*, b*.
        before, after: The same of the model, at the recipe's values and at the fitted ones.
        delta_e_before, delta_e_after: CIEDE2000 between the mean colours of model and patches.
        pixels_target, pixels_before, pixels_after: `(n, 3)` linear sRGB of evenly sampled pixels, for plots.
    """

    target: Array
    before: Array
    after: Array
    delta_e_before: float
    delta_e_after: float
    pixels_target: Array
    pixels_before: Array
    pixels_after: Array


@dataclass(frozen=True, eq=False)
class SpectrumFit:
    """One measured reflectance, before and after a fit.

    Attributes:
        wavelength_nm, target, before, after: `(n,)` wavelengths and reflectances.
        rmse_before, rmse_after: Root mean square errors in reflectance.
    """

    wavelength_nm: Array
    target: Array
    before: Array
    after: Array
    rmse_before: float
    rmse_after: float


@dataclass(frozen=True)
class Start:
    """One run of the optimiser."""

    values: Mapping[str, tuple[float, ...]]  # start values by parameter
    cost: float  # half the sum of squared residuals at the end, including those of the priors
    evaluations: int  # of the model
    message: str  # why the optimiser stopped


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of a fit.

    Attributes:
        parameters: Fitted parameters, in order.
        values: `(k,)` best values of each parameter.
        sd: `(k,)` posterior standard deviations of each parameter.
        variance_reduction: `(k,)` 1 - posterior variance / prior variance: 0 if the data add nothing.
        correlation: `(p, p)` posterior correlations of all entries, in order.
        undetermined: A sentence for each entry that the data cannot determine.
        kinds: Colours by kind of organ.
        spectra: Measured reflectances by name.
        starts: Runs of the optimiser, in order.
        chi_squared: Sum of squared residuals of the data at the best values.
        data_count: Number of independent data.
        omitted: Fraction of `chi_squared` that each group of parameters that was not fitted could remove, the
            likeliest cause first.
        diagnostics: Sentences that describe the fit.
        tuned_parts: The recipe's parts at the best values.
    """

    parameters: tuple[Parameter, ...]
    values: Mapping[str, Array]
    sd: Mapping[str, Array]
    variance_reduction: Mapping[str, Array]
    correlation: Array
    undetermined: tuple[str, ...]
    kinds: Mapping[str, KindFit]
    spectra: Mapping[str, SpectrumFit]
    starts: tuple[Start, ...]
    chi_squared: float
    data_count: int
    omitted: Mapping[str, float]
    diagnostics: tuple[str, ...]
    tuned_parts: TunedParts


def fit_parameters(
    target: TuningTarget,
    problem: FitProblem,
    *,
    starts: int = STARTS,
    seed: int = 0,
    on_progress: Callable[[str], None] | None = None,
) -> FitResult:
    """Find the best values of a problem, and their uncertainty.

    The first start is the recipe itself; further ones are each the best of a dozen points drawn from the
    priors. They end once the residuals are consistent with the errors of the data.

    Args:
        target: Recipe and patches.
        problem: The problem to solve, from `target.problem`.
        starts: Maximum number of starts.
        seed: Seed of the random points.
        on_progress: Called with a line of text after each start.
    """
    rng = np.random.default_rng(seed)
    runs: list[tuple[Array, Start]] = []
    for number in range(starts):
        vector = problem.default if number == 0 else _random_start(problem, rng)
        runs.append(_optimise(problem, problem.inside(vector)))
        best, _ = min(runs, key=lambda run: run[1].cost)
        chi2 = chi_squared(problem, best)
        if on_progress is not None:
            ratio, count = np.sqrt(chi2 / max(problem.data_count, 1)), runs[-1][1].evaluations
            residuals = f"RMS residuals are {ratio:.2f} times the expected size after {count} evaluations"
            on_progress(f"start {number + 1} of {starts}: {residuals}")
        if is_consistent(chi2, problem.data_count):
            break
    return _summarise(target, problem, best, tuple(start for _, start in runs))


def _random_start(problem: FitProblem, rng: np.random.Generator) -> Array:
    """The best of some points drawn from the priors."""
    points = [np.array([entry.prior.draw(rng) for entry in problem.entries]) for _ in range(_CANDIDATES)]
    return min(points, key=lambda point: float((problem.residuals(problem.inside(point)) ** 2).sum()))


def _optimise(problem: FitProblem, vector: Array) -> tuple[Array, Start]:
    from scipy.optimize import least_squares

    options = {"ftol": _TOLERANCE, "xtol": _TOLERANCE, "max_nfev": _EVALUATIONS, "x_scale": problem.sd}
    bounds = (problem.low, problem.high)
    solution = least_squares(problem.residuals, vector, problem.jacobian, bounds=bounds, **options)
    values = {name: tuple(value.tolist()) for name, value in problem.values(vector).items()}
    return solution.x, Start(values, float(solution.cost), int(solution.nfev), str(solution.message))


def _summarise(
    target: TuningTarget, problem: FitProblem, vector: Array, starts: tuple[Start, ...]
) -> FitResult:
    """The result at the best values."""
    posterior, chi2 = uncertainty(problem, vector), chi_squared(problem, vector)
    values, before = problem.values(vector), problem.values(problem.default)
    omitted: dict[str, OmittedGroup] = {}
    if not is_consistent(chi2, problem.data_count):
        unfitted = target.unfitted_parameters([parameter.name for parameter in problem.parameters])
        omitted = omitted_groups(problem, vector, unfitted)
    undetermined = undetermined_entries(problem, vector, posterior)
    kinds = _compare_kinds(problem, before, values, target.targets)
    delta_e = {kind: kind_fit.delta_e_after for kind, kind_fit in kinds.items()}
    return FitResult(
        parameters=problem.parameters,
        values=values,
        sd=problem.values(posterior.sd),
        variance_reduction=problem.values(posterior.variance_reduction),
        correlation=posterior.correlation,
        undetermined=undetermined,
        kinds=kinds,
        spectra=_compare_spectra(problem, before, values),
        starts=starts,
        chi_squared=chi2,
        data_count=problem.data_count,
        omitted={group: cause.explained for group, cause in omitted.items()},
        diagnostics=describe_fit(problem, chi2, undetermined, omitted, delta_e),
        tuned_parts=target.tuned_parts(values),
    )


def _compare_kinds(
    problem: FitProblem, before: Mapping[str, Array], after: Mapping[str, Array], targets: Mapping[str, Array]
) -> dict[str, KindFit]:
    """Colours of each kind, pooled over its views."""
    kinds = {}
    both = [problem.tuned_parts(values) for values in (before, after)] if targets else []
    for kind, target in targets.items():
        observations = [o for o in problem.observations if any(m.view.kind == kind for m in o.view_models)]
        if not observations:
            continue
        # The colours of the views are those among their neighbours.
        offset = np.mean([o.neighbours.offset for o in observations], axis=0)[:6].reshape(2, 3)
        pixels = [np.concatenate([o.linear(parts) for o in observations]) for parts in both]
        moments = [_moments(target), *(_moments(colours) + offset for colours in pixels)]
        delta_e = [float(delta_e_2000(moment[0], moments[0][0])) for moment in moments]
        sampled = [colours[:: max(1, -(-len(colours) // _PLOTTED))] for colours in (target, *pixels)]
        kinds[kind] = KindFit(moments[0], moments[1], moments[2], delta_e[1], delta_e[2], *sampled)
    return kinds


def _moments(pixels: Array) -> Array:
    """`(2, 3)` CIELAB of the mean colour, and sd of the pixels' L*, a*, b*."""
    return np.stack([linear_srgb_to_lab(pixels.mean(axis=0)), linear_srgb_to_lab(pixels).std(axis=0)])


def _compare_spectra(
    problem: FitProblem, before: Mapping[str, Array], after: Mapping[str, Array]
) -> dict[str, SpectrumFit]:
    """Reflectances by name; empty if none were measured."""
    model = problem.direct_model
    if model is None:
        return {}
    measured, *predicted = model.measured, model.predicted(before), model.predicted(after)
    spectra = {}
    for (name, part), nm in zip(model.parts.items(), model.wavelength_nm, strict=True):
        rmse = [float(np.sqrt(np.mean((curve - measured)[part] ** 2))) for curve in predicted]
        curves = [curve[part] for curve in predicted]
        spectra[name] = SpectrumFit(nm, measured[part], curves[0], curves[1], *rmse)
    return spectra

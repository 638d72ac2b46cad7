"""Speed and accuracy of methods that fit the same hidden values to the same small images.

Pigments and light are drawn from their priors, and simulated patches of single organs rendered with them,
with noise and other random numbers. Every method starts from the recipe's values.

- *Gauss-Newton, forward derivatives*: a trust-region method, as in `pepperscene tune`.
- *the same, finite differences*: each derivative costs one more image, a hundredth of a prior sd away.
- *L-BFGS, backward derivatives*: one derivative pass for all entries, of the cost alone (SciPy's L-BFGS-B).
- *Adam, backward derivatives*: the same, with first-order steps (Kingma & Ba 2015); two step sizes.

All minimise the same cost within the same bounds. Errors are computed off the clock, at the best cost so far.
One process, all cores; the order of the methods rotates, and the first problem warms up and is not counted.

    python benchmarks/tuning.py
"""

from __future__ import annotations

import argparse
import functools
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.bench.records import describe_machine, machine_info
from pepperscene.colour import PatchSet, delta_e_2000, linear_srgb_to_lab
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render.gradients.renderer import DifferentiableRenderer
from pepperscene.tuning.observables import hue_vectors, lab_derivatives, observables
from pepperscene.tuning.problem import FitProblem, Observation
from pepperscene.tuning.target import TuningTarget, simulate_patches
from pepperscene.tuning.view_model import VIEW_QUALITY, ParameterStep, ViewModel

if TYPE_CHECKING:
    from pepperscene.tuning.tuned import TunedParts

Array = NDArray[np.float64]

KINDS: Final = ("leaf", "pepper.unripe")
NAMES: Final = ("leaf.chlorophyll", "leaf.carotenoid", "fruit.chlorophyll", "fruit.brown", "flash.colour")
DIFFERENCE: Final = 0.01
"""Step of the finite differences, in prior sd: images are in single precision, so that a much smaller step
has rounding errors, and a larger one truncation errors."""
TOLERANCE: Final = 1e-4
"""Relative change of the cost at which a second-order method ends."""
STEPS: Final = (0.03, 0.1)
"""Of Adam, in prior sd: larger ones overshoot, smaller ones are slower still."""
CHECKPOINTS_S: Final = (1.0, 3.0, 10.0, 30.0)
NEAR: Final = 0.05
"""Relative distance from the lowest cost of all methods at which a method counts as converged."""


# --- derivatives --------------------------------------------------------------------------------------------


COUNTS: Final[Counter[str]] = Counter()
"""Images ("rgb") and derivative passes ("forward", "backward") of the renderer."""


def count_calls() -> None:
    """Count calls of `DifferentiableRenderer` from now on."""
    for name in ("rgb", "forward", "backward"):
        plain = getattr(DifferentiableRenderer, name)

        @functools.wraps(plain)
        def counted(*args: Any, plain: Callable[..., Any] = plain, name: str = name) -> Any:
            COUNTS[name] += 1
            return plain(*args)

        setattr(DifferentiableRenderer, name, counted)


class BackwardViewModel(ViewModel):
    """A view with reverse-mode derivatives of a cost of its pixels with respect to all entries at once."""

    def backward(
        self,
        parts: TunedParts,
        cost_gradient: Callable[[Array], Array],
        steps: Sequence[ParameterStep],
        shade: Array,
    ) -> Array:
        """`(p,)` derivatives of a cost along steps.

        Args:
            parts: The recipe's parts.
            cost_gradient: From pixels `(n, 3)` to the derivatives of the cost with respect to them.
            steps: Steps of the entries.
            shade: `(c,)` fraction of the light that neighbours let through.
        """
        parameters, electrons = self._light(parts), shade * self.electrons(parts)
        linear, by_electrons, unclipped = self._sensor.linear_and_slopes(
            electrons, parts.exposure, parts.gains, parts.matrix
        )
        gradient = cost_gradient(linear)
        # From pixels back to electrons, from there to the renderer's tables, and to the parameters.
        image = np.zeros((*self.view.mask.shape, electrons.shape[1]))
        image[self.view.mask] = shade * by_electrons * ((unclipped * gradient) @ parts.matrix)
        slopes = self._renderer.backward(parameters, image)
        derivatives = np.zeros(len(steps))
        for i, step in enumerate(steps):
            if step.changes_light:
                above, below = self._light(step.above), self._light(step.below)
                change = sum(float((slopes[name] * (above[name] - below[name])).sum()) for name in parameters)
            else:
                ends = [self._developed(electrons, one) for one in (step.above, step.below)]
                change = float((gradient * (ends[0] - ends[1])).sum())
            derivatives[i] = change / step.width
        return derivatives


def pixel_gradient(linear: Array, weight: Array) -> Array:
    """`(n, 3)` derivatives of a weighted sum of the observables with respect to pixels, in reverse mode."""
    mean, pixels, (_, hue_derivatives) = linear.mean(axis=0), linear_srgb_to_lab(linear), hue_vectors(linear)
    deviation = (pixels - pixels.mean(axis=0)) / pixels.std(axis=0)
    of_pixels = np.einsum("ni,nij->nj", weight[3:6] * deviation, lab_derivatives(linear))
    of_hues = np.einsum("i,nij->nj", weight[6:], hue_derivatives)
    return (weight[:3] @ lab_derivatives(mean) + of_pixels + of_hues) / len(linear)


# --- problem ------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class KnownProblem:
    """A problem with a known solution. Methods see entries in prior sd about their means ("scaled").

    Attributes:
        problem: The fit.
        hidden: `(p,)` the solution.
        path: (seconds, images, passes, cost, vector) after each evaluation of the cost.
    """

    problem: FitProblem
    hidden: Array
    path: list[tuple[float, int, int, float, Array]] = field(default_factory=list)
    start_s: float = 0.0

    @contextmanager
    def clock(self) -> Iterator[None]:
        """Start counting."""
        COUNTS.clear()
        self.path = []
        self.start_s = time.perf_counter()
        yield

    @property
    def seconds(self) -> float:
        """Seconds since the clock was started."""
        return time.perf_counter() - self.start_s

    def vector(self, scaled: Array) -> Array:
        """Values of scaled entries."""
        problem = self.problem
        return np.clip(problem.mean + problem.sd * scaled, problem.low, problem.high)

    @property
    def start(self) -> Array:
        """The recipe's values, scaled."""
        problem = self.problem
        return (problem.inside(problem.default) - problem.mean) / problem.sd

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds, scaled."""
        problem = self.problem
        return (problem.low - problem.mean) / problem.sd, (problem.high - problem.mean) / problem.sd

    def residuals(self, scaled: Array) -> Array:
        """Residuals of data and priors."""
        residuals = self.problem.residuals(self.vector(scaled))
        self._record(0.5 * float(residuals @ residuals), scaled)
        return residuals

    def jacobian(self, scaled: Array) -> Array:
        """Forward derivatives: one pass for each entry that changes light."""
        return self.problem.jacobian(self.vector(scaled)) * self.problem.sd

    def differences(self, scaled: Array) -> Array:
        """Finite differences: one image for each entry, within the bounds."""
        _, high = self.bounds
        residuals, columns = self.problem.residuals(self.vector(scaled)), []
        for i in range(scaled.size):
            step = DIFFERENCE if scaled[i] + DIFFERENCE <= high[i] else -DIFFERENCE
            shifted = scaled.copy()
            shifted[i] += step
            columns.append((self.problem.residuals(self.vector(shifted)) - residuals) / step)
        return np.stack(columns, axis=1)

    def cost_and_gradient(self, scaled: Array) -> tuple[float, Array]:
        """Half the sum of squares, and its derivatives by one backward pass for each view."""
        problem, vector = self.problem, self.vector(scaled)
        values = problem.values(vector)
        parts = problem.tuned_parts(values)
        steps = [ParameterStep.along(entry, values, problem.tuned_parts) for entry in problem.entries]
        deviation = (vector - problem.mean) / problem.sd
        cost, gradient = 0.5 * float(deviation @ deviation), deviation / problem.sd
        for observation in problem.observations:
            # One image gives the residuals, which are the input of the backward pass.
            (model,) = observation.view_models
            residuals: list[Array] = []

            def cost_gradient(
                linear: Array, observation: Observation = observation, residuals: list[Array] = residuals
            ) -> Array:
                residuals.append(
                    (observables(linear) + observation.neighbours.offset - observation.target)
                    / observation.sigma
                )
                return pixel_gradient(linear, residuals[0] / observation.sigma)

            gradient = gradient + model.backward(parts, cost_gradient, steps, observation.neighbours.shade)
            cost += 0.5 * float(residuals[0] @ residuals[0])
        self._record(cost, scaled)
        return cost, gradient * problem.sd

    def errors(self, vector: Array) -> tuple[float, float]:
        """Mean CIEDE2000 of the patches, and mean distance of the entries from the solution in prior sd."""
        parts = self.problem.tuned_parts(self.problem.values(vector))
        predicted = np.array([observation.predicted(parts)[:3] for observation in self.problem.observations])
        target = np.array([observation.target[:3] for observation in self.problem.observations])
        distance = np.abs(vector - self.hidden) / self.problem.sd
        return float(np.mean(delta_e_2000(predicted, target))), float(np.mean(distance))

    def _record(self, cost: float, scaled: Array) -> None:
        passes = COUNTS["forward"] + COUNTS["backward"]
        self.path.append((self.seconds, COUNTS["rgb"], passes, cost, self.vector(scaled)))


def known_problem(recipe_name: str, seed: int) -> KnownProblem:
    """Values drawn from the priors, and patches simulated with other random numbers than the fit's."""
    recipe, rng = load_recipe(recipe_name), np.random.default_rng(seed)
    parameters = TuningTarget(recipe, PatchSet("none", ())).parameters(NAMES)
    hidden = {
        parameter.name: np.array([prior.draw(rng) for prior in parameter.prior]) for parameter in parameters
    }
    patches = simulate_patches(recipe, hidden, KINDS, organs=1, seed=seed, noise=seed + 1)
    target = TuningTarget(recipe, patches, registered=True, organs=1, seed=seed)
    problem = target.problem(NAMES)
    models = {
        view.name: BackwardViewModel(view, target.cultivar, seed + i, VIEW_QUALITY)
        for i, view in enumerate(target.views)
    }
    observations = [
        replace(observation, view_models=(models[observation.label],)) for observation in problem.observations
    ]
    problem = FitProblem(problem.parameters, target.tuned_parts, observations)
    return KnownProblem(problem, np.concatenate([hidden[parameter.name] for parameter in parameters]))


# --- methods ------------------------------------------------------------------------------------------------


def gauss_newton(known: KnownProblem, budget_s: float, derivatives: Callable[[Array], Array]) -> None:
    """Trust-region Gauss-Newton method (Branch, Coleman & Li 1999)."""
    from scipy.optimize import least_squares

    least_squares(
        known.residuals,
        known.start,
        derivatives,
        bounds=known.bounds,
        ftol=TOLERANCE,
        xtol=TOLERANCE,
        max_nfev=40,
    )


def l_bfgs(known: KnownProblem, budget_s: float) -> None:
    """A limited-memory approximation of the curvature from gradients (Byrd et al. 1995)."""
    from scipy.optimize import minimize

    minimize(
        known.cost_and_gradient,
        known.start,
        jac=True,
        method="L-BFGS-B",
        bounds=np.transpose(known.bounds),
        options={"ftol": TOLERANCE, "maxfun": 400},
    )


def adam(known: KnownProblem, budget_s: float, step: float) -> None:
    """Kingma & Ba 2015 with their constants, clipped to the bounds, until the time limit."""
    scaled, (low, high) = known.start, known.bounds
    mean, square = np.zeros(scaled.size), np.zeros(scaled.size)
    for i in range(1, 10_000):
        _, gradient = known.cost_and_gradient(scaled)
        mean, square = 0.9 * mean + 0.1 * gradient, 0.999 * square + 0.001 * gradient**2
        unbiased = mean / (1.0 - 0.9**i), square / (1.0 - 0.999**i)
        scaled = np.clip(scaled - step * unbiased[0] / (np.sqrt(unbiased[1]) + 1e-8), low, high)
        if known.seconds > budget_s:
            break


METHODS: Final[Mapping[str, Callable[[KnownProblem, float], None]]] = {
    "Gauss-Newton, forward derivatives": lambda known, budget: gauss_newton(known, budget, known.jacobian),
    "the same, finite differences": lambda known, budget: gauss_newton(known, budget, known.differences),
    "L-BFGS, backward derivatives": l_bfgs,
    **{
        f"Adam, backward derivatives, steps of {step:g} sd": (
            lambda known, budget, step=step: adam(known, budget, step)
        )
        for step in STEPS
    },
}


@dataclass(frozen=True)
class Run:
    """Result of one method on one problem.

    Attributes:
        cost: Lowest cost.
        converged_s, converged_images, converged_passes: Until the cost was within `NEAR` of the lowest of any
            method.
        total_s: Until the method ended.
        errors: (CIEDE2000, distance) at the end.
        errors_by_time: The same at `CHECKPOINTS_S`.
    """

    cost: float
    converged_s: float
    converged_images: float
    converged_passes: float
    total_s: float
    errors: tuple[float, float]
    errors_by_time: tuple[tuple[float, float], ...]


def compare_methods(known: KnownProblem, order: Sequence[str], budget_s: float) -> dict[str, Run]:
    """Run all methods on one problem, in the given order."""
    paths, totals = {}, {}
    for name in order:
        with known.clock():
            METHODS[name](known, budget_s)
            totals[name] = known.seconds
        paths[name] = known.path
    lowest = min(cost for path in paths.values() for *_, cost, _ in path)
    runs = {}
    for name, path in paths.items():
        converged = next((step for step in path if step[3] <= (1.0 + NEAR) * lowest), None)
        best = min(path, key=lambda step: step[3])
        by_time = []
        for limit in CHECKPOINTS_S:
            until = [step for step in path if step[0] <= limit] or path[:1]
            by_time.append(known.errors(min(until, key=lambda step: step[3])[4]))
        reached = converged[:3] if converged is not None else (np.inf, np.inf, np.inf)
        runs[name] = Run(best[3], *reached, totals[name], known.errors(best[4]), tuple(by_time))
    return runs


def check_derivatives(known: KnownProblem) -> None:
    """Check that forward, backward and finite differences agree, before comparing methods that use them."""
    scaled = 0.5 * known.start
    residuals, jacobian = known.residuals(scaled), known.jacobian(scaled)
    cost, gradient = known.cost_and_gradient(scaled)
    expected = jacobian.T @ residuals
    assert abs(cost - 0.5 * residuals @ residuals) <= 1e-6 * cost
    assert np.abs(gradient - expected).max() <= 1e-2 * np.abs(expected).max(), (gradient, expected)
    assert np.abs(known.differences(scaled) - jacobian).max() <= 5e-2 * np.abs(jacobian).max()


# --- tables -------------------------------------------------------------------------------------------------


def format_tables(runs: Sequence[Mapping[str, Run]]) -> list[str]:
    """Rows of two Markdown tables: time until converged, and errors by time."""
    first, median = next(iter(METHODS)), statistics.median
    lines = [
        "| method | seconds until converged | relative to the first | images | derivative passes "
        f"| converged, of {len(runs)} | final ΔE₀₀ | final distance, in sd |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name in METHODS:
        method_runs = [run[name] for run in runs]
        # The ratio within each problem removes what slows all methods equally.
        ratio = median(run[name].converged_s / run[first].converged_s for run in runs)
        row = [
            _format(median(run.converged_s for run in method_runs), ".2f"),
            _format(ratio, ".2f"),
            _format(median(run.converged_images for run in method_runs), ".0f"),
            _format(median(run.converged_passes for run in method_runs), ".0f"),
            str(sum(bool(np.isfinite(run.converged_s)) for run in method_runs)),
            _format(median(run.errors[0] for run in method_runs), ".3f"),
            _format(median(run.errors[1] for run in method_runs), ".3f"),
        ]
        lines.append(f"| {name} | {' | '.join(row)} |")
    times = " | ".join(f"{limit:g} s" for limit in CHECKPOINTS_S)
    lines += ["", f"| ΔE₀₀, and distance in sd, after | {times} |", "|---|" + "---:|" * len(CHECKPOINTS_S)]
    for name in METHODS:
        cells = []
        for i in range(len(CHECKPOINTS_S)):
            errors = [run[name].errors_by_time[i] for run in runs]
            cells.append(
                f"{median(error[0] for error in errors):.2f}, {median(error[1] for error in errors):.2f}"
            )
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def _format(number: float, spec: str) -> str:
    return format(number, spec) if np.isfinite(number) else "-"


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipe", default="barth2018", help="recipe of the organs, light and camera")
    parser.add_argument("--twins", type=int, default=5, help="number of problems that are counted")
    parser.add_argument("--budget", type=float, default=30.0, metavar="SECONDS", help="time of Adam")
    options = parser.parse_args()
    names, runs = list(METHODS), []
    count_calls()
    for seed in range(options.twins + 1):
        known = known_problem(options.recipe, seed)
        check_derivatives(known)  # also compiles the kernels
        rotation = seed % len(names)
        results = compare_methods(known, names[rotation:] + names[:rotation], options.budget if seed else 1.0)
        if seed:
            runs.append(results)
    sys.stdout.write("\n".join([describe_machine(machine_info()), "", *format_tables(runs)]) + "\n")


if __name__ == "__main__":
    main()

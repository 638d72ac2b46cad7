"""How quickly a fit comes how near: ways to fit the same hidden values to the same small pictures.

A twin: pigments and light are drawn from their bounds, pictures of single organs are made with them, with
noise and other random numbers, and every way starts from the recipe's own values.

- *Gauss-Newton, forward derivatives*: a trust region about Gauss and Newton's steps, as `pepperscene tune`.
- *the same, finite differences*: each derivative is one more picture, a hundredth of a bound's sd away.
- *L-BFGS, backward derivatives*: one derivative pass for all entries, of the cost alone (SciPy's L-BFGS-B).
- *Adam, backward derivatives*: the same, with steps of first order (Kingma & Ba 2015); two step sizes.

All minimise the same cost within the same bounds. Errors are taken off the clock, at the best cost so far.
One process, all cores; the ways take turns, twin by twin, and the first twin warms up and is not counted.

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
from pepperscene.colour import PatchSet, delta_e_2000
from pepperscene.dataset import load_recipe
from pepperscene.render.gradients.renderer import DifferentiableRenderer
from pepperscene.tuning.model.observables import hues, lab_of, lab_slopes, numbers
from pepperscene.tuning.model.problem import Cell, FitProblem
from pepperscene.tuning.model.subject import TuningTarget
from pepperscene.tuning.model.view_model import EFFORT, ParameterStep, ViewModel
from pepperscene.tuning.twin import simulate_patches

if TYPE_CHECKING:
    from pepperscene.tuning.parameters.tuned import TunedParts

Array = NDArray[np.float64]

KINDS: Final = ("leaf", "pepper.unripe")
NAMES: Final = ("leaf.chlorophyll", "leaf.carotenoid", "fruit.chlorophyll", "fruit.brown", "flash.colour")
DIFFERENCE: Final = 0.01
"""Step of the finite differences, in sd of the bounds: pictures are in single precision, so that a much
smaller step finds rounding, and a larger one the curve."""
TOLERANCE: Final = 1e-4
"""Relative change of the cost at which a way of second order ends."""
STEPS: Final = (0.03, 0.1)
"""Adam's, in sd of the bounds: larger ones overshoot, smaller ones are slower yet."""
CHECKPOINTS_S: Final = (1.0, 3.0, 10.0, 30.0)
NEAR: Final = 0.05
"""Share by which a way's cost may exceed the least that any way finds, to count as there."""


# --- pictures, and what is asked of them --------------------------------------------------------------------


COUNTS: Final[Counter[str]] = Counter()
"""Pictures ("rgb") and derivative passes ("forward", "backward") that the renderer was asked for."""


def count_calls() -> None:
    """Count what `DifferentiableRenderer` does from now on."""
    for name in ("rgb", "forward", "backward"):
        plain = getattr(DifferentiableRenderer, name)

        @functools.wraps(plain)
        def counted(*args: Any, plain: Callable[..., Any] = plain, name: str = name) -> Any:
            COUNTS[name] += 1
            return plain(*args)

        setattr(DifferentiableRenderer, name, counted)


class BackwardEye(ViewModel):
    """A view that also takes derivatives of a cost the other way: from its pixels to every entry at once."""

    def backward(
        self,
        made: TunedParts,
        of_linear: Callable[[Array], Array],
        moves: Sequence[ParameterStep],
        shade: Array,
    ) -> Array:
        """`(p,)` derivatives of a cost along moves.

        Args:
            made: the recipe's parts.
            of_linear: from pixels `(n, 3)` to the derivatives of the cost with respect to them.
            moves: of the entries.
            shade: `(c,)` share of the light that neighbours let through.
        """
        parameters, electrons = self._light(made), shade * self.electrons(made)
        linear, by_electrons, free = self._photograph.linear_and_slope(
            electrons, made.exposure, made.gains, made.matrix
        )
        wanted = of_linear(linear)
        # From pixels back to electrons, from there to the renderer's tables, and to what they are made of.
        picture = np.zeros((*self.view.mask.shape, electrons.shape[1]))
        picture[self.view.mask] = shade * by_electrons * ((free * wanted) @ made.matrix)
        slopes = self._renderer.backward(parameters, picture)
        found = np.zeros(len(moves))
        for i, move in enumerate(moves):
            if move.in_the_scene:
                above, below = self._light(move.above), self._light(move.below)
                found[i] = sum(float((slopes[one] * (above[one] - below[one])).sum()) for one in parameters)
            else:
                here = [self._developed(electrons, one) for one in (move.above, move.below)]
                found[i] = float((wanted * (here[0] - here[1])).sum())
            found[i] /= move.width
        return found


def pixel_slopes(linear: Array, weight: Array) -> Array:
    """`(n, 3)` slopes by pixels of a weighted sum of a cell's numbers: `numbers_and_slopes` the other way."""
    mean, pixels, (_, turned) = linear.mean(axis=0), lab_of(linear), hues(linear)
    away = (pixels - pixels.mean(axis=0)) / pixels.std(axis=0)
    of_pixels = np.einsum("ni,nij->nj", weight[3:6] * away, lab_slopes(linear))
    of_hues = np.einsum("i,nij->nj", weight[6:], turned)
    return (weight[:3] @ lab_slopes(mean) + of_pixels + of_hues) / len(linear)


# --- a twin -------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Twin:
    """A problem whose answer is known, and what is asked of it.

    Attributes:
        problem: the fit.
        hidden: `(p,)` the answer.
        path: (seconds, pictures, passes, cost, vector) after each evaluation of the cost.
    """

    problem: FitProblem
    hidden: Array
    path: list[tuple[float, int, int, float, Array]] = field(default_factory=list)
    began: float = 0.0

    @contextmanager
    def clock(self) -> Iterator[None]:
        """Count from here."""
        COUNTS.clear()
        self.path = []
        self.began = time.perf_counter()
        yield

    @property
    def seconds(self) -> float:
        """Since the clock was started."""
        return time.perf_counter() - self.began

    def vector(self, scaled: Array) -> Array:
        """From units of the bounds' sd about their mean."""
        problem = self.problem
        return np.clip(problem.mean + problem.sd * scaled, problem.low, problem.high)

    @property
    def start(self) -> Array:
        """The recipe's own values, in those units."""
        problem = self.problem
        return (problem.inside(problem.default) - problem.mean) / problem.sd

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Their ends, in those units."""
        problem = self.problem
        return (problem.low - problem.mean) / problem.sd, (problem.high - problem.mean) / problem.sd

    def residuals(self, scaled: Array) -> Array:
        """Of data and bounds."""
        found = self.problem.residuals(self.vector(scaled))
        self._note(0.5 * float(found @ found), scaled)
        return found

    def jacobian(self, scaled: Array) -> Array:
        """By forward derivatives: a pass for each entry that changes light."""
        return self.problem.jacobian(self.vector(scaled)) * self.problem.sd

    def differences(self, scaled: Array) -> Array:
        """By finite differences: a picture for each entry, and inwards."""
        _, high = self.bounds
        here, columns = self.problem.residuals(self.vector(scaled)), []
        for i in range(scaled.size):
            step = DIFFERENCE if scaled[i] + DIFFERENCE <= high[i] else -DIFFERENCE
            moved = scaled.copy()
            moved[i] += step
            columns.append((self.problem.residuals(self.vector(moved)) - here) / step)
        return np.stack(columns, axis=1)

    def cost_and_slope(self, scaled: Array) -> tuple[float, Array]:
        """Half the sum of squares, and its derivatives by one backward pass for each view."""
        problem, vector = self.problem, self.vector(scaled)
        values = problem.values(vector)
        made = problem.tuned(values)
        moves = [ParameterStep.along(entry, values, problem.tuned) for entry in problem.entries]
        pull = (vector - problem.mean) / problem.sd
        cost, slope = 0.5 * float(pull @ pull), pull / problem.sd
        for cell in problem.cells:
            # One picture gives the residuals, and these what the pass starts from.
            (eye,) = cell.eyes
            missed: list[Array] = []

            def of_linear(linear: Array, cell: Cell = cell, missed: list[Array] = missed) -> Array:
                missed.append((numbers(linear) + cell.around.offset - cell.target) / cell.sigma)
                return pixel_slopes(linear, missed[0] / cell.sigma)

            slope = slope + eye.backward(made, of_linear, moves, cell.around.shade)
            cost += 0.5 * float(missed[0] @ missed[0])
        self._note(cost, scaled)
        return cost, slope * problem.sd

    def errors(self, vector: Array) -> tuple[float, float]:
        """CIEDE2000 of the patches, their mean, and the entries' distance from the answer in sd, theirs."""
        made = self.problem.tuned(self.problem.values(vector))
        seen = np.array([cell.predicted(made)[:3] for cell in self.problem.cells])
        target = np.array([cell.target[:3] for cell in self.problem.cells])
        off = np.abs(vector - self.hidden) / self.problem.sd
        return float(np.mean(delta_e_2000(seen, target))), float(np.mean(off))

    def _note(self, cost: float, scaled: Array) -> None:
        passes = COUNTS["forward"] + COUNTS["backward"]
        self.path.append((self.seconds, COUNTS["rgb"], passes, cost, self.vector(scaled)))


def twin(recipe_name: str, seed: int) -> Twin:
    """Hidden values drawn from the bounds, and pictures of them with other random numbers."""
    recipe, rng = load_recipe(recipe_name), np.random.default_rng(seed)
    parameters = TuningTarget(recipe, PatchSet("none", ())).parameters(NAMES)
    hidden = {one.name: np.array([law.draw(rng) for law in one.prior]) for one in parameters}
    patches = simulate_patches(recipe, hidden, KINDS, organs=1, seed=seed, noise=seed + 1)
    subject = TuningTarget(recipe, patches, registered=True, organs=1, seed=seed)
    given = subject.problem(NAMES)
    eyes = (BackwardEye(one, subject.cultivar, seed + i, EFFORT) for i, one in enumerate(subject.views))
    own = {eye.view.name: eye for eye in eyes}
    cells = [replace(cell, eyes=(own[cell.label],)) for cell in given.cells]
    problem = FitProblem(given.parameters, subject.tuned, cells)
    return Twin(problem, np.concatenate([hidden[one.name] for one in parameters]))


# --- ways to fit --------------------------------------------------------------------------------------------


def gauss_newton(of: Twin, budget_s: float, derivatives: Callable[[Array], Array]) -> None:
    """Trust region about Gauss and Newton's steps (Branch, Coleman & Li 1999)."""
    from scipy.optimize import least_squares

    least_squares(
        of.residuals, of.start, derivatives, bounds=of.bounds, ftol=TOLERANCE, xtol=TOLERANCE, max_nfev=40
    )


def l_bfgs(of: Twin, budget_s: float) -> None:
    """A limited-memory approximation of the curvature, from gradients (Byrd et al. 1995)."""
    from scipy.optimize import minimize

    options = {"ftol": TOLERANCE, "maxfun": 400}
    minimize(
        of.cost_and_slope,
        of.start,
        jac=True,
        method="L-BFGS-B",
        bounds=np.transpose(of.bounds),
        options=options,
    )


def adam(of: Twin, budget_s: float, step: float) -> None:
    """Kingma & Ba 2015 with their constants, kept within the bounds, until the time is over."""
    place, (low, high) = of.start, of.bounds
    mean, square = np.zeros(place.size), np.zeros(place.size)
    for i in range(1, 10_000):
        _, slope = of.cost_and_slope(place)
        mean, square = 0.9 * mean + 0.1 * slope, 0.999 * square + 0.001 * slope**2
        unbiased = mean / (1.0 - 0.9**i), square / (1.0 - 0.999**i)
        place = np.clip(place - step * unbiased[0] / (np.sqrt(unbiased[1]) + 1e-8), low, high)
        if of.seconds > budget_s:
            break


WAYS: Final[Mapping[str, Callable[[Twin, float], None]]] = {
    "Gauss-Newton, forward derivatives": lambda of, budget: gauss_newton(of, budget, of.jacobian),
    "the same, finite differences": lambda of, budget: gauss_newton(of, budget, of.differences),
    "L-BFGS, backward derivatives": l_bfgs,
    **{
        f"Adam, backward derivatives, steps of {step:g} sd": (
            lambda of, budget, step=step: adam(of, budget, step)
        )
        for step in STEPS
    },
}


@dataclass(frozen=True)
class Ran:
    """One way on one twin: what it reached, and when it was there.

    Attributes:
        cost: the least.
        there_s, there_pictures, there_passes: until the cost was within `NEAR` of the least of any way.
        total_s: until it ended.
        errors: (CIEDE2000, distance) in the end.
        by_time: the same at `CHECKPOINTS_S`.
    """

    cost: float
    there_s: float
    there_pictures: float
    there_passes: float
    total_s: float
    errors: tuple[float, float]
    by_time: tuple[tuple[float, float], ...]


def compared(of: Twin, order: Sequence[str], budget_s: float) -> dict[str, Ran]:
    """All ways on one twin, in an order."""
    paths, totals = {}, {}
    for name in order:
        with of.clock():
            WAYS[name](of, budget_s)
            totals[name] = of.seconds
        paths[name] = of.path
    least = min(cost for path in paths.values() for *_, cost, _ in path)
    found = {}
    for name, path in paths.items():
        there = next((one for one in path if one[3] <= (1.0 + NEAR) * least), None)
        best = min(path, key=lambda one: one[3])
        by_time = []
        for limit in CHECKPOINTS_S:
            until = [one for one in path if one[0] <= limit] or path[:1]
            by_time.append(of.errors(min(until, key=lambda one: one[3])[4]))
        missed = (np.inf, np.inf, np.inf)
        reached = there[:3] if there is not None else missed
        found[name] = Ran(best[3], *reached, totals[name], of.errors(best[4]), tuple(by_time))
    return found


def check(of: Twin) -> None:
    """Forward, backward and finite differences agree: else the comparison would be of faults."""
    scaled = 0.5 * of.start
    residuals, jacobian = of.residuals(scaled), of.jacobian(scaled)
    cost, slope = of.cost_and_slope(scaled)
    wanted = jacobian.T @ residuals
    assert abs(cost - 0.5 * residuals @ residuals) <= 1e-6 * cost
    assert np.abs(slope - wanted).max() <= 1e-2 * np.abs(wanted).max(), (slope, wanted)
    finite = of.differences(scaled)
    assert np.abs(finite - jacobian).max() <= 5e-2 * np.abs(jacobian).max()


# --- the table ----------------------------------------------------------------------------------------------


def table(runs: Sequence[Mapping[str, Ran]]) -> list[str]:
    """Rows of two Markdown tables: until there, and errors by time."""
    first, median = next(iter(WAYS)), statistics.median
    told = [
        "| way | seconds until there | against the first | pictures | derivative passes "
        f"| there, of {len(runs)} | ΔE₀₀ in the end | entries off, in sd |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name in WAYS:
        every = [one[name] for one in runs]
        # A ratio within each twin, so that what slows all ways of a twin alike drops out.
        ratio = median(one[name].there_s / one[first].there_s for one in runs)
        row = [
            _told(median(one.there_s for one in every), ".2f"),
            _told(ratio, ".2f"),
            _told(median(one.there_pictures for one in every), ".0f"),
            _told(median(one.there_passes for one in every), ".0f"),
            str(sum(bool(np.isfinite(one.there_s)) for one in every)),
            _told(median(one.errors[0] for one in every), ".3f"),
            _told(median(one.errors[1] for one in every), ".3f"),
        ]
        told.append(f"| {name} | {' | '.join(row)} |")
    times = " | ".join(f"{one:g} s" for one in CHECKPOINTS_S)
    told += ["", f"| ΔE₀₀, and entries off in sd, after | {times} |", "|---|" + "---:|" * len(CHECKPOINTS_S)]
    for name in WAYS:
        cells = []
        for i in range(len(CHECKPOINTS_S)):
            errors = [one[name].by_time[i] for one in runs]
            cells.append(f"{median(one[0] for one in errors):.2f}, {median(one[1] for one in errors):.2f}")
        told.append(f"| {name} | {' | '.join(cells)} |")
    return told


def _told(number: float, form: str) -> str:
    return format(number, form) if np.isfinite(number) else "-"


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipe", default="barth2018", help="whose organs, light and camera")
    parser.add_argument("--twins", type=int, default=5, help="that are counted")
    parser.add_argument("--budget", type=float, default=30.0, metavar="SECONDS", help="of Adam")
    options = parser.parse_args()
    names, runs = list(WAYS), []
    count_calls()
    for seed in range(options.twins + 1):
        of = twin(options.recipe, seed)
        check(of)  # compiles, too
        turn = seed % len(names)
        ran = compared(of, names[turn:] + names[:turn], options.budget if seed else 1.0)
        if seed:
            runs.append(ran)
    told = [describe_machine(machine_info()), "", *table(runs)]
    sys.stdout.write("\n".join(told) + "\n")


if __name__ == "__main__":
    main()

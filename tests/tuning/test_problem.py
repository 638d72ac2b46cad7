"""Residuals of a fit and their derivatives.

The derivatives pass through the whole fit: from a parameter through the path to pigments at its knots,
through light to electrons, noise and saturation to linear sRGB, and to mean, spread and hue. They are
compared with central differences of the residuals, with other steps and the same random numbers, so that
the residuals are smooth. The comparison has to detect mutations, each of which makes it fail.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_fits import FEW_SAMPLES, no_patches

from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.tuning import observables, view_model
from pepperscene.tuning.observables import OBSERVABLE_COUNT, SensorModel
from pepperscene.tuning.problem import FitProblem, NeighbourEffect
from pepperscene.tuning.target import TuningTarget
from pepperscene.tuning.view_model import Entry, ParameterStep, ViewModel

NAMES = (
    "leaf.chlorophyll", "leaf.unripe.carotenoid", "leaf.anthocyanin", "leaf.structure", "leaf.state",
    "leaf.roughness", "leaf.ior", "fruit.unripe.brown", "fruit.ripeness", "fruit.spread", "fruit.flesh",
    "flash.power", "flash.colour", "flash.spectrum", "exposure", "white_balance", "colour_matrix",
)  # fmt: skip
"""One of every kind of parameter."""

TOLERANCE = 0.01
"""Relative, of a column: differences in single precision, and pixels that become clipped within a step."""
STEPS = {"exposure": 0.004, "white_balance": 0.004, "colour_matrix": 0.004, "flash.spectrum": 0.4}
"""In prior sd; others have 0.1. Clipping requires a small step, and rounding, of what is rendered in single
precision, a large one. The image is linear in the flash's spectrum, whose ends give so little of it that no
step clips a pixel, but that rounding is more than a hundredth of their slopes with a smaller step."""

NEIGHBOURS = {"leaf": NeighbourEffect(np.array([0.9, 0.8, 0.7]), np.zeros(OBSERVABLE_COUNT))}
"""Leaves are in green shade, which the derivatives have to include."""


@pytest.fixture(scope="module")
def target() -> TuningTarget:
    patches = no_patches(["leaf", "pepper.unripe"])
    # With a fast lens some pixels are saturated.
    recipe = load_recipe("barth2018", {"camera.lens": "lensagon_cmfa0420nd"})
    return TuningTarget(recipe, patches, organs=1, pixels=16, quality=FEW_SAMPLES)


@pytest.fixture(scope="module")
def problem(target) -> FitProblem:
    return target.problem(NAMES, NEIGHBOURS)


@pytest.fixture(scope="module")
def vector(problem) -> np.ndarray:
    """Differs from the recipe's values, and is so far from the bounds that steps stay within."""
    rng = np.random.default_rng(4)
    changed = problem.default + 0.1 * problem.sd * rng.standard_normal(problem.sd.size)
    margin = 0.8 * problem.sd
    return np.clip(changed, problem.low + margin, problem.high - margin)


@pytest.fixture(scope="module")
def jacobian(problem, vector) -> np.ndarray:
    return problem.jacobian(vector)


def central_differences(problem: FitProblem, vector: np.ndarray) -> np.ndarray:
    """`(m, p)` central differences; for a large step Richardson's extrapolation of two of them."""
    columns = []
    for number, (entry, sd) in enumerate(zip(problem.entries, problem.sd, strict=True)):
        step, direction = STEPS.get(entry.parameter.name, 0.1), np.zeros(vector.size)
        direction[number] = sd

        def slope(h, direction=direction, sd=sd):
            above, below = (problem.residuals(vector + side * h * direction) for side in (1.0, -1.0))
            return (above - below) / (2.0 * h * sd)

        columns.append((4.0 * slope(step / 2.0) - slope(step)) / 3.0 if step > 0.01 else slope(step))
    return np.array(columns).T


@pytest.fixture(scope="module")
def differences(problem, vector) -> np.ndarray:
    return central_differences(problem, vector)


def disagreement(jacobian: np.ndarray, differences: np.ndarray, problem: FitProblem) -> dict[str, float]:
    """Relative difference of each entry's column, without the rows of the priors, which would hide it."""
    error, expected = (jacobian - differences)[: problem.data_count], differences[: problem.data_count]
    errors = np.linalg.norm(error, axis=0) / np.linalg.norm(expected, axis=0)
    return dict(zip([one.label for one in problem.entries], errors, strict=True))


def worst(jacobian, differences, problem) -> float:
    return max(disagreement(jacobian, differences, problem).values())


def test_derivatives_match_finite_differences(problem, jacobian, differences):
    errors = disagreement(jacobian, differences, problem)
    assert max(errors.values()) < TOLERANCE, errors


def test_some_pixels_are_saturated_or_clipped(problem, vector):
    """The limits of the sensor and of colours are among what is compared."""
    parts, fractions = problem.tuned_parts(problem.values(vector)), []
    for observation in problem.observations:
        (model,) = observation.view_models
        electrons = observation.neighbours.shade * model.electrons(parts)
        _, slope, unclipped = model._sensor.linear_and_slopes(
            electrons, parts.exposure, parts.gains, parts.matrix
        )
        fractions.append([np.mean(slope == 0.0), np.mean(unclipped == 0.0)])
    saturated, clipped = np.max(fractions, axis=0)
    assert 0.0 < saturated < 0.5
    assert 0.0 < clipped < 0.5


def test_priors_are_rows_of_the_problem(problem, jacobian):
    assert jacobian[problem.data_count :] == pytest.approx(np.diag(1.0 / problem.sd))
    assert problem.residuals(problem.mean)[problem.data_count :] == pytest.approx(0.0)
    assert problem.residuals(problem.mean + problem.sd)[problem.data_count :] == pytest.approx(1.0)


def test_derivative_at_a_bound_is_one_sided(target):
    """No leaf has less than no brown: clipping beyond the bound would halve the slope."""
    problem = target.problem(["leaf.brown"])
    assert problem.default[0] == problem.low[0] == 0.0
    step = 0.05 * problem.sd
    here, once, twice = (problem.residuals(k * step)[: problem.data_count] for k in range(3))
    slope = (4.0 * once - 3.0 * here - twice) / (2.0 * step)
    for start in (problem.default, problem.inside(problem.default)):
        column = problem.jacobian(start)[: problem.data_count, 0]
        assert np.linalg.norm(column - slope) < 0.02 * np.linalg.norm(slope)


def test_raises_on_an_entry_that_cannot_change(target):
    (exposure,) = target.parameters(["exposure"])
    fixed = replace(exposure, prior=(exposure.prior[0].model_copy(update={"low": 1.0, "high": 1.0}),))
    with pytest.raises(ValueError, match="cannot change"):
        ParameterStep.along(Entry(fixed, 0), {}, target.tuned_parts)


def replace_attribute(owner, name, wrap):
    """A mutation that replaces a function by `wrap(function)`."""
    return lambda patch: patch.setattr(owner, name, wrap(getattr(owner, name)))


def as_light(group):
    """A mutation that treats a group that acts after the light as a part of the light."""
    return lambda patch: patch.setattr(view_model, "LIGHT_GROUPS", (*view_model.LIGHT_GROUPS, group))


def sensor_slopes(change):
    """Other slopes of the sensor model for the same image."""
    return replace_attribute(
        SensorModel, "linear_and_slopes", lambda right: lambda *given: change(*right(*given))
    )


def negative_hues(right):
    return lambda linear: (right(linear)[0], -right(linear)[1])


def without_shade(right):
    """Derivatives, but not values, ignore the light that neighbours absorb."""
    return lambda self, parts, steps, shade: (
        right(self, parts, steps, shade)[0], right(self, parts, steps, np.ones(3))[1],
    )  # fmt: skip


MUTATIONS = {
    "exposure dropped": as_light("exposure"),
    "white balance and matrix dropped": as_light("camera"),
    "direction of light reversed": replace_attribute(
        view_model, "_direction", lambda right: lambda above, below, width: right(below, above, width)
    ),
    "slope of the sensor is 1": sensor_slopes(
        lambda linear, slope, unclipped: (linear, np.ones_like(slope), unclipped)
    ),
    "saturated pixels change": sensor_slopes(
        lambda linear, slope, unclipped: (linear, np.where(slope == 0.0, slope.max(), slope), unclipped)
    ),
    "clipped colours change": sensor_slopes(
        lambda linear, slope, unclipped: (linear, slope, np.ones_like(unclipped))
    ),
    "CIELAB transposed": replace_attribute(
        observables, "lab_derivatives", lambda right: lambda linear: np.swapaxes(right(linear), -1, -2)
    ),
    "hues negative": replace_attribute(observables, "hue_vectors", negative_hues),
    "shade left out": replace_attribute(ViewModel, "linear_and_derivatives", without_shade),
}


@pytest.fixture(scope="module")
def bright(problem, vector) -> np.ndarray:
    """The values of a brighter image: one pixel in 40 is saturated instead of one in 80."""
    brighter = vector.copy()
    (exposure,) = (k for k, entry in enumerate(problem.entries) if entry.parameter.name == "exposure")
    brighter[exposure] = problem.default[exposure] + 0.5 * problem.sd[exposure]
    return brighter


@pytest.fixture(scope="module")
def bright_differences(problem, bright) -> np.ndarray:
    return central_differences(problem, bright)


@pytest.mark.long
@pytest.mark.parametrize("mutation", MUTATIONS)
def test_detects_mutations(problem, bright, bright_differences, monkeypatch, mutation):
    assert worst(problem.jacobian(bright), bright_differences, problem) < 2.0 * TOLERANCE
    MUTATIONS[mutation](monkeypatch)
    assert worst(problem.jacobian(bright), bright_differences, problem) > 2.0 * TOLERANCE


def test_vector_has_the_values_in_order(problem):
    values = problem.values(problem.default)
    assert tuple(values) == NAMES
    assert np.concatenate(list(values.values())) == pytest.approx(problem.default)
    assert [one.label for one in problem.entries][11:13] == ["flash.power", "flash.colour (warmth)"]


def test_inside_moves_values_off_the_bounds(problem):
    for end in (problem.low, problem.high, problem.low - 1.0):
        inside = problem.inside(end)
        assert ((inside > problem.low) & (inside < problem.high)).all()
    assert problem.inside(problem.mean) == pytest.approx(problem.mean)


def test_residuals_are_zero_for_predicted_targets_only_and_in_units_of_sigma(problem):
    values = problem.values(problem.default)
    parts = problem.tuned_parts(values)
    exact = [replace(one, target=one.predicted(parts)) for one in problem.observations]
    same = FitProblem(problem.parameters, problem.tuned_parts, exact)
    assert np.abs(same.data_residuals(values)).max() < 1e-6
    assert np.abs(same.data_residuals({**values, "exposure": np.array([0.9])})).max() > 0.5
    uncertain = [replace(one, sigma=2.0 * one.sigma) for one in problem.observations]
    wider = FitProblem(problem.parameters, problem.tuned_parts, uncertain)
    assert wider.data_residuals(values) == pytest.approx(0.5 * problem.data_residuals(values))


def test_neighbours_shade_views_and_add_an_offset(target, problem):
    parts = target.tuned_parts({})
    bare = {one.label: one for one in target.problem(["exposure"]).observations}
    shaded = {one.label: one for one in problem.observations}
    assert shaded["leaf"].predicted(parts)[0] < bare["leaf"].predicted(parts)[0]
    assert shaded["pepper.unripe"].predicted(parts) == pytest.approx(bare["pepper.unripe"].predicted(parts))
    offset = np.arange(OBSERVABLE_COUNT, dtype=float)
    moved = replace(bare["leaf"], neighbours=NeighbourEffect(np.ones(3), offset))
    assert moved.predicted(parts) - bare["leaf"].predicted(parts) == pytest.approx(offset)

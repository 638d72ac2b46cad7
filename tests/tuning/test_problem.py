"""Residuals of a fit and their derivatives.

The derivatives go through all of a fit: from a parameter through the path to pigments at its knots, through
light to electrons, noise and saturation to linear sRGB, and on to mean, spread and hue. They are held against
central differences of the residuals themselves, with steps of their own and the same random numbers, so that
the residuals are smooth. The same comparison has to notice when a derivative is wrong: what follows it are
mutations, each of which makes it fail.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_fits import no_patches

from pepperscene.dataset import load_recipe
from pepperscene.render.quality import Quality
from pepperscene.tuning.model import observables
from pepperscene.tuning.model import view_model as model
from pepperscene.tuning.model.observables import OBSERVABLE_COUNT, SensorModel
from pepperscene.tuning.model.problem import FitProblem, NeighbourEffect
from pepperscene.tuning.model.target import TuningTarget
from pepperscene.tuning.model.view_model import Entry, ParameterStep

CONTENT_FIELDS = (
    "leaf.chlorophyll", "leaf.unripe.carotenoid", "leaf.anthocyanin", "leaf.structure", "leaf.state",
    "leaf.roughness", "leaf.ior", "fruit.unripe.brown", "fruit.ripeness", "fruit.spread", "fruit.flesh",
    "flash.power", "flash.colour", "flash.spectrum", "exposure", "white_balance", "colour_matrix",
)  # fmt: skip
"""Of every kind of parameter one."""

TOLERANCE = 0.01
"""Relative, of a column: differences in single precision, and pixels that a step brings across a limit."""
STEPS = (0.004, 0.1)
"""Of the bounds' sd. Rounding asks for a large one and limits for a small one, so the nearer one counts."""

AROUND = {"leaf": NeighbourEffect(np.array([0.9, 0.8, 0.7]), np.zeros(OBSERVABLE_COUNT))}
"""Leaves stand in a green shade, which derivatives have to go through as well."""


@pytest.fixture(scope="module")
def subject() -> TuningTarget:
    few = Quality(4, 4, 4, 1, target=None, denoise=False)
    kinds = ["leaf", "pepper.unripe"]
    return TuningTarget(load_recipe("barth2018"), no_patches(kinds), organs=1, pixels=16, quality=few)


@pytest.fixture(scope="module")
def problem(subject) -> FitProblem:
    return subject.problem(CONTENT_FIELDS, AROUND)


@pytest.fixture(scope="module")
def place(problem) -> np.ndarray:
    """Not the recipe's own values, and so far from the ends of the bounds that steps stay within."""
    rng = np.random.default_rng(4)
    off = problem.default + 0.1 * problem.sd * rng.standard_normal(problem.sd.size)
    room = 0.2 * problem.sd
    return np.clip(off, problem.low + room, problem.high - room)


def slopes_by_differences(problem: FitProblem, place: np.ndarray, step: float) -> np.ndarray:
    """`(m, p)` central differences, and for a large step Richardson's from two of them."""
    columns = []
    for entry, sd in enumerate(problem.sd):
        along = np.zeros(place.size)
        along[entry] = sd

        def slope(h, along=along, sd=sd):
            above, below = problem.residuals(place + h * along), problem.residuals(place - h * along)
            return (above - below) / (2.0 * h * sd)

        columns.append((4.0 * slope(step / 2.0) - slope(step)) / 3.0 if step > 0.01 else slope(step))
    return np.array(columns).T


@pytest.fixture(scope="module")
def differences(problem, place) -> list[np.ndarray]:
    return [slopes_by_differences(problem, place, step) for step in STEPS]


def disagreement(
    jacobian: np.ndarray, differences: list[np.ndarray], problem: FitProblem
) -> dict[str, float]:
    """By entry, how far its column lies from that by differences, relative to it; without the bounds' rows,
    which would hide it. A wrong column is far from both steps'.
    """
    found = []
    for by_differences in differences:
        off, size = (jacobian - by_differences)[: problem.data], by_differences[: problem.data]
        found.append(np.linalg.norm(off, axis=0) / np.linalg.norm(size, axis=0))
    return dict(zip([one.label for one in problem.entries], np.min(found, axis=0), strict=True))


def worst(jacobian, differences, problem) -> float:
    return max(disagreement(jacobian, differences, problem).values())


# --- derivatives ------------------------------------------------------------------------------------------


def test_derivatives_are_those_of_the_residuals(problem, place, differences):
    told = disagreement(problem.jacobian(place), differences, problem)
    assert max(told.values()) < TOLERANCE, told


def test_limits_of_the_sensor_and_of_colour_are_among_what_is_tested(problem, place):
    """Some pixels are cut, and some are not."""
    parts, cuts = problem.tuned(problem.values(place)), []
    for cell in problem.observations:
        (eye,) = cell.view_models
        photograph = eye._photograph
        electrons = cell.neighbours.shade * eye.electrons(parts)
        _, slope, free = photograph.linear_and_slopes(electrons, parts.exposure, parts.gains, parts.matrix)
        cuts.append([np.mean(slope == 0.0), np.mean(free == 0.0)])
    assert 0.0 < np.max(cuts, axis=0)[0] < 0.5
    assert 0.0 < np.max(cuts, axis=0)[1] < 0.5


def test_the_bounds_are_rows_of_their_own(problem, place):
    rows = problem.jacobian(place)[problem.data :]
    assert rows == pytest.approx(np.diag(1.0 / problem.sd))
    assert problem.residuals(problem.mean)[problem.data :] == pytest.approx(0.0)
    assert problem.residuals(problem.mean + problem.sd)[problem.data :] == pytest.approx(1.0)


def test_at_an_end_of_the_bounds_a_derivative_is_taken_inwards(subject):
    """No leaf has less than no anthocyanin: what lies beyond is cut, and would halve the slope."""
    problem = subject.problem(["leaf.anthocyanin"])
    assert problem.default[0] == problem.low[0] == 0.0
    step = 0.05 * problem.sd
    here, once, twice = (problem.residuals(k * step)[: problem.data] for k in range(3))
    slope = (4.0 * once - 3.0 * here - twice) / (2.0 * step)
    for start in (problem.default, problem.inside(problem.default)):
        found = problem.jacobian(start)[: problem.data, 0]
        assert np.linalg.norm(found - slope) < 0.02 * np.linalg.norm(slope)


def test_an_entry_without_room_is_refused(subject):
    (only,) = subject.parameters(["exposure"])
    stuck = replace(only, prior=(only.prior[0].model_copy(update={"low": 1.0, "high": 1.0}),))
    with pytest.raises(ValueError, match="cannot move"):
        ParameterStep.along(Entry(stuck, 0), {}, subject.tuned)


# --- mutations --------------------------------------------------------------------------------------------


def test_one_column_with_a_wrong_sign_is_noticed(problem, place, differences):
    right = problem.jacobian(place)
    for entry in range(len(problem.entries)):
        wrong = right.copy()
        wrong[:, entry] *= -1.0
        assert worst(wrong, differences, problem) > 1.0, problem.entries[entry].label


def test_one_column_of_a_wrong_scale_is_noticed(problem, place, differences):
    right = problem.jacobian(place)
    for entry in range(len(problem.entries)):
        for factor in (1.1, 0.9):
            wrong = right.copy()
            wrong[:, entry] *= factor
            assert worst(wrong, differences, problem) > 5.0 * TOLERANCE, problem.entries[entry].label


def _dropped(group):
    """Derivatives of a group that acts behind the light are looked for in the light, and not found."""
    return lambda monkeypatch: monkeypatch.setattr(model, "LIGHT_GROUPS", (*model.LIGHT_GROUPS, group))


def _turned_round(monkeypatch):
    """The direction in which the renderer's tables change, the wrong way."""
    right = model._direction
    monkeypatch.setattr(model, "_direction", lambda above, below, step: right(below, above, step))


def _photograph(change):
    """Other slopes of the photograph, the same picture."""

    def mutate(monkeypatch):
        right = SensorModel.linear_and_slopes
        monkeypatch.setattr(SensorModel, "linear_and_slopes", lambda *given: change(*right(*given)))

    return mutate


def _transposed(monkeypatch):
    """CIELAB by colours, rows for columns."""
    right = observables.lab_derivatives
    monkeypatch.setattr(observables, "lab_derivatives", lambda linear: np.swapaxes(right(linear), -1, -2))


def _hues_backwards(monkeypatch):
    right = observables.hues

    def wrong(linear):
        direction, turned = right(linear)
        return direction, -turned

    monkeypatch.setattr(observables, "hues", wrong)


def _without_shade(monkeypatch):
    """What neighbours let through is left out of the derivatives alone."""
    right = model.ViewModel.linear_and_slopes

    def wrong(self, parts, moves, shade):
        return right(self, parts, moves, shade)[0], right(self, parts, moves, np.ones(3))[1]

    monkeypatch.setattr(model.ViewModel, "linear_and_slopes", wrong)


MUTATIONS = {
    "exposure dropped": _dropped("exposure"),
    "white balance and matrix dropped": _dropped("camera"),
    "light the wrong way": _turned_round,
    "photograph's slope is 1": _photograph(lambda found, slope, free: (found, np.ones_like(slope), free)),
    "saturated pixels change": _photograph(
        lambda found, slope, free: (found, np.where(slope == 0.0, slope.max(), slope), free)
    ),
    "cut colours change": _photograph(lambda found, slope, free: (found, slope, np.ones_like(free))),
    "CIELAB transposed": _transposed,
    "hues backwards": _hues_backwards,
    "shade left out": _without_shade,
}


@pytest.mark.parametrize("mutation", MUTATIONS)
def test_mutations_are_noticed(problem, place, differences, monkeypatch, mutation):
    MUTATIONS[mutation](monkeypatch)
    assert worst(problem.jacobian(place), differences, problem) > 2.0 * TOLERANCE


# --- the vector -------------------------------------------------------------------------------------------


def test_a_vector_is_the_values_in_order(problem):
    values = problem.values(problem.default)
    assert tuple(values) == CONTENT_FIELDS
    assert np.concatenate(list(values.values())) == pytest.approx(problem.default)
    assert [one.label for one in problem.entries][11:13] == ["flash.power", "flash.colour (warmth)"]


def test_what_lies_on_an_end_is_moved_off_it(problem):
    for end in (problem.low, problem.high, problem.low - 1.0):
        inside = problem.inside(end)
        assert ((inside > problem.low) & (inside < problem.high)).all()
    assert problem.inside(problem.mean) == pytest.approx(problem.mean)


def test_patches_of_the_model_itself_leave_nothing(subject, problem):
    """At the values that parts them, and only there."""
    values = problem.values(problem.default)
    parts = problem.tuned(values)
    cells = [replace(cell, target=cell.predicted(parts)) for cell in problem.observations]
    own = FitProblem(problem.parameters, problem.tuned, cells)
    assert np.abs(own.data_residuals(values)).max() < 1e-6
    darker = own.data_residuals({**values, "exposure": np.array([0.9])})
    assert np.abs(darker).max() > 0.5


def test_residuals_are_in_units_of_sigma(problem):
    values = problem.values(problem.default)
    half = [replace(cell, sigma=2.0 * cell.sigma) for cell in problem.observations]
    wider = FitProblem(problem.parameters, problem.tuned, half)
    assert wider.data_residuals(values) == pytest.approx(0.5 * problem.data_residuals(values))


def test_offsets_are_added_and_shade_dims(subject, problem):
    parts = subject.tuned({})
    bare = {cell.label: cell for cell in subject.problem(["exposure"]).observations}
    shaded = {cell.label: cell for cell in problem.observations}
    assert shaded["leaf"].predicted(parts)[0] < bare["leaf"].predicted(parts)[0]
    assert shaded["pepper.unripe"].predicted(parts) == pytest.approx(bare["pepper.unripe"].predicted(parts))
    more = np.arange(OBSERVABLE_COUNT, dtype=float)
    brought = replace(bare["leaf"], neighbours=NeighbourEffect(np.ones(3), more))
    assert brought.predicted(parts) - bare["leaf"].predicted(parts) == pytest.approx(more)

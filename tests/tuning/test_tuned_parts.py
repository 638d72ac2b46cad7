"""Parts of a recipe at parameter values: unchanged at its own values, as stated elsewhere, and smooth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated_fits import all_parameters

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import leaf_body, rind_reflectance
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.render.gradients.tunable import CONTENTS, RANGES, path_values
from pepperscene.tuning.pigment_paths import (
    CONTENT_FIELDS,
    SMOOTHING_RADIUS,
    state_distribution,
    visible_surfaces,
)
from pepperscene.tuning.tuned import OFF_DIAGONAL, densify_cultivar, densify_path, tuned_parts

FURTHER = ("red_blocky", "orange_pointed", "kaite_february")
CULTIVARS = [
    "kaite", "tomato", "kaite_september", *(pytest.param(name, marks=pytest.mark.long) for name in FURTHER),
]  # fmt: skip
NODES = np.linspace(400.0, 710.0, 8)
NM = np.arange(400.0, 761.0, 20.0)
STATES = np.linspace(0.0, 1.0, 41)

RECIPE = load_recipe("barth2018")
CAMERA = load_camera(RECIPE)
KAITE = load_cultivar("kaite")
PARAMETERS = all_parameters(RECIPE, KAITE, CAMERA)
OF_SURFACES = [name for name, one in PARAMETERS.items() if one.group in ("pigments", "cuticle")]
DENSE = densify_cultivar(KAITE).pigments


def parts_at(values, cultivar=KAITE):
    return tuned_parts(cultivar, CAMERA, values, NODES)


def path_at(name, value):
    """The path of a parameter's surface at one value of it."""
    ((surface, path),) = parts_at({name: np.array([value])}).pigments.items()
    assert surface == name.partition(".")[0]
    return path


def numbers_of(parts):
    """All numbers of a recipe's parts, by name."""
    names = ("flash_power", "flash_factors", "exposure", "gains", "matrix")
    numbers = {name: getattr(parts, name) for name in names}
    for surface, path in parts.pigments.items():
        numbers |= path_values(surface, path)
    return {name: np.asarray(value) for name, value in numbers.items()}


@pytest.mark.parametrize("name", CULTIVARS)
def test_dense_paths_have_the_same_contents(name):
    for path in load_cultivar(name).pigments.values():
        dense = densify_path(path)
        assert len(path.knots) <= len(dense.knots) <= 24 + len(path.ageing)
        assert dense.ageing == path.ageing
        assert {state for state, _ in path.knots} <= {state for state, _ in dense.knots}
        spectra = leaf_body if path.flesh_reflectance is None else rind_reflectance
        np.testing.assert_allclose(
            np.array(spectra(dense, NM, STATES)), np.array(spectra(path, NM, STATES)), rtol=0, atol=1e-12
        )
        assert densify_path(dense) == dense


@pytest.mark.parametrize("name", CULTIVARS)
def test_default_values_change_nothing(name):
    cultivar = load_cultivar(name)
    dense = densify_cultivar(cultivar)
    parameters = all_parameters(RECIPE, cultivar, CAMERA)
    # Everything that can be combined, from the cultivar as it is and from the dense one; and nothing.
    paths = {n: p.default for n, p in parameters.items() if not {"unripe", "ripe"} & set(n.split("."))}
    ends = {
        n: p.default
        for n, p in parameters.items()
        if n.rpartition(".")[2] not in CONTENT_FIELDS or n not in paths
    }
    for values, start in ((paths, cultivar), (paths, dense), (ends, cultivar), (ends, dense), ({}, dense)):
        parts = parts_at(values, start)
        assert set(parts.pigments) == (set(visible_surfaces(cultivar)) if values else set())
        for surface, path in parts.pigments.items():
            expected = path_values(surface, dense.pigments[surface])
            for key, value in path_values(surface, path).items():
                np.testing.assert_allclose(value, expected[key], rtol=1e-12, atol=1e-15, err_msg=key)
            assert path.source == cultivar.pigments[surface].source
        np.testing.assert_array_equal(parts.flash_factors, np.ones(8))
        assert parts.flash_power == parts.exposure == 1.0


def changed_value(name):
    """A value that differs from the default."""
    prior, default = PARAMETERS[name].prior[0], PARAMETERS[name].default[0]
    above = default + 0.3 * (prior.high - default)
    return above if above > default else default - 0.3 * (default - prior.low)


@pytest.mark.parametrize("name", OF_SURFACES)
def test_value_is_applied_and_nothing_else_changes(name):
    value, original = changed_value(name), DENSE[name.partition(".")[0]]
    surface, _, key = name.rpartition(".")
    after, before = (path_values("x", path) for path in (path_at(name, value), original))
    if key in CONTENT_FIELDS:
        field = CONTENT_FIELDS[key][0]
        # Tissue that ages is before state 0, and keeps its contents.
        aged = len(original.ageing)
        contents, original_contents = after.pop(f"x.{field}")[aged:], before[f"x.{field}"][aged:]
        assert path_at(name, value).ageing == original.ageing
        end = surface.rpartition(".")[2]
        applied = {"unripe": contents[0], "ripe": contents[-1]}.get(end, contents.max())
        assert applied == pytest.approx(value, rel=1e-12)
        other = {"unripe": -1, "ripe": 0}.get(end)
        if other is not None:
            assert contents[other] == pytest.approx(original_contents[other], rel=1e-12)
        del before[f"x.{field}"]
    elif key in ("state", "spread", "ripeness"):
        moved = [n for n in after if not np.allclose(after[n], before[n], rtol=1e-12, atol=0)]
        assert moved
        for n in moved:
            assert n.removeprefix("x.") in CONTENTS
            del after[n], before[n]
    else:
        field = f"x.{ {'flesh': 'flesh_reflectance'}.get(key, key) }"
        assert after[field].flat[0] == pytest.approx(value, rel=1e-12)
        if key == "roughness":
            assert after[field][1] == pytest.approx(value * original.roughness[1] / original.roughness[0])
        del after[field], before[field]
    for n, numbers in after.items():
        np.testing.assert_allclose(numbers, before[n], rtol=1e-12, atol=1e-15, err_msg=n)


def test_all_knots_scale_with_the_maximum():
    path = path_at("fruit.chlorophyll", 2 * PARAMETERS["fruit.chlorophyll"].default[0])
    found, before = (one.at(STATES)["chlorophyll_ug_cm2"] for one in (path, DENSE["fruit"]))
    np.testing.assert_allclose(found, 2 * before, rtol=1e-12)
    # For the structure parameter N, what exceeds one plate is scaled.
    path = path_at("leaf.structure", 1.0 + 1.5 * 0.75)
    expected = 1.5 * (DENSE["leaf"].at(STATES)["structure_n"] - 1.0)
    np.testing.assert_allclose(path.at(STATES)["structure_n"] - 1.0, expected, rtol=1e-12)


def test_absent_contents_are_added_evenly_and_capsanthin_with_ripeness():
    assert np.ptp(path_at("leaf.brown", 0.3).at(STATES)["brown"]) == pytest.approx(0.0)
    capsanthin = path_at("fruit.capsanthin", 20.0).at(STATES)["capsanthin_ug_cm2"]
    np.testing.assert_allclose(capsanthin, 20.0 * STATES, rtol=1e-12)
    assert np.ptp(path_at("leaf.capsanthin", 3.0).at(STATES)["capsanthin_ug_cm2"]) == pytest.approx(0.0)


def test_both_ends_can_be_empty_and_no_content_is_negative():
    for content, (field, *_) in CONTENT_FIELDS.items():
        floor = RANGES[field][0]
        for surface in visible_surfaces(KAITE):
            values = {f"{surface}.{end}.{content}": [floor] for end in ("unripe", "ripe")}
            contents = parts_at(values).pigments[surface].at(STATES)[field]
            assert contents[[0, -1]] == pytest.approx(floor, abs=1e-12)
            assert contents.min() >= floor


def smoothing_error(path, field):
    """Largest difference between a path and its moving average: at its sharpest kink."""
    knots = np.array([state for state, _ in path.knots if state >= 0.0])
    slopes = np.diff(path.at(knots)[field]) / np.diff(knots)
    jumps = np.abs(np.diff(np.concatenate([[0.0], slopes, [0.0]])))
    return 0.5 * SMOOTHING_RADIUS * jumps.max() + 1e-12


@pytest.mark.parametrize("surface", ["leaf", "stem", "calyx"])
def test_organs_have_the_contents_of_their_new_states(surface):
    states = state_distribution(KAITE, surface)
    mean, stretch = states.mean - 0.15, 1.4
    values = {f"{surface}.state": [mean], f"{surface}.spread": [stretch * states.sd]}
    path = parts_at(values).pigments[surface]
    knots = np.array([state for state, _ in path.knots if state >= 0.0])
    for field in CONTENTS:
        expected = DENSE[surface].at(np.clip(mean + stretch * (knots - states.mean), 0.0, 1.0))[field]
        error = np.abs(path.at(knots)[field] - expected).max()
        assert error <= smoothing_error(KAITE.pigments[surface], field), field


def test_fruit_of_lower_ripeness_has_the_contents_of_less_ripe_fruit():
    states = state_distribution(KAITE, "fruit")
    path = parts_at({"fruit.ripeness": [0.7]}).pigments["fruit"]
    knots = np.array([state for state, _ in path.knots])
    for field in ("chlorophyll_ug_cm2", "brown", "carotenoid_ug_cm2"):
        expected = DENSE["fruit"].at(knots * 0.7 / states.mean_ripeness)[field]
        error = np.abs(path.at(knots)[field] - expected).max()
        assert error <= smoothing_error(KAITE.pigments["fruit"], field)


def test_scaling_and_moving_commute():
    both = parts_at({"leaf.chlorophyll": [28.0], "leaf.state": [0.5]}).pigments["leaf"]
    moved = parts_at({"leaf.state": [0.5]}).pigments["leaf"]
    np.testing.assert_allclose(
        both.at(STATES)["chlorophyll_ug_cm2"], 0.5 * moved.at(STATES)["chlorophyll_ug_cm2"], rtol=1e-12
    )


def test_order_of_values_does_not_matter():
    values = {
        "fruit.ripeness": [0.8], "fruit.unripe.chlorophyll": [9.0], "fruit.ripe.chlorophyll": [2.0],
        "fruit.spread": [0.3], "fruit.brown": [0.5], "exposure": [1.2],
    }  # fmt: skip
    first, second = (numbers_of(parts_at(given)) for given in (values, dict(reversed(values.items()))))
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])


@given(st.integers(0, 2**32 - 1))
def test_values_within_bounds_give_valid_contents(seed):
    rng = np.random.default_rng(seed)
    names = rng.choice(OF_SURFACES, size=12, replace=False)
    values = {
        name: [rng.uniform(PARAMETERS[name].prior[0].low, PARAMETERS[name].prior[0].high)] for name in names
    }
    for surface, path in parts_at(values).pigments.items():
        for name, numbers in path_values(surface, path).items():
            low, high = RANGES[name.rpartition(".")[2]]
            assert ((numbers >= low) & (numbers <= high)).all(), name


def one_sided_slopes(name, entry, value, step):
    """Difference quotients of all numbers to either side."""
    vectors = []
    for change in (0.0, step, -step):
        changed = np.array(value)
        changed[entry] += change
        vectors.append(np.concatenate([n.ravel() for n in numbers_of(parts_at({name: changed})).values()]))
    here, above, below = vectors
    return (above - here) / step, (here - below) / step


SMOOTH = [
    pytest.param(name, marks=pytest.mark.long) if name.startswith(("stem", "dry_shoot")) else name
    for name in PARAMETERS
    if not name.startswith(("petiole", "peduncle", "calyx"))
]


@pytest.mark.parametrize(
    "position", ["default", *(pytest.param(position, marks=pytest.mark.long) for position in (0.21, 0.83))]
)
@pytest.mark.parametrize("name", SMOOTH)
def test_parts_have_no_kinks(name, position):
    """The slopes to either side converge as the step shrinks."""
    parameter = PARAMETERS[name]
    for entry, prior in enumerate(parameter.prior):
        width = prior.high - prior.low
        value = parameter.default.copy()
        if position != "default":
            value[entry] = prior.low + position * width
        # At a bound there is only one side.
        value[entry] = np.clip(value[entry], prior.low + 1e-3 * width, prior.high - 1e-3 * width)
        gaps = []
        for step in (1e-4 * width, 1e-5 * width):
            above, below = one_sided_slopes(name, entry, value, step)
            gaps.append(np.abs(above - below).max() / np.abs(above).max())
        assert gaps[1] <= max(0.2 * gaps[0], 1e-6), gaps


def test_flash_factors_are_spectrum_times_colour():
    values = {"flash.power": [1.3], "flash.colour": [0.5, -0.2], "flash.spectrum": np.linspace(0.5, 1.5, 8)}
    parts = parts_at(values)
    offset = (NODES - 550.0) / 150.0
    expected = np.linspace(0.5, 1.5, 8) * np.exp(0.5 * offset - 0.2 * np.exp(-((3.0 * offset) ** 2)))
    assert parts.flash_power == 1.3
    np.testing.assert_allclose(parts.flash_factors, expected, rtol=1e-12)
    np.testing.assert_array_equal(parts.flash_nodes_nm, NODES)


def test_raises_on_another_number_of_factors_than_nodes():
    with pytest.raises(ValueError, match="5 factors and the renderer 8 nodes"):
        parts_at({"flash.spectrum": np.ones(5)})
    assert tuned_parts(KAITE, CAMERA, {"flash.spectrum": np.ones(5)}).flash_factors.size == 0


def test_gains_and_matrix():
    default = parts_at({})
    parts = parts_at({"white_balance": [1.2, 0.8], "exposure": [0.7]})
    np.testing.assert_allclose(parts.gains, default.gains * [1.2, 1.0, 0.8])
    np.testing.assert_array_equal(parts.matrix, default.matrix)
    assert parts.exposure == 0.7
    entries = np.array([0.1, -0.2, 0.05, -0.3, 0.0, 0.4])
    matrix = parts_at({"colour_matrix": entries}).matrix
    np.testing.assert_allclose([matrix[at] for at in OFF_DIAGONAL], entries)
    np.testing.assert_allclose(matrix.sum(axis=1), default.matrix.sum(axis=1))


def test_explicit_matrix_keeps_its_row_sums():
    rows = ((1.5, -0.3, 0.0), (-0.2, 1.4, -0.3), (0.1, -0.5, 1.3))
    steps = replace(CAMERA.developing, white_balance=(2.0, 1.0, 1.5), colour_matrix=rows)
    camera = replace(CAMERA, developing=steps)
    parts = tuned_parts(KAITE, camera, {"colour_matrix": np.zeros(6)}, NODES)
    np.testing.assert_allclose(parts.matrix, np.diag(np.sum(rows, axis=1)), atol=1e-12)
    np.testing.assert_array_equal(parts.gains, [2.0, 1.0, 1.5])

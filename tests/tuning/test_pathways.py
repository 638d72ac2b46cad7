"""A recipe's parts at values of a fit's parameters: itself at its own, moved as asked, smooth in between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.cultivar import load_cultivar
from pepperscene.dataset import load_recipe
from pepperscene.dataset.recipe.resolved import load_camera
from pepperscene.materials import leaf_body, rind_reflectance
from pepperscene.render.gradients.pigment_models import CONTENTS, RANGES, path_values
from pepperscene.tuning.parameters.camera import OFF_DIAGONAL
from pepperscene.tuning.parameters.parameter import known_parameters, select_parameters
from pepperscene.tuning.parameters.surface import NAMES, REACH, state_law, surfaces_of
from pepperscene.tuning.parameters.tuned import dense, dense_path, tuned_parts

CULTIVARS = ("kaite", "red_blocky", "orange_pointed", "tomato", "kaite_september", "kaite_february")
NODES = np.linspace(400.0, 710.0, 8)
NM = np.arange(400.0, 761.0, 20.0)
STATES = np.linspace(0.0, 1.0, 41)

RECIPE = load_recipe("barth2018")
CAMERA = load_camera(RECIPE)


def everything(cultivar):
    names = known_parameters(cultivar, CAMERA)
    ends = [name for name in names if name.count(".") == 2]
    whole = select_parameters(RECIPE, cultivar, CAMERA, [name for name in names if name not in ends])
    found = {one.name: one for one in (*whole, *select_parameters(RECIPE, cultivar, CAMERA, ends))}
    return {name: found[name] for name in names}


KAITE = load_cultivar("kaite")
PARAMETERS = everything(KAITE)
OF_SURFACES = [name for name, one in PARAMETERS.items() if one.group in ("pigments", "cuticle")]
OWN = dense(KAITE, KAITE.pigments).pigments


def at(values, cultivar=KAITE):
    return tuned_parts(cultivar, CAMERA, values, NODES)


def path_of(name, value):
    """The path of a parameter's surface, at one value of it."""
    ((surface, path),) = at({name: np.array([value])}).pigments.items()
    assert surface == name.partition(".")[0]
    return path


def flat(made):
    """All numbers of a recipe's parts, by their names."""
    found = {
        "power": made.flash_power,
        "spectrum": made.flash_spectrum,
        "exposure": made.exposure,
        "gains": made.gains,
        "matrix": made.matrix,
    }
    for surface, path in made.pigments.items():
        found |= path_values(surface, path)
    return {name: np.asarray(value) for name, value in found.items()}


# --- at the recipe's own values -------------------------------------------------------------------------


@pytest.mark.parametrize("name", CULTIVARS)
def test_more_knots_say_nothing_else(name):
    cultivar = load_cultivar(name)
    for path in cultivar.pigments.values():
        more = dense_path(path)
        assert len(path.knots) <= len(more.knots) <= 24
        assert {state for state, _ in path.knots} <= {state for state, _ in more.knots}
        spectra = leaf_body if path.flesh_reflectance is None else rind_reflectance
        np.testing.assert_allclose(
            np.array(spectra(more, NM, STATES)), np.array(spectra(path, NM, STATES)), rtol=0, atol=1e-12
        )
        assert dense_path(more) == more


@pytest.mark.parametrize("name", CULTIVARS)
def test_at_its_own_values_a_recipe_is_itself(name):
    cultivar = load_cultivar(name)
    own = dense(cultivar, cultivar.pigments)
    every = everything(cultivar)
    # All that can stand beside each other at once, from the cultivar as it is and from the dense one.
    whole = {n: p.default for n, p in every.items() if not {"unripe", "ripe"} & set(n.split("."))}
    ends = {n: p.default for n, p in every.items() if n.rpartition(".")[2] not in NAMES or n not in whole}
    for values in (whole, ends):
        for start in (cultivar, own):
            made = tuned_parts(start, CAMERA, values, NODES)
            assert set(made.pigments) == set(surfaces_of(cultivar))
            for surface, path in made.pigments.items():
                expected = path_values(surface, own.pigments[surface])
                for what, found in path_values(surface, path).items():
                    np.testing.assert_allclose(found, expected[what], rtol=1e-12, atol=1e-15, err_msg=what)
                assert path.source == cultivar.pigments[surface].source
            np.testing.assert_array_equal(made.flash_spectrum, np.ones(8))
            assert made.flash_power == made.exposure == 1.0


def test_without_values_nothing_changes():
    made = at({})
    assert not made.pigments
    assert made.flash_power == made.exposure == 1.0
    np.testing.assert_array_equal(made.flash_spectrum, 1.0)


# --- each parameter moves what it says ------------------------------------------------------------------


def middle(name):
    """A value that differs from the recipe's own."""
    law, own = PARAMETERS[name].prior[0], PARAMETERS[name].default[0]
    above = own + 0.3 * (law.high - own)
    return above if above > own else own - 0.3 * (own - law.low)


@pytest.mark.parametrize("name", OF_SURFACES)
def test_a_value_is_read_back_and_nothing_else_moves(name):
    value, own = middle(name), OWN[name.partition(".")[0]]
    surface, _, what = name.rpartition(".")
    path = path_of(name, value)
    found, before = path_values("x", path), path_values("x", own)
    if what in NAMES:
        field = NAMES[what][0]
        contents = found.pop(f"x.{field}")
        place = {"unripe": contents[0], "ripe": contents[-1]}.get(surface.rpartition(".")[2], contents.max())
        assert place == pytest.approx(value, rel=1e-12)
        other = {"unripe": -1, "ripe": 0}.get(surface.rpartition(".")[2])
        if other is not None:
            assert contents[other] == pytest.approx(before[f"x.{field}"][other], rel=1e-12)
        del before[f"x.{field}"]
    elif what in ("state", "spread", "ripeness"):
        moved = [n for n in found if not np.allclose(found[n], before[n], rtol=1e-12, atol=0)]
        assert moved
        for n in moved:
            assert n.removeprefix("x.") in CONTENTS
            del found[n], before[n]
    else:
        key = f"x.{ {'flesh': 'flesh_reflectance'}.get(what, what) }"
        assert found[key].flat[0] == pytest.approx(value, rel=1e-12)
        if what == "roughness":
            ratio = own.roughness[1] / own.roughness[0]
            assert found[key][1] == pytest.approx(value * ratio)
        del found[key], before[key]
    for n, numbers in found.items():
        np.testing.assert_allclose(numbers, before[n], rtol=1e-12, atol=1e-15, err_msg=n)


def test_all_knots_scale_with_the_largest():
    path = path_of("fruit.chlorophyll", 2 * 15.7)
    np.testing.assert_allclose(
        path.at(STATES)["chlorophyll_ug_cm2"], 2 * OWN["fruit"].at(STATES)["chlorophyll_ug_cm2"], rtol=1e-12
    )
    # Of the structure what lies beyond one plate.
    path = path_of("leaf.structure", 2.5)
    np.testing.assert_allclose(
        path.at(STATES)["structure_n"] - 1.0, 1.5 * (OWN["leaf"].at(STATES)["structure_n"] - 1.0), rtol=1e-12
    )


def test_what_is_nowhere_is_added_evenly_and_the_red_of_fruit_as_it_ripens():
    assert np.ptp(path_of("leaf.anthocyanin", 3.0).at(STATES)["anthocyanin_ug_cm2"]) == pytest.approx(0.0)
    np.testing.assert_allclose(
        path_of("fruit.capsanthin", 20.0).at(STATES)["capsanthin_ug_cm2"], 20.0 * STATES, rtol=1e-12
    )
    assert np.ptp(path_of("leaf.capsanthin", 3.0).at(STATES)["capsanthin_ug_cm2"]) == pytest.approx(0.0)


@pytest.mark.parametrize("what", sorted(NAMES))
def test_both_ends_can_be_emptied_and_nothing_is_less_than_nothing(what):
    field, floor = NAMES[what][0], RANGES[NAMES[what][0]][0]
    for surface in surfaces_of(KAITE):
        names = [f"{surface}.{end}.{what}" for end in ("unripe", "ripe")]
        contents = at({name: [floor] for name in names}).pigments[surface].at(STATES)[field]
        assert contents[[0, -1]] == pytest.approx(floor, abs=1e-12)
        assert contents.min() >= floor


# --- organs along their path ----------------------------------------------------------------------------


def kink_error(path, field):
    """By how much a mean over `REACH` to either side can differ from the path: at its sharpest kink."""
    knots = np.array([state for state, _ in path.knots])
    slopes = np.diff(path.at(knots)[field]) / np.diff(knots)
    jumps = np.abs(np.diff(np.concatenate([[0.0], slopes, [0.0]])))
    return 0.5 * REACH * jumps.max() + 1e-12


@pytest.mark.parametrize("surface", ["leaf", "stem", "calyx"])
def test_organs_take_the_contents_of_the_states_that_they_are_moved_to(surface):
    law = state_law(KAITE, surface)
    moved, stretch = law.mean - 0.15, 1.4
    values = {f"{surface}.state": [moved], f"{surface}.spread": [stretch * law.sd]}
    path = at(values).pigments[surface]
    for field in CONTENTS:
        knots = np.array([state for state, _ in path.knots])
        expected = OWN[surface].at(np.clip(moved + stretch * (knots - law.mean), 0.0, 1.0))[field]
        error = np.abs(path.at(knots)[field] - expected).max()
        assert error <= kink_error(KAITE.pigments[surface], field), field


def test_fruit_that_ripens_less_has_the_contents_of_less_ripe_fruit():
    law = state_law(KAITE, "fruit")
    path = at({"fruit.ripeness": [0.7]}).pigments["fruit"]
    knots = np.array([state for state, _ in path.knots])
    for field in ("chlorophyll_ug_cm2", "brown", "carotenoid_ug_cm2"):
        expected = OWN["fruit"].at(knots * 0.7 / law.ripe)[field]
        error = np.abs(path.at(knots)[field] - expected).max()
        assert error <= kink_error(KAITE.pigments["fruit"], field)


def test_scaling_and_moving_commute():
    both = at({"leaf.chlorophyll": [31.0], "leaf.state": [0.5]}).pigments["leaf"]
    moved = at({"leaf.state": [0.5]}).pigments["leaf"]
    np.testing.assert_allclose(
        both.at(STATES)["chlorophyll_ug_cm2"], 0.5 * moved.at(STATES)["chlorophyll_ug_cm2"], rtol=1e-12
    )


def test_the_order_of_values_does_not_matter():
    values = {
        "fruit.ripeness": [0.8], "fruit.unripe.chlorophyll": [9.0], "fruit.ripe.chlorophyll": [2.0],
        "fruit.spread": [0.3], "fruit.brown": [0.5], "exposure": [1.2],
    }  # fmt: skip
    first, second = flat(at(values)), flat(at(dict(reversed(values.items()))))
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_anything_within_bounds_is_a_plant(seed):
    rng = np.random.default_rng(seed)
    names = rng.choice(OF_SURFACES, size=12, replace=False)
    values = {
        name: [rng.uniform(PARAMETERS[name].prior[0].low, PARAMETERS[name].prior[0].high)] for name in names
    }
    for surface, path in at(values).pigments.items():
        for name, numbers in path_values(surface, path).items():
            low, high = RANGES[name.rpartition(".")[2]]
            assert ((numbers >= low) & (numbers <= high)).all(), name


# --- smooth ---------------------------------------------------------------------------------------------


def slopes(name, entry, where, step):
    """Differences to either side, of all numbers in one row."""
    vectors = []
    for move in (0.0, step, -step):
        value = np.array(where)
        value[entry] += move
        vectors.append(np.concatenate([number.ravel() for number in flat(at({name: value})).values()]))
    here, above, below = vectors
    return (above - here) / step, (here - below) / step


SHAPES = [name for name in PARAMETERS if name.partition(".")[0] not in ("petiole", "peduncle", "calyx")]


@pytest.mark.parametrize("place", ["own", 0.21, 0.83])
@pytest.mark.parametrize("name", SHAPES)
def test_everything_is_smooth(name, place):
    """No kink anywhere: the slopes to either side come together as the step shrinks."""
    one = PARAMETERS[name]
    for entry, law in enumerate(one.prior):
        width = law.high - law.low
        where = one.default.copy()
        if place != "own":
            where[entry] = law.low + place * width
        # A derivative at a bound is one-sided, and there is nothing to compare.
        where[entry] = np.clip(where[entry], law.low + 1e-3 * width, law.high - 1e-3 * width)
        gaps = []
        for step in (1e-4 * width, 1e-5 * width):
            above, below = slopes(name, entry, where, step)
            gaps.append(np.abs(above - below).max() / np.abs(above).max())
        assert gaps[1] <= max(0.2 * gaps[0], 1e-6), gaps


# --- light and camera -----------------------------------------------------------------------------------


def test_the_flash_gets_factors():
    made = at({"flash.power": [1.3], "flash.colour": [0.5, -0.2], "flash.spectrum": np.linspace(0.5, 1.5, 8)})
    off = (NODES - 550.0) / 150.0
    expected = np.linspace(0.5, 1.5, 8) * np.exp(0.5 * off - 0.2 * np.exp(-((3.0 * off) ** 2)))
    assert made.flash_power == 1.3
    np.testing.assert_allclose(made.flash_spectrum, expected, rtol=1e-12)
    np.testing.assert_array_equal(made.flash_nodes_nm, NODES)


def test_factors_must_fit_the_nodes():
    with pytest.raises(ValueError, match="5 factors and the renderer 8 nodes"):
        at({"flash.spectrum": np.ones(5)})
    assert tuned_parts(KAITE, CAMERA, {"flash.spectrum": np.ones(5)}).flash_spectrum.size == 0


def test_gains_and_matrix():
    own = at({})
    made = at({"white_balance": [1.2, 0.8], "exposure": [0.7]})
    np.testing.assert_allclose(made.gains, own.gains * [1.2, 1.0, 0.8])
    np.testing.assert_array_equal(made.matrix, own.matrix)
    assert made.exposure == 0.7
    asked = np.array([0.1, -0.2, 0.05, -0.3, 0.0, 0.4])
    matrix = at({"colour_matrix": asked}).matrix
    np.testing.assert_allclose([matrix[place] for place in OFF_DIAGONAL], asked)
    np.testing.assert_allclose(matrix.sum(axis=1), own.matrix.sum(axis=1))


def test_an_explicit_matrix_keeps_its_own_row_sums():
    rows = ((1.5, -0.3, 0.0), (-0.2, 1.4, -0.3), (0.1, -0.5, 1.3))
    steps = replace(CAMERA.developing, white_balance=(2.0, 1.0, 1.5), colour_matrix=rows)
    made = tuned_parts(KAITE, replace(CAMERA, developing=steps), {"colour_matrix": np.zeros(6)}, NODES)
    np.testing.assert_allclose(made.matrix, np.diag(np.sum(rows, axis=1)), atol=1e-12)
    np.testing.assert_array_equal(made.gains, [2.0, 1.0, 1.5])

"""Parameters of a recipe: names, default values, states of organs, and prior distributions."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_fits import all_parameters

from pepperscene.cultivar import load_cultivar
from pepperscene.errors import ArgumentError, InputError
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.render.gradients.tunable import RANGES
from pepperscene.shipped import shipped_folder
from pepperscene.tuning.parameters import known_parameters, select_parameters
from pepperscene.tuning.pigment_paths import CONTENT_FIELDS, state_distribution, visible_surfaces

RECIPE = load_recipe("barth2018")
CAMERA = load_camera(RECIPE)
KAITE = load_cultivar("kaite")
NO_FLASH = replace(CAMERA, flash=None, developing=replace(CAMERA.developing, white_balance="daylight"))

BERRY = """
extends = "tomato"
name = "Berry"

[organs.fruit]
surface = "berry"

[organs.leaflet]
surface = "frond"

[pigments.berry]
chosen = "for a test"
flesh_reflectance = 0.5
ior = 1.4
roughness = [0.2, 0.2]
start = { structure_n = 1, chlorophyll_ug_cm2 = 8, carotenoid_ug_cm2 = 2, water_cm = 0, dry_matter_g_cm2 = 0 }
end = { structure_n = 1, chlorophyll_ug_cm2 = 0, carotenoid_ug_cm2 = 4, water_cm = 0, dry_matter_g_cm2 = 0 }

[pigments.frond]
chosen = "for a test"
ior = 1.4
roughness = [0.4, 0.8]
start = { structure_n = 2, chlorophyll_ug_cm2 = 9, carotenoid_ug_cm2 = 5, water_cm = 0, dry_matter_g_cm2 = 0 }
end = { structure_n = 2, chlorophyll_ug_cm2 = 140, carotenoid_ug_cm2 = 9, water_cm = 0, dry_matter_g_cm2 = 0 }
"""


def select(names, cultivar=KAITE, camera=CAMERA):
    return select_parameters(RECIPE, cultivar, camera, names)


def test_every_visible_surface_has_every_content():
    known = known_parameters(KAITE, CAMERA)
    assert len(set(known)) == len(known)
    for surface in ("leaf", "petiole", "stem", "fruit", "peduncle", "calyx"):
        for content in CONTENT_FIELDS:
            names = {f"{surface}.{content}", f"{surface}.unripe.{content}", f"{surface}.ripe.{content}"}
            assert names <= {*known}
        assert {f"{surface}.ior", f"{surface}.roughness", f"{surface}.spread"} <= {*known}
    assert {"fruit.ripeness", "leaf.state", "fruit.flesh"} <= {*known}
    # A leaf has no flesh, fruit has stages instead of states, and a plant of April has no flowers.
    assert not {"leaf.flesh", "fruit.state"} & {*known}
    assert not any(name.startswith(("petal.", "cut.")) for name in known)
    assert known[-6:] == (
        "flash.power", "flash.colour", "flash.spectrum", "exposure", "white_balance", "colour_matrix"
    )  # fmt: skip


def test_surfaces_may_have_other_names(tmp_path):
    (tmp_path / "berry.toml").write_text(BERRY, encoding="utf-8")
    berry = load_cultivar(tmp_path / "berry.toml")
    known = known_parameters(berry, CAMERA)
    assert {"berry.ripeness", "berry.flesh", "frond.state", "frond.ripe.chlorophyll"} <= {*known}
    assert not any(name.startswith("fruit.") for name in known)
    parameters = {one.name: one for one in select([name for name in known if name.count(".") < 2], berry)}
    assert parameters["berry.ripeness"].default == pytest.approx(0.96)
    assert parameters["frond.chlorophyll"].default == 140.0
    # The back of a frond is twice as rough as its front.
    assert parameters["frond.roughness"].prior[0].high <= 0.5


def test_defaults_are_the_values_of_the_recipe():
    contents = select(["leaf.chlorophyll", "fruit.unripe.brown", "fruit.ripe.brown"])
    assert [float(one.default[0]) for one in contents] == [56.0, 0.05, 0.02]
    (structure, colour, matrix) = select(["stem.structure", "flash.colour", "colour_matrix"])
    assert structure.default == 2.5
    assert colour.labels == ("warmth", "green")
    assert len(matrix.labels) == len(matrix.default) == len(matrix.prior) == 6


def test_parameters_have_groups_and_the_order_of_their_names():
    names = ["leaf.ior", "exposure", "flash.power", "white_balance", "leaf.state"]
    parameters = select(names)
    assert [one.name for one in parameters] == names
    assert [one.group for one in parameters] == ["cuticle", "exposure", "light", "camera", "pigments"]
    assert [one.name for one in select(["fruit.state"])] == ["fruit.ripeness"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ([], "needs at least one of"),
        (["leaf.chlorophil"], "no parameter 'leaf.chlorophil'; closest are leaf.chlorophyll"),
        (["leaf"], "no parameter 'leaf'"),
        ([""], "no parameter ''"),
        (["nothing"], "no parameter 'nothing'"),
        (["exposur"], "closest are exposure"),
        (["leaf.flesh"], "no parameter 'leaf.flesh'"),
        (["petal.brown"], "petal.brown cannot be fitted, because plants of Kaite show no petal"),
        (["leaf.brown", "leaf.brown"], "leaf.brown is given twice"),
        (["fruit.state", "fruit.ripeness"], "fruit.ripeness is given twice"),
        (["fruit.brown", "fruit.ripe.brown"], "fruit.brown scales the whole path"),
        (["fruit.ripe.brown", "fruit.brown"], "cannot be fitted together with fruit.ripe.brown"),
    ],
)
def test_raises_on_names_that_cannot_be_fitted(names, message):
    with pytest.raises(ArgumentError) as error:
        select(names)
    assert message in str(error.value)
    assert str(error.value).startswith("names: ")
    assert "\n" not in str(error.value)
    if names == ["nothing"]:
        words = {word for name in known_parameters(KAITE, CAMERA) for word in name.split(".")}
        assert all(word in str(error.value) for word in words)


def test_flash_cannot_be_fitted_without_one():
    assert not any(name.startswith("flash") for name in known_parameters(KAITE, NO_FLASH))
    with pytest.raises(ArgumentError, match=r"flash\.power cannot be fitted, because barth2018 has no flash"):
        select(["flash.power"], camera=NO_FLASH)


def test_colours_cannot_be_fitted_for_a_monochrome_sensor():
    curves = CAMERA.sensor.quantum_efficiency
    curve = replace(curves, values=curves.values[:1])
    mono = replace(CAMERA, sensor=replace(CAMERA.sensor, quantum_efficiency=curve, pattern="mono"))
    assert known_parameters(KAITE, mono)[-1] == "exposure"
    with pytest.raises(ArgumentError, match="white_balance cannot be fitted"):
        select(["white_balance"], camera=mono)


@pytest.mark.parametrize("name", ["kaite", "tomato"])
def test_state_distribution_is_that_of_organs_with_equal_weights_of_kinds(name):
    cultivar = load_cultivar(name)
    rng = np.random.default_rng(5)
    for surface in visible_surfaces(cultivar):
        samples = []
        for kind in cultivar.present_kinds:
            organ = cultivar.organs.get(kind)
            if kind == "calyx" and surface == "calyx":
                samples.append(cultivar.organs["fruit"].calyx_state.quantiles(rng.random(4000)))
            elif organ is not None and organ.kind.surface == surface and organ.form != "fruit":
                samples.append(organ.state.quantiles(rng.random(4000), rng.random(4000)))
        if samples:
            distribution, states = state_distribution(cultivar, surface), np.concatenate(samples)
            assert distribution.mean == pytest.approx(states.mean(), abs=0.01)
            assert distribution.sd == pytest.approx(states.std(), abs=0.01)
            assert distribution.mean_ripeness is None


def test_state_distribution_of_fruit_is_the_mixture_of_its_stages():
    fruit, rng = KAITE.organs["fruit"], np.random.default_rng(6)
    quantile = rng.random(20_000)
    ripe, turning = fruit.ripe_fraction.mean, fruit.breaker_fraction.mean
    stages = [stage.draw(rng, quantile.size) for stage in (fruit.ripe, fruit.breaker, fruit.unripe)]
    states = np.select([quantile < ripe - turning / 2, quantile < ripe + turning / 2], stages[:2], stages[2])
    distribution = state_distribution(KAITE, "fruit")
    assert distribution.mean == pytest.approx(states.mean(), abs=0.01)
    assert distribution.sd == pytest.approx(states.std(), abs=0.01)
    assert distribution.mean_ripeness == pytest.approx(0.96)
    # A surface that no organ has has none.
    assert state_distribution(KAITE, "petal") is None
    assert "petal" not in visible_surfaces(KAITE)


# --- prior distributions: the shipped bounds, a user's bounds, and errors in them ---------------------------


SHIPPED = tomllib.loads((shipped_folder("materials") / "tuning" / "bounds.toml").read_text(encoding="utf-8"))
DOCS = Path(__file__).resolve().parents[2] / "docs" / "reference" / "tuning_parameters.md"


def prior_of(name, bounds=None, cultivar=KAITE, entry=0):
    (parameter,) = select_parameters(RECIPE, cultivar, CAMERA, [name], bounds)
    return parameter.prior[entry]


def table(mean, sd, low, high, **more):
    return {"mean": mean, "sd": sd, "low": low, "high": high, "chosen": "for a test", **more}


CROPS = (
    "kaite", "red_blocky", "orange_pointed", "tomato", "cucumber", "eggplant", "kaite_september",
    "kaite_february",
)  # fmt: skip


@pytest.mark.parametrize("name", CROPS)
def test_shipped_bounds_include_the_values_of_cultivars(name):
    for parameter in all_parameters(RECIPE, load_cultivar(name), CAMERA).values():
        assert len(parameter.prior) == len(parameter.default) == len(parameter.labels)
        field = CONTENT_FIELDS.get(parameter.name.rpartition(".")[2], ("",))[0]
        low, high = RANGES.get(field, (-np.inf, np.inf))
        for value, prior in zip(parameter.default, parameter.prior, strict=True):
            assert prior.low <= value <= prior.high, parameter.name
            assert prior.low < prior.mean < prior.high, parameter.name
            assert prior.sd > 0
            assert prior.source or prior.chosen
            assert low <= prior.low
            assert prior.high <= high


def test_shipped_distributions_have_the_stated_moments():
    parameters = all_parameters(RECIPE, KAITE, CAMERA).values()
    for prior in (prior for parameter in parameters for prior in parameter.prior):
        values = prior.quantiles((np.arange(2000) + 0.5) / 2000)
        assert values.mean() == pytest.approx(prior.mean, abs=0.01 * prior.sd + 1e-9)
        assert values.std() == pytest.approx(prior.sd, rel=0.01)


def test_shipped_bounds_are_widened_to_the_cultivar():
    leaf = KAITE.pigments["leaf"]
    dark = leaf.model_copy(update={"end": leaf.end.model_copy(update={"chlorophyll_ug_cm2": 140.0})})
    cultivar = KAITE.model_copy(update={"pigments": {**KAITE.pigments, "leaf": dark}})
    prior = prior_of("leaf.chlorophyll", cultivar=cultivar)
    assert (prior.mean, prior.high) == (58.0, 140.0)


def test_user_bounds_override_shipped_ones(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('leaf.chlorophyll = { mean = 50, sd = 5, low = 30, high = 70, source = "mine" }', "utf-8")
    for bounds in (path, str(path), tomllib.loads(path.read_text("utf-8"))):
        prior = prior_of("leaf.chlorophyll", bounds)
        assert (prior.mean, prior.sd, prior.low, prior.high, prior.source) == (50, 5, 30, 70, "mine")
    assert prior_of("leaf.carotenoid", path) == prior_of("leaf.carotenoid")


def test_keys_may_be_quoted_or_nested():
    quoted = {"flash.colour.green": table(0, 0.2, -0.5, 0.5)}
    nested = {"flash": {"colour": {"green": table(0, 0.2, -0.5, 0.5)}}}
    for bounds in (quoted, nested):
        assert prior_of("flash.colour", bounds, entry=1).sd == 0.2
        assert prior_of("flash.colour", bounds, entry=0) == prior_of("flash.colour")


def test_most_specific_key_has_precedence():
    bounds = {
        "*.chlorophyll": table(1, 0.1, 0.5, 2, relative="times"),
        "*.ripe.chlorophyll": table(1, 0.2, 0.5, 2, relative="times"),
        "leaf.ripe.chlorophyll": table(1, 0.3, 0.5, 2, relative="times"),
    }
    assert prior_of("leaf.chlorophyll", bounds).sd == pytest.approx(5.6)  # not the shipped bounds of leaves
    assert prior_of("stem.unripe.chlorophyll", bounds).sd == pytest.approx(0.11)
    assert prior_of("stem.ripe.chlorophyll", bounds).sd == pytest.approx(5.0)
    assert prior_of("leaf.ripe.chlorophyll", bounds).sd == pytest.approx(16.8)


def test_relative_bounds_scale_with_or_add_to_the_recipes_value():
    times = prior_of("stem.structure", {"stem.structure": table(1.2, 0.2, 0.5, 2, relative="times")})
    assert (times.mean, times.sd, times.low, times.high) == pytest.approx((2.8, 0.3, 1.75, 4.0))
    plus = prior_of("leaf.ior", {"*.ior": table(0.05, 0.02, -0.1, 0.2, relative="plus")})
    assert (plus.mean, plus.sd, plus.low, plus.high) == pytest.approx((1.5, 0.02, 1.35, 1.65))
    # They are clipped to what is possible: no cuticle has an index below 1.
    assert prior_of("leaf.ior", {"*.ior": table(0.05, 0.1, -0.5, 0.6, relative="plus")}).low == 1.0


def test_absent_contents_have_their_own_bounds():
    bounds = {"*.added.capsanthin": table(2, 1, 0, 9), "*.brown": table(1, 0.1, 0.5, 2, relative="times")}
    assert prior_of("leaf.capsanthin", bounds).high == 9
    assert prior_of("leaf.ripe.capsanthin", bounds).high == 9
    with pytest.raises(InputError, match=r"bounds: \*\.brown: cannot be relative: .* leaf\.brown"):
        prior_of("leaf.brown", bounds)


BROWN = "leaf.brown"


@pytest.mark.parametrize(
    ("name", "bounds", "message"),
    [
        ("leaf.chlorophil", table(50, 5, 30, 70), "leaf.chlorophil: is not the name .* leaf.chlorophyll"),
        ("petal.brown", table(50, 5, 30, 70), "petal.brown: is not the name"),
        ("*.leaf", table(50, 5, 30, 70), "is not the name"),
        ("flash.colour.blue", table(0, 1, -2, 2), "flash.colour.blue: is not the name"),
        (BROWN, 3, "leaf.brown = 3: must be a table such as"),
        ("leaf", 3, "leaf = 3: must be a table such as"),
        (BROWN, {}, "leaf.brown: must be a table such as"),
        (BROWN, table(0.1, 0.05, 0, 1) | {"mode": 2}, "leaf.brown.mode: is not one of mean, sd"),
        (BROWN, table(0.1, 0.05, 0, 1, relative="half"), 'relative = .*must be "times" or "plus"'),
        (BROWN, table(0.1, 0.05, 0, 1, relative=["plus"]), 'must be "times" or "plus"'),
        (BROWN, {"mean": 0.1, "sd": 0.05}, "leaf.brown: needs a source, or chosen with the reason"),
        (BROWN, table("a", 0.05, 0, 1), "mean must be a finite number"),
        (BROWN, table(float("nan"), 0.05, 0, 1), "mean must be a finite number"),
        (BROWN, table(0.1, 0, 0, 1), "sd must be greater than 0"),
        (BROWN, table(0.1, 0.05, 1, 0), "mean must be between low and high"),
        (BROWN, table(0.1, 5, 0, 1), "leaf.brown: "),
        (BROWN, {"sd": 0.1, "chosen": "x"}, "must have value, or mean and sd"),
        ("leaf.chlorophyll", table(45, 2, 40, 50), "value of leaf.chlorophyll, 56, but is 40 to 50"),
        (BROWN, table(0.1, 0.05, -0.2, 1), "must be within 0 to inf, but is -0.2 to 1"),
        ("leaf.structure", table(2, 0.3, 1, 6), "must be within 1 to 4"),
        ("leaf.state", table(0.7, 0.1, 0.2, 1.2), "must be within 0 to 1"),
        ("leaf.roughness", table(0.5, 0.1, 0.2, 1), "must be within .* but is 0.2 to 1"),
    ],
)
def test_raises_on_invalid_bounds(name, bounds, message):
    names = ["leaf.brown", "leaf.chlorophyll", "leaf.structure", "leaf.state", "leaf.roughness"]
    with pytest.raises(InputError) as error:
        select_parameters(RECIPE, KAITE, CAMERA, names, {name: bounds})
    assert re.search(message, str(error.value)), error.value
    assert str(error.value).startswith("bounds: ")
    assert "\n" not in str(error.value)


def test_raises_on_invalid_files(tmp_path):
    path = tmp_path / "bounds.toml"
    path.write_text("x = ", "utf-8")
    with pytest.raises(InputError, match=r"bounds\.toml.*not valid TOML"):
        prior_of("leaf.brown", path)
    with pytest.raises(InputError, match=r"nowhere\.toml.*cannot be read"):
        prior_of("leaf.brown", tmp_path / "nowhere.toml")


def documented():
    """Name -> cells of the documentation's tables."""
    lines = [line for line in DOCS.read_text("utf-8").splitlines() if line.startswith("| `")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {name.strip("`"): rest for name, *rest in cells}


def test_documentation_lists_every_name():
    listed = documented()
    for crop in ("kaite", "tomato"):
        for name in known_parameters(load_cultivar(crop), CAMERA):
            surface, _, key = name.rpartition(".")
            general = name if surface in ("", "flash") else f"<surface>.{key}"
            assert general in listed, name


def test_documentation_states_the_shipped_bounds():
    listed, factors = documented(), {"times": "× ", "plus": "+ "}
    for key, one in SHIPPED.items():
        factor = factors.get(one.get("relative"), "")
        numbers = f"{factor}{one['mean']:g} ± {one['sd']:g}, {one['low']:g} to {one['high']:g}"
        assert listed[key.replace("*", "<surface>")][-1] == numbers.replace("-", "−"), key


def test_example_of_the_documentation_is_a_bounds_file(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", DOCS.read_text("utf-8"), re.DOTALL)
    path = tmp_path / "bounds.toml"
    path.write_text(text, "utf-8")
    assert prior_of("leaf.chlorophyll", path).sd == 8
    assert prior_of("stem.brown", path).sd == pytest.approx(0.36)
    prior = prior_of("flash.colour", path, entry=1)
    assert (prior.family, prior.mean) == ("uniform", pytest.approx(0.5 * (prior.low + prior.high)))
    assert prior.sd == pytest.approx((prior.high - prior.low) / np.sqrt(12.0))
    assert prior_of("colour_matrix", path, entry=1).sd == 0.05
    assert prior_of("colour_matrix", path, entry=0) == prior_of("colour_matrix")

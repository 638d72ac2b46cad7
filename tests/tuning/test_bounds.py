"""How far parameters may go: the shipped laws, a user's over them, and every way to get one wrong."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from pepperscene.cultivar import load_cultivar
from pepperscene.dataset import load_recipe
from pepperscene.dataset.recipe.resolved import load_camera
from pepperscene.errors import InputError
from pepperscene.render.gradients.pigment_models import RANGES
from pepperscene.shipped import shipped_folder
from pepperscene.tuning.parameters.parameter import known_parameters, select_parameters
from pepperscene.tuning.parameters.surface import NAMES

RECIPE = load_recipe("barth2018")
CAMERA = load_camera(RECIPE)
KAITE = load_cultivar("kaite")
SHIPPED = tomllib.loads((shipped_folder("materials") / "tuning" / "bounds.toml").read_text(encoding="utf-8"))
DOCS = Path(__file__).resolve().parents[2] / "docs" / "reference" / "tuning_parameters.md"


def prior(name, bounds=None, cultivar=KAITE, entry=0):
    (one,) = select_parameters(RECIPE, cultivar, CAMERA, [name], bounds)
    return one.prior[entry]


def everything(cultivar):
    """Of all that can be fitted; a content cannot stand beside that of an end."""
    names = known_parameters(cultivar, CAMERA)
    ends = [name for name in names if name.count(".") == 2]
    return [
        *select_parameters(RECIPE, cultivar, CAMERA, [name for name in names if name not in ends]),
        *select_parameters(RECIPE, cultivar, CAMERA, ends),
    ]


def law(mean, sd, low, high, **more):
    return {"mean": mean, "sd": sd, "low": low, "high": high, "chosen": "for a test", **more}


# --- shipped --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["kaite", "red_blocky", "orange_pointed", "tomato", "kaite_september", "kaite_february"]
)
def test_everything_that_can_be_fitted_has_a_law_that_holds_the_recipes_own(name):
    for one in everything(load_cultivar(name)):
        known = one.name
        assert len(one.prior) == len(one.default) == len(one.labels)
        for value, own in zip(one.default, one.prior, strict=True):
            assert own.low <= value <= own.high, known
            assert own.low < own.mean < own.high, known
            assert own.sd > 0
            assert own.source or own.chosen
            field = NAMES.get(known.rpartition(".")[2], ("",))[0]
            low, high = RANGES.get(field, (-np.inf, np.inf))
            assert low <= own.low
            assert own.high <= high


def test_shipped_laws_have_the_moments_that_they_state():
    for own in (law for one in everything(KAITE) for law in one.prior):
        drawn = own.quantiles((np.arange(2000) + 0.5) / 2000)
        assert drawn.mean() == pytest.approx(own.mean, abs=0.01 * own.sd + 1e-9)
        assert drawn.std() == pytest.approx(own.sd, rel=0.01)


def test_leaves_hold_as_much_as_was_measured():
    own = prior("leaf.chlorophyll")
    assert "Padilla" in own.source
    assert (own.mean, own.low, own.high) == (58, 15, 100)


def test_shipped_laws_make_room_for_another_crop():
    leaf = KAITE.pigments["leaf"]
    dark = leaf.model_copy(update={"end": leaf.end.model_copy(update={"chlorophyll_ug_cm2": 140.0})})
    cultivar = KAITE.model_copy(update={"pigments": {**KAITE.pigments, "leaf": dark}})
    own = prior("leaf.chlorophyll", cultivar=cultivar)
    assert own.high == 140.0
    assert own.mean == 58.0


# --- a user's -------------------------------------------------------------------------------------------


def test_a_users_law_goes_before_the_shipped_one(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('leaf.chlorophyll = { mean = 50, sd = 5, low = 30, high = 70, source = "mine" }', "utf-8")
    for bounds in (path, str(path), tomllib.loads(path.read_text("utf-8"))):
        own = prior("leaf.chlorophyll", bounds)
        assert (own.mean, own.sd, own.low, own.high, own.source) == (50, 5, 30, 70, "mine")
    assert prior("leaf.carotenoid", path) == prior("leaf.carotenoid")


def test_quotes_are_a_matter_of_taste():
    quoted = {"flash.colour.green": law(0, 0.2, -0.5, 0.5)}
    nested = {"flash": {"colour": {"green": law(0, 0.2, -0.5, 0.5)}}}
    for bounds in (quoted, nested):
        assert prior("flash.colour", bounds, entry=1).sd == 0.2
        assert prior("flash.colour", bounds, entry=0) == prior("flash.colour")


def test_the_nearest_key_holds():
    bounds = {
        "*.chlorophyll": law(1, 0.1, 0.5, 2, relative="times"),
        "*.ripe.chlorophyll": law(1, 0.2, 0.5, 2, relative="times"),
        "leaf.ripe.chlorophyll": law(1, 0.3, 0.5, 2, relative="times"),
    }
    assert prior("leaf.chlorophyll", bounds).sd == pytest.approx(6.2)  # before what is shipped of leaves
    assert prior("stem.unripe.chlorophyll", bounds).sd == pytest.approx(0.14)
    assert prior("stem.ripe.chlorophyll", bounds).sd == pytest.approx(3.6)
    assert prior("leaf.ripe.chlorophyll", bounds).sd == pytest.approx(18.6)


def test_relative_laws():
    times = prior("stem.structure", {"stem.structure": law(1.2, 0.2, 0.5, 2, relative="times")})
    assert (times.mean, times.sd, times.low, times.high) == pytest.approx((2.8, 0.3, 1.75, 4.0))
    plus = prior("leaf.ior", {"*.ior": law(0.05, 0.02, -0.1, 0.2, relative="plus")})
    assert (plus.mean, plus.sd, plus.low, plus.high) == pytest.approx((1.33, 0.02, 1.18, 1.48))
    # They keep to what is possible: no cuticle has an index below 1.
    assert prior("leaf.ior", {"*.ior": law(0.05, 0.1, -0.5, 0.6, relative="plus")}).low == 1.0


def test_what_is_not_there_gets_its_own_law():
    bounds = {"*.added.anthocyanin": law(2, 1, 0, 9), "*.brown": law(1, 0.1, 0.5, 2, relative="times")}
    assert prior("leaf.anthocyanin", bounds).high == 9
    assert prior("leaf.ripe.anthocyanin", bounds).high == 9
    with pytest.raises(InputError, match=r"bounds: \*\.brown: cannot be relative: .* leaf\.brown"):
        prior("leaf.brown", bounds)


def test_even_laws_are_laws():
    own = prior("exposure", {"exposure": {"uniform": [0.5, 1.5], "chosen": "for a test"}})
    assert (own.law, own.mean, own.low, own.high) == ("uniform", 1.0, 0.5, 1.5)
    assert own.sd == pytest.approx(1.0 / np.sqrt(12.0))


@pytest.mark.parametrize(
    ("bounds", "said"),
    [
        ({"leaf.chlorophil": law(50, 5, 30, 70)}, "leaf.chlorophil: is not the name .* leaf.chlorophyll"),
        ({"petal.brown": law(50, 5, 30, 70)}, "petal.brown: is not the name"),
        ({"*.leaf": law(50, 5, 30, 70)}, "is not the name"),
        ({"flash.colour.blue": law(0, 1, -2, 2)}, "flash.colour.blue: is not the name"),
        ({"leaf.brown": 3}, "leaf.brown = 3: must be a table such as"),
        ({"leaf": 3}, "leaf = 3: must be a table such as"),
        ({"leaf.brown": {}}, "leaf.brown: must be a table such as"),
        ({"leaf.brown": law(0.1, 0.05, 0, 1) | {"mode": 2}}, "leaf.brown.mode: is not one of mean, sd"),
        ({"leaf.brown": law(0.1, 0.05, 0, 1, relative="half")}, 'relative = .*must be "times" or "plus"'),
        ({"leaf.brown": law(0.1, 0.05, 0, 1, relative=2)}, 'must be "times" or "plus"'),
        ({"leaf.brown": law(0.1, 0.05, 0, 1, relative=["plus"])}, 'must be "times" or "plus"'),
        ({"leaf.brown": {"mean": 0.1, "sd": 0.05}}, "leaf.brown: needs a source, or chosen with the reason"),
        ({"leaf.brown": law("a", 0.05, 0, 1)}, "mean must be a finite number"),
        ({"leaf.brown": law(float("nan"), 0.05, 0, 1)}, "mean must be a finite number"),
        ({"leaf.brown": law(0.1, 0, 0, 1)}, "sd must be greater than 0"),
        ({"leaf.brown": law(0.1, 0.05, 1, 0)}, "mean must be between low and high"),
        ({"leaf.brown": law(0.1, 5, 0, 1)}, "leaf.brown: "),
        ({"leaf.brown": {"sd": 0.1, "chosen": "x"}}, "must have value, or mean and sd"),
        ({"leaf.chlorophyll": law(50, 5, 40, 60)}, "must hold what the recipe has of leaf.chlorophyll, 62"),
        ({"leaf.brown": law(0.1, 0.05, -0.2, 1)}, "must lie within 0 to inf and goes from -0.2 to 1"),
        ({"leaf.structure": law(2, 0.3, 1, 6)}, "must lie within 1 to 4"),
        ({"leaf.state": law(0.7, 0.1, 0.2, 1.2)}, "must lie within 0 to 1"),
        ({"leaf.roughness": law(0.5, 0.1, 0.2, 1)}, "must lie within .* and goes from 0.2 to 1"),
    ],
)
def test_bounds_that_are_wrong(bounds, said):
    names = ["leaf.brown", "leaf.chlorophyll", "leaf.structure", "leaf.state", "leaf.roughness"]
    with pytest.raises(InputError) as fault:
        select_parameters(RECIPE, KAITE, CAMERA, names, bounds)
    assert re.search(said, str(fault.value)), fault.value
    assert str(fault.value).startswith("bounds: ")
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("text", ["not toml", "x = ", "\x00"])
def test_files_that_are_wrong(tmp_path, text):
    path = tmp_path / "bounds.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(InputError, match=r"bounds\.toml.*not valid TOML"):
        prior("leaf.brown", path)
    with pytest.raises(InputError, match=r"nowhere\.toml.*cannot be read"):
        prior("leaf.brown", tmp_path / "nowhere.toml")


# --- documentation --------------------------------------------------------------------------------------


def rows():
    """Name -> cells of the documentation's tables."""
    lines = [line for line in DOCS.read_text("utf-8").splitlines() if line.startswith("| `")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {name.strip("`"): rest for name, *rest in cells}


def test_the_documentation_lists_every_name():
    listed = rows()
    for crop in ("kaite", "tomato"):
        for name in known_parameters(load_cultivar(crop), CAMERA):
            surface, _, what = name.rpartition(".")
            general = name if surface in ("", "flash") else f"<surface>.{what}"
            assert general in listed, name


def test_the_documentation_has_the_shipped_bounds():
    listed, factors = rows(), {"times": "× ", "plus": "+ "}
    for key, table in SHIPPED.items():
        said = factors.get(table.get("relative"), "")
        numbers = f"{said}{table['mean']:g} ± {table['sd']:g}, {table['low']:g} to {table['high']:g}"
        assert listed[key.replace("*", "<surface>")][-1] == numbers.replace("-", "−"), key


def test_the_example_of_the_documentation_is_a_bounds_file(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", DOCS.read_text("utf-8"), re.DOTALL)
    path = tmp_path / "bounds.toml"
    path.write_text(text, "utf-8")
    assert prior("leaf.chlorophyll", path).sd == 8
    assert prior("stem.brown", path).sd == pytest.approx(0.22)
    assert prior("flash.colour", path, entry=1).law == "uniform"
    assert prior("colour_matrix", path, entry=1).sd == 0.05
    assert prior("colour_matrix", path, entry=0) == prior("colour_matrix")

"""What can be fitted of a recipe: names, own values, and the laws of organs' states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.cultivar import load_cultivar
from pepperscene.dataset import load_recipe
from pepperscene.dataset.recipe.resolved import load_camera
from pepperscene.errors import InputError
from pepperscene.tuning.parameters.parameter import known_parameters, select_parameters
from pepperscene.tuning.parameters.surface import NAMES, state_law, surfaces_of

RECIPE = load_recipe("barth2018")
CAMERA = load_camera(RECIPE)
KAITE = load_cultivar("kaite")
DARK = replace(CAMERA, flash=None, developing=replace(CAMERA.developing, white_balance="daylight"))

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


@pytest.fixture(scope="module")
def berry(tmp_path_factory):
    """A crop whose leaves and fruit have surfaces of other names."""
    path = tmp_path_factory.mktemp("crop") / "berry.toml"
    path.write_text(BERRY, encoding="utf-8")
    return load_cultivar(path)


def of(names, cultivar=KAITE, camera=CAMERA, bounds=None):
    return select_parameters(RECIPE, cultivar, camera, names, bounds)


# --- names ----------------------------------------------------------------------------------------------


def test_every_surface_that_plants_show_has_every_content():
    known = known_parameters(KAITE, CAMERA)
    assert len(set(known)) == len(known)
    for surface in ("leaf", "petiole", "stem", "fruit", "peduncle", "calyx"):
        for what in NAMES:
            assert {f"{surface}.{what}", f"{surface}.unripe.{what}", f"{surface}.ripe.{what}"} <= {*known}
        assert {f"{surface}.ior", f"{surface}.roughness", f"{surface}.spread"} <= {*known}
    assert {"fruit.ripeness", "leaf.state", "fruit.flesh"} <= {*known}
    # A leaf is no body with flesh, fruit has stages, and a plant of April has no flowers.
    assert not {"leaf.flesh", "fruit.state"} & {*known}
    assert not any(name.startswith(("petal.", "cut.")) for name in known)
    assert known[-6:] == (
        "flash.power", "flash.colour", "flash.spectrum", "exposure", "white_balance", "colour_matrix"
    )  # fmt: skip


def test_a_crop_with_other_surfaces(berry):
    known = known_parameters(berry, CAMERA)
    assert {"berry.ripeness", "berry.flesh", "frond.state", "frond.ripe.chlorophyll"} <= {*known}
    assert not any(name.startswith("fruit.") for name in known)
    whole = [name for name in known if name.count(".") < 2]
    every = {one.name: one for one in of(whole, berry)}
    assert every["berry.ripeness"].default == pytest.approx(0.96)
    assert every["frond.chlorophyll"].default == 140.0
    # The back of a frond is twice as rough as its front.
    assert every["frond.roughness"].prior[0].high <= 0.5


def test_defaults_are_what_the_recipe_has():
    found = {one.name: one for one in of(["leaf.chlorophyll", "fruit.unripe.brown", "fruit.ripe.brown"])}
    assert {name: float(one.default[0]) for name, one in found.items()} == {
        "leaf.chlorophyll": 62.0,
        "fruit.unripe.brown": 0.36,
        "fruit.ripe.brown": 0.02,
    }
    (structure, colour, matrix) = of(["stem.structure", "flash.colour", "colour_matrix"])
    assert structure.default == 2.5
    assert colour.labels == ("warmth", "green")
    assert len(matrix.labels) == len(matrix.default) == len(matrix.prior) == 6
    found = of(["leaf.ior", "exposure", "flash.power", "white_balance", "leaf.state"])
    assert [one.group for one in found] == ["cuticle", "exposure", "light", "camera", "pigments"]


def test_parameters_come_in_the_order_of_their_names():
    names = ["exposure", "fruit.ripeness", "leaf.brown", "flash.colour"]
    assert [one.name for one in of(names)] == names


def test_fruit_calls_its_state_ripeness():
    (one,) = of(["fruit.state"])
    assert one.name == "fruit.ripeness"


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ([], "needs at least one of"),
        (["leaf.chlorophil"], "no parameter 'leaf.chlorophil'; closest are leaf.chlorophyll"),
        (["leaf"], "no parameter 'leaf'"),
        ([""], "no parameter ''"),
        (["exposur"], "closest are exposure"),
        (["leaf.flesh"], "no parameter 'leaf.flesh'"),
        (["petal.brown"], "petal.brown cannot be fitted, since plants of Kaite show no petal"),
        (["leaf.brown", "leaf.brown"], "leaf.brown is named twice"),
        (["fruit.state", "fruit.ripeness"], "fruit.ripeness is named twice"),
        (["fruit.brown", "fruit.ripe.brown"], "fruit.brown moves the whole path"),
        (["fruit.ripe.brown", "fruit.brown"], "cannot be fitted beside fruit.ripe.brown"),
    ],
)
def test_names_that_cannot_be_fitted(names, said):
    with pytest.raises(InputError) as fault:
        of(names)
    assert said in str(fault.value)
    assert str(fault.value).startswith("--fit: ")
    assert "\n" not in str(fault.value)


def test_the_message_tells_all_that_there_is():
    with pytest.raises(InputError) as fault:
        of(["nothing"])
    for name in known_parameters(KAITE, CAMERA):
        for word in name.split("."):
            assert word in str(fault.value)


def test_without_a_flash_there_is_none_to_fit():
    assert not any(name.startswith("flash") for name in known_parameters(KAITE, DARK))
    with pytest.raises(InputError, match=r"flash\.power cannot be fitted, since barth2018 has no flash"):
        of(["flash.power"], camera=DARK)


def test_a_grey_sensor_has_no_colours_to_fit():
    colours = CAMERA.sensor.quantum_efficiency
    curve = replace(colours, values=colours.values[:1])
    grey = replace(CAMERA, sensor=replace(CAMERA.sensor, quantum_efficiency=curve, pattern="mono"))
    assert known_parameters(KAITE, grey)[-1] == "exposure"
    with pytest.raises(InputError, match="white_balance cannot be fitted"):
        of(["white_balance"], camera=grey)


# --- laws of states -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["kaite", "tomato", "kaite_september"])
def test_the_law_of_a_surface_is_that_of_its_organs_drawn_alike(name):
    cultivar = load_cultivar(name)
    rng = np.random.default_rng(5)
    for surface in surfaces_of(cultivar):
        drawn = []
        for kind in cultivar.grown:
            organ = cultivar.organs.get(kind)
            if kind == "calyx" and surface == "calyx":
                drawn.append(cultivar.organs["fruit"].calyx_state.quantiles(rng.random(4000)))
            elif organ is not None and organ.kind.surface == surface and organ.form != "fruit":
                drawn.append(organ.state.quantiles(rng.random(4000), rng.random(4000)))
        if drawn:
            law, states = state_law(cultivar, surface), np.concatenate(drawn)
            assert law.mean == pytest.approx(states.mean(), abs=0.01)
            assert law.sd == pytest.approx(states.std(), abs=0.01)
            assert law.ripe is None


def test_the_law_of_fruit_is_that_of_its_stages():
    fruit, rng = KAITE.organs["fruit"], np.random.default_rng(6)
    share = rng.random(20_000)
    ripe, turning = fruit.ripe_fraction.mean, fruit.breaker_fraction.mean
    stages = [law.draw(rng, share.size) for law in (fruit.ripe, fruit.breaker, fruit.unripe)]
    drawn = np.where(
        share < ripe - turning / 2, stages[0], np.where(share < ripe + turning / 2, stages[1], stages[2])
    )
    law = state_law(KAITE, "fruit")
    assert law.mean == pytest.approx(drawn.mean(), abs=0.01)
    assert law.sd == pytest.approx(drawn.std(), abs=0.01)
    assert law.ripe == pytest.approx(0.96)


def test_a_surface_that_nothing_has_has_no_law():
    assert state_law(KAITE, "petal") is None
    assert "petal" not in surfaces_of(KAITE)

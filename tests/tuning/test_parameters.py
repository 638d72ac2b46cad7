"""Parameters of a recipe: names, default values, and the distributions of organ states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.cultivar import load_cultivar
from pepperscene.errors import ArgumentError
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
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

"""Contents of surfaces: which surfaces have which, and that they are those of the pigments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import Surface
from pepperscene.materials.surface import rind_contents

RIND = {"chlorophyll", "carotenoids"}


def test_each_surface_has_the_traits_that_it_can_have(surfaces):
    traits = {name: set(surface.contents) for name, surface in surfaces.items() if surface.contents}
    rinds = dict.fromkeys(("petiole", "stem", "dry_shoot", "peduncle", "calyx"), RIND)
    assert traits == {**rinds, "leaf": RIND | {"water"}, "fruit": RIND | {"ripeness"}}
    assert {name for name, surface in surfaces.items() if surface.is_blade} == {"leaf"}


@pytest.mark.parametrize("name", ["leaf", "fruit", "calyx"])
def test_rows_hold_the_contents_of_their_states(kaite, surfaces, name):
    surface, path = surfaces[name], kaite.pigments[name]
    assert surface.states[[0, -1]].tolist() == [-1.0 if name == "leaf" else 0.0, 1.0]
    expected = path.at(surface.states)
    np.testing.assert_array_equal(surface.contents["chlorophyll"], expected["chlorophyll_ug_cm2"])
    np.testing.assert_array_equal(surface.contents["carotenoids"], expected["carotenoid_ug_cm2"])
    if name == "leaf":
        np.testing.assert_array_equal(surface.contents["water"], expected["water_cm"])
        # Dry tissue has lost its water and its pigments.
        assert surface.contents["water"][0] < 0.1 * surface.contents["water"][-1]
    if name == "fruit":
        np.testing.assert_array_equal(
            surface.contents["ripeness"], np.linspace(0.0, 1.0, len(surface.states))
        )


def test_red_carotenoids_of_fruit_count():
    red = load_cultivar("red_blocky").pigments["fruit"]
    (carotenoids,) = rind_contents(red, np.array([1.0]))["carotenoids"]
    assert carotenoids == red.end.carotenoid_ug_cm2 + red.end.capsanthin_ug_cm2
    assert carotenoids > 10.0 * red.end.carotenoid_ug_cm2


@pytest.mark.parametrize("amounts", [np.full(9, np.nan), np.full(9, -1.0), np.ones((9, 1))])
def test_contents_that_do_not_fit_are_rejected(amounts):
    reflectance, transmittance = np.zeros((9, 2, 2)), np.zeros((9, 2))
    surface = Surface("petal", np.array([400.0, 700.0]), reflectance, transmittance)
    assert not surface.contents
    with pytest.raises(ValueError, match="petal: chlorophyll must be 9 finite numbers"):
        replace(surface, contents={"chlorophyll": amounts})

"""Twins are what a camera would hand on: named after views, noisy, in codes, and changed as their values say.

Rationale: a fit is held against twins. They must show the organs of the fit's own views, and must follow the
values by laws that the fit's model has no part in.
"""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.camera import decode_tone, load_flash
from pepperscene.dataset import load_recipe
from pepperscene.dataset.recipe.resolved import load_camera, load_recipe_cultivar
from pepperscene.errors import InputError
from pepperscene.tuning import TuningTarget, simulate_patches
from pepperscene.tuning.parameters.camera import colour_steps_at
from pepperscene.tuning.parameters.tuned import tuned_parts
from pepperscene.tuning.twin import tuned_camera, tuned_light

SMALL = {"organs": 1, "pixels": 16}
KINDS = ("leaf", "pepper.unripe")
NODES_NM = np.linspace(391.0, 729.0, 8)
NOISE = 2e-3
"""Of a mean over a view this small, in linear light: photons and amplifier give a pixel about .01."""


@pytest.fixture(scope="module")
def recipe():
    return load_recipe("barth2018")


@pytest.fixture(scope="module")
def plain(recipe):
    return simulate_patches(recipe, {}, KINDS, **SMALL)


def mean(patches, kind):
    return patches.pixels(kind).mean(axis=0)


def test_patches_show_the_views_of_a_subject(recipe, plain):
    subject = TuningTarget(recipe, plain, registered=True, **SMALL)
    assert [one.name for one in plain.patches] == [view.name for view in subject.views]
    assert [len(one.codes) for one in plain.patches] == [view.mask.sum() for view in subject.views]
    for one in plain.patches:
        assert one.codes.dtype == np.uint8
        assert np.array_equal(one.linear, decode_tone(one.codes))
    # At the recipe's own values the fit's model and the twin differ by noise.
    problem = subject.problem(["exposure"])
    assert np.abs(problem.data_residuals({})).max() < 5.0


def test_the_same_seeds_give_the_same_codes_and_others_do_not(recipe, plain):
    again, other = (simulate_patches(recipe, {}, KINDS, **SMALL, noise=noise) for noise in (1, 2))
    for one, same, not_same in zip(plain.patches, again.patches, other.patches, strict=True):
        assert np.array_equal(one.codes, same.codes)
        assert not np.array_equal(one.codes, not_same.codes)


def test_exposure_and_power_are_factors_of_light(recipe, plain):
    """Twice the gain is twice the picture, where nothing is cut; without daylight so is twice the flash."""
    half = simulate_patches(recipe, {"exposure": 0.5}, ["leaf"], **SMALL)
    assert mean(half, "leaf") == pytest.approx(0.5 * mean(plain, "leaf"), rel=0.02, abs=NOISE)
    dark = load_recipe("barth2018", {"daylight.illuminance_lx": 0.0})
    one, weak = (simulate_patches(dark, {"flash.power": p}, ["leaf"], **SMALL) for p in (1.0, 0.5))
    assert mean(weak, "leaf") == pytest.approx(0.5 * mean(one, "leaf"), rel=0.02, abs=NOISE)


def test_pigments_change_their_own_organs_only(recipe, plain):
    pale = simulate_patches(recipe, {"leaf.chlorophyll": 20.0}, KINDS, **SMALL)
    assert (mean(pale, "leaf")[:2] > 1.1 * mean(plain, "leaf")[:2]).all()
    assert mean(pale, "pepper.unripe") == pytest.approx(mean(plain, "pepper.unripe"), rel=0.02, abs=NOISE)


def test_the_camera_is_the_tuned_one(recipe):
    camera = load_camera(recipe)
    values = {"white_balance": np.array([1.2, 0.9]), "exposure": np.array([0.7])}
    made = tuned_parts(load_recipe_cultivar(recipe), camera, values, NODES_NM)
    found = tuned_camera(camera, made)
    gains, matrix = colour_steps_at(camera, values)
    assert found.developing.white_balance == pytest.approx(tuple(gains))
    assert np.asarray(found.developing.colour_matrix) == pytest.approx(matrix)
    assert found.sensor.gain == pytest.approx(0.7 * camera.sensor.gain)


@pytest.mark.parametrize("name", ["led_matrix_200klx", "led_nir_850nm"])
def test_the_light_is_the_old_one_times_power_and_factors(recipe, name):
    """At every wavelength, whether the flash's strength is told in lux or in watts."""
    flash = load_flash(name)
    values = {"flash.power": np.array([0.7]), "flash.colour": np.array([0.4, -0.2])}
    made = tuned_parts(load_recipe_cultivar(recipe), load_camera(recipe), values, NODES_NM)
    nm = np.arange(400.0, 701.0) if flash.illuminance_lx is not None else np.arange(800.0, 901.0)
    factors = 0.7 * np.interp(nm, NODES_NM, made.flash_spectrum)
    assert tuned_light(flash, made).irradiance().at(nm) == pytest.approx(flash.irradiance().at(nm) * factors)


def test_slips_are_told(recipe):
    with pytest.raises(InputError, match="chlorofyll"):
        simulate_patches(recipe, {"leaf.chlorofyll": 40.0}, ["leaf"], **SMALL)
    with pytest.raises(InputError, match="white_balance"):
        simulate_patches(recipe, {"white_balance": 1.2}, ["leaf"], **SMALL)
    for kind in ("wire", "branch", "pepper.rotten"):
        with pytest.raises(InputError, match=kind):
            simulate_patches(recipe, {}, [kind], **SMALL)

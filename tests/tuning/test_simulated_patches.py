"""Simulated patches are like those of a camera: noisy, in codes, and changed by parameter values."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.camera import decode_tone, pedestal
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
from pepperscene.tuning import TuningTarget, simulate_patches
from pepperscene.tuning.target import REGISTERED_LAB_ERROR
from pepperscene.tuning.tuned import colour_steps, tuned_camera, tuned_parts

SMALL = {"organs": 1, "pixels": 16}
KINDS = ("leaf", "pepper.unripe")
NODES_NM = np.linspace(391.0, 729.0, 8)
NOISE = 2e-3
"""Of the mean of a view this small, in linear light: photons and amplifier give a pixel about .01."""


@pytest.fixture(scope="module")
def recipe():
    return load_recipe("barth2018")


@pytest.fixture(scope="module")
def default(recipe):
    return simulate_patches(recipe, {}, KINDS, **SMALL)


def mean(patches, kind):
    return patches.pixels(kind).mean(axis=0)


@pytest.mark.long
def test_patches_show_the_views_of_a_target(recipe, default):
    target = TuningTarget(recipe, default, registered=True, **SMALL)
    assert [one.name for one in default.patches] == [view.name for view in target.views]
    assert [len(one.codes) for one in default.patches] == [view.mask.sum() for view in target.views]
    for one in default.patches:
        assert one.codes.dtype == np.uint8
        assert np.array_equal(one.linear, decode_tone(one.codes))
    # At the recipe's values, the fit's model and the simulation differ by noise.
    assert np.abs(target.problem(["exposure"]).data_residuals({})).max() < 5.0


def test_dim_patches_have_more_noise(recipe, default):
    """With a quarter of the light, a mean has twice the relative shot noise, and four times the amplifier's.

    The slope of lightness over the logarithm of light is 4^(1/3) times smaller.
    """
    target = TuningTarget(recipe, default, registered=True, **SMALL)
    power = target.parameters(["flash.power"])[0].default
    bright, dim = (
        np.sqrt([one.sigma[0] ** 2 - REGISTERED_LAB_ERROR**2 for one in problem.observations])
        for problem in (
            target.problem(["exposure"]),
            target.problem(["exposure"], noise_at={"flash.power": 0.25 * power}),
        )
    )
    slope = 4.0 ** (-1.0 / 3.0)
    assert (dim > 2.0 * slope * bright).all()
    assert (dim < 4.0 * slope * bright).all()


@pytest.mark.long
def test_codes_depend_on_the_noise_seed_only(recipe, default):
    again, other = (simulate_patches(recipe, {}, KINDS, **SMALL, noise=noise) for noise in (1, 2))
    for one, same, different in zip(default.patches, again.patches, other.patches, strict=True):
        assert np.array_equal(one.codes, same.codes)
        assert not np.array_equal(one.codes, different.codes)


def test_exposure_and_power_are_factors_of_light(recipe, default):
    """Half the gain gives half the light if nothing is clipped; without daylight so does half the flash.

    Light x is the colour (x + p) / (1 + p) with the pedestal p, which neither of them changes.
    """
    lift = pedestal(load_camera(recipe))

    def light(patches):
        return (1.0 + lift) * mean(patches, "leaf") - lift

    half = simulate_patches(recipe, {"exposure": 0.5}, ["leaf"], **SMALL)
    assert light(half) == pytest.approx(0.5 * light(default), rel=0.02, abs=NOISE)
    dark = load_recipe("barth2018", {"daylight.illuminance_lx": 0.0})
    # At full power, the gloss of a leaf that faces the flash saturates the sensor.
    strong, weak = (simulate_patches(dark, {"flash.power": p}, ["leaf"], **SMALL) for p in (0.5, 0.25))
    assert strong.pixels("leaf").max() < 1.0
    assert light(weak) == pytest.approx(0.5 * light(strong), rel=0.02, abs=NOISE)


def test_pigments_change_their_own_organs_only(recipe, default):
    pale = simulate_patches(recipe, {"leaf.chlorophyll": 20.0}, KINDS, **SMALL)
    assert (mean(pale, "leaf")[:2] > 1.1 * mean(default, "leaf")[:2]).all()
    assert mean(pale, "pepper.unripe") == pytest.approx(mean(default, "pepper.unripe"), rel=0.02, abs=NOISE)


def test_tuned_camera_has_gains_matrix_and_gain(recipe):
    camera = load_camera(recipe)
    values = {"white_balance": np.array([1.2, 0.9]), "exposure": np.array([0.7])}
    tuned = tuned_camera(camera, tuned_parts(load_recipe_cultivar(recipe), camera, values, NODES_NM))
    gains, matrix = colour_steps(camera, values)
    assert tuned.developing.white_balance == pytest.approx(tuple(gains))
    assert np.asarray(tuned.developing.colour_matrix) == pytest.approx(matrix)
    assert tuned.sensor.gain == pytest.approx(0.7 * camera.sensor.gain)


def test_raises_on_unknown_names_kinds_and_wrong_sizes(recipe):
    with pytest.raises(InputError, match="chlorofyll"):
        simulate_patches(recipe, {"leaf.chlorofyll": 40.0}, ["leaf"], **SMALL)
    with pytest.raises(InputError, match=r"values: white_balance = 1\.2: must be 2 number"):
        simulate_patches(recipe, {"white_balance": 1.2}, ["leaf"], **SMALL)
    for kind in ("wire", "branch", "pepper.rotten"):
        with pytest.raises(InputError, match=kind):
            simulate_patches(recipe, {}, [kind], **SMALL)

"""Patches by another camera and lamp than the recipe's: what a fit of pigments cannot explain, and what can.

Rationale: pigments that are fitted to explain another camera are wrong. A fit has to show that they do not
explain it, and to name what is missing.

Set-up: the organs of a recipe with hidden pigments, in the light of another LED (CIE illuminant LED-B3, a
phosphor-converted LED of 5763 K) and with the responses of another sensor (a Nikon D5100). Gains and matrix
are that camera's for the recipe's light, as if the other lamp had not been noticed.

Expected: with pigments alone, residuals are large, some colours differ visibly, and light and camera are
named before other pigments. With light, exposure, white balance and colour matrix, no colour differs visibly.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from simulated_fits import KINDS, draw_values, no_patches, patch_delta_e

from pepperscene.camera import Camera, load_sensor, reference_correction
from pepperscene.colour import PatchSet
from pepperscene.materials import organ_surfaces
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import surface_wavelengths
from pepperscene.spectra import read_spectrum
from pepperscene.tuning import least_squares
from pepperscene.tuning.target import TuningTarget, photograph, simulate_patches
from pepperscene.tuning.views import with_surfaces

pytestmark = pytest.mark.long

PIGMENTS = ("leaf.chlorophyll", "fruit.chlorophyll", "fruit.carotenoid", "stem.chlorophyll")
LIGHT_AND_CAMERA = ("flash.colour", "exposure", "white_balance", "colour_matrix")
EVALUATIONS = 7
"""Of each fit: colours are matched by then."""
CAUSES = "The unexplained residuals point to "


def other_camera(camera: Camera) -> Camera:
    """The same lens and pose with another sensor and another lamp."""
    response = load_sensor("nikon_d5100").quantum_efficiency
    sensor = replace(camera.sensor, name="another sensor", quantum_efficiency=response)
    correction = reference_correction(replace(camera, sensor=sensor))
    lamp = read_spectrum("light/cie_illuminants_colour_science", "led_b3")
    gains = tuple(correction.gains)
    return replace(
        camera,
        sensor=sensor,
        flash=replace(camera.flash, spectrum=lamp),
        developing=replace(camera.developing, white_balance=gains, colour_matrix=correction.matrix),
    )


@pytest.fixture(scope="module")
def recipe():
    return load_recipe("barth2018")


def target_of(recipe, patches=None) -> TuningTarget:
    return TuningTarget(recipe, patches or no_patches(KINDS), registered=True, organs=2, pixels=40)


@pytest.fixture(scope="module")
def hidden(recipe) -> dict[str, np.ndarray]:
    return draw_values(target_of(recipe).parameters(PIGMENTS), np.random.default_rng(5))


@pytest.fixture(scope="module")
def target(recipe, hidden) -> TuningTarget:
    """The recipe and patches by the other camera."""
    plain = target_of(recipe)
    pigments = {**plain.cultivar.pigments, **plain.tuned_parts(hidden).pigments}
    plants = plain.cultivar.model_copy(update={"pigments": pigments})
    surfaces = organ_surfaces(plants, surface_wavelengths(other_camera(plain.camera).sensor))
    patches = [
        photograph(with_surfaces(view, surfaces), other_camera(view.camera), (7, i))
        for i, view in enumerate(plain.views)
    ]
    return target_of(recipe, PatchSet("another camera", tuple(patches)))


def fit_of(target, names):
    """A problem and its fit after a few evaluations."""
    problem = target.problem(names)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(least_squares, "_EVALUATIONS", EVALUATIONS)
        return problem, least_squares.fit_parameters(target, problem, starts=1)


@pytest.fixture(scope="module")
def by_pigments(target):
    return fit_of(target, PIGMENTS)


@pytest.fixture(scope="module")
def by_everything(target):
    return fit_of(target, (*PIGMENTS, *LIGHT_AND_CAMERA))


def test_pigments_alone_do_not_explain_the_patches(by_pigments):
    problem, fit = by_pigments
    assert fit.chi_squared > 100.0 * fit.data_count
    assert max(patch_delta_e(problem, fit).values()) > 2.0
    assert fit.diagnostics[0].startswith("The model does not fit the patches: ")
    assert any(one.startswith("Mean colours still differ visibly: ") for one in fit.diagnostics)


def test_light_and_camera_are_named_as_causes(by_pigments):
    """Before other pigments, although dozens of those could explain as much."""
    _, fit = by_pigments
    first, second, third, *_ = fit.omitted
    assert {first, second} == {"light", "camera"}
    assert min(fit.omitted[first], fit.omitted[second]) > 0.5
    assert third == "pigments"
    assert fit.omitted["pigments"] > 0.5
    (sentence,) = (one for one in fit.diagnostics if one.startswith(CAUSES))
    assert "camera" in sentence
    assert "light" in sentence
    assert "pigments" not in sentence
    assert any(one.startswith("Other groups") and "pigments" in one for one in fit.diagnostics)


def test_light_and_camera_explain_what_is_visible(by_everything, by_pigments):
    """All colours agree; the narrow lines of the lamp leave more than noise in the pixels."""
    problem, fit = by_everything
    delta_e = patch_delta_e(problem, fit)
    assert max(delta_e.values()) < 1.0, delta_e
    assert max(kind.delta_e_after for kind in fit.kinds.values()) < 1.0
    assert fit.chi_squared < 0.02 * by_pigments[1].chi_squared
    assert not any(one.startswith("Mean colours still differ visibly") for one in fit.diagnostics)


def test_pigments_are_closer_to_the_truth_with_light_and_camera(hidden, by_pigments, by_everything):
    errors = [
        np.sqrt(np.mean([(fit.values[name][0] / hidden[name][0] - 1.0) ** 2 for name in PIGMENTS]))
        for _, fit in (by_pigments, by_everything)
    ]
    assert errors[1] < 0.5 * errors[0], errors


@pytest.mark.parametrize(
    ("hidden", "groups"),
    [
        ({"flash.colour": [-0.4, 0.05]}, ("light", "camera")),
        ({"white_balance": [1.2, 0.9]}, ("light", "camera")),
        ({"exposure": [0.75]}, ("exposure", "light", "camera")),
        ({"leaf.carotenoid": [7.0]}, ("pigments",)),
        ({"leaf.structure": [2.3], "petiole.chlorophyll": [6.0], "fruit.brown": [0.7]}, ("pigments",)),
        ({"fruit.ior": [1.52], "leaf.roughness": [0.3]}, ("cuticle",)),
    ],
)
def test_names_the_one_group_that_is_missing(recipe, hidden, groups):
    """With the recipe's camera, and one hidden group that is not fitted.

    White balance and the colour of the light are nearly equivalent, and so are its power and the gain.
    """
    patches = simulate_patches(recipe, hidden, KINDS, organs=2, pixels=40, noise=3)
    _, fit = fit_of(target_of(recipe, patches), ("leaf.chlorophyll", "fruit.chlorophyll"))
    assert next(iter(fit.omitted)) in groups, fit.diagnostics
    (sentence,) = (one for one in fit.diagnostics if one.startswith(CAUSES))
    causes = sentence.removeprefix(CAUSES).split(", or ")
    assert {re.split(r"[ ,]", cause)[0] for cause in causes} <= set(groups), sentence

"""Other cameras of a shot: the next step's, and a stereo partner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.dataset import FrameRenderer, build
from pepperscene.errors import InputError
from pepperscene.scene import view_frustums

BASELINE_M = 0.06  # of the recipe


@pytest.fixture
def alone(recipe):
    """The recipe without a partner."""
    return recipe.model_copy(update={"camera": recipe.camera.model_copy(update={"baseline_mm": None})})


def test_a_camera_is_handed_on_where_an_output_needs_it(recipe, fake_renderer, empty_scenes):
    stage, plan = FrameRenderer(recipe, fake_renderer), recipe.plan
    for outputs in (("class",), ("flow",), ("class", "stereo"), ("colour_stereo",), ("flow", "stereo")):
        stage.render(plan.frame(1), outputs)
    stage.render(plan.frame(plan.frames - 1), ("flow",))
    told = [given for made in fake_renderer.made for given in made.others]
    keys = [None if given is None else set(given) for given in told]
    assert keys == [None, {"flow"}, {"stereo"}, {"stereo"}, {"flow", "stereo"}, None]
    np.testing.assert_array_equal(told[1]["flow"].pose, stage.camera(plan.frame(2)).pose)


def test_the_partner_stands_beside_and_looks_the_same_way(recipe, fake_renderer):
    stage, shot = FrameRenderer(recipe, fake_renderer), recipe.plan.frame(2)
    own, partner = stage.camera(shot), stage.views.others(shot.step, ["stereo"])["stereo"]
    np.testing.assert_array_equal(partner.pose[:3, :3], own.pose[:3, :3])
    step = own.pose[:3, :3].T @ (partner.pose[:3, 3] - own.pose[:3, 3])
    np.testing.assert_allclose(step, [BASELINE_M, 0, 0], atol=1e-12)
    assert (partner.lens, partner.exposure_s, partner.focus_m) == (own.lens, own.exposure_s, own.focus_m)
    # One flash lights both: it stands where it stood.
    lamps = [one.pose[:3, :3] @ np.array(one.flash.offset_m) + one.pose[:3, 3] for one in (own, partner)]
    np.testing.assert_allclose(lamps[1], lamps[0], atol=1e-12)


def test_without_a_flash_there_is_none_beside(recipe, fake_renderer):
    dark = recipe.camera.model_copy(update={"flash": "none"})
    light = recipe.developing.model_copy(update={"white_balance": "daylight"})
    stage = FrameRenderer(recipe.model_copy(update={"camera": dark, "developing": light}), fake_renderer)
    assert stage.views.others(recipe.plan.frame(0).step, ["colour_stereo"])["stereo"].flash is None


@pytest.mark.parametrize("name", ["stereo", "colour_stereo"])
def test_a_recipe_without_baseline_has_no_partner(alone, fake_renderer, empty_scenes, tmp_path, name):
    with pytest.raises(InputError, match=rf"small: camera\.baseline_mm: must be told .*{name}"):
        FrameRenderer(alone, fake_renderer).render(alone.plan.frame(0), ("class", name))
    with pytest.raises(InputError, match=r"camera\.baseline_mm"):
        build(alone, tmp_path / "set", [0], ("class", name), renderer=fake_renderer)
    assert not (tmp_path / "set").exists()


def test_a_path_without_partner_is_seen_as_before(alone, fake_renderer):
    stage = FrameRenderer(alone, fake_renderer)
    camera = stage.camera(alone.plan.frame(0))
    poses = [stage.camera(alone.plan.frame(step)).pose for step in range(alone.plan.frames)]
    expected, found = view_frustums(camera, poses), stage.views.sight
    for name in ("normals", "offsets", "places"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_partners_view_is_part_of_what_is_seen(recipe, fake_renderer):
    stage, plan = FrameRenderer(recipe, fake_renderer), recipe.plan
    half = np.full((1, 3), 1e-3, np.float32)
    for step in range(plan.frames):
        partner = stage.views.others(plan.frame(step).step, ["stereo"])["stereo"]
        wide = replace(partner, focus_m=None)
        for slope in wide.ray_slopes()[[1, 1, -2, -2], [1, -2, 1, -2]]:
            corner = wide.pose[:3, :3] @ [*(0.99 * slope), 1.0] + wide.pose[:3, 3]
            assert stage.views.sight.intersects(corner[None].astype(np.float32), half).all()

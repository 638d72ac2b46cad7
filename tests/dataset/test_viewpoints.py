"""The cameras along the path: the next step's for optical flow, and the stereo partner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.dataset import BuildOptions, FrameRenderer, build
from pepperscene.errors import InputError
from pepperscene.scene import view_frustums

BASELINE_M = 0.06  # of the recipe


@pytest.fixture
def without_partner(recipe):
    return recipe.model_copy(update={"camera": recipe.camera.model_copy(update={"baseline_mm": None})})


def test_other_cameras_are_passed_only_for_outputs_that_need_them(recipe, fake_renderer, empty_scenes):
    renderer, plan = FrameRenderer(recipe, fake_renderer), recipe.plan
    for outputs in (("class",), ("flow",), ("class", "stereo"), ("colour_stereo",), ("flow", "stereo")):
        renderer.render(plan.frame(1), outputs)
    renderer.render(plan.frame(plan.frames - 1), ("flow",))
    others = [call.others for created in fake_renderer.created for call in created.calls]
    purposes = [None if cameras is None else set(cameras) for cameras in others]
    assert purposes == [None, {"flow"}, {"stereo"}, {"stereo"}, {"flow", "stereo"}, None]
    np.testing.assert_array_equal(others[1]["flow"].pose, renderer.camera(plan.frame(2)).pose)


def test_partner_is_one_baseline_to_the_right_and_shares_the_flash(recipe):
    views = FrameRenderer(recipe).views
    camera, partner = views.camera(2), views.others(2, ["stereo"])["stereo"]
    rotation = camera.pose[:3, :3]
    np.testing.assert_array_equal(partner.pose[:3, :3], rotation)
    offset = rotation.T @ (partner.pose[:3, 3] - camera.pose[:3, 3])
    np.testing.assert_allclose(offset, [BASELINE_M, 0, 0], atol=1e-12)
    for name in ("lens", "exposure_s", "focus_m"):
        assert getattr(partner, name) == getattr(camera, name)
    flashes = [rotation @ np.array(one.flash.offset_m) + one.pose[:3, 3] for one in (camera, partner)]
    np.testing.assert_allclose(flashes[1], flashes[0], atol=1e-12)


def test_partner_has_no_flash_if_the_camera_has_none(recipe):
    camera = recipe.camera.model_copy(update={"flash": "none"})
    developing = recipe.developing.model_copy(update={"white_balance": "daylight"})
    views = FrameRenderer(recipe.model_copy(update={"camera": camera, "developing": developing})).views
    assert views.others(0, ["colour_stereo"])["stereo"].flash is None


@pytest.mark.parametrize("name", ["stereo", "colour_stereo"])
def test_stereo_outputs_need_a_baseline(without_partner, fake_renderer, empty_scenes, tmp_path, name):
    with pytest.raises(InputError, match=rf"small: camera\.baseline_mm: is required .*{name}"):
        FrameRenderer(without_partner, fake_renderer).render(without_partner.plan.frame(0), ("class", name))
    options = BuildOptions(renderer=fake_renderer)
    with pytest.raises(InputError, match=r"camera\.baseline_mm"):
        build(without_partner, tmp_path / "set", [0], ("class", name), options)
    assert not (tmp_path / "set").exists()


def test_frustums_without_partner_are_those_of_the_path(without_partner):
    views = FrameRenderer(without_partner).views
    poses = [views.camera(step).pose for step in range(without_partner.plan.frames)]
    expected = view_frustums(views.camera(0), poses)
    for name in ("normals", "offsets", "positions"):
        np.testing.assert_array_equal(getattr(views.frustums, name), getattr(expected, name))


def test_frustums_include_the_partner(recipe):
    views = FrameRenderer(recipe).views
    half_extent = np.full((1, 3), 1e-3, np.float32)
    for step in range(recipe.plan.frames):
        partner = replace(views.others(step, ["stereo"])["stereo"], focus_m=None)
        for slope in partner.ray_slopes()[[1, 1, -2, -2], [1, -2, 1, -2]]:
            corner = partner.pose[:3, :3] @ [*(0.99 * slope), 1.0] + partner.pose[:3, 3]
            assert views.frustums.intersects(corner[None].astype(np.float32), half_extent).all()

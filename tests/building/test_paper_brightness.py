"""The brightness of the paper's images is a published figure, which recipes expect and do not measure."""

from __future__ import annotations

import pytest

from pepperscene import load_lens, load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera


@pytest.mark.parametrize("name", ["barth2018", "demo"])
def test_expected_intensity_is_that_of_the_paper(name):
    low, high = load_recipe(name).expect.intensity
    assert (low + high) / 2 == 37.0
    assert high - low <= 6.0


def test_recipes_of_the_paper_have_the_light_with_which_draft_frames_of_42_scenes_have_the_mean_37():
    used = {load_camera(load_recipe(name)).lens.f_number for name in ("barth2018", "demo", "barth2018_robot")}
    assert used == {3.6}


@pytest.mark.parametrize("name", ["greenhouse", "season", "multispectral", "twins"])
def test_recipes_by_daylight_keep_their_lens(name):
    lens = load_camera(load_recipe(name)).lens
    assert "f/3.6" not in lens.name
    assert load_lens("lensagon_cmfa0420nd").f_number == 2.0

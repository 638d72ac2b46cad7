"""The camera of a frame with automatic exposure, outside its frame."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene import FrameRenderer, load_recipe, open_scene, render_scene
from pepperscene.classes import PLANT_CLASSES
from pepperscene.errors import InputError
from pepperscene.recipe.plan import frame_seed
from pepperscene.tuning.target import TuningTarget

CHANGES = {
    "row.plants_front": 1,
    "row.plants_back": 0,
    "camera.width": 64,
    "camera.height": 48,
    "camera.exposure_us": "auto",
    "auto_exposure.target_grey": 60.0,
    "auto_exposure.metering": "subject",
}


@pytest.fixture(scope="module")
def renderer():
    return FrameRenderer(load_recipe("barth2018", CHANGES))


def test_camera_of_a_frame_has_its_metered_exposure(renderer):
    spec = renderer.recipe.plan.frame(125)
    frame, camera = renderer.render(spec, ["colour"], "draft"), renderer.camera(spec, "draft")
    described = frame.metadata["camera"]
    assert (camera.exposure_s, camera.sensor.gain) == (described["exposure_s"], described["gain"])
    # The same image without a frame renderer.
    seed = frame_seed(renderer.recipe.seed, spec.index)
    again = render_scene(renderer.scene(spec), camera, ["colour"], "draft", seed)
    assert np.array_equal(again["colour"], frame["colour"])
    assert frame.metadata["auto_exposure"]["metering"] == "subject"


def test_locked_exposure_is_that_of_the_first_view_in_any_order():
    # Plants from five sides, the last view alone and after the first one.
    changes = {**CHANGES, "plan.rotations": 1, "plan.frames": 5}
    locked, own = (
        load_recipe("barth2018", {**changes, "auto_exposure.lock": True}),
        FrameRenderer(load_recipe("barth2018", changes)),
    )
    first, last = (locked.plan.frame(index) for index in (0, 4))
    renderer = FrameRenderer(locked)
    alone = renderer.render(last, ["colour"], "draft")
    chosen = alone.metadata["auto_exposure"]
    assert chosen["locked_in_frame"] == 0
    metered = own.render(first, ["colour"], "draft")
    assert chosen == {**metered.metadata["auto_exposure"], "locked_in_frame": 0}
    assert alone.metadata["camera"]["exposure_s"] == chosen["exposure_s"]
    assert chosen["exposure_s"] != own.camera(last, "draft").exposure_s
    assert renderer.camera(last, "draft").exposure_s == chosen["exposure_s"]
    again = FrameRenderer(locked)
    assert np.array_equal(again.render(first, ["colour"], "draft")["colour"], metered["colour"])
    assert np.array_equal(again.render(last, ["colour"], "draft")["colour"], alone["colour"])


@pytest.mark.long
def test_cameras_of_a_rig_and_of_an_open_scene_meter_their_own_subject():
    away = {"name": "away", "rotation_deg": [180.0, 0.0, 0.0]}
    recipe = load_recipe("barth2018", {**CHANGES, "rig": [away], "views.kind": "arc"})
    renderer = FrameRenderer(recipe)
    found = {}
    for index in (250, 251):
        frame = renderer.render(recipe.plan.frame(index), ["colour", "class"], "draft")
        name = "plants" if np.isin(frame["class"], list(PLANT_CLASSES)).any() else "none"
        found[name] = frame.metadata["auto_exposure"]["metering"]
    assert found == {"plants": "subject", "none": "average"}
    described = open_scene(recipe, 250).render(outputs=("colour",)).metadata
    assert described["auto_exposure"]["metering"] == "subject"


def test_camera_without_photographs_is_not_metered(renderer):
    spec = renderer.recipe.plan.frame(125)
    untraced = renderer.camera(spec, traced=False)
    assert np.array_equal(untraced.pose, renderer.camera(spec, "draft").pose)


def test_colours_are_not_tuned_at_an_unknown_exposure():
    with pytest.raises(InputError, match=r"camera\.exposure_us = 'auto': must be a time"):
        TuningTarget(load_recipe("barth2018", CHANGES), None)

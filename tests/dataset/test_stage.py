"""The stage with the real grammar, geometry and camera; only the light transport is a stand-in."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.dataset import Stage
from pepperscene.dataset.seeds import frame_seed

LABELS = ("class", "distance")


@pytest.fixture
def three_plants(recipe):
    row = recipe.row.model_copy(update={"plants_front": 2, "plants_back": 1})
    return recipe.model_copy(update={"row": row})


def footprint(scene, plant):
    """What a plant looks like wherever it stands: its vertices relative to their mean."""
    mesh = scene.mesh
    owner = np.array([instance.plant for instance in mesh.instances])[mesh.face_instance]
    vertices = mesh.vertices[np.unique(mesh.faces[owner == plant])].astype(float)
    return vertices - vertices.mean(axis=0)


def test_rotation_moves_the_plants_on(three_plants, fake_renderer):
    stage = Stage(three_plants, fake_renderer)
    plan = three_plants.plan
    before = stage.scene(plan.shot(0), traced=False)
    after = stage.scene(plan.shot(plan.frames), traced=False)
    np.testing.assert_allclose(footprint(after, 1), footprint(before, 0), atol=1e-5)
    np.testing.assert_allclose(footprint(after, 0), footprint(before, 1), atol=1e-5)
    np.testing.assert_allclose(footprint(after, 2), footprint(before, 2), atol=1e-5)


def test_plants_depend_on_set_and_place_but_not_on_how_many_there_are(three_plants, recipe, fake_renderer):
    many, one = Stage(three_plants, fake_renderer), Stage(recipe, fake_renderer)
    first = footprint(many.scene(three_plants.plan.shot(0), traced=False), 0)
    np.testing.assert_allclose(footprint(one.scene(recipe.plan.shot(0), traced=False), 0), first, atol=1e-5)
    other_set = one.scene(recipe.plan.shot(recipe.plan.count - 1), traced=False)
    assert footprint(other_set, 0).shape != first.shape or not np.allclose(footprint(other_set, 0), first)


def test_one_renderer_serves_a_scene(recipe, fake_renderer):
    stage = Stage(recipe, fake_renderer)
    for index in range(8):
        stage.render(recipe.plan.shot(index), LABELS)
    assert [len(renderer.views) for renderer in fake_renderer.made] == [4, 4]


def test_labels_need_no_surfaces_and_no_sky(recipe, fake_renderer):
    stage = Stage(recipe, fake_renderer)
    shot = recipe.plan.shot(0)
    stage.render(shot, LABELS)
    stage.render(shot, ("colour",))
    stage.render(shot, LABELS)
    plain, lit = fake_renderer.made
    assert (plain.scene.surfaces, plain.scene.sky) == ((), None)
    assert {surface.name for surface in lit.scene.surfaces} == set(lit.scene.mesh.surfaces)
    assert lit.scene.sky is not None
    # A renderer that traces light serves labels as well.
    assert len(lit.views) == 2


def test_without_daylight_there_is_no_sky_and_without_twine_no_wire(recipe, fake_renderer):
    bare = recipe.model_copy(update={"daylight": None, "twine": None})
    scene = Stage(bare, fake_renderer).scene(bare.plan.shot(0))
    assert scene.sky is None
    assert "twine" not in {instance.kind for instance in scene.mesh.instances}
    with_all = Stage(recipe, fake_renderer).scene(recipe.plan.shot(0))
    assert "twine" in {instance.kind for instance in with_all.mesh.instances}


def test_the_camera_goes_along_the_arc(recipe, fake_renderer):
    stage = Stage(recipe, fake_renderer)
    poses = np.array([stage.camera(recipe.plan.shot(step)).pose for step in range(4)])
    places = poses[:, :3, 3]
    np.testing.assert_allclose(np.hypot(places[:, 0], places[:, 1]), 0.4)
    np.testing.assert_allclose(places[:, 2], np.linspace(0.9, 2.1, 4))
    np.testing.assert_allclose(np.degrees(np.arctan2(places[:, 0], -places[:, 1])), np.linspace(-45, 45, 4))
    # Looking 20 degrees upwards.
    np.testing.assert_allclose(poses[:, 2, 2], np.sin(np.radians(20)))


def test_every_frame_has_a_seed_of_its_own(recipe, fake_renderer):
    stage = Stage(recipe, fake_renderer)
    for index in (2, 3):
        stage.render(recipe.plan.shot(index), LABELS)
    seeds = [view[3] for view in fake_renderer.made[0].views]
    assert seeds == [frame_seed(recipe.seed, 2), frame_seed(recipe.seed, 3)]


def test_scenes_do_not_depend_on_the_order_of_the_frames(recipe, fake_renderer):
    plan, last = recipe.plan, recipe.plan.count - 1
    there_and_back = Stage(recipe, fake_renderer)
    for index in (last, 0):
        there_and_back.render(plan.shot(index), LABELS)
    scene = there_and_back.scene(plan.shot(last))
    fresh = Stage(recipe, fake_renderer).scene(plan.shot(last))
    np.testing.assert_array_equal(scene.mesh.vertices, fresh.mesh.vertices)
    np.testing.assert_array_equal(scene.sky.weights, fresh.sky.weights)

"""Frames from the real grammar, geometry and camera; only the light transport is a stand-in."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.classes import OrganClass
from pepperscene.dataset import FrameRenderer, load_recipe
from pepperscene.dataset.recipe.plan import frame_seed

LABELS = ("class", "distance")


@pytest.fixture
def three_plants(recipe):
    row = recipe.row.model_copy(update={"plants_front": 2, "plants_back": 1})
    return recipe.model_copy(update={"row": row})


@pytest.fixture
def renderer(recipe, fake_renderer):
    return FrameRenderer(recipe, fake_renderer)


def stem_shape(scene, plant):
    """Vertices of a plant's stem, which no neighbour moves, relative to their mean."""
    mesh = scene.mesh
    owner = np.array([instance.plant for instance in mesh.instances])[mesh.face_instance]
    stem = (owner == plant) & (mesh.face_class == OrganClass.STEM)
    vertices = mesh.vertices[np.unique(mesh.faces[stem])].astype(float)
    return vertices - vertices.mean(axis=0)


def test_rotation_moves_plants_along_the_row(three_plants, fake_renderer):
    renderer = FrameRenderer(three_plants, fake_renderer, culled=False)
    plan = three_plants.plan
    before = renderer.scene(plan.frame(0), traced=False)
    after = renderer.scene(plan.frame(plan.frames), traced=False)
    for place, plant in ((1, 0), (0, 1), (2, 2)):
        np.testing.assert_allclose(stem_shape(after, place), stem_shape(before, plant), atol=1e-5)


def test_plants_depend_on_set_and_number_but_not_on_the_count(three_plants, recipe, fake_renderer):
    many, one = (FrameRenderer(each, fake_renderer, culled=False) for each in (three_plants, recipe))
    expected = stem_shape(many.scene(three_plants.plan.frame(0), traced=False), 0)
    first = stem_shape(one.scene(recipe.plan.frame(0), traced=False), 0)
    np.testing.assert_allclose(first, expected, atol=1e-5)
    other_set = stem_shape(one.scene(recipe.plan.frame(recipe.plan.count - 1), traced=False), 0)
    assert other_set.shape != expected.shape or not np.allclose(other_set, expected)


def test_frames_of_a_scene_share_its_renderer(renderer, recipe, fake_renderer):
    for index in range(8):
        renderer.render(recipe.plan.frame(index), LABELS)
    assert [len(one.calls) for one in fake_renderer.created] == [4, 4]


def test_labels_need_no_surfaces_and_no_sky(renderer, recipe, fake_renderer):
    spec = recipe.plan.frame(0)
    for outputs in (LABELS, ("colour",), LABELS):
        renderer.render(spec, outputs)
    labels, traced = fake_renderer.created
    assert (labels.scene.surfaces, labels.scene.sky) == ((), None)
    assert {surface.name for surface in traced.scene.surfaces} == set(traced.scene.mesh.surfaces)
    assert traced.scene.sky is not None
    # A renderer that traces light renders labels as well.
    assert len(traced.calls) == 2


def test_scene_has_sky_and_twine_only_if_the_recipe_has(renderer, recipe):
    spec = recipe.plan.frame(0)
    bare = FrameRenderer(recipe.model_copy(update={"daylight": None, "twine": None})).scene(spec)
    assert bare.sky is None
    assert "twine" not in {instance.kind for instance in bare.mesh.instances}
    assert "twine" in {instance.kind for instance in renderer.scene(spec).mesh.instances}


def test_each_set_has_its_own_clouds(recipe):
    def clouds(index, recipe=recipe):
        return FrameRenderer(recipe).scene(recipe.plan.frame(index)).sky.weights

    frames = recipe.plan.frames
    first = clouds(0)
    np.testing.assert_array_equal(clouds(frames), first)
    assert not np.array_equal(clouds(recipe.plan.rotations * frames), first)
    assert not np.array_equal(clouds(0, recipe.with_seed(recipe.seed + 1)), first)


def test_statistics_are_those_of_the_frames_scene_in_any_order(three_plants, fake_renderer):
    plan, last = three_plants.plan, three_plants.plan.count - 1
    expected = {
        index: FrameRenderer(three_plants).assemble(plan.frame(index), traced=False) for index in (0, last)
    }
    assert expected[0].statistics != expected[last].statistics
    for assembled in expected.values():
        organs = [instance.organ_class for instance in assembled.scene.mesh.instances]
        contacts = assembled.statistics["contacts"]
        assert contacts["fruit"] == organs.count(OrganClass.PEPPER)
        assert contacts["blades"] == organs.count(OrganClass.LEAF)
        assert 0 <= contacts["fruit_touching"] <= contacts["fruit"]
        assert 0 <= contacts["blades_touching"] <= contacts["blades"]

    renderer = FrameRenderer(three_plants, fake_renderer)
    # The second frame of a scene follows after another scene was assembled.
    for index, other in ((last, 0), (last - 1, last), (0, last), (1, 0)):
        metadata = renderer.render(plan.frame(index), LABELS).metadata
        statistics = expected[last if index > 1 else 0].statistics
        assert {key: metadata[key] for key in statistics} == statistics, index
        renderer.scene(plan.frame(other), traced=False)


def test_camera_follows_the_arc(renderer, recipe):
    poses = np.array([renderer.camera(recipe.plan.frame(step)).pose for step in range(4)])
    x, y, z = poses[:, :3, 3].T
    np.testing.assert_allclose(np.hypot(x, y), 0.4)
    np.testing.assert_allclose(z, np.linspace(0.9, 2.1, 4))
    np.testing.assert_allclose(np.degrees(np.arctan2(x, -y)), np.linspace(-45, 45, 4))
    # The pitch is 20 degrees upwards.
    np.testing.assert_allclose(poses[:, 2, 2], np.sin(np.radians(20)))


def test_each_frame_has_its_own_seed(renderer, recipe, fake_renderer, empty_scenes):
    for index in (2, 3):
        renderer.render(recipe.plan.frame(index), LABELS)
    seeds = [call.seed for call in fake_renderer.created[0].calls]
    assert seeds == [frame_seed(recipe.seed, 2), frame_seed(recipe.seed, 3)]


def test_scenes_do_not_depend_on_the_order_of_frames(renderer, recipe):
    plan, last = recipe.plan, recipe.plan.count - 1
    for index in (last, 0):
        renderer.render(plan.frame(index), LABELS)
    scene = renderer.scene(plan.frame(last))
    expected = FrameRenderer(recipe).scene(plan.frame(last))
    np.testing.assert_array_equal(scene.mesh.vertices, expected.mesh.vertices)
    np.testing.assert_array_equal(scene.sky.weights, expected.sky.weights)


# --- what a scene takes from the recipe's devices -----------------------------------------------------------


def renderer_with(changes):
    small = {"row.plants_front": 1, "row.plants_back": 0, "cultivar": "kaite_february"}
    recipe = load_recipe("barth2018", {**small, **changes})
    return FrameRenderer(recipe), recipe.plan.frame(0)


@pytest.mark.parametrize(
    "changes", [{}, {"camera.sensor": "onsemi_mt9v024_mono"}, {"camera.filter": "largan_k098_bir690uv"}]
)
def test_surfaces_cover_the_sensitive_wavelengths_and_no_more(changes):
    renderer, spec = renderer_with(changes)
    efficiency = renderer.camera(spec).sensor.quantum_efficiency
    sensitive = efficiency.wavelength_nm[(efficiency.values > 0).any(axis=0)]
    for surface in renderer.scene(spec).surfaces:
        nm = surface.wavelength_nm
        # At most one entry of the sensor's curve and one of the grid beyond.
        assert sensitive[0] - 20 < nm[0] <= sensitive[0], surface.name
        assert sensitive[-1] <= nm[-1] < sensitive[-1] + 20, surface.name


def test_cover_filters_daylight_and_keeps_its_illuminance():
    bare, covered = (
        renderer_with({"daylight.cover": name})[0].sky(0) for name in ("none", "polyethylene_film")
    )
    for sky in (bare, covered):
        assert sky.horizontal_illuminance() == pytest.approx(5500, rel=1e-3)
    # The film scatters sunlight, so that the disc is weaker, and absorbs more ultraviolet than red light.
    bare, covered = bare.sun.irradiance, covered.sun.irradiance
    assert covered.at(550)[0] < bare.at(550)[0]
    assert covered.at(380)[0] / covered.at(650)[0] < bare.at(380)[0] / bare.at(650)[0]

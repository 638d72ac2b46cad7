"""Frames and cameras from the real grammar and geometry; only the light transport is a stand-in."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.scenes.optics import largest_light_reach
from pepperscene.classes import OrganClass
from pepperscene.errors import InputError
from pepperscene.recipe.plan import frame_seed
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.scene import light_reach, view_frustums

LABELS = ("class", "distance")


@pytest.fixture
def three_plants(recipe):
    row = replace(recipe.row, plants_front=2, plants_back=1)
    return recipe.model_copy(update={"row": row})


@pytest.fixture
def renderer(recipe, fake_renderer):
    return FrameRenderer(recipe, fake_renderer)


def test_frames_of_a_scene_share_its_renderer_and_differ_in_seed(
    renderer, recipe, fake_renderer, empty_scenes
):
    for index in range(8):
        renderer.render(recipe.plan.frame(index), LABELS)
    seeds = [[call.seed for call in one.calls] for one in fake_renderer.created]
    expected = [frame_seed(recipe.seed, index) for index in range(8)]
    assert seeds == [expected[:4], expected[4:]]


def test_scenes_have_what_their_outputs_and_recipe_need(renderer, recipe, fake_renderer):
    spec = recipe.plan.frame(0)
    for outputs in (LABELS, ("amodal",), ("albedo",), ("colour",), LABELS):
        renderer.render(spec, outputs)
    labels, traced = fake_renderer.created[0], fake_renderer.created[-1]
    assert (labels.scene.surfaces, labels.scene.sky) == ((), None)
    assert len(labels.calls) == 2
    assert {surface.name for surface in traced.scene.surfaces} == set(traced.scene.mesh.surfaces)
    assert traced.scene.sky is not None
    # A renderer that traces light renders labels as well.
    assert traced.calls[-1].outputs == LABELS
    assert all(one.scene.surfaces for one in fake_renderer.created[1:])
    bare = FrameRenderer(recipe.model_copy(update={"daylight": None, "twine": None})).scene(spec)
    assert bare.sky is None
    assert "twine" not in {instance.kind for instance in bare.mesh.instances}
    assert "twine" in {instance.kind for instance in traced.scene.mesh.instances}


@pytest.mark.long
def test_each_set_has_its_own_clouds(renderer, recipe):
    def clouds(index, renderer=renderer):
        return renderer.scene(renderer.recipe.plan.frame(index)).sky.weights

    frames = recipe.plan.frames
    first, other_set = clouds(0), clouds(recipe.plan.rotations * frames)
    assert not np.array_equal(other_set, first)
    np.testing.assert_array_equal(clouds(frames), first)
    other_recipe = FrameRenderer(recipe.with_seed(recipe.seed + 1))
    assert not np.array_equal(clouds(0, other_recipe), first)


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
    # With the light of photosynthesis, for the outputs `irradiance` and `absorbed`.
    first, last = min(sensitive[0], 400), max(sensitive[-1], 700)
    for surface in renderer.scene(spec).surfaces:
        nm = surface.wavelength_nm
        # At most one entry of the sensor's curve and one of the grid beyond.
        assert first - 20 < nm[0] <= first, surface.name
        assert last <= nm[-1] < last + 20, surface.name


def test_cover_filters_daylight_and_keeps_its_illuminance():
    bare, covered = (
        renderer.sky(spec)
        for renderer, spec in (
            renderer_with({"daylight.cover": name}) for name in ("none", "polyethylene_film")
        )
    )
    for sky in (bare, covered):
        assert sky.horizontal_illuminance() == pytest.approx(5500, rel=1e-3)
    # The film scatters sunlight, so that the disc is weaker, and absorbs more ultraviolet than red light.
    bare, covered = bare.sun.irradiance, covered.sun.irradiance
    assert covered.at(550)[0] < bare.at(550)[0]
    assert covered.at(380)[0] / covered.at(650)[0] < bare.at(380)[0] / bare.at(650)[0]


BASELINE_M = 0.06  # of the recipe


@pytest.fixture
def without_partner(recipe):
    return recipe.model_copy(update={"camera": replace(recipe.camera, baseline_m=None)})


def test_other_cameras_are_passed_only_for_outputs_that_need_them(recipe, fake_renderer, empty_scenes):
    renderer, plan = FrameRenderer(recipe, fake_renderer), recipe.plan
    for outputs in (("class",), ("flow",), ("class", "stereo"), ("colour_stereo",), ("flow", "stereo")):
        renderer.render(plan.frame(1), outputs)
    renderer.render(plan.frame(plan.frames - 1), ("flow",))
    partners = [call.partners for created in fake_renderer.created for call in created.calls]
    given = [{name for name in ("flow", "stereo", "depth") if getattr(one, name)} for one in partners]
    assert given == [set(), {"flow"}, {"stereo"}, {"stereo"}, {"flow", "stereo"}, set()]
    np.testing.assert_array_equal(partners[1].flow.pose, renderer.camera(plan.frame(2)).pose)


def test_partner_is_one_baseline_to_the_right_and_shares_the_flash(recipe):
    views = FrameRenderer(recipe).views
    spec = recipe.plan.frame(2)
    camera, partner = views.camera(spec), views.partners(spec, ["stereo"]).stereo
    rotation = camera.pose[:3, :3]
    np.testing.assert_array_equal(partner.pose[:3, :3], rotation)
    offset = rotation.T @ (partner.pose[:3, 3] - camera.pose[:3, 3])
    np.testing.assert_allclose(offset, [BASELINE_M, 0, 0], atol=1e-12)
    for name in ("lens", "exposure_s", "focus_m"):
        assert getattr(partner, name) == getattr(camera, name)
    flashes = [rotation @ np.array(one.flash.offset_m) + one.pose[:3, 3] for one in (camera, partner)]
    np.testing.assert_allclose(flashes[1], flashes[0], atol=1e-12)
    dark = replace(recipe.camera, flash="none")
    developing = replace(recipe.developing, white_balance="daylight")
    views = FrameRenderer(recipe.model_copy(update={"camera": dark, "developing": developing})).views
    assert views.partners(spec, ["colour_stereo"]).stereo.flash is None


def test_stereo_outputs_need_a_baseline(without_partner, fake_renderer, empty_scenes, tmp_path):
    name = "colour_stereo"
    with pytest.raises(InputError, match=rf"small: camera\.baseline_mm: is required .*{name}"):
        FrameRenderer(without_partner, fake_renderer).render(without_partner.plan.frame(0), ("class", name))
    options = BuildOptions(renderer=fake_renderer)
    with pytest.raises(InputError, match=r"camera\.baseline_mm"):
        build(without_partner, tmp_path / "set", [0], ("class", name), options)
    assert not (tmp_path / "set").exists()


def test_frustums_include_the_partner(recipe, without_partner):
    views = FrameRenderer(recipe).views
    half_extent = np.full((1, 3), 1e-3, np.float32)
    specs = [recipe.plan.frame(step) for step in range(recipe.plan.frames)]
    frustums = views.frustums(specs)
    own = view_frustums(views.camera(specs[0]), [views.camera(spec).pose for spec in specs])
    alone = FrameRenderer(without_partner).views.frustums(specs)
    np.testing.assert_array_equal(alone.positions, own.positions)
    for spec in specs:
        partner = replace(views.partners(spec, ["stereo"]).stereo, focus_m=None)
        for slope in partner.ray_slopes()[[1, 1, -2, -2], [1, -2, 1, -2]]:
            corner = partner.pose[:3, :3] @ [*(0.99 * slope), 1.0] + partner.pose[:3, 3]
            assert frustums.intersects(corner[None].astype(np.float32), half_extent).all()


def test_the_reach_of_light_covers_all_limits_of_automatic_exposures():
    # Short exposures need hardly any daylight beside the flash, long ones much.
    limits = {"in_turn": [[10.0, 10_000.0], [10.0, 20.0]]}
    changes = {"plan.frames": 2, "camera.exposure_us": "auto", "auto_exposure.exposure_us": limits}
    recipe = load_recipe("barth2018", changes)
    renderer, specs = FrameRenderer(recipe), [recipe.plan.frame(index) for index in range(2)]
    setups = [renderer.setups.at(spec) for spec in specs]
    long, short = (largest_light_reach([setup]).sky for setup in setups)
    assert long > 2 * short > 0
    assert largest_light_reach(setups).sky == long


@pytest.mark.parametrize("elevation_deg", [10.0, 60.0])
def test_the_sun_reaches_as_far_as_its_irradiance_across_the_beam(elevation_deg):
    daylight = {"illuminance_lx": 20_000.0, "sun_fraction": 0.6, "sun_elevation_deg": elevation_deg}
    recipe = load_recipe("barth2018", {f"daylight.{key}": value for key, value in daylight.items()})
    setup = FrameRenderer(recipe).setups.at(recipe.plan.frame(0))
    # 12,000 lx on the ground are more across the beam of a low sun; the sky has the other 8,000 lx.
    across_lx = 12_000.0 / np.cos(np.radians(90.0 - elevation_deg))
    expected = light_reach(setup.camera, recipe.views.subject_m, 8000.0, across_lx)
    assert astuple(largest_light_reach([setup])) == pytest.approx(astuple(expected))

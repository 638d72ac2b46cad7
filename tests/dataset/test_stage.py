"""The stage with the real grammar, geometry and camera; only the light transport is a stand-in."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

from pepperscene.camera import load_filter, load_sensor
from pepperscene.classes import OrganClass
from pepperscene.dataset import FrameRenderer, load_recipe
from pepperscene.dataset.recipe.plan import frame_seed
from pepperscene.dataset.recipe.resolved import surface_wavelengths
from pepperscene.dataset.scenes import frame_renderer as stage_module
from pepperscene.render import QUALITIES
from pepperscene.spectra import Spectrum

LABELS = ("class", "distance")


@pytest.fixture
def three_plants(recipe):
    row = recipe.row.model_copy(update={"plants_front": 2, "plants_back": 1})
    return recipe.model_copy(update={"row": row})


def footprint(scene, plant):
    """A plant's stem, which no neighbour moves, wherever it stands: its vertices relative to their mean."""
    mesh = scene.mesh
    owner = np.array([instance.plant for instance in mesh.instances])[mesh.face_instance]
    stem = (owner == plant) & (mesh.face_class == OrganClass.STEM)
    vertices = mesh.vertices[np.unique(mesh.faces[stem])].astype(float)
    return vertices - vertices.mean(axis=0)


def test_rotation_moves_the_plants_on(three_plants, fake_renderer):
    stage = FrameRenderer(three_plants, fake_renderer, culled=False)
    plan = three_plants.plan
    before = stage.scene(plan.frame(0), traced=False)
    after = stage.scene(plan.frame(plan.frames), traced=False)
    np.testing.assert_allclose(footprint(after, 1), footprint(before, 0), atol=1e-5)
    np.testing.assert_allclose(footprint(after, 0), footprint(before, 1), atol=1e-5)
    np.testing.assert_allclose(footprint(after, 2), footprint(before, 2), atol=1e-5)


def test_plants_depend_on_set_and_place_but_not_on_how_many_there_are(three_plants, recipe, fake_renderer):
    many, one = (FrameRenderer(plan, fake_renderer, culled=False) for plan in (three_plants, recipe))
    first = footprint(many.scene(three_plants.plan.frame(0), traced=False), 0)
    np.testing.assert_allclose(footprint(one.scene(recipe.plan.frame(0), traced=False), 0), first, atol=1e-5)
    other_set = one.scene(recipe.plan.frame(recipe.plan.count - 1), traced=False)
    assert footprint(other_set, 0).shape != first.shape or not np.allclose(footprint(other_set, 0), first)


def test_one_renderer_serves_a_scene(recipe, fake_renderer):
    stage = FrameRenderer(recipe, fake_renderer)
    for index in range(8):
        stage.render(recipe.plan.frame(index), LABELS)
    assert [len(renderer.views) for renderer in fake_renderer.made] == [4, 4]


def test_labels_need_no_surfaces_and_no_sky(recipe, fake_renderer):
    stage = FrameRenderer(recipe, fake_renderer)
    shot = recipe.plan.frame(0)
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
    scene = FrameRenderer(bare, fake_renderer).scene(bare.plan.frame(0))
    assert scene.sky is None
    assert "twine" not in {instance.kind for instance in scene.mesh.instances}
    with_all = FrameRenderer(recipe, fake_renderer).scene(recipe.plan.frame(0))
    assert "twine" in {instance.kind for instance in with_all.mesh.instances}


def test_every_frame_tells_what_touches(three_plants, fake_renderer):
    stage = FrameRenderer(three_plants, fake_renderer)
    plan = three_plants.plan
    frames = [stage.render(plan.frame(index), LABELS) for index in (0, 1, plan.frames)]
    told = [frame.metadata["contacts"] for frame in frames]
    # All frames of a scene tell the same.
    assert told[0] == told[1]
    for index, found in ((0, told[0]), (plan.frames, told[2])):
        mesh = stage.scene(plan.frame(index), traced=False).mesh
        kinds = [one.organ_class for one in mesh.instances]
        assert found["fruit"] == kinds.count(OrganClass.PEPPER)
        assert found["blades"] == kinds.count(OrganClass.LEAF)
        assert 0 <= found["fruit_touching"] <= found["fruit"]
        assert 0 <= found["blades_touching"] <= found["blades"]


def test_the_camera_goes_along_the_arc(recipe, fake_renderer):
    stage = FrameRenderer(recipe, fake_renderer)
    poses = np.array([stage.camera(recipe.plan.frame(step)).pose for step in range(4)])
    places = poses[:, :3, 3]
    np.testing.assert_allclose(np.hypot(places[:, 0], places[:, 1]), 0.4)
    np.testing.assert_allclose(places[:, 2], np.linspace(0.9, 2.1, 4))
    np.testing.assert_allclose(np.degrees(np.arctan2(places[:, 0], -places[:, 1])), np.linspace(-45, 45, 4))
    # Looking 20 degrees upwards.
    np.testing.assert_allclose(poses[:, 2, 2], np.sin(np.radians(20)))


def test_every_frame_has_a_seed_of_its_own(recipe, fake_renderer):
    stage = FrameRenderer(recipe, fake_renderer)
    for index in (2, 3):
        stage.render(recipe.plan.frame(index), LABELS)
    seeds = [view[3] for view in fake_renderer.made[0].views]
    assert seeds == [frame_seed(recipe.seed, 2), frame_seed(recipe.seed, 3)]


def test_scenes_do_not_depend_on_the_order_of_the_frames(recipe, fake_renderer):
    plan, last = recipe.plan, recipe.plan.count - 1
    there_and_back = FrameRenderer(recipe, fake_renderer)
    for index in (last, 0):
        there_and_back.render(plan.frame(index), LABELS)
    scene = there_and_back.scene(plan.frame(last))
    fresh = FrameRenderer(recipe, fake_renderer).scene(plan.frame(last))
    np.testing.assert_array_equal(scene.mesh.vertices, fresh.mesh.vertices)
    np.testing.assert_array_equal(scene.sky.weights, fresh.sky.weights)


# --- what is begun while the row settles --------------------------------------------------------------------


def test_surfaces_that_were_begun_early_are_those_made_in_time(recipe, fake_renderer):
    early, shot = FrameRenderer(recipe, fake_renderer), recipe.plan.frame(0)
    early.render(shot, ("colour",))
    (begun,) = (made.scene for made in fake_renderer.made)
    late = FrameRenderer(recipe, fake_renderer).scene(shot)
    for one, other in zip(begun.surfaces, late.surfaces, strict=True):
        assert one.name == other.name
        np.testing.assert_array_equal(one.reflectance, other.reflectance)
        np.testing.assert_array_equal(one.transmittance, other.transmittance)
    np.testing.assert_array_equal(begun.mesh.vertices, late.mesh.vertices)


def test_labels_alone_begin_nothing(recipe, fake_renderer, monkeypatch):
    def fail(_):
        raise AssertionError("labels need no surfaces")

    monkeypatch.setattr(FrameRenderer, "_made_surfaces", fail)
    monkeypatch.setattr(FrameRenderer, "_begin", fail)
    FrameRenderer(recipe, fake_renderer).render(recipe.plan.frame(0), LABELS)
    assert len(fake_renderer.made) == 1


def test_what_fails_while_the_row_settles_is_told(recipe, fake_renderer, monkeypatch):
    def fail(_):
        raise ValueError("no such pigments")

    monkeypatch.setattr(FrameRenderer, "_made_surfaces", fail)
    with pytest.raises(ValueError, match="no such pigments"):
        FrameRenderer(recipe, fake_renderer).render(recipe.plan.frame(0), ("colour",))
    assert not fake_renderer.made


def test_the_renderer_begins_early_where_mitsuba_is_to_render(recipe, fake_renderer, monkeypatch):
    begun = []
    room = importlib.import_module("pepperscene.render")
    monkeypatch.setattr(room, "warm_up", lambda camera, quality: begun.append((camera, quality)))
    monkeypatch.setattr(stage_module, "mitsuba_renderer", fake_renderer)
    stage = FrameRenderer(recipe)
    for index in (0, 1):
        stage.render(recipe.plan.frame(index), LABELS)
    assert not begun
    for index in (0, 1, 2):
        stage.render(recipe.plan.frame(index), ("colour", "class"), "draft")
    ((camera, quality),) = begun
    assert camera.sensor is stage.camera(recipe.plan.frame(0)).sensor
    assert quality == QUALITIES["draft"]


# --- the camera as it is set --------------------------------------------------------------------------------


def of(changes, fake_renderer):
    recipe = load_recipe("barth2018", {"row.plants_front": 1, "row.plants_back": 0, **changes})
    return FrameRenderer(recipe, fake_renderer), recipe.plan.frame(0)


def test_settings_of_the_camera(fake_renderer):
    plain, shot = of({}, fake_renderer)
    stage, _ = of({"camera.focus_mm": 350, "camera.gain": 4, "camera.bits": 8}, fake_renderer)
    before, after = plain.camera(shot), stage.camera(shot)
    assert (before.focus_m, after.focus_m) == (0.4, 0.35)
    assert (after.sensor.gain, after.sensor.bits) == (4, 8)
    assert before.sensor.gain == 1
    # A gain of 4 makes 4 times the digital numbers of the same electrons, on a converter of 8 bits.
    span = [camera.sensor.full_scale_dn - camera.sensor.black_level_dn for camera in (before, after)]
    ratio = before.sensor.gain_e_per_dn / after.sensor.gain_e_per_dn
    assert ratio == pytest.approx(4 * span[1] / span[0])


def test_a_filter_takes_its_share(fake_renderer):
    stage, shot = of({"camera.filter": "schott_22022010"}, fake_renderer)
    bare = load_sensor("ueye_ui5250re").quantum_efficiency
    nm = np.arange(400.0, 701.0, 50.0)
    expected = bare.at(nm) * load_filter("schott_22022010").transmittance.at(nm)
    np.testing.assert_allclose(stage.camera(shot).sensor.quantum_efficiency.at(nm), expected)


@pytest.mark.parametrize(
    "changes", [{}, {"camera.sensor": "onsemi_mt9v024_mono"}, {"camera.filter": "largan_k098_bir690uv"}]
)
def test_surfaces_are_known_where_the_sensor_sees_and_no_further(fake_renderer, changes):
    stage, shot = of(changes, fake_renderer)
    efficiency = stage.camera(shot).sensor.quantum_efficiency
    seen = efficiency.wavelength_nm[(efficiency.values > 0).any(axis=0)]
    for surface in stage.scene(shot).surfaces:
        nm = surface.wavelength_nm
        assert nm[0] <= seen[0], surface.name
        assert nm[-1] >= seen[-1], surface.name
        # One entry of the sensor's curve and one of the grid beyond.
        assert nm[0] > seen[0] - 20, surface.name
        assert nm[-1] < seen[-1] + 20, surface.name


def test_the_cover_filters_the_daylight_and_keeps_its_illuminance(fake_renderer):
    skies = [
        stage.scene(shot).sky
        for stage, shot in (
            of({"daylight.cover": name}, fake_renderer) for name in ("none", "polyethylene_film")
        )
    ]
    assert [sky.horizontal_illuminance() for sky in skies] == pytest.approx([5500, 5500], rel=1e-3)
    # The film spreads sunlight, so that the disc is weaker, and takes more ultraviolet than red light.
    bare, covered = (sky.sun.irradiance for sky in skies)
    assert covered.at(550)[0] < bare.at(550)[0]
    assert covered.at(380)[0] / covered.at(650)[0] < bare.at(380)[0] / bare.at(650)[0]


def test_the_grid_of_the_surfaces_ends_where_the_sensor_does():
    def sensor(nm, efficiency):
        curve = Spectrum(np.array(nm), np.array([efficiency]))
        return replace(load_sensor("onsemi_mt9v024_mono"), quantum_efficiency=curve)

    grid = surface_wavelengths(sensor([300.0, 402.0, 500.0, 993.0, 1100.0], [0.0, 0.0, 0.5, 0.0, 0.0]))
    np.testing.assert_array_equal(grid, np.arange(400.0, 996.0, 5.0))
    # A curve that ends high is zero beyond.
    np.testing.assert_array_equal(
        surface_wavelengths(sensor([400.0, 412.0], [0.5, 0.5])), [400, 405, 410, 415]
    )
    with pytest.raises(ValueError, match="sees up to 2600 nm"):
        surface_wavelengths(sensor([900.0, 2600.0], [0.5, 0.5]))
    with pytest.raises(ValueError, match="sees no light at all"):
        surface_wavelengths(sensor([400.0, 700.0], [0.0, 0.0]))

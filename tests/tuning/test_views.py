"""Views: single organs, large in the picture, in the light and at the f-number of the recipe's own camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_fits import KINDS, no_patches

from pepperscene.camera import Distortion
from pepperscene.classes import OrganClass
from pepperscene.dataset import load_recipe
from pepperscene.dataset.recipe.equipment import surface_wavelengths
from pepperscene.errors import InputError
from pepperscene.materials import organ_surfaces
from pepperscene.render import Renderer
from pepperscene.render.quality import Quality
from pepperscene.tuning.model.target import TuningTarget
from pepperscene.tuning.model.views import POSITIONS, organ_views, with_surfaces

PIXELS = 24


@pytest.fixture(scope="module")
def subject() -> TuningTarget:
    return TuningTarget(load_recipe("barth2018"), no_patches(), registered=True, pixels=PIXELS)


def views_of(subject, kinds, **how):
    how = {"organs": 1, "pixels": PIXELS, "sky": subject.frame_renderer.sky(0), **how}
    return organ_views(subject.recipe, subject.cultivar, subject.camera, kinds, **how)


# --- which organs -----------------------------------------------------------------------------------------


def test_every_kind_has_its_organs(subject):
    names = [view.name for view in subject.views]
    assert len(set(names)) == len(names)
    assert {view.kind for view in subject.views} == set(KINDS)
    for view in subject.views:
        (organ,) = view.scene.mesh.instances
        assert organ.organ_class == OrganClass[view.kind.partition(".")[0].upper()]
        assert view.name.startswith(view.kind)


def test_stages_of_fruit_are_told_by_their_ripeness(subject):
    state = {view.name: view.scene.mesh.state.mean() for view in subject.views}
    assert all(state[name] < 0.5 for name in state if name.startswith("pepper.unripe"))
    assert all(state[name] >= 0.5 for name in state if name.startswith("pepper.ripe"))


def test_organs_of_one_surface_go_from_the_lowest_state_to_the_highest(subject):
    for kind in KINDS:
        by_surface = {}
        for view in subject.views:
            if view.kind == kind:
                mesh = view.scene.mesh
                by_surface.setdefault(mesh.surfaces, []).append(mesh.state[mesh.faces].mean())
        assert all(states == sorted(states) for states in by_surface.values())


def test_a_kind_of_two_surfaces_shows_both(subject):
    """The calyx of a fruit counts as its stalk, and shows more: without turns no stalk would be seen."""
    shown = [view.scene.mesh.surfaces for view in subject.views if view.kind == "peduncle"]
    assert set(shown) == {("peduncle",), ("calyx",)}


def test_views_are_the_same_each_time_and_others_with_another_seed(subject):
    (one,), (same,), (other,) = (views_of(subject, ["leaf"], seed=seed) for seed in (0, 0, 5))
    assert np.array_equal(one.scene.mesh.vertices, same.scene.mesh.vertices)
    assert np.array_equal(one.camera.pose, same.camera.pose)
    assert np.array_equal(one.mask, same.mask)
    different = one.scene.mesh.vertices.shape != other.scene.mesh.vertices.shape
    assert different or not np.array_equal(one.scene.mesh.vertices, other.scene.mesh.vertices)


def test_the_views_of_one_kind_do_not_depend_on_the_others(subject):
    (alone,), (first, _) = views_of(subject, ["stem"]), views_of(subject, ["stem", "shoot"])
    assert np.array_equal(alone.scene.mesh.vertices, first.scene.mesh.vertices)
    assert np.array_equal(alone.mask, first.mask)


@pytest.mark.parametrize("kind", ["wire", "background", "tomato", "pepper.rotten", "leaf.ripe"])
def test_what_is_no_organ_is_refused_in_a_sentence(subject, kind):
    with pytest.raises(InputError) as told:
        views_of(subject, ["leaf", kind])
    said = str(told.value)
    assert kind in said
    assert "must be one of" in said
    assert "pepper.unripe" in said
    assert "\n" not in said


def test_a_kind_that_no_plant_has_is_refused_in_a_sentence(subject):
    """A cultivar whose fruit never ripens has no ripe ones."""
    fruit = subject.cultivar.organs["fruit"]
    shares = {
        name: getattr(fruit, name).model_copy(update={"mean": 0.0, "sd": 0.0, "low": 0.0, "high": 0.0})
        for name in ("ripe_fraction", "ripe_descent", "breaker_fraction")
    }
    never = subject.cultivar.model_copy(
        update={"organs": {**subject.cultivar.organs, "fruit": fruit.model_copy(update=shares)}}
    )
    with pytest.raises(InputError, match=r"must have organs of the kind 'pepper\.ripe'"):
        organ_views(subject.recipe, never, subject.camera, ["pepper.ripe"], organs=1, pixels=PIXELS)


# --- the picture ------------------------------------------------------------------------------------------


def test_masks_hold_the_organ_alone(subject):
    """Not even beside them, in a pixel around, shows anything else."""
    for view in subject.views:
        seen = Renderer(view.scene).render(view.camera, ["class"])["class"]
        wanted = OrganClass[view.kind.partition(".")[0].upper()]
        padded = np.pad(seen == wanted, 1, constant_values=True)
        rows, columns = np.nonzero(view.mask)
        assert len(rows) > 0
        for down in (0, 1, 2):
            for right in (0, 1, 2):
                assert padded[rows + down, columns + right].all()


def test_organs_stand_where_places_say(subject):
    """At these slopes off the axis, and so far away: the middle of the view shows a point of the organ."""
    for view in subject.views:
        right, down, far = POSITIONS[int(view.name.split()[-1]) - 1]
        wanted = 1e-3 * subject.recipe.path.distance_mm * far * np.array([right, down, 1.0])
        inverse = np.linalg.inv(view.camera.pose)
        points = view.scene.mesh.vertices.astype(float) @ inverse[:3, :3].T + inverse[:3, 3]
        assert np.linalg.norm(points - wanted, axis=1).min() < 1e-4
        # A pixel of the middle looks there.
        middle = view.camera.intrinsics @ wanted
        assert middle[:2] / middle[2] == pytest.approx([PIXELS / 2, PIXELS / 2], abs=1e-6)


def test_pitch_and_f_number_are_the_recipes(subject):
    for view in subject.views:
        forward = view.camera.pose[:3, 2]
        assert np.degrees(np.arcsin(forward[2])) == pytest.approx(subject.recipe.path.pitch_deg)
        assert view.camera.lens.f_number == subject.camera.lens.f_number
        assert view.camera.flash is subject.camera.flash
        assert view.camera.exposure_s == subject.camera.exposure_s


@pytest.mark.parametrize("kind", ["leaf", "stem"])
def test_electrons_are_those_that_the_recipes_own_camera_counts(subject, kind):
    """A longer lens of the same f-number: pixels see less each, and are as bright.

    The own camera stands in the same place; its lens draws straight here, so that pixels can be told apart,
    and of its picture the piece around the organ is enough.
    """
    (view,) = views_of(subject, [kind], pixels=48)
    light = Quality(36, 36, 36, 1, target=None, denoise=False)
    large = Renderer(view.scene).render(view.camera, ["electrons"], light, 1)["electrons"]
    lens, own = view.camera.lens, subject.camera.lens
    shorter = own.focal_length_m / lens.focal_length_m
    off = tuple(shorter * offset for offset in lens.principal_offset_m)
    camera = replace(
        subject.camera,
        lens=replace(own, distortion=Distortion(), principal_offset_m=off),
        sensor=replace(subject.camera.sensor, columns=100, rows=100),
        pose=view.camera.pose,
        focus_m=None,
    )
    small = Renderer(view.scene).render(camera, ["electrons"], light, 2)["electrons"]

    # Each pixel of the small picture, where the large one shows it.
    rows, columns = np.mgrid[: camera.height, : camera.width]
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones_like(rows)], axis=-1)
    rays = pixels @ np.linalg.inv(camera.intrinsics).T
    seen = rays @ view.camera.intrinsics.T
    at = np.floor(seen[..., :2]).astype(int)
    within = ((at >= 0) & (at < view.mask.shape)).all(axis=-1)
    shown = np.zeros_like(within)
    shown[within] = view.mask[at[within][:, 1], at[within][:, 0]]
    assert shown.sum() > 50
    here, there = small[shown].mean(axis=0), large[at[shown][:, 1], at[shown][:, 0]].mean(axis=0)
    assert here == pytest.approx(there, rel=0.02)


def test_other_surfaces_keep_everything_else(subject):
    (view,) = views_of(subject, ["leaf"])
    path = subject.cultivar.pigments["leaf"]
    pale = path.model_copy(update={"roughness": (0.2, 0.2)})
    plants = subject.cultivar.model_copy(update={"pigments": {**subject.cultivar.pigments, "leaf": pale}})
    other = with_surfaces(view, organ_surfaces(plants, surface_wavelengths(subject.camera.sensor)))
    assert other.scene.mesh is view.scene.mesh
    assert other.scene.sky is view.scene.sky
    assert other.camera is view.camera
    (before,), (after,) = view.scene.surfaces, other.scene.surfaces
    assert before.name == after.name == "leaf"
    assert after is not before

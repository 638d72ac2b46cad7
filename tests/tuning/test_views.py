"""Views: enlarged images of single organs in the light and at the f-number of the recipe's camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_fits import KINDS, no_patches

from pepperscene.camera import Distortion
from pepperscene.classes import OrganClass
from pepperscene.errors import InputError
from pepperscene.materials import organ_surfaces
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import surface_wavelengths
from pepperscene.render import Renderer
from pepperscene.render.quality import Quality
from pepperscene.tuning.target import TuningTarget
from pepperscene.tuning.views import POSITIONS, organ_views, with_surfaces

PIXELS = 24


@pytest.fixture(scope="module")
def target() -> TuningTarget:
    return TuningTarget(load_recipe("barth2018"), no_patches(), registered=True, organs=2, pixels=PIXELS)


def views_of(target, kinds, **changes):
    options = {
        "organs": 1,
        "pixels": PIXELS,
        "sky": target.frame_renderer.sky(target.recipe.plan.frame(0)),
        **changes,
    }
    return organ_views(target.recipe, target.cultivar, target.camera, kinds, **options)


@pytest.fixture(scope="module")
def leaf(target):
    (view,) = views_of(target, ["leaf"])
    return view


def same_view(one, other) -> bool:
    vertices, others = one.scene.mesh.vertices, other.scene.mesh.vertices
    return (
        np.array_equal(vertices, others)
        and np.array_equal(one.camera.pose, other.camera.pose)
        and np.array_equal(one.mask, other.mask)
    )


def test_every_kind_has_organs_of_its_class(target):
    names = [view.name for view in target.views]
    assert len(set(names)) == len(names)
    assert {view.kind for view in target.views} == set(KINDS)
    for view in target.views:
        (organ,) = view.scene.mesh.instances
        assert organ.organ_class == OrganClass[view.kind.partition(".")[0].upper()]
        assert view.name.startswith(view.kind)


def test_organs_have_ascending_states_of_their_stages(target):
    for kind in KINDS:
        by_surface = {}
        for view in target.views:
            if view.kind == kind:
                mesh = view.scene.mesh
                by_surface.setdefault(mesh.surfaces, []).append(mesh.state[mesh.faces].mean())
                if kind.startswith("pepper"):
                    assert (mesh.state.mean() >= 0.5) == (kind == "pepper.ripe")
        assert all(states == sorted(states) for states in by_surface.values())
        # The calyx of a fruit is of the same kind as its stalk, and its area is larger.
        assert kind != "peduncle" or set(by_surface) == {("peduncle",), ("calyx",)}


@pytest.mark.long
def test_views_depend_on_the_seed_and_not_on_other_kinds(target, leaf):
    (same, _), (other,) = views_of(target, ["leaf", "stem"]), views_of(target, ["leaf"], seed=5)
    assert same_view(leaf, same)
    assert not np.array_equal(leaf.scene.mesh.vertices, other.scene.mesh.vertices)


def test_raises_on_kinds_that_are_not_organs(target):
    for kind in ("wire", "tomato", "pepper.rotten", "leaf.ripe"):
        with pytest.raises(InputError, match=r"must be one of .*pepper\.unripe") as error:
            views_of(target, ["leaf", kind])
        assert kind in str(error.value)
        assert "\n" not in str(error.value)


def test_raises_on_a_kind_that_no_plant_has(target):
    """The fruit of this cultivar never ripens."""
    fruit = target.cultivar.organs["fruit"]
    fractions = {
        name: getattr(fruit, name).model_copy(update={"mean": 0.0, "sd": 0.0, "low": 0.0, "high": 0.0})
        for name in ("ripe_fraction", "ripe_descent", "breaker_fraction")
    }
    organs = {**target.cultivar.organs, "fruit": fruit.model_copy(update=fractions)}
    unripe = target.cultivar.model_copy(update={"organs": organs})
    with pytest.raises(InputError, match=r"must have organs of the kind 'pepper\.ripe'"):
        organ_views(target.recipe, unripe, target.camera, ["pepper.ripe"], organs=1, pixels=PIXELS)


def test_masked_pixels_and_their_neighbours_show_the_organ(target):
    for view in target.views:
        classes = Renderer(view.scene).render(view.camera, ["class"])["class"]
        organ = classes == OrganClass[view.kind.partition(".")[0].upper()]
        padded = np.pad(organ, 1, constant_values=True)
        rows, columns = np.nonzero(view.mask)
        assert len(rows) > 0
        for down in (0, 1, 2):
            for right in (0, 1, 2):
                assert padded[rows + down, columns + right].all()


def test_organs_are_at_the_stated_positions(target):
    """A point of the organ is at the position, and the middle of the view shows it."""
    for view in target.views:
        right, down, distance = POSITIONS[int(view.name.split()[-1]) - 1]
        position = target.recipe.views.distance_m * distance * np.array([right, down, 1.0])
        inverse = np.linalg.inv(view.camera.pose)
        points = view.scene.mesh.vertices.astype(float) @ inverse[:3, :3].T + inverse[:3, 3]
        assert np.linalg.norm(points - position, axis=1).min() < 1e-4
        middle = view.camera.intrinsics @ position
        assert middle[:2] / middle[2] == pytest.approx([PIXELS / 2, PIXELS / 2], abs=1e-6)


def test_pitch_f_number_flash_and_exposure_are_the_recipes(target):
    for view in target.views:
        forward = view.camera.pose[:3, 2]
        assert np.arcsin(forward[2]) == pytest.approx(target.recipe.views.pitch_rad)
        assert view.camera.lens.f_number == target.camera.lens.f_number
        assert view.camera.flash is target.camera.flash
        assert view.camera.exposure_s == target.camera.exposure_s


@pytest.mark.parametrize("kind", ["leaf", pytest.param("stem", marks=pytest.mark.long)])
def test_electrons_are_those_of_the_recipes_lens(target, kind):
    """A longer lens of the same f-number: pixels see less each, and are as bright.

    The recipe's lens is at the same position, without distortion, so that pixels can be matched; the part of
    its image around the organ is enough. Neither has stray light, which spreads light from a narrow stem over
    its surroundings and is none of a view's.
    """
    (view,) = views_of(target, [kind], pixels=48)
    quality = Quality(36, 36, 36, 1, target=None, denoise=False)
    large = Renderer(view.scene).render(view.camera, ["electrons"], quality, 1)["electrons"]
    lens, recipe_lens = view.camera.lens, target.camera.lens
    ratio = recipe_lens.focal_length_m / lens.focal_length_m
    offset = tuple(ratio * one for one in lens.principal_offset_m)
    camera = replace(
        target.camera,
        lens=replace(recipe_lens, distortion=Distortion(), principal_offset_m=offset),
        sensor=replace(target.camera.sensor, columns=100, rows=100),
        pose=view.camera.pose,
        focus_m=None,
        developing=view.camera.developing,
    )
    small = Renderer(view.scene).render(camera, ["electrons"], quality, 2)["electrons"]

    # Find each pixel of the small image in the large one.
    rows, columns = np.mgrid[: camera.height, : camera.width]
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones_like(rows)], axis=-1)
    projected = pixels @ np.linalg.inv(camera.intrinsics).T @ view.camera.intrinsics.T
    at = np.floor(projected[..., :2]).astype(int)
    inside = ((at >= 0) & (at < view.mask.shape)).all(axis=-1)
    organ = np.zeros_like(inside)
    organ[inside] = view.mask[at[inside][:, 1], at[inside][:, 0]]
    assert organ.sum() > 50
    expected = large[at[organ][:, 1], at[organ][:, 0]].mean(axis=0)
    assert small[organ].mean(axis=0) == pytest.approx(expected, rel=0.02)


def test_with_surfaces_replaces_nothing_else(target, leaf):
    path = target.cultivar.pigments["leaf"]
    pale = path.model_copy(update={"roughness": (0.2, 0.2)})
    plants = target.cultivar.model_copy(update={"pigments": {**target.cultivar.pigments, "leaf": pale}})
    other = with_surfaces(leaf, organ_surfaces(plants, surface_wavelengths(target.camera.sensor)))
    assert other.scene.mesh is leaf.scene.mesh
    assert other.scene.sky is leaf.scene.sky
    assert other.camera is leaf.camera
    (before,), (after,) = leaf.scene.surfaces, other.scene.surfaces
    assert before.name == after.name == "leaf"
    assert after is not before

"""Scenes and skeletons: surfaces match the mesh, and centrelines are inside the bodies of their organs."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import JointRotation, concatenate_meshes, mesh_plant, move_plant, rectangle
from pepperscene.grammar import grow
from pepperscene.materials import lambertian_surface
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.views.free_space import winding_number
from pepperscene.scene import Scene, Skeleton, assemble_scene, build_skeleton

MESH = concatenate_meshes(
    [
        rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1), surface="leaf"),
        rectangle((0, 1, 1), (1, 0, 0), (0, 0, 1), surface="fruit"),
        rectangle((0, 2, 1), (1, 0, 0), (0, 0, 1), surface="leaf"),
    ]
)
LEAF, FRUIT, STEM = (lambertian_surface(name, 0.5) for name in ("leaf", "fruit", "stem"))


def test_surfaces_are_in_the_order_of_the_mesh():
    scene = assemble_scene(MESH, {"stem": STEM, "fruit": FRUIT, "leaf": LEAF})
    assert scene.surfaces == (LEAF, FRUIT)
    names = [scene.surfaces[number].name for number in scene.mesh.face_surface[::2]]
    assert names == ["leaf", "fruit", "leaf"]


def test_raises_on_missing_or_mismatched_surfaces():
    with pytest.raises(ValueError, match=r"leaf.*fruit"):
        assemble_scene(MESH, {"stem": STEM})
    for surfaces in ((FRUIT, LEAF), (LEAF,), (LEAF, FRUIT, STEM)):
        with pytest.raises(ValueError, match="do not match"):
            Scene(MESH, surfaces)


@pytest.fixture(scope="module", params=["barth2018", "greenhouse"])
def planted(request):
    """A built row: upright plants, and leaning, rotated ones of another crop in their greenhouse."""
    # Close together, so that there are contacts to resolve.
    changes = {"row.plants_front": 2, "row.plants_back": 1, "row.spacing_mm": 90, "row.gap_mm": 220}
    if request.param == "greenhouse":
        changes |= {"cultivar": "tomato", "greenhouse.far_rows": 0}
    recipe = load_recipe(request.param, changes)
    return SceneBuilder(recipe, load_cultivar(recipe.cultivar), 1).scene(0, 1)


@pytest.fixture(scope="module")
def plant():
    return grow(load_cultivar("kaite_february"), np.random.default_rng(3))


def points_along(curve, fractions):
    position = np.asarray(fractions) * (len(curve) - 1)
    low = np.minimum(position.astype(int), len(curve) - 2)
    return curve[low] + (position - low)[:, None] * (curve[low + 1] - curve[low])


@pytest.mark.parametrize(("form", "fractions"), [("peduncle", [0.1, 0.4, 0.9]), ("fruit", [0.3, 0.5])])
def test_centrelines_are_inside_their_bodies(planted, form, fractions):
    assert planted.skeleton.motions  # without them the test would prove little
    instances = planted.skeleton.of_form(form)
    if form == "peduncle":
        # Only those that bear fruit; a truss has few rings for its length, and its body cuts corners.
        instances = sorted({planted.mesh.instances[one].parent for one in planted.skeleton.of_form("calyx")})
    assert len(instances) >= 5
    for number in instances[::3]:
        organ, instance = planted.skeleton.organ(number), planted.mesh.instances[number]
        assert (organ.kind, organ.phytomer, organ.parent) == (
            instance.kind, instance.phytomer, instance.parent,
        )  # fmt: skip
        corners = planted.mesh.vertices[planted.mesh.faces[planted.mesh.face_instance == number]]
        for point in points_along(organ.curve, fractions):
            assert winding_number(point, corners.astype(float)) == pytest.approx(1.0, abs=1e-3)


def test_skeleton_holds_exactly_the_plants_organs(planted):
    skeleton, instances = planted.skeleton, planted.mesh.instances
    kinds = [skeleton.kind(number) for number in range(len(instances))]
    assert len(kinds) - kinds.count(None) == sum(len(plant.organs) for plant in skeleton.plants)
    others = [number for number, kind in enumerate(kinds) if kind is None]
    assert {instances[number].kind for number in others} >= {"twine"}
    for kind, instance in zip(kinds, instances, strict=True):
        assert kind is None or kind.organ_class == instance.organ_class
    for number in (min(others), -1, len(instances) + 1000):
        assert skeleton.kind(number) is None
        with pytest.raises(ValueError, match="not an organ"):
            skeleton.organ(number)


def test_motions_apply_to_the_second_plant_as_to_a_single_one(plant):
    # Several rotations, of organs and of those that they grow on, in an order that matters.
    forms = {name: kind.form for name, kind in plant.kinds.items()}
    fruit = next(i for i, organ in enumerate(plant.organs) if forms[organ.kind] == "fruit")
    calyx = plant.organs[fruit].parent
    stalk = plant.organs[calyx].parent
    rng = np.random.default_rng(4)
    motions = []
    for index in (stalk, fruit, stalk, calyx):
        turn = trimesh.transformations.rotation_matrix(rng.uniform(0.1, 1.0), rng.normal(size=3))[:3, :3]
        motions.append(JointRotation(index, turn, rng.normal(size=3)))
    moved = move_plant(plant, motions)
    # The first plant's mesh has one instance more than organs.
    size = len(plant.organs)
    shifted = tuple(replace(motion, instance=motion.instance + size + 1) for motion in motions)
    skeleton = Skeleton((plant, plant), (size + 1, size), np.zeros((2, 3)), np.zeros(2), shifted)
    for index in (fruit, calyx, stalk, 0):
        organ = skeleton.organ(size + 1 + index)
        np.testing.assert_allclose(organ.curve, moved.organs[index].curve, atol=1e-12)
        np.testing.assert_allclose(organ.up, moved.organs[index].up, atol=1e-12)
        np.testing.assert_array_equal(skeleton.organ(index).curve, plant.organs[index].curve)


def test_skeleton_of_an_unsupported_plant_matches_its_mesh(plant):
    skeleton, mesh = build_skeleton([plant]), mesh_plant(plant, 0.5)
    fruit = skeleton.of_form("fruit")
    assert fruit
    assert fruit == skeleton.of_form("fruit", plant=0)
    assert all(mesh.instances[index].kind == skeleton.organ(index).kind for index in fruit)


def test_skeleton_can_be_pickled(planted):
    copy = pickle.loads(pickle.dumps(planted.skeleton))
    for instance in planted.skeleton.of_form("fruit")[:3]:
        np.testing.assert_array_equal(copy.organ(instance).curve, planted.skeleton.organ(instance).curve)

"""Edits of a living scene: images, truth and numbers follow, and everything else stays as it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import row_cache
import trimesh

import pepperscene as ps
from pepperscene.errors import ArgumentError
from pepperscene.live.cut import cut_tube
from pepperscene.render import Renderer
from pepperscene.render.kernel.split_scene import join_parts

IMAGES = ("class", "instance", "distance", "depth_z", "normal")


def assert_same_images(frame, expected, names=IMAGES):
    for name in names:
        np.testing.assert_array_equal(frame[name], expected[name], err_msg=name)


def visible_fruit(scene, least=0.1):
    """Fruit in view, the most visible first."""
    scene.render()
    fruit = sorted(scene.fruit, key=lambda one: -one.visible_fraction)
    return [one for one in fruit if one.visible_fraction > least]


@pytest.fixture(scope="module")
def whole(small_recipe, rows):
    """The scene of the recipe as one mesh, with nothing left out."""
    with row_cache.rows_from(rows):
        frames = ps.FrameRenderer(small_recipe, culled=False)
        return frames.scene(small_recipe.plan.frame(1), traced=False)


def test_picked_fruit_are_gone_as_if_they_had_never_been_there(scene, whole):
    # Its own stumps have other triangles than the scene that it was assembled with.
    mesh, skeleton = whole.mesh, replace(whole.skeleton, fingerprints=None)
    gone, rests = [], []
    for fruit in visible_fruit(scene)[:4]:
        scene.pick(fruit.instance)
        stalk = fruit.stalk - 1
        gone += list(skeleton.branch(stalk))
        # The stump that is left.
        part = mesh.select_faces(np.flatnonzero(mesh.face_instance == stalk))
        radius_m = skeleton.organ(stalk).measures["radius_m"]
        rests.append(cut_tube(part, fruit.cut, fruit.cut_tangent, radius_m))
        expected = join_parts([mesh.without_triangles(np.array(gone)), *rests])
        built = Renderer(ps.Scene(expected, skeleton=skeleton)).render(scene.camera, (*IMAGES, "harvest"))
        frame = scene.render(outputs=(*IMAGES, "harvest"))
        assert_same_images(frame, built)
        assert frame["harvest"] == built["harvest"]
        assert fruit.instance not in [one.instance for one in scene.fruit]
        kinds = {mesh.instances[index].kind for index in gone}
        assert kinds == {"peduncle", "fruit", "calyx"}


def test_a_stalk_is_cut_at_its_cut_point(whole):
    mesh = whole.mesh
    for truth in Renderer(whole).fruit_truths()[:12]:
        stalk = truth.stalk
        part = mesh.select_faces(np.flatnonzero(mesh.face_instance == stalk.instance))
        rest = cut_tube(part, stalk.cut, stalk.tangent, stalk.radius_m)
        beyond = (rest.vertices - stalk.cut) @ stalk.tangent
        is_near = np.linalg.norm(rest.vertices - stalk.cut, axis=1) < 3.0 * stalk.radius_m
        assert beyond[is_near].max() < 1e-6
        # The flat end is a disc of about the stalk's radius that faces the cut.
        solid = trimesh.Trimesh(rest.vertices, rest.faces, process=False)
        is_end = (np.abs(beyond[rest.faces]) < 1e-6).all(axis=1)
        assert (solid.face_normals[is_end & (solid.area_faces > 1e-9)] @ stalk.tangent > 0.99).all()
        area = solid.area_faces[is_end].sum()
        assert 0.5 < area / (np.pi * stalk.radius_m**2) < 8.0  # its collar is wider
        assert np.isfinite(rest.normals).all()
        assert solid.area < trimesh.Trimesh(part.vertices, part.faces, process=False).area


def test_moving_a_fruit_moves_every_entry_of_its_truth(scene):
    fruit = visible_fruit(scene)[0]
    before = scene.render(outputs=("harvest", "instance"))
    shift = np.array([0.03, -0.04, 0.0])
    pose = fruit.pose.copy()
    pose[:3, 3] += shift
    scene.move(fruit.instance, pose)
    moved = scene.fruit.of(fruit.instance)
    for name in ("blossom_end", "cut", "stalk_curve"):
        np.testing.assert_allclose(getattr(moved, name), getattr(fruit, name) + shift, atol=1e-7)
    np.testing.assert_allclose(moved.pose, pose, atol=1e-9)
    for name in ("cut_tangent", "size_m"):
        np.testing.assert_allclose(getattr(moved, name), getattr(fruit, name), atol=1e-6)
    after = scene.render(outputs=("harvest", "instance"))
    old, new = (
        next(one for one in frame["harvest"]["fruit"] if one["instance"] == fruit.instance)
        for frame in (before, after)
    )
    for path in (("stalk_end",), ("blossom_end",), ("peduncle", "cut"), ("peduncle", "attachment")):
        points = []
        for entry in (old, new):
            for key in path:
                entry = entry[key]
            points.append(np.array(entry["world_m"]))
        np.testing.assert_allclose(points[1] - points[0], shift, atol=2e-6)
    np.testing.assert_allclose(new["box_3d"]["size"], old["box_3d"]["size"], atol=2e-6)
    # Every other fruit stays.
    others = {one.instance: one for one in scene.fruit if one.instance != fruit.instance}
    for number, one in others.items():
        np.testing.assert_array_equal(one.pose, scene.copy().fruit.of(number).pose)
    # A turn moves it about its stalk end.
    turned = moved.pose.copy()
    turned[:3, :3] = turned[:3, :3] @ trimesh.transformations.euler_matrix(0.4, -0.2, 0.3)[:3, :3]
    scene.move(fruit.instance, turned)
    np.testing.assert_allclose(scene.fruit.of(fruit.instance).pose, turned, atol=1e-9)


def test_random_edits_and_reset_give_the_first_image_again(scene):
    rng = np.random.default_rng(5)
    first = scene.render(outputs=IMAGES)
    numbers = [one.instance for one in scene.organs]
    for action in rng.permutation(["pick", "remove", "add", "move"] * 5):
        organs = scene.organs
        kinds = {"pick": {"fruit"}, "remove": {"lamina", "object"}}.get(
            action, {"fruit", "petiole", "object"}
        )
        near = [one for one in organs if one.kind in kinds]
        chosen = near[int(rng.integers(len(near)))]
        pose = chosen.pose.copy()
        pose[:3, 3] += rng.uniform(-0.02, 0.02, 3)
        if action == "pick":
            scene.pick(chosen.instance)
        elif action == "remove":
            scene.remove(chosen.instance)
        elif action == "add":
            scene.add(trimesh.creation.icosphere(radius=0.02), pose)
        else:
            scene.move(chosen.instance, pose)
    edited = scene.render(outputs=IMAGES)
    assert not np.array_equal(edited["instance"], first["instance"])
    scene.reset()
    assert_same_images(scene.render(outputs=IMAGES), first)
    assert [one.instance for one in scene.organs] == numbers


def test_objects_have_numbers_of_their_own(scene):
    before = scene.render()
    camera = scene.camera
    pose = camera.pose.copy()
    pose[:3, 3] += 0.2 * pose[:3, 2]
    numbers = [scene.add(trimesh.creation.box((0.04, 0.04, 0.04)), pose, "pipe", kind=k) for k in ("a", "b")]
    assert numbers[1] == numbers[0] + 1
    scene.remove(numbers[0])
    frame = scene.render()
    is_box = frame["instance"] == numbers[1]
    assert numbers[0] not in frame["instance"]
    assert frame.metadata["instances"][str(numbers[1])]["kind"] == "b"
    # The front of the cube is 18 cm away.
    assert frame["depth_z"][is_box].min() == pytest.approx(0.18, abs=1e-5)
    np.testing.assert_array_equal(frame["instance"][~is_box], before["instance"][~is_box])
    assert (frame["class"][is_box] == 0).all()
    assert scene.organs.of(numbers[1]).pose == pytest.approx(pose)
    moved = pose.copy()
    moved[:3, 3] += 0.1 * pose[:3, 2]
    scene.move(numbers[1], moved)
    depth = scene.render()["depth_z"]
    assert depth[is_box].min() == pytest.approx(0.28, abs=1e-5)
    assert scene.add(trimesh.creation.box((0.1, 0.1, 0.1))) == numbers[1] + 1


def test_leaves_can_be_taken_off(scene):
    petiole = next(one for one in scene.organs if one.kind == "petiole")
    leaf = next(one for one in scene.organs if one.parent == petiole.instance)
    scene.remove(petiole.instance)
    left = {one.instance for one in scene.organs}
    assert left.isdisjoint({petiole.instance, leaf.instance})
    with pytest.raises(ArgumentError, match=f"{leaf.instance}, a lamina, is not in the scene any more"):
        scene.move(leaf.instance, leaf.pose)


def test_copies_are_edited_on_their_own(scene):
    first = scene.render()
    other = scene.copy()
    other.pick(visible_fruit(other)[0].instance)
    assert not np.array_equal(other.render()["instance"], first["instance"])
    assert_same_images(scene.render(), first, ("class", "instance", "depth_z"))


def test_traits_follow_edits(scene, small_recipe):
    """Before the edits they are those of the recipe's command."""
    before, grown = scene.traits(), ps.plant_traits(small_recipe, 1)
    assert before.leaves["area_m2"].to_pylist() == grown.leaves["area_m2"].to_pylist()
    assert before.plants["leaf_area_index"].to_pylist() == grown.plants["leaf_area_index"].to_pylist()
    one, other, *_ = scene.fruit
    scene.pick(one.instance)
    pose = other.pose.copy()
    pose[2, 3] += 0.05
    scene.move(other.instance, pose)
    left = {row["instance"]: row for row in scene.traits().fruit.to_pylist()}
    fruit = {row["instance"]: row for row in before.fruit.to_pylist() if row["instance"] != one.instance}
    assert left.keys() == fruit.keys()
    for number, row in left.items():
        lifted = 0.05 if number == other.instance else 0.0
        assert row["z_m"] - fruit[number]["z_m"] == pytest.approx(lifted, abs=1e-6)
        assert row["volume_m3"] == pytest.approx(fruit[number]["volume_m3"], rel=1e-4)


def test_tables_have_the_attributes_as_columns(scene):
    fruit, organs = scene.fruit, scene.organs
    table = fruit.to_table().to_pylist()
    assert [row["instance"] for row in table] == [one.instance for one in fruit]
    np.testing.assert_array_equal(table[0]["pose"], fruit[0].pose.ravel())
    rows = organs.to_table().to_pylist()
    assert len(rows) == len(organs)
    assert rows[0]["kind"] == organs[0].kind


CUBE = trimesh.creation.box((0.1, 0.1, 0.1))


def with_nan():
    bad = CUBE.copy()
    bad.vertices = np.where(np.arange(8)[:, None] == 3, np.nan, bad.vertices)
    return bad


FRUIT, LEAF, TWINE = (
    lambda scene: scene.fruit[0].instance,
    lambda scene: next(one.instance for one in scene.organs if one.kind == "lamina"),
    lambda scene: 1 + [one.kind for one in scene._state.instances].index("twine"),
)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda scene: scene.pick(LEAF(scene)), "a lamina, not a fruit"),
        (lambda scene: scene.pick(0), "must be from 1 to"),
        (lambda scene: scene.pick(10**6), "must be from 1 to"),
        (lambda scene: scene.pick(1.5), "must be a number of the instance image"),
        (lambda scene: scene.pick(True), "must be a number of the instance image"),
        (lambda scene: scene.move(FRUIT(scene), np.diag([-1.0, 1, 1, 1])), "must be a rotation"),
        (lambda scene: scene.move(FRUIT(scene), np.eye(3)), "must have the shape"),
        (lambda scene: scene.move(FRUIT(scene), np.stack([np.eye(4)] * 2)), "must be one pose, not 2"),
        (lambda scene: scene.move(TWINE(scene), np.eye(4)), "neither an organ of a plant nor"),
        (lambda scene: scene.remove(TWINE(scene)), "neither an organ of a plant nor"),
        (lambda scene: scene.add(with_nan()), "finite"),
        (lambda scene: scene.add(trimesh.Trimesh()), "must have triangles"),
        (lambda scene: scene.add("box.glb"), "must be a Mesh or a trimesh"),
        (lambda scene: scene.add(CUBE, np.zeros((4, 4))), "must be a rotation"),
        (lambda scene: scene.add(CUBE, surface="gold"), "must be one of"),
        (lambda scene: scene.add(CUBE, surface=ps.lambertian_surface("leaf", 0.5)), "another surface named"),
        (lambda scene: scene.add(CUBE, surface=0.5), "must be a Surface"),
    ],
)
def test_invalid_edits_are_refused_and_change_nothing(scene, edit, message):
    state = scene._state
    with pytest.raises(ArgumentError, match=message) as caught:
        edit(scene)
    assert "\n" not in str(caught.value)
    assert scene._state is state

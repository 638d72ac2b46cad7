"""The output `harvest` of one plant: hidden fruit, isolated fruit, cameras inside and facing away."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, short_plant
from test_kernel_reuse import count_compiled

from pepperscene.camera import look_at
from pepperscene.errors import InputError
from pepperscene.geometry import concatenate_meshes, mesh_plant, move_plant, rectangle, resolve_contacts
from pepperscene.render import Renderer
from pepperscene.render.viewpoints import FruitObserver
from pepperscene.scene import assemble_scene, build_skeleton

OUTPUTS = ["instance", "distance", "harvest"]


def scene_of(plant, *others):
    """The plant, and other meshes after its organs in the list of instances."""
    mesh = concatenate_meshes([mesh_plant(plant, 0.5), *others])
    return assemble_scene(mesh, skeleton=build_skeleton([plant]))


def largest_fruit_centre(plant):
    fruit = max(plant.of_form("fruit"), key=lambda organ: organ.measures["diameter_m"])
    return fruit.curve.mean(axis=0)


def aisle_camera(plant, distance_m=0.45, columns=160, rows=120):
    """A camera in the aisle, level with the largest fruit."""
    target, view = largest_fruit_centre(plant), camera(columns=columns, rows=rows)
    sensor = replace(view.sensor, binning=4)
    return replace(view, sensor=sensor, pose=look_at(target - [0.0, distance_m, 0.0], target))


@pytest.fixture(scope="module")
def plant():
    return short_plant(14, 3)


@pytest.fixture(scope="module")
def scene(plant):
    return scene_of(plant)


@pytest.fixture(scope="module")
def frame(plant, scene):
    return Renderer(scene).render(aisle_camera(plant), OUTPUTS)


def test_fruit_hidden_by_a_board_keep_their_truth(plant, frame):
    view = aisle_camera(plant)
    centre = view.pose[:3, 3] + 0.1 * view.pose[:3, 2]
    board = rectangle(centre, view.pose[:3, 0], -view.pose[:3, 1])
    scene = scene_of(plant, board)
    hidden = Renderer(scene).render(view, OUTPUTS)["harvest"]
    number = len(scene.mesh.instances)
    for fruit, visible in zip(hidden["fruit"], frame["harvest"]["fruit"], strict=True):
        for key in ("instance", "amodal", "amodal_box", "pose", "box_3d", "approach", "truncated"):
            assert fruit[key] == visible[key]
        assert (fruit["box"], fruit["visible_pixels"], fruit["visible_fraction"]) == (None, 0, 0.0)
        assert fruit["occluders"] == [{"instance": number, "pixels": fruit["amodal_pixels"]}]
        for point in (fruit["peduncle"]["cut"], fruit["stalk_end"], fruit["blossom_end"]):
            assert not point["visible"]
        assert fruit["peduncle"]["cut"]["world_m"] == visible["peduncle"]["cut"]["world_m"]
    assert all(node["pixels"] == 0 for node in hidden["graph"]["nodes"])


def test_camera_and_world_coordinates_agree(plant, frame):
    view = aisle_camera(plant)
    for fruit in frame["harvest"]["fruit"]:
        stalk = fruit["peduncle"]
        for point in (stalk["attachment"], stalk["cut"]):
            world = view.pose @ [*point["camera_m"], 1.0]
            np.testing.assert_allclose(world[:3], point["world_m"], atol=2e-6)
        np.testing.assert_allclose(stalk["curve_m"][0], stalk["attachment"]["camera_m"], atol=1e-6)
        pieces = np.linalg.norm(np.diff(stalk["curve_m"], axis=0), axis=1)
        assert pieces.sum() == pytest.approx(stalk["length_m"], abs=2e-5)
        # The stalk ends where the calyx begins, a little above the fruit.
        foot = np.array(fruit["pose"])[:3, 3]
        assert np.linalg.norm(stalk["curve_m"][-1] - foot) < 0.08 * fruit["diameter_m"] + 1e-4
        approach = fruit["approach"]
        np.testing.assert_allclose(view.pose[:3, :3] @ approach["camera"], approach["world"], atol=1e-8)


def test_ends_of_a_fruit_are_points_of_its_mesh(plant, scene, frame):
    view = aisle_camera(plant)
    for fruit in frame["harvest"]["fruit"]:
        mesh = scene.mesh.select_instances([fruit["instance"] - 1])
        calyx = scene.mesh.instances[fruit["instance"] - 1].parent + 1
        itself, stalk = fruit["instance"], fruit["peduncle"]["instance"]
        owners = {"stalk_end": {itself, calyx, stalk}, "blossom_end": {itself}}
        # The poles of the skin: surface coordinate 0 where the stalk meets the fruit, 1 at the other end.
        for name, v in (("stalk_end", 0.0), ("blossom_end", 1.0)):
            (pole,) = mesh.vertices[mesh.uv[:, 1] == v]
            point = fruit[name]
            np.testing.assert_allclose(point["world_m"], pole, atol=2e-6)
            world = view.pose @ [*point["camera_m"], 1.0]
            np.testing.assert_allclose(world[:3], pole, atol=2e-6)
            column, row = pixel = view.project(pole[None].astype(float))[0]
            inside = 0 <= column < view.width and 0 <= row < view.height
            assert (point["px"] is not None) == inside
            if inside:
                np.testing.assert_allclose(point["px"], pixel, atol=0.05)
            if point["visible"]:
                assert int(frame["instance"][int(row), int(column)]) in owners[name]
        np.testing.assert_allclose(fruit["stalk_end"]["camera_m"], np.array(fruit["pose"])[:3, 3], atol=2e-6)


def test_stalks_are_cut_in_the_furrow_above_their_collar():
    # The thinnest ring of vertices near the foot of a stalk is at the cut.
    plant = short_plant(14, 5)
    mesh = mesh_plant(plant)
    renderer = Renderer(assemble_scene(mesh, skeleton=build_skeleton([plant])))
    view = aisle_camera(plant, 0.6, columns=320, rows=240)
    stalks = [fruit["peduncle"] for fruit in renderer.render(view, OUTPUTS)["harvest"]["fruit"]]
    assert len(stalks) >= 3
    for stalk in stalks:
        vertices = mesh.select_instances([stalk["instance"] - 1]).vertices
        along = (vertices - stalk["cut"]["world_m"]) @ (view.pose[:3, :3] @ stalk["cut"]["tangent"])
        # The next rings are half a foot's length away.
        foot = min(stalk["radius_m"], 0.12 * stalk["length_m"])
        radii = []
        for position in (-0.5 * foot, 0.0, 0.6 * foot):
            ring = vertices[np.abs(along - position) < 0.2 * foot]
            assert len(ring) >= 6
            radii.append(np.linalg.norm(ring - ring.mean(axis=0), axis=1).max())
        assert radii[1] < min(radii[0], radii[2])


def test_graph_leads_from_each_fruit_to_the_stem(plant, scene, frame):
    harvest = frame["harvest"]
    parent = dict(harvest["graph"]["edges"])
    assert len(parent) == len(harvest["graph"]["edges"])
    nodes = {node["instance"]: node for node in harvest["graph"]["nodes"]}
    for fruit in harvest["fruit"]:
        line = [fruit["instance"]]
        while line[-1] in parent:
            line.append(parent[line[-1]])
        kinds = [nodes[value]["kind"] for value in line]
        assert kinds == ["fruit", "calyx", "peduncle", "node"]
        assert line[2] == fruit["peduncle"]["instance"]
        assert all(scene.mesh.instances[value - 1].parent + 1 == above for value, above in parent.items())
    for value, node in nodes.items():
        assert node["pixels"] == (frame["instance"] == value).sum()
        assert node["class"] == scene.mesh.instances[value - 1].organ_class


def test_fruit_without_a_stalk_has_no_peduncle(plant, scene):
    # The calyx grows directly on the node.
    organs, forms = list(plant.organs), {name: kind.form for name, kind in plant.kinds.items()}
    for index, organ in enumerate(organs):
        if forms[organ.kind] == "calyx":
            organs[index] = replace(organ, parent=organs[organ.parent].parent)
    bare = replace(scene, skeleton=build_skeleton([replace(plant, organs=tuple(organs))]))
    harvest = Renderer(bare).render(aisle_camera(plant), OUTPUTS)["harvest"]
    assert harvest["fruit"]
    assert all(fruit["peduncle"] is None for fruit in harvest["fruit"])


def edited(mesh, instance, change):
    """The mesh with other vertices of one instance."""
    vertices = mesh.vertices.copy()
    rows = mesh.vertex_runs.rows(instance)
    vertices[rows] = change(vertices[rows])
    return replace(mesh, vertices=vertices)


@pytest.mark.parametrize(
    ("way", "form", "change"),
    [
        ("replace", "fruit", lambda points: points + np.float32([0.0, 0.0, 1e-4])),
        ("assemble", "peduncle", lambda points: points + np.float32([0.05, 0.0, 0.0])),
        ("replace", "blade", lambda points: points[:, [1, 0, 2]] * np.float32([1, -1, 1])),
        ("assemble", "node", lambda points: points * np.float32(1.01)),
    ],
    ids=["moved slightly", "moved", "turned", "scaled"],
)
def test_an_edited_mesh_has_no_harvest_truth(way, form, change, plant, scene):
    """The poses of its organs, which did not move, are not those of its triangles."""
    instance = scene.skeleton.of_form(form)[-1]
    mesh = edited(scene.mesh, instance, change)
    other = replace(scene, mesh=mesh) if way == "replace" else assemble_scene(mesh, skeleton=scene.skeleton)
    renderer = Renderer(other)
    message = rf"scene: has moved or changed triangles of 1 instances, first {instance}, a .*skeleton did not"
    with pytest.raises(InputError, match=message):
        renderer.render(aisle_camera(plant), OUTPUTS)
    with pytest.raises(InputError, match=message):
        FruitObserver(other, 64)
    # Labels are those of the triangles.
    assert renderer.render(aisle_camera(plant), ["instance"])["instance"].any()


def test_all_triangles_can_be_moved_only_with_their_skeleton(plant, scene):
    moved = replace(scene, mesh=scene.mesh.moved(np.eye(3), np.array([0.0, 0.1, 0.0])))
    with pytest.raises(InputError, match="skeleton did not move with them"):
        Renderer(moved).render(aisle_camera(plant), OUTPUTS)
    with pytest.raises(InputError, match="harvest needs a scene"):
        Renderer(assemble_scene(scene.mesh)).render(aisle_camera(plant), ["harvest"])


def test_organs_can_be_removed_and_objects_added(plant, scene, frame):
    leaves = np.array(scene.skeleton.of_form("blade"))
    wall = rectangle((0.0, 2.0, 0.0), (4.0, 0.0, 0.0), (0.0, 0.0, 4.0), "wall")
    mesh = concatenate_meshes([scene.mesh.without_triangles(leaves), wall])
    bare = Renderer(assemble_scene(mesh, skeleton=scene.skeleton)).render(aisle_camera(plant), OUTPUTS)
    poses = {fruit["instance"]: fruit["pose"] for fruit in frame["harvest"]["fruit"]}
    found = {fruit["instance"]: fruit["pose"] for fruit in bare["harvest"]["fruit"]}
    assert {number: found[number] for number in poses} == poses


def test_camera_inside_a_fruit_sees_only_that_fruit(plant):
    # Nothing reaches into the fruit after its contacts are resolved.
    resolved = resolve_contacts(mesh_plant(plant, 0.5), np.random.default_rng(5))
    plant = move_plant(plant, resolved.motions)
    scene = assemble_scene(resolved.mesh, skeleton=build_skeleton([plant]))
    target = largest_fruit_centre(plant)
    view = camera().at_pose(look_at(target, target + np.array([0.0, 1.0, 0.0])))
    frame = Renderer(scene).render(view, OUTPUTS)
    instance = np.bincount(frame["instance"].ravel()).argmax()
    fruit = next(item for item in frame["harvest"]["fruit"] if item["instance"] == instance)
    assert fruit["amodal_pixels"] == view.width * view.height
    assert fruit["visible_fraction"] == 1.0
    assert fruit["truncated"]
    assert fruit["amodal"]["counts"] == [0, view.width * view.height]
    # Some corners of its box are behind the camera.
    assert None in fruit["box_3d"]["corners_px"]
    json.dumps(frame["harvest"], allow_nan=False)


def test_camera_facing_away_sees_no_fruit(plant, scene):
    target = largest_fruit_centre(plant)
    away = camera().at_pose(look_at(target - [0.0, 0.5, 0.0], target - [0.0, 2.0, 0.0]))
    harvest = Renderer(scene).render(away, ["harvest"])["harvest"]
    assert (harvest["fruit"], harvest["graph"]) == ([], {"nodes": [], "edges": []})


def test_other_plants_and_image_sizes_compile_nothing(plant, scene, frame):
    other = short_plant(14, 8)
    render = Renderer(scene_of(other)).render
    assert count_compiled(lambda: render(aisle_camera(other, columns=84, rows=63), OUTPUTS)) == 0
    render = Renderer(scene).render
    assert count_compiled(lambda: render(aisle_camera(plant, 0.3, columns=120, rows=90), OUTPUTS)) == 0

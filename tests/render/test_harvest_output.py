"""Harvest and amodal truth: cards with closed forms, and one plant with hidden and isolated organs."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import axis_camera, body, card, sphere
from greenhouse import camera, digests, short_plant
from scipy.ndimage import binary_dilation, binary_erosion
from test_kernel_reuse import count_compiled
from trimesh.ray.ray_triangle import RayMeshIntersector

from pepperscene.camera import look_at
from pepperscene.classes import Instance, OrganClass
from pepperscene.errors import InputError
from pepperscene.geometry import concatenate_meshes, mesh_plant, move_plant, rectangle, resolve_contacts
from pepperscene.render import Renderer
from pepperscene.render.aov import isolated
from pepperscene.render.viewpoints import FruitObserver
from pepperscene.scene import assemble_scene, build_skeleton
from pepperscene.truth.encodings import decode_rle

OUTPUTS = ["instance", "distance", "harvest", "amodal"]
FOCAL_PX = 4.16e-3 / 9e-6  # of `axis_camera`
VIEW = axis_camera(64, 48, flash=False)


def scene_of(plant, *others):
    """The plant, and other meshes after its organs in the list of instances."""
    mesh = concatenate_meshes([mesh_plant(plant, 0.5), *others])
    return assemble_scene(mesh, skeleton=build_skeleton([plant]))


def largest_fruit_centre(plant):
    fruit = max(plant.of_form("fruit"), key=lambda organ: organ.measures["diameter_m"])
    return fruit.curve.mean(axis=0)


def aisle_camera(plant, distance_m=0.45, columns=160, rows=120):
    """A camera with a distorting lens in the aisle, level with the largest fruit."""
    target, view = largest_fruit_centre(plant), camera(columns=columns, rows=rows, distorted=True)
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


def amodal_of(mesh, view=VIEW):
    """Entries of the output by value, and the instance image."""
    frame = Renderer(assemble_scene(mesh)).render(view, ["instance", "amodal"])
    assert frame["amodal"]["format"] == "pepperscene amodal 1"
    return {entry["instance"]: entry for entry in frame["amodal"]["organs"]}, frame["instance"]


def pixels_card(x0, y0, x1, y1, z):
    """A card at a depth whose image is these columns and rows."""
    size = z / FOCAL_PX
    centre = (0.5 * (x0 + x1) - 32) * size, (0.5 * (y0 + y1) - 24) * size
    return card(*centre, (x1 - x0) * size, (y1 - y0) * size, "matt", z)


def test_card_behind_a_card_has_its_hidden_part():
    front, back = pixels_card(10, 10, 30, 30, 0.4), pixels_card(20, 5, 50, 40, 0.6)
    entries, instance = amodal_of(concatenate_meshes([front, back]))
    expected = np.zeros((48, 64), bool)
    expected[5:40, 20:50] = True
    np.testing.assert_array_equal(decode_rle(entries[2]["amodal"]), expected)
    hidden = 10 * 20
    assert entries[2] == {
        "instance": 2, "class": OrganClass.LEAF, "kind": "test body", "box": [20, 5, 50, 40],
        "amodal_box": [20, 5, 50, 40], "visible_pixels": 35 * 30 - hidden, "amodal_pixels": 35 * 30,
        "visible_fraction": pytest.approx(1 - hidden / (35 * 30), abs=1e-6), "truncated": False,
        "occluders": [{"instance": 1, "pixels": hidden}], "amodal": entries[2]["amodal"],
    }  # fmt: skip
    # Nothing is in front of the other one.
    np.testing.assert_array_equal(decode_rle(entries[1]["amodal"]), instance == 1)
    assert (entries[1]["visible_fraction"], entries[1]["occluders"]) == (1.0, [])


def test_hidden_part_at_the_border_counts_as_truncated():
    front, back = pixels_card(0, 0, 20, 48, 0.4), pixels_card(-5, 20, 30, 28, 0.6)
    entries, instance = amodal_of(concatenate_meshes([front, back]))
    assert not (instance[:, 0] == 2).any()
    assert entries[2]["truncated"]
    assert entries[2]["amodal_box"] == [0, 20, 30, 28]
    assert amodal_of(pixels_card(100, 0, 110, 10, 0.5))[0] == {}


def test_sphere_has_the_disc_of_a_sphere_from_before_and_from_inside():
    half = pixels_card(0, 0, 32, 48, 0.2)
    entries, _ = amodal_of(concatenate_meshes([half, sphere((0, 0, 0.5), 0.02, "m")]))
    # A sphere is seen up to the tangents from the projection centre.
    radius_px = FOCAL_PX * 0.02 / np.sqrt(0.5**2 - 0.02**2)
    y, x = np.mgrid[:48, :64] + 0.5
    outside = np.hypot(x - 32, y - 24) - radius_px
    mask = decode_rle(entries[2]["amodal"])
    clear = np.abs(outside) > 0.1
    np.testing.assert_array_equal(mask[clear], (outside < 0)[clear])
    assert entries[2]["visible_fraction"] == pytest.approx(0.5, abs=0.02)
    # From inside it is everywhere, although no vertex behind the camera has a pixel.
    entries, _ = amodal_of(sphere((0, 0, 0), 0.3, "matt"))
    assert (entries[1]["amodal_pixels"], entries[1]["visible_fraction"]) == (48 * 64, 1.0)


def test_only_visible_organs_are_listed():
    cards = [pixels_card(5 * k, 5, 5 * k + 4, 20, 0.5) for k in range(5)]
    hidden = pixels_card(1, 6, 3, 10, 0.6)
    instances = [
        Instance(OrganClass.STEM, "internode"), Instance(OrganClass.BACKGROUND, "gutter"),
        Instance(OrganClass.LEAF, "lamina", ignored=True), Instance(OrganClass.CUT, "scar"),
        Instance(OrganClass.WIRE, "crop_wire"),
    ]  # fmt: skip
    meshes = [replace(mesh, instances=(item,)) for mesh, item in zip(cards, instances, strict=True)]
    entries, _ = amodal_of(concatenate_meshes([*meshes, hidden]))
    found = {value: (entry["class"], entry["kind"]) for value, entry in entries.items()}
    assert found == {1: (4, "internode"), 4: (7, "scar"), 5: (6, "crop_wire")}


@pytest.mark.parametrize("limit", ["_BATCH", "_PROJECTED", "_MOST_KEPT"])
def test_many_organs_are_divided(limit, monkeypatch):
    cards = [pixels_card(8 * k, 0, 8 * k + 16, 48, 0.3 + 0.05 * k) for k in range(6)]
    scene = assemble_scene(concatenate_meshes(cards))
    views = [VIEW, replace(VIEW, sensor=replace(VIEW.sensor, columns=30)), VIEW]
    renderer = Renderer(scene)
    whole = [renderer.render(view, ["amodal"])["amodal"] for view in views]
    monkeypatch.setattr(isolated, limit, 5)
    renderer = Renderer(scene)
    assert [renderer.render(view, ["amodal"])["amodal"] for view in views] == whole
    assert [len(one["organs"]) for one in whole] == [6, 4, 6]


def test_all_visible_organs_are_listed_with_their_pixels(frame):
    visible = np.unique(frame["instance"][frame["instance"] > 0]).tolist()
    organs = frame["amodal"]["organs"]
    assert [entry["instance"] for entry in organs] == visible
    assert {entry["class"] for entry in organs} >= {1, 2, 3, 4, 5}
    described = frame.metadata["instances"]
    for entry in organs:
        own = described[str(entry["instance"])]
        assert (entry["class"], entry["kind"]) == (own["class"], own["kind"])
        assert (entry["visible_pixels"], entry["box"]) == (own["pixels"], own["box"])
        mask = decode_rle(entry["amodal"])
        # What is visible is a part of the whole; the rest belongs to the occluders.
        assert mask[frame["instance"] == entry["instance"]].all()
        assert entry["amodal_pixels"] == mask.sum()
        rows, columns = np.nonzero(mask)
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        assert entry["amodal_box"] == box
        hidden = {item["instance"]: item["pixels"] for item in entry["occluders"]}
        hidden[entry["instance"]] = entry["visible_pixels"]
        assert hidden == Counter(frame["instance"][mask].tolist())
        assert entry["truncated"] == bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())
    assert 0.2 < np.mean([entry["visible_fraction"] < 1 for entry in organs]) < 1


def test_masks_of_fruit_are_those_of_harvest(frame):
    organs = {entry["instance"]: entry for entry in frame["amodal"]["organs"]}
    fruit = [entry for entry in frame["harvest"]["fruit"] if entry["visible_pixels"]]
    assert len(fruit) >= 2
    for entry in fruit:
        shared = organs[entry["instance"]].keys() & entry.keys()
        assert len(shared) == 10
        assert {key: entry[key] for key in shared} == {key: organs[entry["instance"]][key] for key in shared}


def test_masks_are_those_of_a_ray_caster(plant, scene, frame):
    """Trimesh, in double precision; casters may differ where an outline meets a pixel's centre."""
    view = aisle_camera(plant)
    by_size = sorted(frame["amodal"]["organs"], key=lambda entry: entry["amodal_pixels"])
    # The largest one of each class.
    largest = {entry["class"]: entry for entry in by_size}
    assert largest.keys() >= {1, 2, 3, 4, 5}
    for entry in largest.values():
        part = scene.mesh.select_instances([entry["instance"] - 1])
        x0, y0, x1, y1 = entry["amodal_box"]
        rows, columns = (
            part.ravel()
            for part in np.mgrid[max(y0 - 3, 0) : min(y1 + 3, 120), max(x0 - 3, 0) : min(x1 + 3, 160)]
        )
        directions = view.pixel_directions()[rows, columns] @ view.pose[:3, :3].T
        origins = np.tile(view.pose[:3, 3], (len(directions), 1))
        caster = RayMeshIntersector(trimesh.Trimesh(part.vertices, part.faces, process=False))
        hit = np.zeros((120, 160), bool)
        hit[rows, columns] = caster.intersects_any(origins, directions)
        mask = decode_rle(entry["amodal"])
        outline = binary_dilation(mask) & ~binary_erosion(mask)
        differ = hit != mask
        assert not differ[~outline].any()
        assert differ.sum() <= 1


def test_outputs_do_not_depend_on_each_other(plant, scene, frame, monkeypatch):
    view = aisle_camera(plant)
    alone = Renderer(scene).render(view, ["amodal"])
    without = Renderer(scene).render(view, ["instance", "harvest"])
    for other in (without, alone):
        assert digests(other) == {name: digests(frame)[name] for name in other.images}
    json.dumps(frame["amodal"], allow_nan=False)
    # No organ is isolated unless an output needs it.
    monkeypatch.setattr(isolated.IsolatedOrgans, "__init__", None)
    Renderer(scene).render(view, ["instance", "class"])


def test_other_organs_and_image_sizes_compile_nothing(plant, scene, frame):
    other = short_plant(14, 8)
    render = Renderer(scene_of(other)).render
    assert count_compiled(lambda: render(aisle_camera(other, columns=84, rows=63), OUTPUTS)) == 0
    closer = aisle_camera(plant, 0.3, columns=120, rows=90)
    assert count_compiled(lambda: Renderer(scene).render(closer, OUTPUTS)) == 0


def test_thin_body_outside_the_image_is_not_searched():
    rod = trimesh.creation.cylinder(radius=0.002, height=0.1)
    rod.apply_translation([0.0, 0.0, -0.5])
    entries, _ = amodal_of(concatenate_meshes([body(rod, "matt"), pixels_card(0, 0, 9, 9, 0.5)]))
    assert list(entries) == [2]

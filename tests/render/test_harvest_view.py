"""The harvest truth of a plant by itself: hidden, alone, cut off, from within, from behind."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera
from test_kernel_reuse import compiled

from pepperscene.camera import look_at
from pepperscene.cultivar import load_cultivar
from pepperscene.errors import InputError
from pepperscene.geometry import concatenate_meshes, mesh_plant, rectangle
from pepperscene.grammar import grow
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene, build_skeleton
from pepperscene.truth.encodings import decode_rle

OUTPUTS = ["instance", "distance", "harvest"]


def plant_of(seed=3):
    cultivar = load_cultivar("kaite")
    short = cultivar.model_copy(update={"stem": cultivar.stem.model_copy(update={"parts": 14})})
    return grow(short, np.random.default_rng(seed))


def scene_of(plant, *others):
    """The plant, and things behind its organs in the list of instances."""
    return assemble_scene(
        concatenate_meshes([mesh_plant(plant, 0.5), *others]), skeleton=build_skeleton([plant])
    )


def middle_of(plant):
    """The centre of the largest of its fruit."""
    fruit = max(plant.of_form("fruit"), key=lambda organ: organ.measures["diameter_m"])
    return fruit.curve.mean(axis=0)


def facing(plant, distance_m=0.45, columns=160, rows=120):
    """A camera level with a fruit, in the aisle."""
    target, taken = middle_of(plant), camera(columns=columns, rows=rows)
    sensor = replace(taken.sensor, binning=4)
    return replace(taken, sensor=sensor, pose=look_at(target - [0.0, distance_m, 0.0], target))


@pytest.fixture(scope="module")
def plant():
    return plant_of()


@pytest.fixture(scope="module")
def scene(plant):
    return scene_of(plant)


@pytest.fixture(scope="module")
def frame(plant, scene):
    return Renderer(scene).render(facing(plant), OUTPUTS)


def test_the_whole_mask_is_what_the_fruit_alone_shows(plant, scene, frame):
    assert len(frame["harvest"]["fruit"]) >= 2
    for fruit in frame["harvest"]["fruit"]:
        alone = assemble_scene(scene.mesh.of_instances([fruit["instance"] - 1]))
        mask = Renderer(alone).render(facing(plant), ["instance"])["instance"] > 0
        np.testing.assert_array_equal(decode_rle(fruit["amodal"]), mask)
        seen = frame["instance"] == fruit["instance"]
        assert not (seen & ~mask).any()
        assert fruit["visible_pixels"] == seen.sum()
        hidden = sum(one["pixels"] for one in fruit["occluders"])
        assert hidden == mask.sum() - seen.sum()


def test_behind_a_board_all_is_hidden_and_still_told(plant, frame):
    taken = facing(plant)
    centre = taken.pose[:3, 3] + 0.1 * taken.pose[:3, 2]
    board = rectangle(centre, taken.pose[:3, 0], -taken.pose[:3, 1])
    scene = scene_of(plant, board)
    hidden = Renderer(scene).render(taken, OUTPUTS)["harvest"]
    number = len(scene.mesh.instances)
    assert [one["instance"] for one in hidden["fruit"]] == [
        one["instance"] for one in frame["harvest"]["fruit"]
    ]
    for fruit, open_one in zip(hidden["fruit"], frame["harvest"]["fruit"], strict=True):
        for key in ("amodal", "amodal_box", "pose", "box_3d", "approach", "truncated"):
            assert fruit[key] == open_one[key]
        assert (fruit["box"], fruit["visible_pixels"], fruit["visible_fraction"]) == (None, 0, 0.0)
        assert fruit["occluders"] == [{"instance": number, "pixels": fruit["amodal_pixels"]}]
        assert not fruit["peduncle"]["cut"]["visible"]
        assert fruit["peduncle"]["cut"]["world_m"] == open_one["peduncle"]["cut"]["world_m"]
    assert all(node["pixels"] == 0 for node in hidden["graph"]["nodes"])


def test_camera_and_world_tell_the_same_places(plant, frame):
    taken = facing(plant)
    for fruit in frame["harvest"]["fruit"]:
        stalk = fruit["peduncle"]
        for point in (stalk["attachment"], stalk["cut"]):
            world = taken.pose @ [*point["camera_m"], 1.0]
            np.testing.assert_allclose(world[:3], point["world_m"], atol=2e-6)
        np.testing.assert_allclose(stalk["curve_m"][0], stalk["attachment"]["camera_m"], atol=1e-6)
        pieces = np.linalg.norm(np.diff(stalk["curve_m"], axis=0), axis=1)
        assert pieces.sum() == pytest.approx(stalk["length_m"], abs=2e-5)
        # The stalk ends where the calyx begins, a little above the fruit.
        foot = np.array(fruit["pose"])[:3, 3]
        assert np.linalg.norm(stalk["curve_m"][-1] - foot) < 0.08 * fruit["diameter_m"] + 1e-4
        way = fruit["approach"]
        np.testing.assert_allclose(taken.pose[:3, :3] @ way["camera"], way["world"], atol=1e-8)


def test_stalks_are_cut_in_the_furrow_above_their_collar():
    # Of the rings that a stalk's body is made of, the thinnest near its foot lies at the cut.
    plant = plant_of(5)
    mesh, bones = mesh_plant(plant), build_skeleton([plant])
    scene = assemble_scene(mesh, skeleton=bones)
    renderer, taken = Renderer(scene), facing(plant, 0.6, columns=320, rows=240)
    found = [fruit["peduncle"] for fruit in renderer.render(taken, OUTPUTS)["harvest"]["fruit"]]
    assert len(found) >= 3
    for stalk in found:
        body = mesh.select_instances([stalk["instance"] - 1]).vertices
        off = (body - stalk["cut"]["world_m"]) @ (taken.pose[:3, :3] @ stalk["cut"]["tangent"])
        # Rings next to it lie half a foot's length farther.
        foot = min(stalk["radius_m"], 0.12 * stalk["length_m"])
        radii = []
        for place in (-0.5 * foot, 0.0, 0.6 * foot):
            ring = body[np.abs(off - place) < 0.2 * foot]
            assert len(ring) >= 6
            radii.append(np.linalg.norm(ring - ring.mean(axis=0), axis=1).max())
        assert radii[1] < min(radii[0], radii[2])


def test_the_graph_leads_from_each_fruit_to_the_stem(plant, scene, frame):
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
        assert all(scene.mesh.instances[one - 1].parent + 1 == two for one, two in parent.items())
    for value, node in nodes.items():
        assert node["pixels"] == (frame["instance"] == value).sum()
        assert node["class"] == scene.mesh.instances[value - 1].organ_class


def test_a_fruit_on_no_stalk_has_none(plant, scene):
    # The calyx grows out of the node itself.
    organs, forms = list(plant.organs), {name: kind.form for name, kind in plant.kinds.items()}
    for index, organ in enumerate(organs):
        if forms[organ.kind] == "calyx":
            organs[index] = replace(organ, parent=organs[organ.parent].parent)
    bare = replace(scene, skeleton=build_skeleton([replace(plant, organs=tuple(organs))]))
    harvest = Renderer(bare).render(facing(plant), OUTPUTS)["harvest"]
    assert harvest["fruit"]
    assert all(fruit["peduncle"] is None for fruit in harvest["fruit"])


def test_from_within_a_fruit_there_is_nothing_else(plant, scene):
    target = middle_of(plant)
    taken = camera().at_pose(look_at(target, target + np.array([0.0, 1.0, 0.0])))
    frame = Renderer(scene).render(taken, OUTPUTS)
    seen = np.bincount(frame["instance"].ravel()).argmax()
    fruit = next(one for one in frame["harvest"]["fruit"] if one["instance"] == seen)
    assert fruit["amodal_pixels"] == taken.width * taken.height
    # The plant has not settled: something reaches into the fruit.
    assert fruit["visible_fraction"] > 0.9
    assert fruit["truncated"]
    assert fruit["amodal"]["counts"] == [0, taken.width * taken.height]
    # Some corners of its box are behind the camera.
    assert None in fruit["box_3d"]["corners_px"]
    json.dumps(frame["harvest"], allow_nan=False)


def test_who_looks_away_is_told_of_nothing(plant, scene):
    target = middle_of(plant)
    away = camera().at_pose(look_at(target - [0.0, 0.5, 0.0], target - [0.0, 2.0, 0.0]))
    harvest = Renderer(scene).render(away, ["harvest"])["harvest"]
    assert (harvest["fruit"], harvest["graph"]) == ([], {"nodes": [], "edges": []})


def test_the_same_view_gives_the_same_text(plant, scene, frame):
    again = Renderer(scene).render(facing(plant), ["harvest"])["harvest"]
    assert json.dumps(again, allow_nan=False) == json.dumps(frame["harvest"], allow_nan=False)


def test_a_scene_without_its_plants_is_refused(plant):
    with pytest.raises(InputError, match="harvest needs a scene"):
        Renderer(assemble_scene(mesh_plant(plant, 0.5))).render(facing(plant), ["harvest"])


def test_other_plants_and_other_pictures_compile_nothing(plant, scene, frame):
    other = plant_of(8)
    for made, taken in (
        (scene_of(other), facing(other, columns=84, rows=63)),
        (scene, facing(plant, 0.3, columns=120, rows=90)),
    ):
        renderer = Renderer(made)
        _, missed = compiled(lambda r=renderer, c=taken: r.render(c, OUTPUTS))
        assert missed == 0

"""ROS 2 bags, read by rosbags: every message against the data set, projections against OpenCV."""

from __future__ import annotations

import json
import sys
from itertools import pairwise

import numpy as np
import pytest
from mcap.reader import make_reader
from rendered_set import RECIPE, LabelRenderer
from ros_bag import COLOUR, DEPTH, DETECTIONS, INSTANCE, Bag, pose, xyz
from rosbags.typesys import Stores, get_typestore
from traced_set import LENSES, make_traced_set, reprojection_error, visible_pixels

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.errors import ArgumentError, InputError, SetupError
from pepperscene.export import export_dataset
from pepperscene.export.mcap import BAG, CAMERA, TOPICS, definition
from pepperscene.recipe.resolve.load import load_recipe

MODELS = {"rational": "rational_polynomial", "fisheye": "equidistant"}
CENTRE_OF_FIRST_PIXEL = 0.5  # in the harvest truth; 0 in ROS


@pytest.fixture(scope="module")
def fruit_bag(rendered, tmp_path_factory):
    """Bags of the two rotations of a rendered row, with all fruit."""
    return export_dataset(rendered.folder, "mcap", tmp_path_factory.mktemp("mcap") / "bag").folder


@pytest.fixture(scope="module")
def fruit_frames(rendered, fruit_bag):
    """Bag, number of the message, and index of each frame."""
    bags = [Bag(path) for path in sorted(fruit_bag.iterdir())]
    return [(bags[0], 0, 5), (bags[0], 1, 6), (bags[1], 0, 17)]


def test_images_are_those_of_the_data_set(rendered, fruit_frames):
    for bag, number, index in fruit_frames:
        np.testing.assert_array_equal(
            bag.image(f"{COLOUR}/image_raw", number), rendered.image(index, "colour")
        )
        np.testing.assert_array_equal(bag.image(INSTANCE, number), rendered.image(index, "instance"))
        depth = bag.image(f"{DEPTH}/image_raw", number)
        assert depth.dtype == np.float32
        np.testing.assert_allclose(depth, rendered.image(index, "depth_z"), rtol=1e-6)
        assert not bag.get(f"{DEPTH}/image_raw", number).is_bigendian


def check_transforms(dataset, bag, number, index):
    """The camera and the fruit of a message are where the data set has them; returns the number of fruit."""
    camera = np.array(dataset.metadata(index)["camera"]["pose"])
    fruit = dataset.image(index, "harvest")["fruit"]
    found = bag.transforms(number)
    np.testing.assert_allclose(found.pop(CAMERA), camera, atol=1e-9)
    assert sorted(found) == sorted(f"fruit_{one['instance']}" for one in fruit)
    for one in fruit:
        in_world = found[f"fruit_{one['instance']}"]
        np.testing.assert_allclose(in_world, camera @ one["pose"], atol=2e-8)
        np.testing.assert_allclose(in_world[:3, 3], one["stalk_end"]["world_m"], atol=2e-6)
    return len(fruit)


def check_detections(dataset, bag, number, index):
    """Detections are the visible fruit, with their boxes."""
    message = bag.get(DETECTIONS, number)
    assert message.header.frame_id == CAMERA
    fruit = dataset.image(index, "harvest")["fruit"]
    seen = {str(one["instance"]): one for one in fruit if one["visible_pixels"]}
    assert [detection.id for detection in message.detections] == list(seen)
    for detection in message.detections:
        box, centre = seen[detection.id]["box_3d"], detection.bbox.center
        np.testing.assert_allclose(xyz(centre.position), box["centre"], atol=1e-12)
        np.testing.assert_allclose(xyz(detection.bbox.size), box["size"], atol=1e-12)
        turn = pose(centre.position, centre.orientation)[:3, :3]
        np.testing.assert_allclose(turn, box["rotation"], atol=2e-8)
        (result,) = detection.results
        assert (result.hypothesis.class_id, result.hypothesis.score) == ("pepper", 1.0)
        assert repr(result.pose.pose) == repr(centre)


def check_projections(dataset, bag, number, index):
    """The calibration and the transforms give the pixel coordinates of the harvest truth; their number."""
    info, found = bag.get(f"{COLOUR}/camera_info", number), bag.transforms(number)
    matrix, count = info.p.reshape(3, 4), 0
    np.testing.assert_array_equal(matrix[:, :3], info.k.reshape(3, 3))
    np.testing.assert_array_equal(info.r.reshape(3, 3), np.eye(3))
    for one in dataset.image(index, "harvest")["fruit"]:
        if one["stalk_end"]["px"] is None:
            continue
        in_camera = np.linalg.inv(found[CAMERA]) @ found[f"fruit_{one['instance']}"]
        assert in_camera[2, 3] > 0
        pixel = matrix @ in_camera[:, 3]
        expected = np.array(one["stalk_end"]["px"]) - CENTRE_OF_FIRST_PIXEL
        np.testing.assert_allclose(pixel[:2] / pixel[2], expected, atol=2e-3)
        count += 1
    return count


def test_fruit_is_that_of_the_harvest_truth(rendered, fruit_frames):
    for frame in fruit_frames:
        check_detections(rendered, *frame)
    assert sum(check_transforms(rendered, *frame) for frame in fruit_frames) > 15
    assert sum(check_projections(rendered, *frame) for frame in fruit_frames) > 15


@pytest.mark.long
def test_a_hundred_fruit_are_those_of_the_harvest_truth(tmp_path):
    changes = {**RECIPE, "plan.rotations": 1, "row.plants_front": 5, "row.plants_back": 3}
    options = BuildOptions(quality="draft", renderer=LabelRenderer)
    outputs = ("colour", "instance", "distance", "harvest")
    dataset = build(load_recipe("barth2018", changes), tmp_path / "set", None, outputs, options).dataset
    bag = Bag(export_dataset(dataset.folder, "mcap", tmp_path / "bag").folder)
    frames = [(bag, number, index) for number, index in enumerate(dataset.indices())]
    for frame in frames:
        check_detections(dataset, *frame)
    assert sum(check_transforms(dataset, *frame) for frame in frames) > 100
    assert sum(check_projections(dataset, *frame) for frame in frames) > 100


@pytest.mark.parametrize("lens", LENSES)
def test_calibrations_project_points_to_their_pixels(lens, traced, exported):
    dataset, bag = traced(lens), Bag(exported("mcap", lens))
    for number, index in enumerate(dataset.indices()):
        info, camera = bag.get(f"{COLOUR}/camera_info", number), bag.transforms(number)[CAMERA]
        assert info.distortion_model == MODELS.get(lens, "plumb_bob")
        assert repr(info) == repr(bag.get(f"{DEPTH}/camera_info", number))
        pixels, points = visible_pixels(dataset, index)
        in_camera = (points - camera[:3, 3]) @ camera[:3, :3]
        lens_values = {"distortion_model": info.distortion_model, "distortion": info.d}
        assert reprojection_error(in_camera, lens_values, info.k.reshape(3, 3), pixels) < 0.001
        depth = bag.image(f"{DEPTH}/image_raw", number)
        columns, rows = pixels.T
        assert np.abs(depth[rows, columns] - in_camera[:, 2]).max() < 1e-5
        np.testing.assert_array_equal(np.isinf(depth), np.isinf(dataset.image(index, "distance")))


def sections(text):
    """The fields of a type, and of each type that it contains, by name."""
    own, *others = text.split(f"{'=' * 80}\nMSG: ")
    named = {one.partition("\n")[0]: one.partition("\n")[2].split() for one in others}
    assert len(named) == len(others)
    return {"": own.split(), **named}


def test_bags_hold_the_definitions_of_ros(fruit_bag, rendered, fruit_frames):
    """The texts have the fields of the releases of ROS, of which rosbags has its own copies."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name in dict.fromkeys(TOPICS.values()):
        if name in store.types:
            expected = store.generate_msgdef(name, ros_version=2)[0]
            assert sections(definition(name)) == sections(expected)
    bag = fruit_frames[0][0]
    assert bag.types == TOPICS
    assert set(bag.counts.values()) == {2}
    with (fruit_bag / "set_000_rotation_000" / BAG).open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary.statistics.message_count == 2 * len(TOPICS)


def test_times_follow_the_option_or_the_steps(traced, exported, tmp_path):
    bag = Bag(exported("mcap"))
    for topic in (f"{COLOUR}/image_raw", f"{DEPTH}/camera_info", "/tf"):
        assert bag.times_s(topic) == [1.0, 2.0, 3.0, 4.0]
    assert DETECTIONS not in bag.types
    out = export_dataset(traced().folder, "mcap", tmp_path / "out", frames="1:4", frame_rate_hz=30).folder
    np.testing.assert_allclose(Bag(out).times_s(), 1 + np.array([1, 2, 3]) / 30, atol=1e-9)


PATH = {
    "kind": "path",
    "points_mm": [[-300, -600, 1200], [0, -500, 1250], [300, -600, 1200]],
    "speed_mm_s": 250,
}


@pytest.mark.parametrize(
    "views",
    [PATH, {**PATH, "frame_rate_hz": 5}, {"speed_mm_s": 300}],
    ids=["path", "path with a frame rate", "arc"],
)
def test_times_follow_the_speed_of_the_views(views, tmp_path):
    changes = {"views": views} if "kind" in views else {f"views.{key}": value for key, value in views.items()}
    if "frame_rate_hz" in views:
        changes["plan.frames"] = 13
    dataset = make_traced_set(tmp_path / "set", frames=None, **changes)
    bag = Bag(export_dataset(dataset.folder, "mcap", tmp_path / "bag").folder)
    times = bag.times_s()
    assert times[0] == 1.0
    assert len(times) == len(dataset.indices())
    # Chords are shorter than the path by less than this.
    speed = views["speed_mm_s"] / 1000
    centres = [bag.transforms(number)[CAMERA][:3, 3] for number in range(len(times))]
    steps = [np.linalg.norm(b - a) / speed for a, b in pairwise(centres)]
    np.testing.assert_allclose(np.diff(times), steps, rtol=2e-3)
    if "frame_rate_hz" in views:
        np.testing.assert_allclose(np.diff(times), 0.2, atol=1e-8)


def test_varied_views_have_no_clock(tmp_path):
    speeds = {"uniform": [200, 400], "per": "scene"}
    dataset = make_traced_set(tmp_path / "set", **{"views.speed_mm_s": speeds})
    assert Bag(export_dataset(dataset.folder, "mcap", tmp_path / "bag").folder).times_s() == [1, 2, 3, 4]


def test_objects_are_those_that_are_chosen(rendered, tmp_path):
    options = {"frames": "5:6", "ripe_from": 0.5, "least_visible": 0.4}
    bag = Bag(export_dataset(rendered.folder, "mcap", tmp_path / "out", **options).folder)
    expected = {
        str(one["instance"]): "ripe pepper" if one["ripeness"] >= 0.5 else "unripe pepper"
        for one in rendered.image(5, "harvest")["fruit"]
        if one["visible_pixels"] and one["visible_fraction"] >= 0.4
    }
    found = {one.id: one.results[0].hypothesis.class_id for one in bag.get(DETECTIONS, 0).detections}
    assert found == expected
    assert len(set(expected.values())) == 2


def test_mistakes_are_refused(traced, tmp_path, monkeypatch):
    folder = traced().folder
    for rate in (0, -1, 1e9, float("nan")):
        with pytest.raises(ArgumentError, match=r"frame.rate: .* must be 0\.001 to 10000 a second"):
            export_dataset(folder, "mcap", tmp_path / "out", frame_rate_hz=rate)
    with pytest.raises(ArgumentError, match="frames of coco have no times"):
        export_dataset(folder, "coco", tmp_path / "out", frame_rate_hz=5)
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "mcap_ros2", None)
        with pytest.raises(SetupError, match=r"pepperscene\[ros\]"):
            export_dataset(folder, "mcap", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_fruit_without_a_pose_is_an_error(rendered, tmp_path, monkeypatch):
    image = DatasetFrame.image

    def damaged(frame, output):
        content = image(frame, output)
        if output == "harvest":
            content["fruit"][0]["pose"] = np.zeros((4, 4)).tolist()
        return content

    monkeypatch.setattr(DatasetFrame, "image", damaged)
    with pytest.raises(
        InputError, match=r"harvest/000005\.json: fruit\.pose: must hold rigid motions: pose 0"
    ):
        export_dataset(rendered.folder, "mcap", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_path_that_is_damaged_is_an_error(traced, copied, tmp_path):
    dataset = copied(traced())
    dataset.info["recipe"]["views"] = {**PATH, "points_mm": [[0, 0, 0]]}
    path = dataset.folder / "dataset.json"
    path.write_text(json.dumps(dict(dataset.info)))
    with pytest.raises(InputError, match="points_mm"):
        export_dataset(dataset.folder, "mcap", tmp_path / "out")
    assert not (tmp_path / "out").exists()

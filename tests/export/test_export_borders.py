"""Points and boxes at the borders of the image are inside it in every format."""

from __future__ import annotations

import contextlib
import io
import json

import numpy as np
import pytest
from label_set import FRAMES, SIZE, LabelPainter, export, read_yolo
from painted_set import ALL, make_painted_set

from pepperscene.camera import Camera, load_lens, load_sensor
from pepperscene.classes import Instance, OrganClass
from pepperscene.export.yolo import VisibleObject
from pepperscene.truth.amodal import AmodalMask
from pepperscene.truth.harvest import FruitTruth, LabelView, harvest_truth

HEIGHT, WIDTH = SIZE
CORNERS = ((0.2, 0.0), (WIDTH - 0.001, HEIGHT - 0.2))


class BorderPainter(LabelPainter):
    """The ends of all fruit are in the outermost half pixels of the image."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        frame = super().render(camera, outputs, quality, seed, **others)
        for entry in frame.images["harvest"]["fruit"]:
            for name, point in zip(("stalk_end", "blossom_end"), CORNERS, strict=True):
                entry[name] |= {"px": list(point), "visible": True}
        return frame


@pytest.fixture(scope="module")
def borders(tmp_path_factory):
    return make_painted_set(tmp_path_factory.mktemp("borders") / "set", ALL, FRAMES[:1], BorderPainter)


def test_keypoints_of_coco_are_inside_the_picture(borders, tmp_path):
    from pycocotools.coco import COCO

    with contextlib.redirect_stdout(io.StringIO()):
        truth = COCO(export(borders, "coco", tmp_path / "out") / "annotations" / "instances_train.json")
    known = [one for one in truth.anns.values() if one.get("num_keypoints")]
    assert known
    for one in known:
        points = np.reshape(one["keypoints"], (3, 3))
        shown = points[points[:, 2] > 0, :2]
        assert (shown >= 0).all()
        assert (shown <= [WIDTH - 1, HEIGHT - 1]).all()
        # No point moves by more than half a pixel.
        assert points[1:, 2].tolist() == [2, 2]
        assert np.abs(points[1:, :2] + 0.5 - CORNERS).max() <= 0.5


def test_keypoints_of_yolo_are_inside_the_picture(borders, tmp_path):
    folder = export(borders, "yolo_pose", tmp_path / "out")
    found = 0
    for path in (folder / "labels" / "train").glob("*.txt"):
        for _, values in read_yolo(path):
            points = values[4:].reshape(3, 3)
            assert points[:, :2].min() >= 0
            assert points[:, :2].max() <= 1
            found += np.count_nonzero(points[:, 2])
    assert found


def test_edges_of_yolo_boxes_are_inside_the_picture():
    for count in (3, 7, 11, 480, 799, 1280, 4999):
        for start in range(0, count, max(1, count // 40)):
            text = VisibleObject(1, 0, (slice(0, count - start), slice(start, count))).box((count, count))
            x, y, width, height = (round(float(number) * 1e6) for number in text.split())
            assert 2 * x + width <= 2_000_000
            assert 2 * x - width >= 0
            assert 2 * y + height <= 2_000_000
            assert 2 * y - height >= 0
            # Within a millionth of the image's side.
            assert abs(x / 1e6 - 0.5 * (start + count) / count) < 1e-6
            assert abs(width / 1e6 - (count - start) / count) < 2.1e-6


def test_rounding_of_truth_leaves_points_in_the_picture():
    camera = Camera(
        load_lens("realsense_d435_infrared"), load_sensor("realsense_d435_infrared").with_size(8, 6)
    )
    matrix, nearly = camera.intrinsics, np.array([8 - 2e-4, 6 - 3e-4])
    point = np.append((nearly - matrix[:2, 2]) / matrix[[0, 1], [0, 1]], 1.0)
    pose = np.eye(4)
    pose[:3, 3] = point
    instance = Instance(OrganClass.PEPPER, "fruit")
    measures = dict.fromkeys(("ripeness", "ripeness_spread", "length_m", "diameter_m"), 0.1)
    fruit = FruitTruth(
        0, instance, pose, -np.ones(3) / 10, np.ones(3) / 10, measures, point, (0,), None, None
    )
    view = LabelView(camera, np.ones((6, 8), np.uint16), np.ones((6, 8), np.float32))
    mask = AmodalMask((0, 0), np.ones((6, 8), bool))
    (entry,) = harvest_truth([(fruit, mask)], view, [instance])["fruit"]
    for name in ("stalk_end", "blossom_end"):
        x, y = json.loads(json.dumps(entry[name]["px"]))
        assert 7.999 <= x < 8
        assert 5.999 <= y < 6

"""Keypoints and boxes: COCO by pycocotools, YOLO by a reader of the published label formats.

Formats: https://cocodataset.org/#format-data, https://docs.ultralytics.com/datasets/pose/ and /detect/.
"""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
from label_set import (
    FRAMES,
    MAPPING,
    NAMES,
    POINTS,
    box_of,
    expected_objects,
    expected_points,
    export,
    fruit_truth,
    pixels_of_box,
    read_yolo,
)
from painted_set import SIZE

from pepperscene.dataset.store.images import read_image

pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")
yaml = pytest.importorskip("yaml", reason="a reader of YAML")
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

from pycocotools.coco import COCO  # noqa: E402
from pycocotools.cocoeval import COCOeval  # noqa: E402


def load_coco(folder):
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(folder / "annotations" / "instances_train.json")


def check_coco(dataset, truth):
    """Fruit has its keypoints, 0.05 pixels from the harvest truth, and its attributes."""
    visibilities = []
    for category in truth.cats.values():
        if category["name"] in ("ripe", "green"):
            assert tuple(category["keypoints"]) == POINTS
            assert category["skeleton"] == [[1, 2], [2, 3]]
        else:
            assert "keypoints" not in category
    for index in FRAMES:
        fruit = fruit_truth(dataset, index)
        for one in truth.imgToAnns[index]:
            if "keypoints" not in truth.cats[one["category_id"]]:
                assert "keypoints" not in one
                continue
            found = np.array(one["keypoints"], float).reshape(3, 3)
            assert one["num_keypoints"] == np.count_nonzero(found[:, 2])
            if one["iscrowd"]:
                assert not found.any()
                continue
            entry = fruit[one["attributes"]["instance"]]
            expected = expected_points(entry)
            assert (found[:, 2] == expected[:, 2]).all()
            # Centres of first pixels are at 0 in COCO, at 0.5 in the data set.
            known = expected[:, 2] > 0
            distance = np.linalg.norm(found[known, :2] + 0.5 - expected[known, :2], axis=1)
            assert distance.max(initial=0) < 0.05, "a keypoint is elsewhere"
            assert not found[~known].any()
            attributes = one["attributes"]
            assert attributes["pose"] == entry["pose"]
            assert attributes["distance_m"] == pytest.approx(
                np.linalg.norm(entry["box_3d"]["centre"]), abs=1e-6
            )
            assert attributes["visible_fraction"] == entry["visible_fraction"]
            visibilities += found[:, 2].tolist()
    assert set(visibilities) == {0, 1, 2}


def test_coco_has_keypoints_and_poses_of_fruit(labels, tmp_path):
    check_coco(labels, load_coco(export(labels, "coco", tmp_path / "out", classes=MAPPING)))


def test_pycocotools_evaluates_the_keypoints(labels, tmp_path):
    truth = load_coco(export(labels, "coco", tmp_path / "out", classes="pepper"))
    detections = [
        {key: one[key] for key in ("image_id", "category_id", "keypoints")} | {"score": 1.0}
        for one in truth.anns.values()
        if not one["iscrowd"] and one["num_keypoints"]
    ]

    def precision(found):
        with contextlib.redirect_stdout(io.StringIO()):
            evaluation = COCOeval(truth, truth.loadRes(found), "keypoints")
            evaluation.params.kpt_oks_sigmas = np.full(len(POINTS), 0.05)
            evaluation.params.areaRng, evaluation.params.areaRngLbl = [[0, 1e10]], ["all"]
            evaluation.evaluate()
            evaluation.accumulate()
        values = evaluation.eval["precision"]
        return values[values > -1].mean()

    assert precision(detections) == pytest.approx(1, abs=1e-12)
    for one in detections:
        one["keypoints"] = (np.reshape(one["keypoints"], (3, 3)) + np.array([30, 0, 0])).ravel().tolist()
    assert precision(detections) < 0.5


def check_yolo(dataset, folder, kpt_shape=None, smallest_px=1):
    """Each line is an object with its class and its box, and with its keypoints if the format has them."""
    data = yaml.safe_load((folder / "data.yaml").read_text())
    assert list(data["names"].values()) == list(NAMES)
    assert data.get("kpt_shape") == kpt_shape
    for index in FRAMES:
        name = f"{index:06d}"
        image = read_image(folder / data["train"] / f"{name}.png")
        assert (image == dataset.image(index, "colour")).all()
        lines = read_yolo(folder / data["train"].replace("images", "labels") / f"{name}.txt")
        expected, fruit = expected_objects(dataset, index, smallest_px), fruit_truth(dataset, index)
        assert len(lines) == len(expected)
        for (number, values), (value, (label, mask)) in zip(lines, sorted(expected.items()), strict=True):
            assert data["names"][number] == label, f"the class of {value}"
            assert len(values) == 4 + np.prod(kpt_shape or [0])
            assert values[4:].min(initial=0) >= 0
            assert values[:4].max() <= 1
            np.testing.assert_allclose(
                pixels_of_box(values[:4]), box_of(mask), atol=1e-3, err_msg=f"the box of {value}"
            )
            if kpt_shape:
                points = values[4:].reshape(kpt_shape)
                truth = expected_points(fruit[value]) if label in ("ripe", "green") else np.zeros((3, 3))
                assert (points[:, 2] == truth[:, 2]).all()
                distance = np.linalg.norm(points[:, :2] * SIZE[::-1] - truth[:, :2], axis=1)
                assert distance.max() < 0.05, f"a keypoint of {value}"


def test_detection_has_boxes(labels, tmp_path):
    check_yolo(labels, export(labels, "yolo_detect", tmp_path / "a", classes=MAPPING, smallest_px=1))
    check_yolo(labels, export(labels, "yolo_detect", tmp_path / "b", classes=MAPPING), smallest_px=12)


def test_pose_has_boxes_and_keypoints(labels, tmp_path):
    folder = export(labels, "yolo_pose", tmp_path / "out", classes=MAPPING, smallest_px=1)
    check_yolo(labels, folder, [3, 3])
    data = yaml.safe_load((folder / "data.yaml").read_text())
    assert data["kpt_names"] == {0: list(POINTS), 1: list(POINTS)}
    # A mirrored image has the same points: none is of the left or the right side.
    assert data["flip_idx"] == [0, 1, 2]


def test_pose_is_of_fruit_by_default(labels, tmp_path):
    folder = export(labels, "yolo_pose", tmp_path / "out")
    assert yaml.safe_load((folder / "data.yaml").read_text())["names"] == {0: "pepper"}


def test_words_of_yaml_stay_names(labels, tmp_path):
    folder = export(labels, "yolo_detect", tmp_path / "out", classes="no=leaf,null=stem,y=pepper")
    data = yaml.safe_load((folder / "data.yaml").read_text())
    assert data["names"] == {0: "no", 1: "null", 2: "y"}

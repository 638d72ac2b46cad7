"""COCO and YOLO read back: COCO by pycocotools, YOLO by readers of its published label formats.

https://cocodataset.org/#format-data, https://docs.ultralytics.com/datasets/ (segment, detect, pose)
"""

from __future__ import annotations

import contextlib
import io
import json

import cv2
import numpy as np
import yaml
from figures import Figures
from label_set import box_of, expected_points, fruit_truth
from PIL import Image

from pepperscene.classes import OrganClass
from pepperscene.export.polygons import MAX_BRIDGE_FRACTION
from pepperscene.truth.encodings import decode_rle

SMALLEST_PX = 12  # default of the formats of YOLO
REST = 65536
"""Panoptic ids from here on are of pixels that belong to no organ."""


def organs(dataset, index, smallest_px=1):
    """The entries of a frame's organs of plants by instance, ascending."""
    entries = dataset.metadata(index)["instances"].items()
    found = {int(key): entry for key, entry in entries if entry["class"] and entry["plant"] >= 0}
    return {value: found[value] for value in sorted(found) if found[value]["pixels"] >= smallest_px}


def class_name(entry):
    return OrganClass(entry["class"]).name.lower()


# --- COCO ------------------------------------------------------------------------------------------------


def verify_coco(dataset, folder):
    from pycocotools.coco import COCO

    figures = Figures()
    with contextlib.redirect_stdout(io.StringIO()):
        truth = COCO(folder / "annotations" / "instances_train.json")
    assert sorted(truth.imgs) == list(dataset.indices())
    for index, record in truth.imgs.items():
        photograph = (folder / "train" / record["file_name"]).read_bytes()
        assert photograph == dataset.path(index, "colour").read_bytes(), f"frame {index}: another photograph"
        instance, entries, fruit = dataset.image(index, "instance"), organs(dataset, index), {}
        fruit = fruit_truth(dataset, index)
        things = {one["attributes"]["instance"]: one for one in truth.imgToAnns[index] if not one["iscrowd"]}
        assert sorted(things) == list(entries), f"frame {index}: other organs"
        for value, one in things.items():
            place = f"frame {index}, organ {value}"
            name = truth.cats[one["category_id"]]["name"]
            assert name == class_name(entries[value]), f"{place}: the class differs"
            figures.add_mask(truth.annToMask(one) > 0, instance == value, place)
            assert one["bbox"] == box_of(instance == value), f"{place}: the box differs"
            if value in fruit:
                _compare_fruit(figures, one, fruit[value], dataset.metadata(index)["camera"], place)
    _compare_panoptic(figures, dataset, folder / "annotations")
    return figures


def _compare_fruit(figures, annotation, fruit, camera, place):
    """Keypoints, amodal mask, and the pose, whose origin is the end of the fruit at the stalk."""
    from pycocotools import mask as coder

    found, expected = np.array(annotation["keypoints"], float).reshape(3, 3), expected_points(fruit)
    assert (found[:, 2] == expected[:, 2]).all(), f"{place}: a keypoint's visibility differs"
    known = expected[:, 2] > 0
    # The centre of the first pixel is at 0 in COCO, at 0.5 in the data set; COCO has no points before it.
    size = np.array([camera["width"], camera["height"]])
    inside = np.clip(expected[known, :2], 0.5, size - 0.5)
    figures.add_points(found[known, :2] + 0.5, inside, place)
    amodal = coder.decode(annotation["attributes"]["amodal"]["segmentation"]) > 0
    figures.add_mask(amodal, decode_rle(fruit["amodal"]), place)
    if known[1]:
        x, y, z = np.array(annotation["attributes"]["pose"])[:3, 3]
        pixel = [camera["fx"] * x / z + camera["cx"], camera["fy"] * y / z + camera["cy"]]
        figures.add_points([pixel if z > 0 else [np.inf, np.inf]], expected[1:2, :2], f"{place}, pose")


def _compare_panoptic(figures, dataset, annotations):
    content = json.loads((annotations / "panoptic_train.json").read_text())
    for record in content["annotations"]:
        index = record["image_id"]
        with Image.open(annotations / "panoptic_train" / record["file_name"]) as image:
            red, green, blue = np.moveaxis(np.asarray(image, int), 2, 0)
        ids, place = red + 256 * green + 65536 * blue, f"panoptic image {index}"
        category = {info["id"]: info["category_id"] for info in record["segments_info"]}
        assert set(category) == set(np.unique(ids)), f"{place}: other segments"
        instance = dataset.image(index, "instance")
        is_organ = np.isin(instance, list(organs(dataset, index)))
        figures.add_labels(np.where(ids < REST, ids, 0), np.where(is_organ, instance, 0), place)
        found = np.vectorize(category.get)(ids)
        figures.add_labels(found, dataset.image(index, "class"), f"{place}, class")


# --- YOLO ------------------------------------------------------------------------------------------------


def verify_yolo(dataset, folder):
    """Polygons, filled as Ultralytics does, are masks except for bridges between pieces of an organ."""
    figures = Figures()
    for index, names, lines in _label_files(dataset, folder):
        instance, entries = dataset.image(index, "instance"), organs(dataset, index, SMALLEST_PX)
        filled = {}
        for number, values in lines:
            points = (values.reshape(-1, 2) * instance.shape[::-1]).astype(np.int32)
            mask = np.zeros(instance.shape, np.uint8)
            cv2.fillPoly(mask, [points], 1)
            value = int(np.bincount(instance[mask > 0]).argmax())
            assert value in entries, f"frame {index}: a polygon of no organ"
            place = f"frame {index}, organ {value}"
            assert names[number] == class_name(entries[value]), f"{place}: the class differs"
            filled[value] = filled.get(value, False) | (mask > 0)
        for value, mask in filled.items():
            _compare_filled(figures, mask, instance == value, f"frame {index}, organ {value}")
        assert all(value in filled for value in entries if entries[value]["pixels"] > 200), f"frame {index}"
    return figures


def _compare_filled(figures, mask, expected, place):
    """All pixels of the pieces that the polygons cover, and no others but those of bridges."""
    count, pieces = cv2.connectedComponents(expected.astype(np.uint8))
    covered = np.isin(pieces, np.setdiff1d(pieces[mask], [0]))
    pixels = expected.sum()
    small = sum(size for size in np.bincount(pieces.ravel(), minlength=count)[1:] if size < SMALLEST_PX)
    bridges = (MAX_BRIDGE_FRACTION + 0.01) * pixels + 2 * small
    differs = (covered & ~mask).sum() > 0.01 * pixels or (mask & ~expected).sum() > bridges
    assert not differs, f"{place}: a mask differs"
    figures.masks += 1
    figures.ious.append((int(pixels), (mask & expected).sum() / (mask | expected).sum()))


def verify_yolo_detect(dataset, folder):
    return _verify_boxes(dataset, folder, lambda entry: True)


def verify_yolo_pose(dataset, folder):
    return _verify_boxes(dataset, folder, lambda entry: entry["class"] == OrganClass.PEPPER)


def _verify_boxes(dataset, folder, is_object):
    """Each line is an organ, in ascending order, with its class and box, and keypoints if there are some."""
    figures = Figures()
    for index, names, lines in _label_files(dataset, folder):
        instance, fruit = dataset.image(index, "instance"), fruit_truth(dataset, index)
        entries = organs(dataset, index, SMALLEST_PX)
        entries = {value: entry for value, entry in entries.items() if is_object(entry)}
        assert len(lines) == len(entries), f"frame {index}: other organs"
        size = np.array(instance.shape[::-1])
        for (number, values), (value, entry) in zip(lines, entries.items(), strict=True):
            place = f"frame {index}, organ {value}"
            assert names[number] == class_name(entry), f"{place}: the class differs"
            corner, extent = (values[:2] - values[2:4] / 2) * size, values[2:4] * size
            left, top, width, height = box_of(instance == value)
            expected = np.array([[left, top], [left + width, top + height]])
            figures.add_points([corner, corner + extent], expected, f"{place}, box")
            points = values[4:].reshape(-1, 3)
            if len(points):
                truth = expected_points(fruit[value])
                assert (points[:, 2] == truth[:, 2]).all(), f"{place}: a keypoint's visibility differs"
                figures.add_points(points[:, :2] * size, truth[:, :2], f"{place}, keypoint")
    return figures


def _label_files(dataset, folder):
    """Index, names of the classes by number, and number and values of each line, of every photograph."""
    data = yaml.safe_load((folder / "data.yaml").read_text())
    images = sorted((folder / data["train"]).iterdir())
    assert [int(path.stem) for path in images] == list(dataset.indices())
    for path in images:
        index = int(path.stem)
        assert path.read_bytes() == dataset.path(index, "colour").read_bytes(), f"frame {index}"
        # Ultralytics replaces the folder `images` by `labels`.
        text = (folder / data["train"].replace("images", "labels") / f"{path.stem}.txt").read_text()
        lines = [line.split() for line in text.splitlines()]
        yield index, data["names"], [(int(number), np.array(values, float)) for number, *values in lines]

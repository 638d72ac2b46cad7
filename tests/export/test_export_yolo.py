"""YOLO by readers of the published label formats: polygons, boxes, poses and data.yaml.

Formats: https://docs.ultralytics.com/datasets/ (segment, detect, pose)
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
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
from painted_set import FRAMES as PAINTED_FRAMES
from painted_set import SIZE

from pepperscene.classes import OrganClass
from pepperscene.dataset.store.images import read_image
from pepperscene.export.yolo import MAX_BRIDGE_FRACTION, VisibleObject, mask_polygons

cv2 = pytest.importorskip("cv2", reason="the extra `test` installs OpenCV")
yaml = pytest.importorskip("yaml", reason="a reader of YAML")


def read_data(folder):
    return yaml.safe_load((folder / "data.yaml").read_text())


# Polygons.


def fill(points, size):
    """A mask as Ultralytics makes it: coordinates truncated to integers, sides painted."""
    mask = np.zeros(size, np.uint8)
    cv2.fillPoly(mask, [np.asarray(points).astype(np.int32)], 1)
    return mask > 0


def read_masks(path):
    """Class and mask of every line of a label file."""
    masks = []
    for number, values in read_yolo(path):
        points = values.reshape(-1, 2)
        # A line with four numbers would be a box.
        assert len(points) >= 3
        assert points.min() > 0
        assert points.max() < 1
        masks.append((number, fill(points * SIZE[::-1], SIZE)))
    return masks


def test_every_organ_has_its_mask(painted, tmp_path):
    out = export(painted, "yolo", tmp_path / "out", split="train=.6,val=.4")
    assert read_data(out) == {
        "train": "images/train",
        "val": "images/val",
        "names": {int(organ) - 1: organ.name.lower() for organ in OrganClass if organ},
    }
    for split, indices in (("train", PAINTED_FRAMES[:4]), ("val", PAINTED_FRAMES[4:])):
        names = [f"{index:06d}" for index in indices]
        assert sorted(path.stem for path in (out / "labels" / split).iterdir()) == names
        for index, name in zip(indices, names, strict=True):
            colour = read_image(out / "images" / split / f"{name}.png")
            assert (colour == painted.image(index, "colour")).all()
            instance, entries = painted.image(index, "instance"), painted.metadata(index)["instances"]
            masks = {}
            for class_id, mask in read_masks(out / "labels" / split / f"{name}.txt"):
                value = int(np.bincount(instance[mask], minlength=1).argmax())
                assert class_id == entries[str(value)]["class"] - 1
                masks.setdefault(value, []).append(mask)
            large = 0
            for value, entry in entries.items():
                is_organ = entry["class"] > 0 and entry["plant"] >= 0
                if not is_organ or entry["pixels"] < 12:
                    assert int(value) not in masks
                elif entry["pixels"] > 200:
                    mask, expected = np.any(masks[int(value)], axis=0), instance == int(value)
                    assert np.count_nonzero(mask & expected) / np.count_nonzero(mask | expected) >= 0.9
                    large += 1
            assert large > 8


@pytest.mark.parametrize(
    ("split", "train", "val"),
    [(None, "train", "train"), ("a=.5,b=.5", "a", "a"), ("val=.5,x=.5", "val", "val"),
     ("train=.5,validation=.5", "train", "validation")],
)  # fmt: skip
def test_description_has_train_and_val_for_any_split_names(split, train, val, painted, tmp_path):
    out = export(painted, "yolo_detect", tmp_path / "out", split=split, frames="0:15" if split else "0:1")
    description = read_data(out)
    assert (description["train"], description["val"]) == (f"images/{train}", f"images/{val}")


def test_smallest_organ_is_an_option(painted, tmp_path):
    out = export(painted, "yolo", tmp_path / "out", frames="3:4", smallest_px=300)
    entries = painted.metadata(3)["instances"].values()
    large = [entry for entry in entries if entry["class"] and entry["plant"] >= 0 and entry["pixels"] >= 300]
    assert 0 < len(read_masks(out / "labels" / "train" / "000003.txt")) <= len(large)


def test_hole_stays_open():
    mask = np.zeros((60, 80), bool)
    mask[10:50, 10:70] = True
    mask[20:40, 20:35] = mask[15:30, 50:60] = mask[45, 45] = False
    (polygon,) = mask_polygons(mask, 12)
    assert (fill(polygon, mask.shape) == mask).all()


def test_island_in_a_hole_is_joined():
    yy, xx = np.mgrid[:101, :101] - 50
    radius = np.hypot(xx, yy)
    mask = (radius < 45) & ~((radius > 20) & (radius < 24))
    (polygon,) = mask_polygons(mask, 12)
    # The bridge over the hole is painted.
    assert 0 < np.count_nonzero(fill(polygon, mask.shape) & ~mask) <= 5
    assert (mask <= fill(polygon, mask.shape)).all()


def test_near_pieces_are_joined_and_far_ones_are_not():
    near, far = np.zeros((2, 40, 200), bool)
    near[10:30, 10:40] = near[10:30, 44:80] = True
    far[10:30, 10:40] = far[10:30, 150:190] = True
    assert len(mask_polygons(near, 12)) == 1
    polygons = mask_polygons(far, 12)
    # The larger one comes first.
    assert [cv2.boundingRect(polygon) for polygon in polygons] == [(150, 10, 40, 20), (10, 10, 30, 20)]
    assert (np.any([fill(polygon, far.shape) for polygon in polygons], axis=0) == far).all()


def test_small_pieces_are_left_out():
    mask = np.zeros((20, 60), bool)
    mask[5:8, 5:9] = mask[5, 40:43] = True
    assert len(mask_polygons(mask, 12)) == 1
    assert mask_polygons(mask, 13) == []
    assert mask_polygons(np.zeros((5, 5), bool), 1) == []


def random_mask(seed):
    """Overlapping ellipses, some of them removed."""
    rng = np.random.default_rng(seed)
    mask = np.zeros((64, 80), np.uint8)
    for value in rng.choice([1, 1, 0], 14):
        centre, axes = map(int, rng.integers(0, 64, 2)), map(int, rng.integers(2, 16, 2))
        cv2.ellipse(mask, tuple(centre), tuple(axes), float(rng.uniform(0, 180)), 0, 360, int(value), -1)
    return mask > 0


@given(st.integers(0, 2**32 - 1))
@example(13226)  # the shortest bridge between two pieces crosses a third one
@example(16973)
def test_polygons_cover_a_mask_except_bridges_and_specks(seed):
    mask = random_mask(seed)
    filled = [fill(polygon, mask.shape) for polygon in mask_polygons(mask, 4)]
    covered = np.any(filled, axis=0) if filled else np.zeros_like(mask)
    _, labels = cv2.connectedComponents(mask.view(np.uint8))
    sizes = np.bincount(labels.ravel())
    # Only pieces below the smallest may be missing, and only bridges may be painted.
    specks = np.isin(labels, np.flatnonzero(sizes < 4))
    assert np.count_nonzero(mask & ~covered & ~specks) <= 0.01 * np.count_nonzero(mask)
    small = sum(int(size) for size in sizes[1:] if size < 4)
    limit = 0.01 * mask.sum() + MAX_BRIDGE_FRACTION * mask.sum() + 2 * small
    assert np.count_nonzero(covered & ~mask) <= limit
    assert not any((a & b & mask).any() for a, b in itertools.combinations(filled, 2))


# Boxes and keypoints.


@pytest.mark.parametrize(
    ("format_name", "smallest_px"), [("yolo_detect", 1), ("yolo_detect", None), ("yolo_pose", 1)]
)
def test_each_line_is_an_object_with_its_class_box_and_keypoints(format_name, smallest_px, labels, tmp_path):
    out = export(labels, format_name, tmp_path / "out", classes=MAPPING, smallest_px=smallest_px)
    data, kpt_shape = read_data(out), [3, 3] if format_name == "yolo_pose" else None
    assert list(data["names"].values()) == list(NAMES)
    assert data.get("kpt_shape") == kpt_shape
    if kpt_shape:
        assert data["kpt_names"] == {0: list(POINTS), 1: list(POINTS)}
        # A mirrored image has the same points: none is of the left or the right side.
        assert data["flip_idx"] == [0, 1, 2]
    for index in FRAMES:
        lines = read_yolo(out / "labels" / "train" / f"{index:06d}.txt")
        expected, fruit = expected_objects(labels, index, smallest_px or 12), fruit_truth(labels, index)
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
                np.testing.assert_allclose(points * [*SIZE[::-1], 1], truth, rtol=0, atol=0.035)


def test_keypoints_at_the_border_are_inside_the_picture(borders, tmp_path):
    out = export(borders, "yolo_pose", tmp_path / "out")
    assert read_data(out)["names"] == {0: "pepper"}
    lines = read_yolo(out / "labels" / "train" / "000000.txt")
    points = np.array([values[4:].reshape(3, 3) for _, values in lines])
    assert points[..., :2].min() >= 0
    assert points[..., :2].max() <= 1
    assert points[..., 2].any()


def test_edges_of_boxes_are_inside_the_picture():
    for count in (3, 7, 11, 480, 799, 1280, 4999):
        for start in range(0, count, max(1, count // 40)):
            text = VisibleObject(1, 0, (slice(0, count - start), slice(start, count))).box((count, count))
            x, y, width, height = (round(float(number) * 1e6) for number in text.split())
            for centre, extent in ((x, width), (y, height)):
                assert 0 <= 2 * centre - extent <= 2 * centre + extent <= 2_000_000
            # Within a millionth of the image's side.
            assert abs(x / 1e6 - 0.5 * (start + count) / count) < 1e-6
            assert abs(width / 1e6 - (count - start) / count) < 2.1e-6


def test_words_of_yaml_stay_names(labels, tmp_path):
    out = export(labels, "yolo_detect", tmp_path / "out", classes="no=leaf,null=stem,y=pepper", frames="0:1")
    assert read_data(out)["names"] == {0: "no", 1: "null", 2: "y"}

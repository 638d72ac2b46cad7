"""Faults to plant in the folder of an export of a rendered set: shifted masks, swapped classes, wrong poses.

`FAULTS` has for each format functions that change files of the export in place, by a short name.
"""

from __future__ import annotations

import gzip
import io
import json
import tarfile

import cv2
import numpy as np
from label_set import edit_json
from PIL import Image

LEAF, FRUIT = 1, 2


# --- what a fault does to an array -----------------------------------------------------------------------


def shift_fruit(image):
    """The pixels of class 2 move right by one."""
    mask = image == FRUIT
    result = np.where(mask, 0, image).astype(image.dtype)
    result[np.roll(mask, 1, axis=1)] = FRUIT
    return result


def shift(mask):
    return np.roll(mask, 1, axis=1)


def swap_classes(image):
    """Leaves become fruit, and fruit leaves."""
    result = image.copy()
    result[image == LEAF], result[image == FRUIT] = FRUIT, LEAF
    return result


def scale(depth):
    """By one per cent; whole numbers stay whole."""
    scaled = 1.01 * depth
    return scaled.astype(depth.dtype) if depth.dtype.kind == "f" else np.rint(scaled).astype(depth.dtype)


def scale_code(code):
    """Distances of the 8-bit code by five per cent."""
    return np.clip(np.rint(255 - 1.05 * (255.0 - code)), 0, 255).astype(np.uint8)


def invert(pose):
    return np.linalg.inv(np.array(pose)).tolist()


# --- how files are changed -------------------------------------------------------------------------------


def first(folder, pattern):
    return sorted(folder.rglob(pattern))[0]


def images(pattern, change):
    """A fault in the first image of a name that it changes."""

    def plant(folder):
        for path in sorted(folder.glob(pattern)):
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            changed = change(image)
            if (changed != image).any():
                cv2.imwrite(str(path), changed)
                return
        raise ValueError(f"no image changes: {pattern}")

    return plant


def coco(change):
    """A fault in the list of annotations of organs."""
    return lambda folder: edit_json(
        folder / "annotations" / "instances_train.json",
        lambda content: change([one for one in content["annotations"] if not one["iscrowd"]]),
    )


def shift_annotation(annotations):
    from pycocotools import mask as coder

    one = next(one for one in annotations if one["area"] > 100)
    moved = coder.encode(np.asfortranarray(shift(coder.decode(one["segmentation"]))))
    one["segmentation"]["counts"] = moved["counts"].decode()


def swap_categories(annotations):
    one = next(one for one in annotations if one["category_id"] == FRUIT)
    other = next(one for one in annotations if one["category_id"] == LEAF)
    one["category_id"], other["category_id"] = LEAF, FRUIT


def swap_keypoints(annotations):
    """The ends of a fruit."""
    points = next(one["keypoints"] for one in annotations if one.get("num_keypoints") == 3)
    points[3:6], points[6:9] = points[6:9], points[3:6]


def invert_pose_of_fruit(annotations):
    one = next(one for one in annotations if one.get("num_keypoints") == 3)
    one["attributes"]["pose"] = invert(one["attributes"]["pose"])


def shift_segment(image):
    """The largest organ of a panoptic image, as OpenCV reads it."""
    ids = image.astype(int) @ [65536, 256, 1]
    values, counts = np.unique(ids[ids < 65536], return_counts=True)
    mask = ids == values[counts.argmax()]
    result = image.copy()
    result[shift(mask)] = image[mask][0]
    return result


def yolo(change, is_chosen=lambda words: True):
    """A fault in the first chosen line of a label file."""

    def plant(folder):
        path = first(folder, "labels/train/*.txt")
        lines = [line.split() for line in path.read_text().splitlines()]
        change(next(line for line in lines if is_chosen(line)))
        path.write_text("".join(" ".join(line) + "\n" for line in lines))

    return plant


def shift_polygon(words):
    words[1::2] = [f"{float(x) + 1 / 320:.6f}" for x in words[1::2]]


def shift_box(words):
    words[1] = f"{float(words[1]) + 1 / 320:.6f}"


def change_number(words):
    words[0] = str((int(words[0]) + 1) % 7)


def swap_ends(words):
    words[8:11], words[11:14] = words[11:14], words[8:11]


def is_large(words):
    return np.ptp(np.array(words[1::2], float)) > 0.1


def has_ends(words):
    return words[10] == words[13] != "0"


def shards(suffix, change):
    """A fault in a member of the first sample."""

    def plant(folder):
        path = first(folder, "*.tar")
        with tarfile.open(path) as tar:
            members = [(member, tar.extractfile(member).read()) for member in tar]
        with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
            done = False
            for member, content in members:
                if member.name.partition(".")[2] == suffix and not done:
                    content, done = _changed(content, change, suffix), True
                    member.size = len(content)
                tar.addfile(member, io.BytesIO(content))
        assert done

    return plant


def _changed(content, change, suffix):
    if suffix == "json":
        value = json.loads(content)
        change(value)
        return json.dumps(value).encode()
    buffer = io.BytesIO()
    np.save(buffer, change(np.load(io.BytesIO(gzip.decompress(content)))))
    return gzip.compress(buffer.getvalue())


def parquet(column, change):
    """A fault in a column of the first row."""

    def plant(folder):
        import pyarrow as pa
        from pyarrow import parquet as files

        path = first(folder, "*.parquet")
        table = files.read_table(path)
        values = table[column].to_pylist()
        values[0] = change(values[0])
        place = table.column_names.index(column)
        field = table.schema.field(place)
        files.write_table(table.set_column(place, field, pa.array(values, field.type)), path)

    return plant


def stored_image(change):
    def changed(value):
        with Image.open(io.BytesIO(value["bytes"])) as image:
            array = np.asarray(image)
        buffer = io.BytesIO()
        Image.fromarray(change(array)).save(buffer, "png")
        return {**value, "bytes": buffer.getvalue()}

    return changed


def swap_organs(organs):
    for organ in organs:
        organ["class"] = {LEAF: FRUIT, FRUIT: LEAF}.get(organ["class"], organ["class"])
    return organs


def invert_camera(metadata):
    metadata["camera"]["pose"] = invert(metadata["camera"]["pose"])


def invert_transform(folder):
    def change(content):
        entry = content["frames"][0]
        entry["transform_matrix"] = invert(entry["transform_matrix"])

    edit_json(first(folder, "transforms.json"), change)


def invert_colmap(folder):
    """The first pose becomes camera to world."""
    path = first(folder, "images.txt")
    lines = path.read_text().splitlines()
    row = next(number for number, line in enumerate(lines) if not line.startswith("#"))
    words = lines[row].split()
    (w, *xyz), translation = map(float, words[1:5]), np.array(words[5:8], float)
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat([*xyz, w]).inv()
    words[2:5] = [str(-value) for value in xyz]
    words[5:8] = [str(value) for value in -turn.apply(translation)]
    lines[row] = " ".join(words)
    path.write_text("\n".join(lines) + "\n")


def invert_trajectory(folder):
    """The first row of groundtruth.txt becomes world to camera."""
    from scipy.spatial.transform import Rotation

    path = first(folder, "groundtruth.txt")
    lines = path.read_text().splitlines()
    row = next(number for number, line in enumerate(lines) if not line.startswith("#"))
    time, *values = lines[row].split()
    turn = Rotation.from_quat(np.array(values[3:], float)).inv()
    numbers = [*-turn.apply(np.array(values[:3], float)), *turn.as_quat()]
    lines[row] = " ".join([time, *map(str, numbers)])
    path.write_text("\n".join(lines) + "\n")


def points(change):
    """A fault in the points of the first PLY file."""

    def plant(folder):
        path = first(folder, "*.ply")
        header, end, body = path.read_bytes().partition(b"end_header\n")
        types = {"float": "<f4", "uchar": "u1", "ushort": "<u2"}
        lines = [line.split() for line in header.decode().splitlines()]
        vertices = np.frombuffer(body, [(one[2], types[one[1]]) for one in lines if one[0] == "property"])
        vertices = vertices.copy()
        change(vertices)
        path.write_bytes(header + end + vertices.tobytes())

    return plant


def scale_points(vertices):
    for name in "xyz":
        vertices[name] *= 1.01


def swap_class_of_points(vertices):
    vertices["class"] = swap_classes(vertices["class"])


def shift_instances(vertices):
    vertices["instance"] = np.roll(vertices["instance"], 1)


def bop(table, change):
    """A fault in the first record of a table of the first scene."""
    return lambda folder: edit_json(
        first(folder, f"{table}.json"), lambda content: change(next(iter(content.values())))
    )


def invert_models(records):
    for record in records:
        record["cam_R_m2c"] = np.reshape(record["cam_R_m2c"], (3, 3)).T.ravel().tolist()


def swap_models(records):
    records[0]["obj_id"], records[1]["obj_id"] = records[1]["obj_id"], records[0]["obj_id"]


def invert_world(record):
    turn = np.reshape(record["cam_R_w2c"], (3, 3))
    record["cam_R_w2c"] = turn.T.ravel().tolist()
    record["cam_t_w2c"] = (-turn.T @ record["cam_t_w2c"]).tolist()


CLASS_FAULTS = {"shifted mask": shift_fruit, "swapped class": swap_classes}
GREY = "synthetic_label_class_grayscale"
FAULTS = {
    "published": {
        name: images(f"{GREY}/synthetic_label_class_all_grayscale/*.png", change)
        for name, change in CLASS_FAULTS.items()
    } | {
        "shifted binary mask": images(f"{GREY}/synthetic_label_class_2_grayscale_binary/*.png", shift),
        "scaled distance": images("synthetic_label_depth_grayscale/*.png", scale_code),
    },
    "semantic": {name: images("masks/train/*.png", change) for name, change in CLASS_FAULTS.items()},
    "webdataset": {
        **{name: shards("class.npy.gz", change) for name, change in CLASS_FAULTS.items()},
        "inverted pose": shards("json", invert_camera),
        "scaled distance": shards("distance.npy.gz", scale),
    },
    "huggingface": {
        "shifted mask": parquet("mask", stored_image(shift_fruit)),
        "swapped class": parquet("organs", swap_organs),
        "inverted pose": parquet("pose", invert),
        "scaled distance": parquet("distance", lambda rows: scale(np.array(rows, np.float32)).tolist()),
    },
    "coco": {
        "shifted mask": coco(shift_annotation),
        "swapped class": coco(swap_categories),
        "swapped keypoint": coco(swap_keypoints),
        "inverted pose": coco(invert_pose_of_fruit),
        "shifted panoptic mask": images("annotations/panoptic_train/*.png", shift_segment),
    },
    "yolo": {"shifted mask": yolo(shift_polygon, is_large), "swapped class": yolo(change_number)},
    "yolo_detect": {"shifted box": yolo(shift_box), "swapped class": yolo(change_number)},
    "yolo_pose": {"shifted box": yolo(shift_box), "swapped keypoint": yolo(swap_ends, has_ends)},
    "nerfstudio": {
        "inverted pose": invert_transform,
        "scaled depth": images("**/depths/*.png", scale),
    },
    "colmap": {"inverted pose": invert_colmap},
    "ply": {
        "scaled depth": points(scale_points),
        "swapped class": points(swap_class_of_points),
        "shifted mask": points(shift_instances),
    },
    "rgbd": {"inverted pose": invert_trajectory, "scaled depth": images("**/depth/*.png", scale)},
    "bop": {
        "shifted mask": images("train/*/mask_visib/*.png", shift),
        "swapped object": bop("scene_gt", swap_models),
        "inverted pose": bop("scene_gt", invert_models),
        "inverted camera": bop("scene_camera", invert_world),
        "scaled depth": images("train/*/depth/*.png", scale),
    },
}  # fmt: skip

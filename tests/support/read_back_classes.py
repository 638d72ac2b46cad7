"""Formats of whole images read back: the published layout and masks by Pillow, others by their libraries.

Shards are read by webdataset, Parquet files by Hugging Face's `datasets`.
"""

from __future__ import annotations

import csv
import gc
import json
import tempfile

import numpy as np
from figures import Figures
from PIL import Image
from read_back_geometry import View, compare_view

from pepperscene.classes import OrganClass

NAMES = [organ.name.lower() for organ in OrganClass]
CODE_MM = 8.5
"""A step of the 8-bit code of distances."""


def read_png(path):
    with Image.open(path) as image:
        return np.asarray(image)


def verify_published(dataset, folder):
    figures = Figures()
    with (folder / "frames.csv").open(newline="") as file:
        numbers = {int(row["index"]): row["number"] for row in csv.DictReader(file)}
    assert sorted(numbers) == list(dataset.indices())

    def read(name, number, within=""):
        return read_png(folder / within / name / f"{name}_{number}.png")

    for index, number in numbers.items():
        place, classes = f"frame {index}", dataset.image(index, "class")
        photograph = read("synthetic_image_color", number)
        assert (photograph == dataset.image(index, "colour")).all(), f"{place}: another photograph"
        grey = "synthetic_label_class_grayscale"
        figures.add_labels(read("synthetic_label_class_all_grayscale", number, grey), classes, place)
        for organ in range(1, 8):
            name = f"synthetic_label_class_{organ}_grayscale"
            mask = read_png(folder / grey / f"{name}_binary" / f"{name}_{number}.png")
            figures.add_mask(mask > 0, classes == organ, f"{place}, binary image of class {organ}")
        # z in cm is (255 - I) / (2 * 150 / 255); 0 is beyond.
        code = read("synthetic_label_depth_grayscale", number)
        distance = 10 * (255.0 - code) / (2 * 150 / 255)
        known = code > 0
        expected = 1000 * dataset.image(index, "distance")
        figures.add_depths(distance[known], expected[known], place, CODE_MM / 2 + 0.01)
    return figures


def verify_semantic(dataset, folder):
    figures = Figures()
    table = json.loads((folder / "classes.json").read_text())["classes"]
    assert [one["name"] for one in sorted(table, key=lambda one: one["value"])] == NAMES
    for index in dataset.indices():
        name, place = f"train/{index:06d}.png", f"frame {index}"
        photograph = read_png(folder / "images" / name)
        assert (photograph == dataset.image(index, "colour")).all(), f"{place}: another photograph"
        figures.add_labels(read_png(folder / "masks" / name), dataset.image(index, "class"), place)
    return figures


def verify_webdataset(dataset, folder):
    import webdataset

    figures, keys = Figures(), []
    urls = [str(path) for path in sorted(folder.glob("*.tar"))]
    samples = webdataset.WebDataset(urls, shardshuffle=False, empty_check=False).decode("rgb8")
    for sample in samples:
        index = int(sample["__key__"])
        keys.append(index)
        place = f"frame {index}"
        assert (sample["colour.png"] == dataset.image(index, "colour")).all(), f"{place}: another photograph"
        for output in ("class", "instance"):
            found = sample[f"{output}.npy.gz"]
            figures.add_labels(found, dataset.image(index, output), f"{place}, {output}")
        camera = sample["json"]["camera"]
        _compare_camera(figures, dataset, index, camera["pose"], camera, sample["distance.npy.gz"])
        assert sample["harvest.json"] == dataset.image(index, "harvest"), f"{place}: another harvest truth"
    assert sorted(keys) == list(dataset.indices())
    # webdataset leaves it to the garbage collector to close the shards that it has read.
    del samples
    gc.collect()
    return figures


def verify_huggingface(dataset, folder):
    import datasets

    figures = Figures()
    with tempfile.TemporaryDirectory() as cache:
        rows = datasets.load_dataset(str(folder), cache_dir=cache, split="train")
        names = rows.features["organs"].feature["class"].names
        assert rows["index"][:] == list(dataset.indices())
        for row in rows.with_format("numpy"):
            index = int(row["index"])
            place, instances = f"frame {index}", dataset.metadata(index)["instances"]
            assert (row["image"] == dataset.image(index, "colour")).all(), f"{place}: another photograph"
            figures.add_labels(row["mask"], dataset.image(index, "class"), f"{place}, class")
            figures.add_labels(row["instances"], dataset.image(index, "instance"), f"{place}, instance")
            found = {str(organ["instance"]): names[organ["class"]] for organ in row["organs"]}
            expected = {value: NAMES[entry["class"]] for value, entry in instances.items()}
            assert found == expected, f"{place}: the class of an organ differs"
            _compare_camera(figures, dataset, index, row["pose"], row["camera"], row["distance"])
    return figures


def _compare_camera(figures, dataset, index, pose, camera, distance):
    """A pose (camera to world), intrinsics as in the frame's JSON, and metres along the rays `(h, w)`."""
    matrix = np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1.0]])
    # The centre of the first pixel is at (0.5, 0.5).
    matrix[:2, 2] -= 0.5
    rows, columns = np.mgrid[: distance.shape[0], : distance.shape[1]]
    rays = np.stack([columns, rows, np.ones(distance.shape)], axis=-1) @ np.linalg.inv(matrix).T
    depth_mm = 1000 * distance / np.linalg.norm(rays, axis=-1)
    view = View(index, np.linalg.inv(pose), matrix, np.where(np.isfinite(depth_mm), depth_mm, 0))
    compare_view(figures, dataset, view)

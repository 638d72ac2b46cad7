"""A painted data set whose fruit differs in ripeness and truncation; some of it has no harvest truth.

`MAPPING` merges, renames and divides its classes. What each organ must be in an export is computed here from
the data set alone.
"""

from __future__ import annotations

import json

import numpy as np
from painted_set import ALL, SIZE, Painter, make_painted_set

from pepperscene.export import export_dataset
from pepperscene.truth.encodings import decode_rle

MAPPING = "ripe=pepper.ripe,green=pepper.unripe,stalk=peduncle+stem,leaf"
NAMES = ("ripe", "green", "stalk", "leaf")
FRAMES = (0, 3, 14)
POINTS = ("cut", "stalk", "blossom_end")
CORNERS = ((0.2, 0.0), (SIZE[1] - 0.001, SIZE[0] - 0.2))


class LabelPainter(Painter):
    """Every fifth fruit is unknown to the harvest truth, as in far rows."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        frame = super().render(camera, outputs, quality, seed, **others)
        fruit = frame.images["harvest"]["fruit"]
        for k, entry in enumerate(fruit):
            entry["ripeness"] = (0.0, 0.49, 0.5, 1.0)[k % 4]
            mask = decode_rle(entry["amodal"])
            entry["truncated"] = bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())
        frame.images["harvest"]["fruit"] = [entry for k, entry in enumerate(fruit) if k % 5 < 4]
        return frame


class BorderPainter(LabelPainter):
    """The ends of all fruit are in the outermost half pixels of the image."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        frame = super().render(camera, outputs, quality, seed, **others)
        for entry in frame.images["harvest"]["fruit"]:
            for name, point in zip(("stalk_end", "blossom_end"), CORNERS, strict=True):
                entry[name] |= {"px": list(point), "visible": True}
        return frame


def make_label_set(folder, changes=None, frames=FRAMES):
    return make_painted_set(folder, ALL, frames, LabelPainter, changes)


def fruit_truth(dataset, index):
    """The entries of the harvest truth by instance."""
    return {entry["instance"]: entry for entry in dataset.image(index, "harvest")["fruit"]}


def expected_name(entry, fruit, ripe_from=0.5):
    """The class of an organ of a plant by `MAPPING`; "?" if its ripeness is unknown, None for no class."""
    if entry["class"] == 2:
        return "?" if fruit is None else "ripe" if fruit["ripeness"] >= ripe_from else "green"
    return {1: "leaf", 3: "stalk", 4: "stalk"}.get(entry["class"])


def expected_objects(dataset, index, smallest_px=1, ripe_from=0.5):
    """Name and mask `(h, w)` by instance of all organs that are objects."""
    instance, truth = dataset.image(index, "instance"), fruit_truth(dataset, index)
    objects = {}
    for key, entry in dataset.metadata(index)["instances"].items():
        name = expected_name(entry, truth.get(int(key)), ripe_from)
        if name in NAMES and entry["plant"] >= 0 and entry["pixels"] >= smallest_px:
            objects[int(key)] = name, instance == int(key)
    return objects


def expected_points(fruit):
    """x, y and visibility of the three points `(3, 3)`, in continuous pixel coordinates of the data set."""
    points = (fruit["peduncle"] and fruit["peduncle"]["cut"], fruit["stalk_end"], fruit["blossom_end"])
    return np.array(
        [[*point["px"], 1 + point["visible"]] if point and point["px"] else [0, 0, 0] for point in points]
    )


def box_of(mask):
    """Left, top, width and height of a mask."""
    rows, columns = np.nonzero(mask)
    return [int(v) for v in (columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1)]


def export(dataset, format_name, folder, **options):
    return export_dataset(dataset.folder, format_name, folder, **options).folder


def load_coco(folder, kind="instances", split="train"):
    return json.loads((folder / "annotations" / f"{kind}_{split}.json").read_text())


def edit_json(path, change):
    """Apply a function to the content of a JSON file."""
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def read_yolo(path):
    """Class number and further numbers of each line, relative coordinates as they are."""
    lines = [line.split() for line in path.read_text().splitlines()]
    return [(int(number), np.array(values, float)) for number, *values in lines]


def pixels_of_box(values):
    """Left, top, width and height in pixels of a box (centre, size) relative to the image."""
    x, y, width, height = values * [SIZE[1], SIZE[0], SIZE[1], SIZE[0]]
    return np.array([x - width / 2, y - height / 2, width, height])

"""A data set of painted images: organs in pieces and with holes, and instances that belong to no plant."""

from __future__ import annotations

import cv2
import numpy as np
from data_sets import D435, set_without_plants
from stand_in import SceneStandIn

from pepperscene.frame import Frame
from pepperscene.truth import class_colour, distance_code
from pepperscene.truth.encodings import encode_rle

SIZE = (180, 240)
ALL = (
    "colour", "class", "class_colour", "instance", "distance", "distance_code", "depth_sensor", "harvest",
)  # fmt: skip
FRAMES = (0, 3, 5, 9, 14, 20)
"""Of 2 sets x 3 rotations x 4 steps: four of the first set, two of the second."""

KINDS = {1: "lamina", 2: "fruit", 3: "peduncle", 4: "internode", 5: "petiole", 6: "twine", 7: "cut"}
WIRE, FLOOR = 60_000, 60_001
"""Instances that belong to no plant: one has an organ's class, the other the background."""


class Painter(SceneStandIn):
    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        rng = np.random.default_rng(seed)
        instance, entries, masks = paint(rng)
        pixels = np.bincount(instance.ravel(), minlength=65536)
        visible = {
            value: {**entry, "pixels": int(pixels[value])}
            for value, entry in entries.items()
            if pixels[value]
        }
        class_of = np.zeros(65536, np.uint8)
        class_of[list(visible)] = [entry["class"] for entry in visible.values()]
        distance = rng.uniform(0.2, 1.5, SIZE).astype(np.float32)
        distance[instance == 0] = np.inf
        images = {
            "colour": rng.integers(0, 256, (*SIZE, 3)).astype(np.uint8),
            "class": class_of[instance],
            "class_colour": class_colour(class_of[instance]),
            "instance": instance,
            "distance": distance,
            "distance_code": distance_code(distance),
            "harvest": harvest(rng, visible, {v: m for v, m in masks.items() if entries[v]["class"] == 2}),
            "depth_sensor": np.where(distance < 1.0, distance, np.nan).astype(np.float32),
        }
        if "amodal" in outputs:
            images["amodal"] = amodal(instance, visible, masks)
        instances = {str(value): entry for value, entry in visible.items()}
        size = {"width": SIZE[1], "height": SIZE[0]}
        metadata = {"camera": {**camera.to_metadata(), **size}, "instances": instances}
        return Frame({name: images[name] for name in outputs}, metadata)


def paint(rng):
    """An instance image, the entry of each instance, and the masks of organs with their hidden pixels."""
    instance = np.zeros(SIZE, np.uint16)
    instance[-20:] = FLOOR
    entries = {
        FLOOR: {"class": 0, "kind": "floor_film", "plant": -1, "phytomer": -1, "parent": 0},
        WIRE: {"class": 6, "kind": "crop_wire", "plant": -1, "phytomer": -1, "parent": 0},
    }
    values = rng.choice(np.arange(1, WIRE), 340, replace=False)
    masks = {}

    def add(value, mask, organ_class, parent=0):
        instance[mask] = value
        entries[int(value)] = {
            "class": organ_class, "kind": KINDS[organ_class], "plant": int(value) % 3,
            "phytomer": int(rng.integers(20)), "parent": int(parent),
        }  # fmt: skip
        masks[int(value)] = mask

    # More organs than a byte can count, of a few pixels each.
    for k, value in enumerate(values[40:]):
        mask = np.zeros(SIZE, bool)
        row, column = 2 + 3 * (k // 75), 3 + 3 * (k % 75)
        mask[row : row + 2, column : column + 1 + k % 2] = True
        add(value, mask, 5)
    for k, value in enumerate(values[:30]):
        centre = (int(rng.integers(0, SIZE[1])), int(rng.integers(30, SIZE[0])))
        axes = (int(rng.integers(12, 30)), int(rng.integers(8, 24)))
        mask = _draw(cv2.ellipse, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
        if k % 3 == 0:
            mask &= ~_draw(cv2.circle, centre, 4, 1, -1)
        add(value, mask, 1 + k % 3, parent=values[(k + 1) % 30])
    # Thin organs in front divide those behind them into pieces.
    for k, value in enumerate(values[30:40]):
        column = int(rng.integers(0, SIZE[1]))
        mask = _draw(cv2.line, (column, 0), (SIZE[1] - column, SIZE[0]), 1, 2 + k % 3)
        add(value, mask, 4 + k % 4)
    instance[_draw(cv2.line, (0, 25), (SIZE[1], 40), 1, 3)] = WIRE
    return instance, entries, masks


def harvest(rng, visible, fruit_masks):
    """The output `harvest` of all visible fruit, every third one without a peduncle."""
    fruit, ends = [], np.random.default_rng(len(visible))
    for k, (value, mask) in enumerate(sorted(fruit_masks.items())):
        if value not in visible:
            continue
        entry = visible[value]
        px = rng.uniform(0, 180, 2).tolist() if k % 2 else None
        cut = {"camera_m": [0.0, 0.0, 0.4], "px": px, "visible": k % 4 == 1}
        fruit.append({
            "instance": value, "plant": entry["plant"], "phytomer": 4, "kind": "fruit", "ripeness": 0.5,
            "length_m": 0.08, "diameter_m": 0.07, "visible_pixels": entry["pixels"],
            "amodal_pixels": int(mask.sum()), "visible_fraction": entry["pixels"] / int(mask.sum()),
            "truncated": False, "amodal": encode_rle(mask), "pose": np.eye(4).tolist(), "occluders": [],
            "peduncle": {"instance": 7, "cut": cut} if k % 3 else None,
            "stalk_end": end_point(ends, k % 5), "blossom_end": end_point(ends, k % 3),
            "box_3d": {"centre": [0.03, -0.04, 0.4 + 0.01 * k], "size": [0.07, 0.07, 0.08]},
            "box": None, "amodal_box": [0, 0, 1, 1], "approach": None,
        })  # fmt: skip
    return {"format": "pepperscene harvest 1", "fruit": fruit, "graph": {"nodes": [], "edges": []}}


def amodal(instance, visible, masks):
    """The output `amodal` of all visible organs."""
    organs = []
    for value, mask in sorted(masks.items()):
        if value not in visible:
            continue
        rows, columns = np.nonzero(mask)
        own, pixels = visible[value], int(mask.sum())
        occluders, counts = np.unique(instance[mask & (instance != value)], return_counts=True)
        organs.append({
            "instance": value, "class": own["class"], "kind": own["kind"], "box": None,
            "amodal_box": [int(v) for v in (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)],
            "visible_pixels": own["pixels"], "amodal_pixels": pixels,
            "visible_fraction": own["pixels"] / pixels,
            "truncated": bool(mask[[0, -1]].any() or mask[:, [0, -1]].any()),
            "occluders": [
                {"instance": v, "pixels": n}
                for v, n in zip(occluders.tolist(), counts.tolist(), strict=True)
            ],
            "amodal": encode_rle(mask),
        })  # fmt: skip
    return {"format": "pepperscene amodal 1", "organs": organs}


def end_point(rng, kind):
    """An end of a fruit: outside the image, visible or hidden."""
    px = None if kind == 0 else (rng.uniform(0, 1, 2) * SIZE[::-1]).round(3).tolist()
    return {"camera_m": [0.0, 0.0, 0.4], "px": px, "visible": kind == 1}


def make_painted_set(folder, outputs=ALL, frames=FRAMES, painter=Painter, changes=None):
    """Frames of two sets of plants."""
    return set_without_plants(folder, frames, outputs, painter, {**D435, **(changes or {})})


def _draw(function, *arguments):
    canvas = np.zeros(SIZE, np.uint8)
    function(canvas, *arguments)
    return canvas > 0

"""Small images of discs and bars, which are fruit and peduncles, with their instances."""

from __future__ import annotations

import numpy as np
from memory_set import MemorySet
from PIL import Image

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import LabelledImage

SIZE = (64, 96)
COLOURS = {OrganClass.PEPPER: (200, 50, 40), OrganClass.PEDUNCLE: (130, 220, 90)}


def paint_objects(number, seed=0, size=SIZE):
    """Two discs and two bars in random places, each in front of those before."""
    rng = np.random.default_rng([seed, number])
    rows, columns = np.mgrid[: size[0], : size[1]]
    classes, instances = np.zeros(size, np.uint8), np.zeros(size, np.uint16)
    colour = np.full((*size, 3), (60.0, 90.0, 60.0))
    for place in range(4):
        # One object in each quarter, so that none is hidden.
        x = (0.25 + 0.5 * (place % 2) + rng.uniform(-0.06, 0.06)) * size[1]
        y = (0.25 + 0.5 * (place // 2) + rng.uniform(-0.06, 0.06)) * size[0]
        if (place + number) % 2:
            organ, inside = OrganClass.PEPPER, np.hypot(columns - x, rows - y) < rng.uniform(8, 12)
        else:
            half = rng.uniform(4, 6), rng.uniform(9, 12)
            organ, inside = OrganClass.PEDUNCLE, (abs(columns - x) < half[0]) & (abs(rows - y) < half[1])
        classes[inside], instances[inside] = organ, 10 + place
        colour[inside] = np.array(COLOURS[organ]) * rng.uniform(0.8, 1.1)
    colour = np.clip(colour + rng.normal(0, 5, colour.shape), 0, 255).astype(np.uint8)
    return LabelledImage(f"image{number}", colour, classes, instances)


def object_set(count, seed=0, size=SIZE, name="objects"):
    """A set in memory."""
    return MemorySet(name=name, items=tuple(paint_objects(number, seed, size) for number in range(count)))


def write_objects(folder, count, seed=0):
    """A folder in COCO's format, with masks of run lengths."""
    import json

    folder.mkdir(parents=True)
    images, annotations = [], []
    for number in range(count):
        image = paint_objects(number, seed)
        Image.fromarray(image.colour).save(folder / f"{image.name}.png")
        height, width = image.size
        images.append({"id": number, "file_name": f"{image.name}.png", "height": height, "width": width})
        for value in np.unique(image.instances[image.instances > 0]).tolist():
            mask = image.instances == value
            annotations.append({
                "id": len(annotations) + 1, "image_id": number, "iscrowd": 0,
                "category_id": int(image.classes[mask][0]),
                "segmentation": {"size": [height, width], "counts": run_lengths(mask)},
            })  # fmt: skip
    categories = [{"id": int(organ), "name": organ.name.lower()} for organ in COLOURS]
    content = {"images": images, "annotations": annotations, "categories": categories}
    (folder / "annotations.json").write_text(json.dumps(content))
    return folder


def run_lengths(mask):
    """COCO's run lengths of a mask: zeros and ones in turn, down the columns."""
    flat = mask.ravel(order="F")
    edges = np.flatnonzero(np.diff(flat)) + 1
    lengths = np.diff([0, *edges.tolist(), flat.size]).tolist()
    return [0, *lengths] if flat[0] else lengths

"""Semantic segmentation: a folder of images and one of class masks, and a table of the classes.

The layout is the usual one of image and mask folders with equal names, which `open_images` reads too. 255
marks pixels to ignore, as in Cityscapes and PASCAL VOC.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, IGNORE_CLASS, OrganClass
from pepperscene.dataset.export.job import ExportFrame, ExportJob
from pepperscene.dataset.export.selection import FRUIT, Category, Selection
from pepperscene.dataset.readers.labels import LABEL_FILE
from pepperscene.dataset.store.images import png_bytes

_BACKGROUND: Final = int(OrganClass.BACKGROUND)


def write_semantic(job: ExportJob, folder: Path) -> None:
    """Write `images/train/000110.png`, `masks/train/000110.png`, `classes.json` and `classes.toml`.

    A mask is an 8-bit grey image of class numbers. If no category contains the background, class 0 is the
    background with all organs that are not selected, and the categories follow; otherwise the classes are the
    categories, and other organs are ignored. Organs that are not separate objects, and fruit of unknown
    ripeness, are ignored where the categories depend on them.
    """
    classes = _mask_classes(job.selection)
    records = [_class_record(number, category) for number, category in enumerate(classes)]
    selection = replace(job.selection, categories=classes)
    table: dict[str, Any] = {"ignore": IGNORE_CLASS, "classes": records}
    if job.selection.is_divided:
        table["ripe_from"] = job.selection.ripe_from
    (folder / "classes.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    (folder / LABEL_FILE).write_text(_label_table(classes, job.selection), encoding="utf-8")
    for split, frames in job.frames_by_split():
        images, masks = folder / "images" / split, folder / "masks" / split
        images.mkdir(parents=True)
        masks.mkdir(parents=True)
        for frame in frames:
            (images / f"{frame.name}.png").write_bytes(frame.content("colour"))
            mask = _class_mask(frame, selection)
            (masks / f"{frame.name}.png").write_bytes(png_bytes(mask))


def _mask_classes(selection: Selection) -> tuple[Category, ...]:
    """The classes in the order of their numbers."""
    selected = frozenset[int]().union(*(category.parts for category in selection.categories))
    if _BACKGROUND in selected:
        return selection.categories
    rest = frozenset({*map(int, OrganClass), *FRUIT}) - selected
    return Category("background", rest), *selection.categories


def _class_record(number: int, category: Category) -> dict[str, object]:
    colour = CLASS_COLOURS[category.organ_class]
    return {
        "value": number,
        "name": category.name,
        "members": category.members,
        "colour": [value // 2 for value in colour] if category.is_unripe else list(colour),
    }


def _label_table(classes: Sequence[Category], selection: Selection) -> str:
    """The table by which `open_images` reads the masks.

    A merged class is read as its organ class of the lowest id. A background that has organs because they are
    not selected is void: what it shows is unknown.
    """
    lines = ["# Classes of the mask values, for pepperscene.open_images."]
    for number, category in enumerate(classes):
        is_rest = category not in selection.categories and len(category.parts) > 1
        organ = "void" if is_rest else category.organ_class.name.lower()
        lines.append(f'{number} = "{organ}"  # {category.name}: {" + ".join(category.members)}')
    return "\n".join([*lines, f'{IGNORE_CLASS} = "void"']) + "\n"


def _class_mask(frame: ExportFrame, selection: Selection) -> NDArray[np.uint8]:
    """`(h, w)` the number of each pixel's class, or `IGNORE_CLASS`; `selection` is of all classes."""
    if not selection.needs_organs:
        by_class = np.full(256, IGNORE_CLASS, np.uint8)
        by_class[: len(OrganClass)] = [_number(selection, selection.category(organ)) for organ in OrganClass]
        return by_class[frame.image("class")]
    instance: NDArray[np.uint16] = frame.image("instance")
    fruit, objects = frame.fruit_for(selection), frame.objects(selection, instance)
    by_instance = np.full(1 << 16, IGNORE_CLASS, np.uint8)
    by_instance[0] = _number(selection, selection.category(OrganClass.BACKGROUND))
    for key, entry in frame.metadata["instances"].items():
        value = int(key)
        if entry["class"] == IGNORE_CLASS:
            continue
        category = selection.category(OrganClass(entry["class"]), fruit.get(value))
        # The background has no objects, so nothing of it is ignored.
        is_background = category is not None and _BACKGROUND in category.parts
        if value in objects or entry["plant"] < 0 or is_background:
            by_instance[value] = _number(selection, category)
    return by_instance[instance]


def _number(selection: Selection, category: Category | None) -> int:
    """The mask value of a class."""
    return IGNORE_CLASS if category is None else selection.categories.index(category)

"""Semantic segmentation: a folder of images and one of class masks, and a table of the classes.

The layout is the usual one of image and mask folders with equal names, which `open_images` reads too. 255
marks pixels to ignore, as in Cityscapes and PASCAL VOC.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pepperscene.classes import CLASS_COLOURS, IGNORE_CLASS
from pepperscene.dataset.class_masks import class_mask, mask_selection
from pepperscene.dataset.readers.labels import LABEL_FILE
from pepperscene.dataset.selection import Category, Selection
from pepperscene.dataset.store.images import png_bytes
from pepperscene.export.job import ExportJob, write_json


def write_semantic(job: ExportJob, folder: Path) -> None:
    """Write `images/train/000110.png`, `masks/train/000110.png`, `classes.json` and `classes.toml`.

    A mask is an 8-bit grey image of class numbers; see `mask_selection` and `class_mask`.
    """
    selection = mask_selection(job.selection)
    classes = selection.categories
    records = [_class_record(number, category) for number, category in enumerate(classes)]
    table: dict[str, Any] = {"ignore": IGNORE_CLASS, "classes": records}
    if job.selection.is_divided:
        table["ripe_from"] = job.selection.ripe_from
    write_json(folder / "classes.json", table)
    (folder / LABEL_FILE).write_text(_label_table(classes, job.selection), encoding="utf-8")
    for split, frames in job.frames_by_split():
        images, masks = folder / "images" / split, folder / "masks" / split
        images.mkdir(parents=True)
        masks.mkdir(parents=True)
        for frame in frames:
            (images / f"{frame.name}.png").write_bytes(frame.content("colour"))
            mask = class_mask(frame, selection)
            (masks / f"{frame.name}.png").write_bytes(png_bytes(mask))


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

"""Folders of images and masks: class masks for segmentation, and the layout of the published data set.

Class masks have the usual layout of image and mask folders with equal names, which `open_images` reads too.
255 marks pixels to ignore, as in Cityscapes and PASCAL VOC. Source of the published layout: doi
10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0, as public code reads it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame, class_mask, mask_selection
from pepperscene.dataset.readers.labels import LABEL_FILE
from pepperscene.dataset.selection import Category, Selection
from pepperscene.dataset.store.images import png_bytes
from pepperscene.export.job import ExportJob, write_json, write_table
from pepperscene.truth import class_colour, distance_code


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
    return {
        "value": number,
        "name": category.name,
        "members": category.members,
        "colour": category.colour,
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


_COLUMNS: Final = ("number", "index", "set", "rotation", "step", "split")

_ORGANS: Final = [organ for organ in OrganClass if organ != OrganClass.BACKGROUND]

# Folder and file name of each kind of image, without the number.
_COLOUR: Final = "synthetic_image_color/synthetic_image_color"
_CLASS_FOLDER: Final = "synthetic_label_class_grayscale"
_CLASS: Final = f"{_CLASS_FOLDER}/synthetic_label_class_all_grayscale/synthetic_label_class_all_grayscale"
_CLASS_COLOUR: Final = "synthetic_label_class_colorscale/synthetic_label_class_colorscale"
_DISTANCE_CODE: Final = "synthetic_label_depth_grayscale/synthetic_label_depth_grayscale"
"""The published names of the files in this folder are not known; these follow the others."""


def write_published(job: ExportJob, folder: Path) -> None:
    """Write colour, classes (grey, binary and coloured) and 8-bit distance codes under the published names.

    Frames are numbered from 1 in the order of their indices; `frames.csv` lists the index, set, rotation,
    step and split of each number. The layout has no splits.
    """
    names = (_COLOUR, _CLASS, _CLASS_COLOUR, _DISTANCE_CODE, *map(_binary_name, _ORGANS))
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)

    def write_images() -> Iterator[dict[str, Any]]:
        for number, frame in enumerate(job.frames(), start=1):
            for name, content in _image_files(frame).items():
                (folder / f"{name}_{number}.png").write_bytes(content)
            yield {**frame.metadata, "number": number, "split": job.split_of[frame.index]}

    write_table(folder / "frames.csv", _COLUMNS, write_images())


def _binary_name(organ_class: OrganClass) -> str:
    name = f"synthetic_label_class_{organ_class:d}_grayscale"
    return f"{_CLASS_FOLDER}/{name}_binary/{name}"


def _image_files(frame: DatasetFrame) -> Mapping[str, bytes]:
    """PNG files of a frame by name without the number; files of the data set are copied where they fit."""
    classes, outputs = frame.image("class"), frame.metadata["outputs"]
    if "class_colour" in outputs:
        coloured = frame.content("class_colour")
    else:
        coloured = png_bytes(class_colour(classes))
    if "distance_code" in outputs:
        coded = frame.content("distance_code")
    else:
        coded = png_bytes(distance_code(frame.image("distance")))
    return {
        _COLOUR: frame.content("colour"),
        _CLASS: png_bytes(classes),
        _CLASS_COLOUR: coloured,
        _DISTANCE_CODE: coded,
        # 0 and 1 as published, not 0 and 255.
        **{_binary_name(organ): png_bytes((classes == organ).astype(np.uint8)) for organ in _ORGANS},
    }

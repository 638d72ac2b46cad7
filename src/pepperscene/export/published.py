"""The layout of the published data set: its folders, names, numbers and codes.

Source: doi 10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0, as public code reads it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.store.images import png_bytes
from pepperscene.export.job import ExportJob, write_table
from pepperscene.truth import class_colour, distance_code

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

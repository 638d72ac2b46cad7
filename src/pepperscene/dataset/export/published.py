"""The layout of the published data set: its folders, names, numbers and codes.

Source: doi 10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0, as public code reads it.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.dataset.export.run import ExportResult
from pepperscene.dataset.export.source import ExportSource, OnFrame, export_sources, new_folder, wanted_frames
from pepperscene.dataset.export.splits import Splits
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.images import png_bytes
from pepperscene.truth import class_colour, distance_code

SET: Final = "synthetic"
MAPPING: Final = "frames.csv"
_COLUMNS: Final = ("number", "index", "set", "rotation", "step", "split")

_ORGANS: Final = [one for one in OrganClass if one != OrganClass.BACKGROUND]

_COLOUR: Final = f"{SET}_image_color/{SET}_image_color"
_GREY: Final = f"{SET}_label_class_grayscale/{SET}_label_class_all_grayscale/{SET}_label_class_all_grayscale"
_COLOURED: Final = f"{SET}_label_class_colorscale/{SET}_label_class_colorscale"
_DISTANCE: Final = f"{SET}_label_depth_grayscale/{SET}_label_depth_grayscale"
"""The names of the published files in this folder are not known; these follow the others."""


def export_published(
    dataset: Dataset,
    out: Path,
    splits: Splits,
    *,
    indices: Sequence[int] | None = None,
    on_frame: OnFrame | None = None,
) -> ExportResult:
    """Write colour, classes (grey, binary and coloured) and 8-bit distance codes under the published names.

    Frames are numbered from 1 in the order of their indices; `frames.csv` beside the folders tells which
    index, set, rotation, step and split each number has. The layout itself knows no splits.

    Args:
        dataset: with the outputs colour, class, and distance_code or distance.
        out: a new or an empty folder.
        splits: frames in none are left out.
        indices: of the frames wanted; None for all.
        on_frame: called after every frame.

    Raises:
        InputError: an output is missing, or a file is damaged.
        OutputError: the folder holds something, or cannot be written to.
    """
    needed, instead = ("colour", "class", "distance_code"), {"distance_code": "distance"}
    wanted = wanted_frames(dataset, splits, indices, needed, instead)
    files = 1
    with new_folder(out, dataset.folder) as folder:
        for path in (*map(Path, (_COLOUR, _GREY, _COLOURED, _DISTANCE)), *map(_binary, _ORGANS)):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
        with (folder / MAPPING).open("w", newline="", encoding="utf-8") as mapping:
            rows = csv.DictWriter(mapping, _COLUMNS, extrasaction="ignore", lineterminator="\n")
            rows.writeheader()
            for number, source in enumerate(export_sources(dataset, wanted, on_frame), start=1):
                for name, content in _files(source, number).items():
                    (folder / name).write_bytes(content)
                    files += 1
                rows.writerow({**source.facts, "number": number, "split": splits.named(source.index)})
    return ExportResult(out, len(wanted), files)


def _binary(organ_class: OrganClass) -> Path:
    """Folder and name, without the number, of the mask of a class."""
    name = f"{SET}_label_class_{organ_class:d}_grayscale"
    return Path(f"{SET}_label_class_grayscale/{name}_binary/{name}")


def _files(source: ExportSource, number: int) -> Mapping[str, bytes]:
    """The content of a frame's files by their names."""
    classes = source.image("class")
    # What stands in the data set as it is published is not decoded and coded again.
    coloured = (
        source.content("class_colour") if source.has("class_colour") else png_bytes(class_colour(classes))
    )
    coded = (
        source.content("distance_code")
        if source.has("distance_code")
        else png_bytes(distance_code(source.image("distance")))
    )
    named = {
        _COLOUR: source.content("colour"),
        _GREY: png_bytes(classes),
        _COLOURED: coloured,
        _DISTANCE: coded,
    }
    for organ_class in _ORGANS:
        # 0 and 1, as published: not 255.
        named[_binary(organ_class).as_posix()] = png_bytes((classes == organ_class).astype(np.uint8))
    return {f"{name}_{number}.png": content for name, content in named.items()}

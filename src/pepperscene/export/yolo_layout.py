"""The files that all exports to YOLO share: images, label files and `data.yaml`, as Ultralytics reads them.

Format: https://docs.ultralytics.com/datasets/detect/.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.dataset.dataset_frame import IGNORED, REST, DatasetFrame
from pepperscene.dataset.selection import Selection
from pepperscene.dataset.splits import DEFAULT_SPLIT
from pepperscene.dataset.store.images import png_bytes
from pepperscene.export.job import ExportJob

DECIMALS: Final = 6  # 1/200 of a pixel in images 5,000 pixels wide

_VALIDATION_NAMES: Final = ("val", "valid", "validation", "dev")
_YAML_WORDS: Final = frozenset({"y", "n", "yes", "no", "on", "off", "true", "false", "null"})
"""Names that are not text in YAML 1.1."""

LabelLines = Callable[[DatasetFrame, Selection, NDArray[np.uint32]], list[str]]
"""The lines of the label file of a frame, from its segment ids `(h, w)`."""


@dataclass(frozen=True)
class VisibleObject:
    """An object of a frame."""

    instance: int  # its value in the instance image
    number: int  # of its category in the selection, from 0
    window: tuple[slice, slice]  # rows and columns of its visible pixels

    def box(self, shape: tuple[int, ...]) -> str:
        """Centre, width and height of its visible pixels over the `shape` (h, w) of the image, as text."""
        (height, width), (rows, columns) = shape, self.window
        (x, wide), (y, high) = _rounded_side(columns, width), _rounded_side(rows, height)
        return " ".join(f"{number:.{DECIMALS}f}" for number in (x, y, wide, high))


def _rounded_side(pixels: slice, count: int) -> tuple[float, float]:
    """Centre and length of a box along a side of `count` pixels, over its length, rounded.

    Where rounding would move an edge out of the image, the box is made shorter by the last digit.
    """
    centre = round(0.5 * (pixels.start + pixels.stop) / count, DECIMALS)
    length = round((pixels.stop - pixels.start) / count, DECIMALS)
    excess = length - 2.0 * min(centre, 1.0 - centre)
    if excess > 0.1 * 10.0**-DECIMALS:
        length = round(length - math.ceil(round(excess * 10.0**DECIMALS, 1)) * 10.0**-DECIMALS, DECIMALS)
    return centre, length


def write_yolo_layout(
    job: ExportJob, folder: Path, label_lines: LabelLines, keys: Sequence[str] = ()
) -> None:
    """Write `images/train/000110.png`, `labels/train/000110.txt` and `data.yaml`.

    The format has no ignored pixels: if frames can have some, `ignore/train/000110.png` is 255 there and 0
    elsewhere, for training and evaluation code that reads it.

    Args:
        job: the frames and the selection of their objects.
        folder: to write into.
        label_lines: makes the lines of a label file.
        keys: further lines of `data.yaml`.
    """
    data = _data_yaml(list(job.splits), job.selection, keys)
    (folder / "data.yaml").write_text(data, encoding="utf-8")
    for split, frames in job.frames_by_split():
        images, labels = folder / "images" / split, folder / "labels" / split
        images.mkdir(parents=True)
        labels.mkdir(parents=True)
        if job.has_ignored_pixels:
            (folder / "ignore" / split).mkdir(parents=True)
        for frame in frames:
            (images / f"{frame.name}.png").write_bytes(frame.content("colour"))
            ids = frame.segment_ids(job.selection)
            if job.has_ignored_pixels:
                mask = np.where(ids == IGNORED, np.uint8(IGNORE_CLASS), np.uint8(0))
                (folder / "ignore" / split / f"{frame.name}.png").write_bytes(png_bytes(mask))
            lines = "".join(f"{line}\n" for line in label_lines(frame, job.selection, ids))
            (labels / f"{frame.name}.txt").write_text(lines, encoding="ascii")


def _data_yaml(splits: Sequence[str], selection: Selection, keys: Sequence[str]) -> str:
    """`data.yaml`, with paths relative to its folder; readers require both `train` and `val`."""
    folders = {split: f"images/{split}" for split in splits}
    validation = next((name for name in _VALIDATION_NAMES if name in splits), splits[0])
    for name, substitute in ((DEFAULT_SPLIT, splits[0]), ("val", validation)):
        folders.setdefault(name, f"images/{substitute}  # there is no split of this name")
    names = [category.name for category in selection.categories]
    classes = [
        f"  {number}: {json.dumps(name) if name in _YAML_WORDS else name}"
        for number, name in enumerate(names)
    ]
    # Keys in quotes: `no`, `on` and `null` are not text in YAML.
    paths = [f'"{name}": {path}' for name, path in folders.items()]
    return "\n".join([*paths, *keys, "names:", *classes]) + "\n"


def find_objects(
    frame: DatasetFrame, selection: Selection, ids: NDArray[np.uint32]
) -> Iterator[VisibleObject]:
    """Yield the objects of a frame with its `segment_ids`, by ascending instance."""
    from scipy import ndimage

    numbers = {category.id: number for number, category in enumerate(selection.categories)}
    fruit = frame.fruit_for(selection)
    for value, window in enumerate(ndimage.find_objects(ids.astype("int32"), max_label=REST - 1), start=1):
        if window is None:
            continue
        organ_class = OrganClass(frame.metadata["instances"][str(value)]["class"])
        category = selection.category(organ_class, fruit.get(value))
        if category is not None:
            yield VisibleObject(value, numbers[category.id], window)

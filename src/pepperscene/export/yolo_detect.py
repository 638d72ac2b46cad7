"""YOLO detection as Ultralytics reads it: a text file for each image, one box per line.

Format: https://docs.ultralytics.com/datasets/detect/.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.selection import Selection
from pepperscene.export.job import ExportJob
from pepperscene.export.yolo_layout import find_objects, write_yolo_layout


def write_yolo_detect(job: ExportJob, folder: Path) -> None:
    """Write the files of `write_yolo_layout` with boxes.

    A line is an organ of a plant: the number of its category, and the centre, width and height of the box of
    its visible pixels over the width and height of the image.
    """
    write_yolo_layout(job, folder, _label_lines)


def _label_lines(frame: DatasetFrame, selection: Selection, ids: NDArray[np.uint32]) -> list[str]:
    return [f"{found.number} {found.box(ids.shape)}" for found in find_objects(frame, selection, ids)]

"""YOLO pose as Ultralytics reads it: a text file for each image, a box and its keypoints per line.

Format: https://docs.ultralytics.com/datasets/pose/.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.selection import Selection
from pepperscene.export.job import ExportJob
from pepperscene.export.yolo_layout import DECIMALS, find_objects, write_yolo_layout
from pepperscene.truth.keypoints import FLIP_INDICES, KEYPOINTS, fruit_keypoints


def write_yolo_pose(job: ExportJob, folder: Path) -> None:
    """Write the files of `write_yolo_layout` with boxes and keypoints.

    A line is an organ of a plant: the number of its category, the box as in `write_yolo_detect`, and for each
    of the `KEYPOINTS` x and y over the width and height of the image and its visibility. Organs other than
    fruit have the visibility 0, as the format gives all classes the same keypoints.
    """
    numbers = [category for category, one in enumerate(job.selection.categories) if one.has_fruit]
    keys = [
        f"kpt_shape: [{len(KEYPOINTS)}, 3]  # x, y, visibility",
        f"flip_idx: {list(FLIP_INDICES)}",
        "kpt_names:",
        *(f"  {number}: [{', '.join(KEYPOINTS)}]" for number in numbers),
    ]
    write_yolo_layout(job, folder, _label_lines, keys)


def _label_lines(frame: DatasetFrame, selection: Selection, ids: NDArray[np.uint32]) -> list[str]:
    height, width = ids.shape
    lines = []
    for found in find_objects(frame, selection, ids):
        points = " ".join(
            f"{x / width:.{DECIMALS}f} {y / height:.{DECIMALS}f} {flag}"
            for x, y, flag in fruit_keypoints(frame.fruit.get(found.instance, {}))
        )
        lines.append(f"{found.number} {found.box(ids.shape)} {points}")
    return lines

"""Point clouds: a PLY file for each frame, with colours, classes and organs.

Format: G. Turk, "The PLY polygon file format", Stanford University, 1994,
https://paulbourke.net/dataformats/ply/.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.export.job import ExportJob
from pepperscene.export.surface import point_file, read_colour, read_label, read_surface

_COLUMNS: Final = ("index", "set", "rotation", "step", "split", "file")
_LABELS: Final = ("class", "instance")


def write_ply(job: ExportJob, folder: Path) -> None:
    """Write `points/000110.ply` of each frame, and `frames.csv`, which gives its split.

    A point is a pixel with a surface: its centre's world coordinates `x`, `y`, `z` in metres, its colour
    `red`, `green`, `blue`, its `class` id and its `instance`.
    """
    (folder / "points").mkdir()
    with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.DictWriter(file, _COLUMNS, extrasaction="ignore", lineterminator="\n")
        rows.writeheader()
        for frame in job.frames():
            name = f"points/{frame.name}.ply"
            (folder / name).write_bytes(_point_cloud(frame))
            rows.writerow({**frame.metadata, "split": job.split_of[frame.index], "file": name})


def _point_cloud(frame: DatasetFrame) -> bytes:
    surface = read_surface(frame, allows_line_scan=True)
    colour, labels = read_colour(frame, surface), {name: read_label(frame, name, surface) for name in _LABELS}
    rows, columns = np.nonzero(np.isfinite(surface.distance))
    further = {name: image[rows, columns] for name, image in labels.items()}
    return point_file(surface.points(rows, columns), colour[rows, columns], **further)

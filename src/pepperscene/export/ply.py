"""Point clouds: a PLY file for each frame, with colours, classes and organs.

Format: G. Turk, "The PLY polygon file format", Stanford University, 1994,
https://paulbourke.net/dataformats/ply/.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.export.job import ExportJob, write_table
from pepperscene.export.surface import read_colour, read_label, read_surface

_COLUMNS: Final = ("index", "set", "rotation", "step", "split", "file")
_COLOURS: Final = ("red", "green", "blue")
_LABELS: Final = ("class", "instance")


def write_ply(job: ExportJob, folder: Path) -> None:
    """Write `points/000110.ply` of each frame, and `frames.csv`, which gives its split.

    A point is a pixel with a surface: its centre's world coordinates `x`, `y`, `z` in metres, its colour
    `red`, `green`, `blue`, its `class` id and its `instance`.
    """
    (folder / "points").mkdir()

    def write_clouds() -> Iterator[dict[str, Any]]:
        for frame in job.frames():
            name = f"points/{frame.name}.ply"
            (folder / name).write_bytes(_point_cloud(frame))
            yield {**frame.metadata, "split": job.split_of[frame.index], "file": name}

    write_table(folder / "frames.csv", _COLUMNS, write_clouds())


def _point_cloud(frame: DatasetFrame) -> bytes:
    surface = read_surface(frame, allows_line_scan=True)
    colour, labels = read_colour(frame, surface), {name: read_label(frame, name, surface) for name in _LABELS}
    rows, columns = np.nonzero(np.isfinite(surface.distance))
    extra = {name: image[rows, columns] for name, image in labels.items()}
    return point_file(surface.points(rows, columns), colour[rows, columns], **extra)


def point_file(
    position: NDArray[np.floating[Any]], colour: NDArray[np.uint8], **extra: NDArray[Any]
) -> bytes:
    """A binary PLY file of points.

    Args:
        position: `(n, 3)` metres, stored in single precision.
        colour: `(n, 3)` uint8.
        extra: more properties by name, each `(n,)` of uint8 or uint16.
    """
    columns = dict(zip("xyz", np.asarray(position, "<f4").T, strict=True))
    columns |= dict(zip(_COLOURS, colour.T, strict=True))
    columns |= {name: values.astype(values.dtype.newbyteorder("<")) for name, values in extra.items()}
    names = {"f": "float", "u1": "uchar", "u2": "ushort"}
    properties = [
        f"property {names.get(values.dtype.str[1:], names.get(values.dtype.kind))} {name}"
        for name, values in columns.items()
    ]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(position)}", *properties]
    table = np.empty(len(position), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return "\n".join([*header, "end_header", ""]).encode("ascii") + table.tobytes()

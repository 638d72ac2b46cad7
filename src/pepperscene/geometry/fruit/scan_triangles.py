"""Triangles of a scanned fruit as a file has them, and what is wrong with those that cannot be used."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.errors import InputError
from pepperscene.geometry.mesh import FloatArray, IndexArray

ALLOWED_SCAN: Final = (
    "a scanned fruit must be a GLB, OBJ, PLY or STL file with one closed surface, "
    "upright with its stalk end on top"
)

MAX_TRIANGLES_READ: Final = 1_000_000
"""That are read. Chosen: forty times what is used, 0.2 mm apart on a fruit of 80 mm."""
_LARGEST_COORDINATE: Final = 1e12
"""Chosen: a metre in picometres; products of three such numbers do not overflow."""


@dataclass(frozen=True, eq=False)
class ScanTriangles:
    """Triangles as a file has them."""

    vertices: FloatArray  # `(v, 3)` in the file's unit and axes
    faces: IndexArray  # `(f, 3)`
    colours: FloatArray | None  # `(v, 3)` linear sRGB in [0, 1], or None if the file has none


def check_count(triangles: int, path: Path) -> None:
    """Raise `InputError` if a file has more triangles than are read."""
    if triangles > MAX_TRIANGLES_READ:
        problem = (
            f"has {triangles:,} triangles, and at most {MAX_TRIANGLES_READ:,} are read: simplify it before"
        )
        raise InputError(path, problem)


def damaged_scan(path: Path, reason: str) -> InputError:
    """The error about a file that is no mesh of its format."""
    return InputError(path, f"cannot be read as a mesh ({reason}); {ALLOWED_SCAN}")


def checked_triangles(body: ScanTriangles, path: Path) -> ScanTriangles:
    """Return one mesh of a file, if every face has three corners that exist and are finite.

    Raises:
        InputError: it is not so.
    """
    vertices, faces, colours = np.asarray(body.vertices), np.asarray(body.faces), body.colours
    if vertices.ndim != 2 or vertices.shape[1] != 3 or vertices.dtype.kind not in "fiu":
        raise damaged_scan(path, "its points do not have three coordinates each")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "fiu":
        raise damaged_scan(path, "its faces cannot be divided into triangles")
    count = len(vertices)
    exists = (faces >= -count) & (faces < count) & (faces == np.floor(faces))
    if not exists.all():
        corner = faces[~exists][0]
        raise damaged_scan(path, f"a triangle has the corner {corner:g}, and there are {count} points")
    # Negative numbers count from the last point.
    faces = faces.astype(np.intp) % count
    points = vertices.astype(float)
    used = points[faces]
    if not np.isfinite(used).all():
        raise InputError(path, f"has points that are not finite numbers; {ALLOWED_SCAN}")
    if np.abs(used).max() > _LARGEST_COORDINATE:
        problem = f"has a coordinate beyond {_LARGEST_COORDINATE:g}; {ALLOWED_SCAN}"
        raise InputError(path, problem, value=float(np.abs(used).max()))
    if colours is not None:
        if colours.shape != points.shape:
            raise damaged_scan(path, f"it has {len(colours)} colours for {count} points")
        colours = np.clip(np.nan_to_num(colours), 0.0, 1.0)
    return ScanTriangles(points, faces, colours)

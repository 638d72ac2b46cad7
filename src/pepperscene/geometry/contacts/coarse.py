"""Coarse triangles of organs, on some of the vertices of their meshes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from pepperscene.geometry.contacts.organs import LEAF
from pepperscene.geometry.mesh import FloatArray, IndexArray, SingleArray


@dataclass(frozen=True)
class Resolution:
    """How many of an organ's vertices its coarse triangles use."""

    along: int  # rows of vertices along a blade between base and tip
    across: int  # vertices in a row
    rings: int  # of a tube
    around: int  # vertices in a ring
    few: int  # organs with at most so many triangles keep them


FINE: Final = Resolution(9, 5, 7, 4, 64)
"""Chosen: rows 14 mm apart on a blade; decides whether organs cross."""

ROUGH: Final = Resolution(4, 3, 4, 3, 24)
"""Chosen: rows 28 mm apart on a blade, a fifth of the triangles; compares candidate poses."""

ALL: Final = Resolution(0, 0, 0, 0, 2**31)
"""All triangles of the mesh; decides what touches at last."""


def coarse_faces(uv: SingleArray, organ_class: int, resolution: Resolution) -> IndexArray:
    """Choose `(f, 3)` triangles on some vertices of an organ with surface coordinates `(v, 2)`."""
    return _cached_faces(
        np.ascontiguousarray(uv, dtype=np.float32).tobytes(), organ_class == LEAF, resolution
    )


@lru_cache(maxsize=256)
def _cached_faces(uv: bytes, is_sheet: bool, resolution: Resolution) -> IndexArray:
    """The triangles of a sheet or tube; plants of a cultivar have the same few grids."""
    wide = np.frombuffer(uv, dtype=np.float32).reshape(-1, 2).astype(np.float64)
    return _sheet_faces(wide, resolution) if is_sheet else _tube_faces(wide, resolution)


def _sheet_faces(uv: FloatArray, resolution: Resolution) -> IndexArray:
    """Triangles of a blade: rows of vertices from margin to margin, without triangles between its lobes."""
    from scipy.spatial import Delaunay, QhullError

    place = np.stack([2.0 * uv[:, 0] - 1.0, 2.0 * uv[:, 1]], axis=1)
    targets = [place[place[:, 1].argmin()], place[place[:, 1].argmax()]]
    for along in 2.0 * np.arange(1, resolution.along + 1) / (resolution.along + 1):
        out = place[np.abs(place[:, 1] - along) < 0.12, 0]
        low, high = (out.min(), out.max()) if len(out) else (0.0, 0.0)
        targets += [
            np.array([x, along])
            for x in np.interp(np.linspace(-1, 1, resolution.across), [-1, 0, 1], [low, 0, high])
        ]
    nearest = [int(np.square(place - target).sum(axis=1).argmin()) for target in targets]
    rows = np.unique(nearest)
    try:
        faces = rows[Delaunay(place[rows]).simplices]
    except QhullError:
        # All on a line, because the blade is as thin as a thread: one flat triangle.
        return np.asarray(rows[[[0, len(rows) // 2, len(rows) - 1]]], dtype=np.intp)
    a, b, c = (place[faces[:, corner]] for corner in range(3))
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    centre = (a + b + c) / 3.0
    gap = np.square(centre[:, None] - place).sum(axis=2).min(axis=1)
    return np.asarray(faces[(area > 1e-3) & (gap < 0.15**2)], dtype=np.intp)


def _tube_faces(uv: FloatArray, resolution: Resolution) -> IndexArray:
    """Triangles of a closed body: some of its rings, some vertices of each."""
    levels = np.unique(np.round(uv[:, 1], 4))
    chosen = np.unique(np.round(np.linspace(0, len(levels) - 1, resolution.rings)).astype(np.intp))
    turns = np.arange(resolution.around) / resolution.around
    rings = []
    for level in levels[chosen]:
        ring = np.flatnonzero(np.abs(uv[:, 1] - level) < 1e-3)
        nearest = np.abs(uv[ring, 0] - turns[:, None]).argmin(axis=1)
        rings.append(ring[nearest])
    low, high = np.array(rings[:-1]), np.array(rings[1:])
    after = [np.roll(ring, -1, axis=1) for ring in (low, high)]
    faces = np.concatenate([np.stack([low, after[0], after[1]], -1), np.stack([low, after[1], high], -1)])
    faces = faces.reshape(-1, 3)
    # The ends may be single points.
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return np.asarray(faces[distinct])

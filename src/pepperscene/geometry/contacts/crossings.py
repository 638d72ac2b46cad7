"""Crossings: organs whose triangles pass through those of others, for many pairs and motions at once.

Coarse triangles, on some of the vertices of its mesh, stand for an organ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from pepperscene.geometry.contacts.organs import LEAF, Organs, bounds_of_runs
from pepperscene.geometry.mesh import FloatArray, IndexArray, InstanceRuns, SingleArray, expand_counts

_TYPICAL: Final = 32  # blades, chosen: enough for a median

CLEARANCE: Final = 1.5e-3
"""Metres, chosen: triangles closer than this cross, as fine ones may between the vertices of coarse ones."""


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


class CoarseTriangles:
    """Coarse triangles of some organs of a mesh, `chosen` `(m,)`, at the organs' current poses."""

    def __init__(self, organs: Organs, chosen: IndexArray, resolution: Resolution = FINE) -> None:
        self._organs, self._seen = organs, 0
        rows, self._corners, counts = coarse_triangles(organs, chosen, resolution)
        self._vertices, self._faces = (_runs(len(organs), chosen, count) for count in counts)
        self._corners += np.repeat(self._vertices.first[chosen], counts[1])
        self._rest = np.ascontiguousarray(organs.mesh.vertices.take(rows, axis=0).T)
        self._points = self._rest.copy()
        self.update()

    def update(self) -> None:
        """Follow the organs that have moved since the last call."""
        moved = np.flatnonzero((self._organs.moved_at > self._seen) & (self._vertices.count > 0))
        rows, position = self._vertices.rows_of(moved)
        rotation, shift = self._organs.rotation[moved], self._organs.shift[moved]
        self._points[:, rows] = _moved_points(self._rest[:, rows], rotation, shift, position)
        self._seen = self._organs.moves

    def boxes(
        self, organ: IndexArray, rotation: FloatArray, shift: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """`(e, 3)` corners of boxes, larger by the clearance, around organs `(e,)` after motions."""
        rows, position = self._vertices.rows_of(organ)
        points = _moved_points(self._points.take(rows, axis=1), rotation, shift, position)
        low, high = bounds_of_runs(points, position)
        return low.astype(np.float64) - CLEARANCE, high.astype(np.float64) + CLEARANCE

    def count(
        self,
        organ: IndexArray,
        rotation: FloatArray,
        shift: FloatArray,
        entry: IndexArray,
        other: IndexArray,
        clearance: float = CLEARANCE,
        *,
        by_boxes: bool = False,
    ) -> IndexArray:
        """Count pairs of triangles that cross or are closer than the clearance.

        Args:
            organ: `(e,)` organs that move.
            rotation: `(e, 3, 3)` and
            shift: `(e, 3)` metres: the motion of each.
            entry: `(n,)` index of the first organ of each pair among these.
            other: `(n,)` second organ of each pair, which stays.
            clearance: metres.
            by_boxes: count pairs whose bounding boxes are closer than the clearance.

        Returns:
            `(n,)` numbers of pairs of triangles.
        """
        from pepperscene.geometry.contacts import crossing_kernel as kernel

        boxes = np.concatenate([self._organs.low[other], self._organs.high[other]], axis=1)
        vertex_runs = self._vertices.first, self._vertices.count
        face_runs = self._faces.first, self._faces.count
        return kernel.count_crossings(
            kernel.OrganTriangles(self._points, self._corners, vertex_runs, face_runs),
            kernel.Motions(organ, rotation.astype(np.float32), shift.astype(np.float32)),
            kernel.OrganPairs(entry, other, boxes.astype(np.float32)),
            np.float32(clearance),
            by_boxes,
        )

    def count_at_rest(
        self, one: IndexArray, two: IndexArray, clearance: float, *, by_boxes: bool = False
    ) -> IndexArray:
        """Count the same of pairs of organs `(n,)` at their current poses."""
        distinct, entry = np.unique(one, return_inverse=True)
        rotation, shift = np.tile(np.eye(3), (len(distinct), 1, 1)), np.zeros((len(distinct), 3))
        return self.count(distinct, rotation, shift, entry, two, clearance, by_boxes=by_boxes)


def _runs(organs: int, chosen: IndexArray, count: IndexArray) -> InstanceRuns:
    """Runs of items, of the chosen organs one after another; others have none."""
    first, stop = np.zeros((2, organs), dtype=np.intp)
    stop[chosen] = np.cumsum(count)
    first[chosen] = stop[chosen] - count
    return InstanceRuns(None, first, stop)


def _moved_points(
    points: SingleArray, rotation: FloatArray, shift: FloatArray, position: IndexArray
) -> SingleArray:
    """`(3, v)` points moved by the motion at the position of each, computed as the kernel does."""
    matrix, offset = rotation.astype(np.float32), shift.astype(np.float32)
    result = np.empty(points.shape, dtype=np.float32)
    for axis in range(3):
        column = offset[:, axis].take(position)
        for other in range(3):
            column += matrix[:, axis, other].take(position) * points[other]
        result[axis] = column
    return result


_Chosen = tuple[IndexArray, IndexArray, tuple[IndexArray, IndexArray]]
"""Vertices in the mesh, organ after organ; `(3, f)` corners of triangles, from each organ's first vertex;
and the numbers of vertices and triangles of each."""


def coarse_triangles(organs: Organs, chosen: IndexArray, resolution: Resolution) -> _Chosen:
    """Choose coarse triangles of organs, for all organs of a form at a time."""
    vertex_runs, face_runs = organs.mesh.vertex_runs, organs.mesh.face_runs
    face_count, order = face_runs.count[chosen], vertex_runs.order
    # Organs with few triangles keep them.
    small = np.flatnonzero(face_count <= resolution.few)
    places, corners, counts = _all_triangles(organs, chosen[small])
    vertex_count, coarse_count = np.empty((2, len(chosen)), dtype=np.intp)
    vertex_count[small], coarse_count[small] = counts
    # Organs of one form share their grid, and so the coarse triangles; without an order each has its own.
    large = np.flatnonzero(face_count > resolution.few)
    keys = large if order is not None else organs.organ_class[chosen[large]] << 32 | face_count[large]
    forms = []
    for key in np.unique(keys):
        group = large[keys == key]
        uv = _typical_uv(organs, chosen[group])
        is_sheet = bool(organs.organ_class[chosen[group[0]]] == LEAF)
        used, own = np.unique(_coarse_faces(uv.tobytes(), is_sheet, resolution), return_inverse=True)
        own = own.reshape(-1, 3).T
        vertex_count[group], coarse_count[group] = len(used), own.shape[1]
        forms.append((group, used, own))
    # Both kinds in the order of the organs.
    vertex_start, face_start = (np.cumsum(count) - count for count in (vertex_count, coarse_count))
    all_places = np.empty(vertex_count.sum(), dtype=np.intp)
    all_corners = np.empty((3, coarse_count.sum()), dtype=np.intp)
    for values, whole, number, start in (
        (places, all_places, counts[0], vertex_start[small]),
        (corners, all_corners, counts[1], face_start[small]),
    ):
        position, step = expand_counts(number)
        whole[..., start[position] + step] = values
    first = vertex_runs.first[chosen]
    for group, used, own in forms:
        all_places[vertex_start[group, None] + np.arange(len(used))] = first[group, None] + used
        all_corners[:, face_start[group, None] + np.arange(own.shape[1])] = own[:, None]
    return all_places if order is None else order[all_places], all_corners, (vertex_count, coarse_count)


def _all_triangles(organs: Organs, chosen: IndexArray) -> _Chosen:
    """All triangles of organs, with places in the order of the mesh's vertex runs instead of vertices."""
    vertex_runs, face_runs = organs.mesh.vertex_runs, organs.mesh.face_runs
    counts = vertex_runs.count[chosen], face_runs.count[chosen]
    position, number = expand_counts(counts[0])
    face_rows, face_position = face_runs.rows_of(chosen)
    corners = np.empty((3, len(face_rows)), dtype=np.intp)
    corners[:] = organs.mesh.faces.take(face_rows, axis=0).T
    if vertex_runs.order is not None:
        place = np.empty_like(vertex_runs.order)
        place[vertex_runs.order] = np.arange(len(place))
        corners = place[corners]
    corners -= vertex_runs.first[chosen].take(face_position)
    return vertex_runs.first[chosen].take(position) + number, corners, counts


def _typical_uv(organs: Organs, group: IndexArray) -> SingleArray:
    """`(v, 2)` surface coordinates of an ordinary organ of a group: old blades have lost parts of theirs."""
    group = group[:: -(-len(group) // _TYPICAL)] if organs.organ_class[group[0]] == LEAF else group[:1]
    uv = [organs.mesh.uv[organs.mesh.vertex_runs.rows(organ)] for organ in group.tolist()]
    return np.ascontiguousarray(np.median(uv, axis=0) if len(uv) > 1 else uv[0], dtype=np.float32)


@lru_cache(maxsize=256)
def _coarse_faces(uv: bytes, is_sheet: bool, resolution: Resolution) -> IndexArray:
    """`(f, 3)` triangles of a sheet or tube by its `(v, 2)` float32 surface coordinates.

    They are kept: plants of a cultivar have the same few grids.
    """
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

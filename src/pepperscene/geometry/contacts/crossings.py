"""Crossings: organs whose triangles pass through those of others, for many pairs and motions at once.

Coarse triangles stand for an organ.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from pepperscene.geometry import compilation
from pepperscene.geometry.contacts.coarse import ALL, FINE, Resolution, coarse_faces
from pepperscene.geometry.contacts.crossing_arrays import transform_points
from pepperscene.geometry.contacts.organs import LEAF, Organs
from pepperscene.geometry.contacts.patches import expand_counts
from pepperscene.geometry.contacts.triangles import OrganMotions, OrganPairs, OrganTriangles, Runs
from pepperscene.geometry.mesh import FloatArray, IndexArray, SingleArray

_TYPICAL: Final = 32  # blades, chosen: enough for a median

CLEARANCE: Final = 1.5e-3
"""Metres, chosen: triangles closer than this cross, as fine ones may between the vertices of coarse ones."""


class CoarseTriangles:
    """Coarse triangles of some organs of a mesh, `chosen` `(m,)`, at the organs' current poses."""

    def __init__(self, organs: Organs, chosen: IndexArray, resolution: Resolution = FINE) -> None:
        self._organs, self._seen = organs, 0
        if resolution is ALL and organs.is_contiguous:
            rows, corners, counts = _all_triangles(organs, chosen)
        else:
            choose = coarse_triangles_by_form if organs.is_contiguous else coarse_triangles
            rows, corners, counts = choose(organs, chosen, resolution)
        vertex_runs, face_runs = (Runs(len(organs), chosen, count) for count in counts)
        self._rest = np.ascontiguousarray(organs.mesh.vertices.take(rows, axis=0).T)
        corners += np.repeat(vertex_runs.first[chosen], face_runs.count[chosen])
        self._triangles = OrganTriangles(self._rest.copy(), corners, vertex_runs, face_runs)
        self.update()

    def update(self) -> None:
        """Follow the organs that have moved since the last call."""
        vertices = self._triangles.vertices
        moved = np.flatnonzero((self._organs.moved_at > self._seen) & (vertices.count > 0))
        rows, position = vertices.of(moved)
        motions = _motions(moved, self._organs.rotation[moved], self._organs.shift[moved])
        self._triangles.points[:, rows] = transform_points(self._rest[:, rows], motions, position)
        self._seen = self._organs.moves

    def boxes(
        self, organ: IndexArray, rotation: FloatArray, shift: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """`(e, 3)` corners of boxes, larger by the clearance, around organs `(e,)` after motions."""
        vertices = self._triangles.vertices
        rows, position = vertices.of(organ)
        points = self._triangles.points.take(rows, axis=1)
        low, high = _bounds(
            transform_points(points, _motions(organ, rotation, shift), position), vertices.starts(organ)
        )
        return low - CLEARANCE, high + CLEARANCE

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
        motions = _motions(organ, rotation, shift)
        low, high = self._organs.low[other].astype(np.float32), self._organs.high[other].astype(np.float32)
        pairs = OrganPairs(entry, other, low, high)
        if compilation.AVAILABLE:
            from pepperscene.geometry.contacts.crossing_kernel import count_crossings
        else:
            from pepperscene.geometry.contacts.crossing_arrays import count_crossings
        return count_crossings(self._triangles, motions, pairs, np.float32(clearance), by_boxes=by_boxes)


def _motions(organ: IndexArray, rotation: FloatArray, shift: FloatArray) -> OrganMotions:
    """Motions in single precision."""
    return OrganMotions(organ, rotation.astype(np.float32), shift.astype(np.float32))


def _bounds(points: SingleArray, starts: IndexArray) -> tuple[FloatArray, FloatArray]:
    """`(e, 3)` corners of the boxes around runs of points."""
    low = [np.minimum.reduceat(axis, starts) for axis in points]
    high = [np.maximum.reduceat(axis, starts) for axis in points]
    return np.stack(low, axis=1).astype(np.float64), np.stack(high, axis=1).astype(np.float64)


_Chosen = tuple[IndexArray, IndexArray, tuple[IndexArray, IndexArray]]
"""Vertices in the mesh, organ after organ; `(3, f)` corners of triangles, from each organ's first vertex;
and the numbers of vertices and triangles of each."""


def _all_triangles(organs: Organs, chosen: IndexArray) -> _Chosen:
    """All triangles of organs whose vertices are contiguous."""
    rows, position = organs.vertices_of(chosen)
    face_rows, face_position = organs.faces_of(chosen)
    first = rows[np.flatnonzero(np.diff(position, prepend=-1))]
    corners = np.empty((3, len(face_rows)), dtype=np.intp)
    corners[:] = organs.mesh.faces.take(face_rows, axis=0).T
    corners -= first.take(face_position)
    counts = (np.bincount(items, minlength=len(chosen)) for items in (position, face_position))
    return rows, corners, (next(counts), next(counts))


def coarse_triangles_by_form(organs: Organs, chosen: IndexArray, resolution: Resolution) -> _Chosen:
    """`coarse_triangles` of organs whose vertices are contiguous, for all organs of a form at a time."""
    first, face_count = organs.first_vertices(chosen), organs.face_counts(chosen)
    small = np.flatnonzero(face_count <= resolution.few)
    rows, corners, counts = _all_triangles(organs, chosen[small])
    vertex_count, coarse_count = np.empty((2, len(chosen)), dtype=np.intp)
    vertex_count[small], coarse_count[small] = counts
    # Organs of one form share their grid, and so the coarse triangles.
    large = np.flatnonzero(face_count > resolution.few)
    keys = organs.organ_class[chosen[large]] << 32 | face_count[large]
    forms = []
    for key in np.unique(keys):
        group = large[keys == key]
        uv = _typical_uv(organs, chosen[group].tolist())
        used, own = np.unique(coarse_faces(uv, int(key >> 32), resolution), return_inverse=True)
        own = own.reshape(-1, 3).T
        vertex_count[group], coarse_count[group] = len(used), own.shape[1]
        forms.append((group, used, own))
    # Both kinds in the order of the organs.
    vertex_start, face_start = (np.cumsum(count) - count for count in (vertex_count, coarse_count))
    all_rows = np.empty(vertex_count.sum(), dtype=np.intp)
    all_corners = np.empty((3, coarse_count.sum()), dtype=np.intp)
    for values, whole, number, start in (
        (rows, all_rows, counts[0], vertex_start[small]),
        (corners, all_corners, counts[1], face_start[small]),
    ):
        position, step = expand_counts(number)
        whole[..., start[position] + step] = values
    for group, used, own in forms:
        all_rows[vertex_start[group, None] + np.arange(len(used))] = first[group, None] + used
        all_corners[:, face_start[group, None] + np.arange(own.shape[1])] = own[:, None]
    return all_rows, all_corners, (vertex_count, coarse_count)


def coarse_triangles(organs: Organs, chosen: IndexArray, resolution: Resolution) -> _Chosen:
    """Coarse triangles on some of the vertices of organs, organ by organ."""
    groups: dict[tuple[int, int], list[int]] = {}
    keys = [(int(organs.organ_class[organ]), len(organs.faces(organ))) for organ in chosen.tolist()]
    for organ, key in zip(chosen.tolist(), keys, strict=True):
        groups.setdefault(key, []).append(organ)
    layouts: dict[tuple[int, int], tuple[IndexArray, IndexArray]] = {}
    vertices, faces = [], []
    for organ, key in zip(chosen.tolist(), keys, strict=True):
        rows, own = organs.vertex_rows(organ), organs.faces(organ)
        if len(own) > resolution.few:
            # Organs of one form share their grid, and so the coarse triangles.
            if key not in layouts or not isinstance(rows, slice):
                group = groups[key] if isinstance(rows, slice) else [organ]
                coarse = coarse_faces(_typical_uv(organs, group), key[0], resolution)
                layouts[key] = np.unique(coarse, return_inverse=True)
            used, corners = layouts[key]
            used = used + rows.start if isinstance(rows, slice) else rows[used]
        elif isinstance(rows, slice):
            used, corners = np.arange(rows.start, rows.stop), own.astype(np.intp) - rows.start
        else:
            used, corners = np.unique(own.astype(np.intp), return_inverse=True)
        vertices.append(used)
        faces.append(corners.reshape(-1, 3).T)
    counts = ([len(part) for part in vertices], [part.shape[1] for part in faces])
    return (
        np.concatenate([np.empty(0, dtype=np.intp), *vertices]),
        np.concatenate([np.empty((3, 0), dtype=np.intp), *faces], axis=1),
        (np.array(counts[0], dtype=np.intp), np.array(counts[1], dtype=np.intp)),
    )


def _typical_uv(organs: Organs, group: list[int]) -> SingleArray:
    """`(v, 2)` surface coordinates of an ordinary organ of a group: old blades have lost parts of theirs."""
    if organs.organ_class[group[0]] != LEAF:
        return organs.vertex_uv(group[0])
    some = group[:: -(-len(group) // _TYPICAL)]
    return np.asarray(np.median([organs.vertex_uv(organ) for organ in some], axis=0), dtype=np.float32)

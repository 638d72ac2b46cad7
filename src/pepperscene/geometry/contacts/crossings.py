"""Crossings: organs whose triangles pass through those of others, for many pairs and motions at once.

Coarse triangles stand for an organ. Their bounding boxes are compared first, then their planes, then edges
with triangles.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.coarse import FINE, Resolution, coarse_faces
from pepperscene.geometry.contacts.organs import Organs
from pepperscene.geometry.contacts.patches import expand_counts
from pepperscene.geometry.mesh import FloatArray, IndexArray, SingleArray

_BLOCK: Final = 1 << 18  # pairs of boxes compared at a time, chosen: they fit into a cache

CLEARANCE: Final = 1.5e-3
"""Metres, chosen: triangles closer than this cross, as fine ones may between the vertices of coarse ones."""

Corners = tuple[SingleArray, SingleArray, SingleArray]
"""Corners of triangles, `(3, n)` metres each."""


class CoarseTriangles:
    """Coarse triangles of some organs of a mesh, `chosen` `(m,)`, at the organs' current poses."""

    def __init__(self, organs: Organs, chosen: IndexArray, resolution: Resolution = FINE) -> None:
        self._organs, self._seen = organs, 0
        vertices, faces = _choose_triangles(organs, chosen, resolution)
        self._vertices, self._faces = (_Runs(len(organs), chosen, parts) for parts in (vertices, faces))
        empty = np.empty(0, dtype=np.intp)
        rest = organs.mesh.vertices[np.concatenate([empty, *vertices])]
        self._rest = np.ascontiguousarray(rest.T)
        self._points = self._rest.copy()
        corners = np.concatenate([empty.reshape(0, 3), *faces])
        first = np.repeat(self._vertices.first[chosen], self._faces.count[chosen])
        self._corners = np.ascontiguousarray((corners + first[:, None]).T)
        self.update()

    def update(self) -> None:
        """Follow the organs that have moved since the last call."""
        moved = np.flatnonzero((self._organs.moved_at > self._seen) & (self._vertices.count > 0))
        rows, position = self._vertices.of(moved)
        self._points[:, rows] = _transform(
            self._rest[:, rows], self._organs.rotation[moved], self._organs.shift[moved], position
        )
        self._seen = self._organs.moves

    def boxes(
        self, organ: IndexArray, rotation: FloatArray, shift: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """`(e, 3)` corners of boxes, larger by the clearance, around organs `(e,)` after motions."""
        rows, position = self._vertices.of(organ)
        points = _transform(self._points[:, rows], rotation, shift, position)
        low, high = _bounds((points, points), self._vertices.starts(organ))
        return low - CLEARANCE, high + CLEARANCE

    def count(
        self,
        organ: IndexArray,
        rotation: FloatArray,
        shift: FloatArray,
        entry: IndexArray,
        other: IndexArray,
        clearance: float = CLEARANCE,
    ) -> IndexArray:
        """Count pairs of triangles that cross or are closer than the clearance.

        Args:
            organ: `(e,)` organs that move.
            rotation: `(e, 3, 3)` and
            shift: `(e, 3)` metres: the motion of each.
            entry: `(n,)` index of the first organ of each pair among these.
            other: `(n,)` second organ of each pair, which stays.
            clearance: metres.

        Returns:
            `(n,)` numbers of pairs of triangles.
        """
        result = np.zeros(len(entry), dtype=np.intp)
        if not len(entry):
            return result
        # The triangles of the organs that move.
        rows, position = self._vertices.of(organ)
        points = _transform(self._points[:, rows], rotation, shift, position)
        face, position = self._faces.of(organ)
        offset = self._vertices.starts(organ) - self._vertices.first[organ]
        corners = self._corners[:, face] + offset[position]
        low, high = _boxes(points, corners)
        boxes = low - np.float32(clearance), high + np.float32(clearance)
        starts = self._faces.starts(organ)
        # The triangles of the first organ near the box of the second, those of the second near the box around
        # these, and of these the triangles near the box around those.
        pair, number = expand_counts(self._faces.count[organ[entry]])
        bounds = tuple(side[other].T.astype(np.float32) for side in (self._organs.low, self._organs.high))
        own, own_pair = _overlapping(boxes, starts[entry][pair] + number, bounds, pair)
        near, around = _bounds_by_pair(boxes, own, own_pair)
        if not len(near):
            return result
        distinct, place = np.unique(other[near], return_inverse=True)
        other_face, _ = self._faces.of(distinct)
        other_corners = self._corners[:, other_face]
        other_boxes = _boxes(self._points, other_corners)
        pair, number = expand_counts(self._faces.count[other[near]])
        theirs = self._faces.starts(distinct)[place][pair] + number
        theirs, pair = _overlapping(other_boxes, theirs, around, pair)
        left, around = _bounds_by_pair(other_boxes, theirs, pair)
        their_pair = near[pair]
        row_of_pair = np.full(len(entry), -1)
        row_of_pair[near[left]] = np.arange(len(left))
        kept = row_of_pair[own_pair] >= 0
        own, row = _overlapping(boxes, own[kept], around, row_of_pair[own_pair[kept]])
        own_pair = near[left][row]
        # Pairs of these.
        start, stop = (np.searchsorted(their_pair, own_pair, side) for side in ("left", "right"))
        total, done = np.cumsum(stop - start), 0
        while done < len(own):
            before = total[done - 1] if done else 0
            end = max(int(np.searchsorted(total, before + _BLOCK, side="right")), done + 1)
            row, number = expand_counts((stop - start)[done:end])
            a, b = own[done:end][row], theirs[start[done:end][row] + number]
            a, b, row = _overlapping_pairs(boxes, a, other_boxes, b, own_pair[done:end][row])
            one = points[:, corners[0, a]], points[:, corners[1, a]], points[:, corners[2, a]]
            x, y, z = other_corners[:, b]
            two = self._points[:, x], self._points[:, y], self._points[:, z]
            crossing = crossing_triangles(one, two, clearance)
            result += np.bincount(row[crossing], minlength=len(result))
            done = end
        return result


def _choose_triangles(
    organs: Organs, chosen: IndexArray, resolution: Resolution
) -> tuple[list[IndexArray], list[IndexArray]]:
    """Vertices of each organ in the mesh, and the corners of its coarse triangles among these."""
    layouts: dict[tuple[int, int], tuple[IndexArray, IndexArray]] = {}
    vertices, faces = [], []
    for organ in chosen.tolist():
        rows, own = organs.vertex_rows(organ), organs.faces(organ)
        if len(own) > resolution.few:
            # Organs of one form share their grid, and so the coarse triangles.
            key = int(organs.organ_class[organ]), len(own)
            if key not in layouts or not isinstance(rows, slice):
                coarse = coarse_faces(organs.vertex_uv(organ), key[0], resolution)
                layouts[key] = np.unique(coarse, return_inverse=True)
            used, corners = layouts[key]
            used = used + rows.start if isinstance(rows, slice) else rows[used]
        elif isinstance(rows, slice):
            used, corners = np.arange(rows.start, rows.stop), own.astype(np.intp) - rows.start
        else:
            used, corners = np.unique(own.astype(np.intp), return_inverse=True)
        vertices.append(used)
        faces.append(corners.reshape(-1, 3))
    return vertices, faces


class _Runs:
    """Items of organs, one organ after another."""

    def __init__(self, organs: int, chosen: IndexArray, parts: list[IndexArray]) -> None:
        self.first, self.count = np.zeros((2, organs), dtype=np.intp)
        count = np.array([len(part) for part in parts], dtype=np.intp)
        self.first[chosen], self.count[chosen] = np.cumsum(count) - count, count

    def of(self, organs: IndexArray) -> tuple[IndexArray, IndexArray]:
        """Items of some organs, and the position of the organ of each."""
        position, number = expand_counts(self.count[organs])
        return self.first[organs].take(position) + number, position

    def starts(self, organs: IndexArray) -> IndexArray:
        """Where the items of each organ start in the items of these organs."""
        return np.asarray(np.cumsum(self.count[organs]) - self.count[organs])


Boxes = tuple[SingleArray, SingleArray]
"""Lower and upper corners of boxes, `(3, n)` metres each."""


def _transform(
    points: SingleArray, rotation: FloatArray, shift: FloatArray, position: IndexArray
) -> SingleArray:
    """`(3, v)` points moved by the transform at the position of each."""
    result = np.empty(points.shape, dtype=np.float32)
    matrix, offset = rotation.astype(np.float32), shift.astype(np.float32)
    for axis in range(3):
        column = offset[:, axis].take(position)
        for other in range(3):
            column += matrix[:, axis, other].take(position) * points[other]
        result[axis] = column
    return result


def _boxes(points: SingleArray, corners: IndexArray) -> Boxes:
    """The boxes of triangles."""
    a, b, c = (points[:, corner] for corner in corners)
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _bounds(boxes: Boxes, starts: IndexArray) -> tuple[FloatArray, FloatArray]:
    """`(e, 3)` corners of the boxes around runs of boxes."""
    low = [np.minimum.reduceat(axis, starts) for axis in boxes[0]]
    high = [np.maximum.reduceat(axis, starts) for axis in boxes[1]]
    return np.stack(low, axis=1).astype(np.float64), np.stack(high, axis=1).astype(np.float64)


def _overlapping(
    boxes: Boxes, rows: IndexArray, others: tuple[SingleArray, ...], columns: IndexArray
) -> tuple[IndexArray, IndexArray]:
    """The rows and columns of two tables of boxes that overlap."""
    for axis in range(3):
        kept = boxes[0][axis].take(rows) <= others[1][axis].take(columns)
        kept &= boxes[1][axis].take(rows) >= others[0][axis].take(columns)
        rows, columns = rows[kept], columns[kept]
    return rows, columns


def _bounds_by_pair(boxes: Boxes, rows: IndexArray, pair: IndexArray) -> tuple[IndexArray, Boxes]:
    """The pairs that have rows of a table of boxes, and the boxes around all rows of each."""
    first = np.flatnonzero(np.diff(pair, prepend=-1))
    if not len(first):
        return first, (np.empty((3, 0), dtype=np.float32), np.empty((3, 0), dtype=np.float32))
    low = np.stack([np.minimum.reduceat(axis.take(rows), first) for axis in boxes[0]])
    high = np.stack([np.maximum.reduceat(axis.take(rows), first) for axis in boxes[1]])
    return pair[first], (low, high)


def _overlapping_pairs(
    boxes: Boxes, rows: IndexArray, others: Boxes, columns: IndexArray, pairs: IndexArray
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """As `_overlapping`, and the pair of each."""
    for axis in range(3):
        kept = boxes[0][axis].take(rows) <= others[1][axis].take(columns)
        kept &= boxes[1][axis].take(rows) >= others[0][axis].take(columns)
        rows, columns, pairs = rows[kept], columns[kept], pairs[kept]
    return rows, columns, pairs


def crossing_triangles(one: Corners, two: Corners, clearance: float = CLEARANCE) -> IndexArray:
    """Indices of pairs of triangles that cross, or do so after a move by the clearance along a normal."""
    rows, near = np.arange(one[0].shape[1]), np.float32(clearance)
    for _ in range(2):
        # Both triangles must have corners on both sides of the plane of the other, or close to it.
        a, b, c = two
        normal = _cross_product(b - a, c - a)
        reach = near * np.sqrt(_dot(normal, normal))
        x, y, z = (_dot(normal, corner - a) for corner in one)
        straddles = np.minimum(np.minimum(x, y), z) < reach
        straddles &= np.maximum(np.maximum(x, y), z) > -reach
        kept = np.flatnonzero(straddles)
        one, two, rows = _select(two, kept), _select(one, kept), rows[kept]
    return np.asarray(rows[_edge_hits(one, two, near) | _edge_hits(two, one, near)])


def _select(corners: Corners, rows: IndexArray) -> Corners:
    a, b, c = corners
    return a[:, rows], b[:, rows], c[:, rows]


def _edge_hits(one: Corners, two: Corners, clearance: np.float32) -> NDArray[np.bool_]:
    """Whether an edge of the first triangle passes through the second, there or moved along its normal."""
    origin = two[0]
    u, v = two[1] - origin, two[2] - origin
    normal = _cross_product(u, v)
    square = np.maximum(_dot(normal, normal), np.float32(1e-30))
    reach = clearance * np.sqrt(square)
    # The coordinates of a point on the triangle are its products with these.
    along_u = (_cross_product(v, normal) / square).astype(np.float32)
    along_v = (_cross_product(normal, u) / square).astype(np.float32)
    corners = [corner - origin for corner in one]
    heights = [_dot(normal, corner) for corner in corners]
    places = [(_dot(along_u, corner), _dot(along_v, corner)) for corner in corners]
    hit = np.zeros(origin.shape[1], dtype=bool)
    for k in range(3):
        h0, h1 = heights[k], heights[k - 2]
        change = np.where(h0 == h1, np.float32(1.0), h0 - h1)
        (s0, t0), (s1, t1) = places[k], places[k - 2]
        for level in (-reach, np.float32(0.0), reach):
            fraction = (h0 - level) / change
            s, t = s0 + fraction * (s1 - s0), t0 + fraction * (t1 - t0)
            crosses = ((h0 - level) * (h1 - level) <= 0.0) & (h0 != h1)
            hit |= crosses & (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    return hit


def _cross_product(a: SingleArray, b: SingleArray) -> SingleArray:
    return np.stack([a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)])


def _dot(a: SingleArray, b: SingleArray) -> SingleArray:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])

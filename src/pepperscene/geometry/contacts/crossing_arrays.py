"""Count of triangles that cross, by arrays: many pairs of triangles at a time.

Bounding boxes are compared first, then planes, then edges with triangles. `crossing_kernel` has the same
function compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.patches import expand_counts
from pepperscene.geometry.contacts.triangles import OrganMotions, OrganPairs, OrganTriangles
from pepperscene.geometry.mesh import IndexArray, SingleArray

_BLOCK: Final = 1 << 18  # pairs of boxes compared at a time, chosen: they fit into a cache

Boxes = tuple[SingleArray, SingleArray]
"""Lower and upper corners of boxes, `(3, n)` metres each."""


def count_crossings(
    triangles: OrganTriangles,
    motions: OrganMotions,
    pairs: OrganPairs,
    clearance: np.float32,
    *,
    by_boxes: bool,
) -> IndexArray:
    """Count pairs of triangles that cross or are closer than the clearance.

    Args:
        triangles: of all organs.
        motions: of the organs that move.
        pairs: `(n,)` of organs.
        clearance: metres.
        by_boxes: count pairs whose bounding boxes are closer than the clearance.

    Returns:
        `(n,)` numbers of pairs of triangles.
    """
    vertices, faces = triangles.vertices, triangles.faces
    organ, entry, other = motions.organ, pairs.motion, pairs.other
    result = np.zeros(len(entry), dtype=np.intp)
    # The triangles of the organs that move.
    rows, position = vertices.of(organ)
    points = transform_points(triangles.points.take(rows, axis=1), motions, position)
    face, position = faces.of(organ)
    offset = vertices.starts(organ) - vertices.first[organ]
    corners = triangles.corners.take(face, axis=1) + offset.take(position)
    low, high = _boxes(points, corners)
    boxes = low - clearance, high + clearance
    starts = faces.starts(organ)
    # The triangles of the first organ near the box of the second, those of the second near the box around
    # these, and of these the triangles near the box around those.
    pair, number = expand_counts(faces.count[organ[entry]])
    own, own_pair = _overlapping(boxes, starts[entry][pair] + number, (pairs.low.T, pairs.high.T), pair)
    near, around = _bounds_by_pair(boxes, own, own_pair)
    if not len(near):
        return result
    distinct, place = np.unique(other[near], return_inverse=True)
    other_face, _ = faces.of(distinct)
    other_corners = triangles.corners.take(other_face, axis=1)
    other_boxes = _boxes(triangles.points, other_corners)
    pair, number = expand_counts(faces.count[other[near]])
    theirs = faces.starts(distinct)[place][pair] + number
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
    their_boxes = other_boxes[0].take(theirs, axis=1), other_boxes[1].take(theirs, axis=1)
    total, done = np.cumsum(stop - start), 0
    while done < len(own):
        before = total[done - 1] if done else 0
        end = max(int(np.searchsorted(total, before + _BLOCK, side="right")), done + 1)
        block = own[done:end]
        row, column = _overlapping_runs(
            (boxes[0].take(block, axis=1), boxes[1].take(block, axis=1)),
            their_boxes,
            start[done:end],
            (stop - start)[done:end],
        )
        pair = own_pair[done:end].take(row)
        if by_boxes:
            result += np.bincount(pair, minlength=len(result))
            done = end
            continue
        a, b = block.take(row), theirs.take(column)
        one, a = _used_planes(points, corners, a)
        two, b = _used_planes(triangles.points, other_corners, b)
        crossing = crossing_triangles(one, a, two, b, clearance)
        result += np.bincount(pair[crossing], minlength=len(result))
        done = end
    return result


def transform_points(points: SingleArray, motions: OrganMotions, position: IndexArray) -> SingleArray:
    """`(3, v)` points moved by the motion at the position of each."""
    result = np.empty(points.shape, dtype=np.float32)
    for axis in range(3):
        column = motions.shift[:, axis].take(position)
        for other in range(3):
            column += motions.rotation[:, axis, other].take(position) * points[other]
        result[axis] = column
    return result


def _boxes(points: SingleArray, corners: IndexArray) -> Boxes:
    """The boxes of triangles."""
    a, b, c = (points.take(corner, axis=1) for corner in corners)
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _overlapping(
    boxes: Boxes, rows: IndexArray, others: tuple[SingleArray, ...], columns: IndexArray
) -> tuple[IndexArray, IndexArray]:
    """The rows and columns of two tables of boxes that overlap."""
    for axis in range(3):
        overlap = boxes[0][axis].take(rows) <= others[1][axis].take(columns)
        overlap &= boxes[1][axis].take(rows) >= others[0][axis].take(columns)
        kept = np.flatnonzero(overlap)
        rows, columns = rows.take(kept), columns.take(kept)
    return rows, columns


def _bounds_by_pair(boxes: Boxes, rows: IndexArray, pair: IndexArray) -> tuple[IndexArray, Boxes]:
    """The pairs that have rows of a table of boxes, and the boxes around all rows of each."""
    first = np.flatnonzero(np.diff(pair, prepend=-1))
    if not len(first):
        return first, (np.empty((3, 0), dtype=np.float32), np.empty((3, 0), dtype=np.float32))
    low = np.stack([np.minimum.reduceat(axis.take(rows), first) for axis in boxes[0]])
    high = np.stack([np.maximum.reduceat(axis.take(rows), first) for axis in boxes[1]])
    return pair[first], (low, high)


def _overlapping_runs(
    boxes: Boxes, others: Boxes, start: IndexArray, count: IndexArray
) -> tuple[IndexArray, IndexArray]:
    """Indices of boxes and of others that overlap, of a run of others for each box."""
    row = np.repeat(np.arange(len(count)), count)
    column = np.arange(len(row)) + np.repeat(start - np.cumsum(count) + count, count)
    for axis in range(3):
        # Repeating is faster than taking, where nothing has been left out yet.
        low, high = (np.repeat(side[axis], count) if axis == 0 else side[axis].take(row) for side in boxes)
        overlap = low <= others[1][axis].take(column)
        overlap &= high >= others[0][axis].take(column)
        kept = np.flatnonzero(overlap)
        row, column = row.take(kept), column.take(kept)
    return row, column


@dataclass(frozen=True, eq=False)
class TrianglePlanes:
    """Triangles and their planes; a product with the normal is a height above the plane times its length."""

    corners: SingleArray  # `(3, 3, f)` metres: axis, corner, triangle
    normal: SingleArray  # `(3, f)` square metres
    square: SingleArray  # `(f,)` of the normal
    coordinates: SingleArray  # `(2, 3, f)`: products with these are coordinates of a point on the triangle

    @classmethod
    def of(cls, corners: SingleArray) -> TrianglePlanes:
        """The planes of triangles `(3, 3, f)`."""
        u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normal = _cross_product(u, v)
        square = np.asarray(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
        nonzero = np.maximum(square, np.float32(1e-30))
        coordinates = np.stack([_cross_product(v, normal), _cross_product(normal, u)]) / nonzero
        return cls(corners, normal, square, coordinates)

    def heights(self, rows: IndexArray, others: TrianglePlanes, columns: IndexArray) -> SingleArray:
        """`(3, n)` products of the normals with the corners of others."""
        x, y, z = self._offsets(rows, others, columns)
        a, b, c = self.normal.take(rows, axis=1)
        return np.asarray(a * x + b * y + c * z)

    def places(self, rows: IndexArray, others: TrianglePlanes, columns: IndexArray) -> SingleArray:
        """`(2, 3, n)` coordinates of the corners of others, along two edges from the first corner."""
        x, y, z = self._offsets(rows, others, columns)
        a, b, c = self.coordinates.take(rows, axis=2).swapaxes(0, 1)[:, :, None]
        return np.asarray(a * x + b * y + c * z)

    def _offsets(self, rows: IndexArray, others: TrianglePlanes, columns: IndexArray) -> SingleArray:
        """`(3, 3, n)` corners of others relative to the first corners."""
        return np.asarray(others.corners.take(columns, axis=2) - self.corners[:, :1].take(rows, axis=2))


def _used_planes(
    points: SingleArray, corners: IndexArray, rows: IndexArray
) -> tuple[TrianglePlanes, IndexArray]:
    """The planes of those triangles that occur in `rows`, and the rows among these."""
    used = np.zeros(corners.shape[1], dtype=bool)
    used[rows] = True
    chosen = np.flatnonzero(used)
    place = np.empty(len(used), dtype=np.intp)
    place[chosen] = np.arange(len(chosen))
    return TrianglePlanes.of(points.take(corners[:, chosen], axis=1)), place.take(rows)


def crossing_triangles(
    one: TrianglePlanes,
    rows: IndexArray,
    two: TrianglePlanes,
    columns: IndexArray,
    clearance: np.float32,
) -> IndexArray:
    """Indices of pairs of triangles that cross, or do so after a move by the clearance along a normal.

    Args:
        one: triangles, and
        rows: `(n,)` that of each pair.
        two: other triangles, and
        columns: `(n,)` that of each pair.
        clearance: metres.
    """
    # Both triangles must have corners on both sides of the plane of the other, or close to it.
    above_two = two.heights(columns, one, rows)
    kept = _straddling(above_two, clearance * np.sqrt(two.square).take(columns))
    above_two, rows, columns = above_two.take(kept, axis=1), rows.take(kept), columns.take(kept)
    above_one = one.heights(rows, two, columns)
    both = _straddling(above_one, clearance * np.sqrt(one.square).take(rows))
    kept, rows, columns = kept.take(both), rows.take(both), columns.take(both)
    hit = _edge_hits(two, columns, one, rows, above_two.take(both, axis=1), clearance)
    hit |= _edge_hits(one, rows, two, columns, above_one.take(both, axis=1), clearance)
    return np.asarray(kept[hit])


def _straddling(heights: SingleArray, reach: SingleArray) -> IndexArray:
    """Indices of triangles with corners on both sides of a plane, or closer to it than the reach."""
    straddles = heights.min(axis=0) < reach
    straddles &= heights.max(axis=0) > -reach
    return np.flatnonzero(straddles)


def _edge_hits(
    planes: TrianglePlanes,
    rows: IndexArray,
    others: TrianglePlanes,
    columns: IndexArray,
    heights: SingleArray,
    clearance: np.float32,
) -> NDArray[np.bool_]:
    """Whether an edge of the other triangle passes through the first, there or moved along its normal.

    `heights` are those of the other's corners, `(3, n)`.
    """
    reach = clearance * np.sqrt(np.maximum(planes.square, np.float32(1e-30))).take(rows)
    # Heights of the corners above the triangle moved by less, not at all and by more; each edge runs to the
    # next corner.
    level = heights[:, None] - np.stack([-reach, np.zeros_like(reach), reach])
    after = (1, 2, 0)
    rise = heights - heights[after, :]
    edge, step, pair = np.nonzero((level * level[after, :] <= 0.0) & (rise != 0.0)[:, None])
    s, t = planes.places(rows, others, columns).reshape(2, -1)
    start, end = edge * len(rows) + pair, np.array(after).take(edge) * len(rows) + pair
    fraction = level[edge, step, pair] / rise.ravel().take(start)
    s0, t0 = s.take(start), t.take(start)
    s, t = s0 + fraction * (s.take(end) - s0), t0 + fraction * (t.take(end) - t0)
    hit = np.zeros(len(rows), dtype=bool)
    hit[pair[(s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)]] = True
    return hit


def _cross_product(a: SingleArray, b: SingleArray) -> SingleArray:
    return np.stack([a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)])

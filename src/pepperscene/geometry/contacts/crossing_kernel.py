"""Compiled count of triangles that cross: by boxes first, then by planes, then by edges and triangles."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from pepperscene.geometry.contacts.compiled import compiled
from pepperscene.geometry.mesh import IndexArray, SingleArray

_TINY: Final = np.float32(1e-30)
_ZERO: Final = np.float32(0.0)
_ONE: Final = np.float32(1.0)
_INFINITE: Final = np.float32(np.inf)

_Vector = tuple[Any, Any, Any]  # Numba's types of single-precision numbers
_Triangle = tuple[_Vector, _Vector, _Vector]
Runs = tuple[IndexArray, IndexArray]
"""`(organs,)` index of the first item of each organ, and `(organs,)` number of its items."""


class OrganTriangles(NamedTuple):
    """The triangles of all organs, in runs."""

    points: SingleArray  # `(3, v)` metres
    corners: IndexArray  # `(3, f)`
    vertex_runs: Runs
    face_runs: Runs


class Motions(NamedTuple):
    """The motions of some organs."""

    organ: IndexArray  # `(e,)`
    rotation: SingleArray  # `(e, 3, 3)`
    shift: SingleArray  # `(e, 3)` metres


class OrganPairs(NamedTuple):
    """Pairs of an organ that moves and one that stays."""

    entry: IndexArray  # `(n,)` index of the first among the motions
    other: IndexArray  # `(n,)` the second
    boxes: SingleArray  # `(n, 6)` of the second, metres


@compiled
def count_crossings(
    triangles: OrganTriangles, motions: Motions, pairs: OrganPairs, clearance: np.float32, by_boxes: bool
) -> IndexArray:
    """The count of `CoarseTriangles.count`."""
    points, corners, face_runs = triangles.points, triangles.corners, triangles.face_runs
    entry, other, other_boxes = pairs.entry, pairs.other, pairs.boxes
    own, own_corners, own_boxes, first = _moved_triangles(triangles, motions, clearance)
    result = np.zeros(len(entry), np.intp)
    near = np.empty(len(own_boxes), np.intp)
    most = 0
    for item in other:
        most = max(most, face_runs[1][item])
    theirs, their_boxes = np.empty(most, np.intp), np.empty((most, 6), np.float32)
    around = np.empty((2, 6), np.float32)
    for pair in range(len(entry)):
        # The triangles of the first organ near the box of the second.
        count = 0
        _clear(around, 0)
        for row in range(first[entry[pair]], first[entry[pair] + 1]):
            if _overlap(own_boxes, row, other_boxes, pair):
                near[count] = row
                count += 1
                _extend(around, 0, own_boxes, row)
        if count == 0:
            continue
        # The triangles of the second organ near the box around these.
        count_other = 0
        _clear(around, 1)
        start = face_runs[0][other[pair]]
        for face in range(start, start + face_runs[1][other[pair]]):
            a, b, c = corners[0, face], corners[1, face], corners[2, face]
            for axis in range(3):
                x, y, z = points[axis, a], points[axis, b], points[axis, c]
                their_boxes[count_other, axis] = min(min(x, y), z)
                their_boxes[count_other, 3 + axis] = max(max(x, y), z)
            if _overlap(their_boxes, count_other, around, 0):
                theirs[count_other] = face
                _extend(around, 1, their_boxes, count_other)
                count_other += 1
        # Pairs of those of the first organ that are also near the box around these.
        for step in range(count if count_other else 0):
            row = near[step]
            if not _overlap(own_boxes, row, around, 1):
                continue
            for column in range(count_other):
                if _overlap(own_boxes, row, their_boxes, column) and (
                    by_boxes
                    or _cross_each_other(
                        _triangle(own, own_corners, row),
                        _triangle(points, corners, theirs[column]),
                        clearance,
                    )
                ):
                    result[pair] += 1
    return result


@compiled
def _moved_triangles(
    triangles: OrganTriangles, motions: Motions, clearance: np.float32
) -> tuple[SingleArray, IndexArray, SingleArray, IndexArray]:
    """Move organs.

    Returns:
        `(3, v)` vertices; `(3, f)` corners of triangles; `(f, 6)` their boxes, larger by the clearance; and
        `(e + 1,)` where the triangles of each organ start.
    """
    points, corners = triangles.points, triangles.corners
    vertex_runs, face_runs = triangles.vertex_runs, triangles.face_runs
    organ, rotation, shift = motions.organ, motions.rotation, motions.shift
    first = np.zeros(len(organ) + 1, np.intp)
    vertices = 0
    for number in range(len(organ)):
        vertices += vertex_runs[1][organ[number]]
        first[number + 1] = first[number] + face_runs[1][organ[number]]
    moved = np.empty((3, vertices), np.float32)
    own_corners, boxes = np.empty((3, first[-1]), np.intp), np.empty((first[-1], 6), np.float32)
    done = 0
    for number in range(len(organ)):
        item = organ[number]
        start, stop = vertex_runs[0][item], vertex_runs[0][item] + vertex_runs[1][item]
        offset = done - start
        for axis in range(3):
            a, b, c = rotation[number, axis, 0], rotation[number, axis, 1], rotation[number, axis, 2]
            d = shift[number, axis]
            for row in range(start, stop):
                moved[axis, offset + row] = d + a * points[0, row] + b * points[1, row] + c * points[2, row]
        done += stop - start
        for step in range(face_runs[1][item]):
            face, row = face_runs[0][item] + step, first[number] + step
            i, j, k = corners[0, face] + offset, corners[1, face] + offset, corners[2, face] + offset
            own_corners[0, row], own_corners[1, row], own_corners[2, row] = i, j, k
            for axis in range(3):
                x, y, z = moved[axis, i], moved[axis, j], moved[axis, k]
                boxes[row, axis] = min(min(x, y), z) - clearance
                boxes[row, 3 + axis] = max(max(x, y), z) + clearance
    return moved, own_corners, boxes, first


@compiled
def _cross_each_other(one: _Triangle, two: _Triangle, clearance: np.float32) -> bool:
    """Whether two triangles cross, or do so after a move by the clearance along a normal."""
    # Both triangles must have corners on both sides of the plane of the other, or close to it.
    normal_two = _cross(_minus(two[1], two[0]), _minus(two[2], two[0]))
    square_two = _dot(normal_two, normal_two)
    above_two = _products(normal_two, one, two[0])
    if not _straddles(above_two, clearance * np.sqrt(square_two)):
        return False
    normal_one = _cross(_minus(one[1], one[0]), _minus(one[2], one[0]))
    square_one = _dot(normal_one, normal_one)
    above_one = _products(normal_one, two, one[0])
    if not _straddles(above_one, clearance * np.sqrt(square_one)):
        return False
    return _has_edge_through(two, normal_two, square_two, one, above_two, clearance) or _has_edge_through(
        one, normal_one, square_one, two, above_one, clearance
    )


@compiled
def _has_edge_through(
    triangle: _Triangle,
    normal: _Vector,
    square: Any,
    other: _Triangle,
    heights: _Vector,
    clearance: np.float32,
) -> bool:
    """Whether an edge of the other triangle passes through the first, there or moved along its normal."""
    nonzero = max(square, _TINY)
    reach = clearance * np.sqrt(nonzero)
    along_u = _cross(_minus(triangle[2], triangle[0]), normal)
    along_v = _cross(normal, _minus(triangle[1], triangle[0]))
    along_u = along_u[0] / nonzero, along_u[1] / nonzero, along_u[2] / nonzero
    along_v = along_v[0] / nonzero, along_v[1] / nonzero, along_v[2] / nonzero
    s, t = _products(along_u, other, triangle[0]), _products(along_v, other, triangle[0])
    for edge in range(3):
        # Each edge runs to the next corner.
        end = (edge + 1) % 3
        rise = heights[edge] - heights[end]
        if rise == _ZERO:
            continue
        for offset in (-reach, _ZERO, reach):
            level = heights[edge] - offset
            if level * (heights[end] - offset) <= _ZERO:
                fraction = level / rise
                x = s[edge] + fraction * (s[end] - s[edge])
                y = t[edge] + fraction * (t[end] - t[edge])
                if x >= _ZERO and y >= _ZERO and x + y <= _ONE:
                    return True
    return False


@compiled
def _straddles(heights: _Vector, reach: Any) -> bool:
    """Whether corners are on both sides of a plane, or closer to it than the reach."""
    lowest = min(min(heights[0], heights[1]), heights[2])
    highest = max(max(heights[0], heights[1]), heights[2])
    return bool(lowest < reach and highest > -reach)


@compiled
def _triangle(points: SingleArray, corners: IndexArray, face: int) -> _Triangle:
    """The corners of a triangle."""
    a, b, c = corners[0, face], corners[1, face], corners[2, face]
    return (
        (points[0, a], points[1, a], points[2, a]),
        (points[0, b], points[1, b], points[2, b]),
        (points[0, c], points[1, c], points[2, c]),
    )


@compiled
def _products(vector: _Vector, triangle: _Triangle, origin: _Vector) -> _Vector:
    """Products of a vector with the corners of a triangle relative to an origin."""
    return (
        _dot(vector, _minus(triangle[0], origin)),
        _dot(vector, _minus(triangle[1], origin)),
        _dot(vector, _minus(triangle[2], origin)),
    )


@compiled
def _minus(a: _Vector, b: _Vector) -> _Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def _dot(a: _Vector, b: _Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def _clear(boxes: SingleArray, row: int) -> None:
    """Set a box that contains nothing."""
    for axis in range(3):
        boxes[row, axis], boxes[row, 3 + axis] = _INFINITE, -_INFINITE


@compiled
def _extend(boxes: SingleArray, row: int, others: SingleArray, column: int) -> None:
    """Extend a box so that it contains another."""
    for axis in range(3):
        boxes[row, axis] = min(boxes[row, axis], others[column, axis])
        boxes[row, 3 + axis] = max(boxes[row, 3 + axis], others[column, 3 + axis])


@compiled
def _overlap(boxes: SingleArray, row: int, others: SingleArray, column: int) -> bool:
    """Whether two boxes overlap or touch."""
    return bool(
        boxes[row, 0] <= others[column, 3]
        and boxes[row, 3] >= others[column, 0]
        and boxes[row, 1] <= others[column, 4]
        and boxes[row, 4] >= others[column, 1]
        and boxes[row, 2] <= others[column, 5]
        and boxes[row, 5] >= others[column, 2]
    )

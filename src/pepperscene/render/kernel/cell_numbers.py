"""Numbers of the cells that triangles and points lie in, from 0 on in the order in which they are met."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.compiled import compiled

_PIECE_M2: Final = 0.02  # area of the parts of a large triangle, square metres; chosen
_MOST_DIVISIONS: Final = 8  # log2 of the parts of a triangle's edge; chosen: .2 m on a floor of 60 m


@compiled
def _number(key: Any, keys: NDArray[np.int64], numbers: NDArray[np.int32], count: int) -> Any:
    """The number of a key in a hash table with open addressing; a new key gets `count`."""
    mask = len(keys) - 1
    place = ((key * 0x9E3779B97F4A7) >> 17) & mask
    while numbers[place] >= 0:
        if keys[place] == key:
            return numbers[place]
        place = (place + 1) & mask
    keys[place], numbers[place] = key, count
    return count


@compiled
def _grown(
    keys: NDArray[np.int64], numbers: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """A table of four times the size with the same keys."""
    larger, empty = np.zeros(4 * len(keys), np.int64), np.full(4 * len(keys), -1, np.int32)
    for place in range(len(keys)):
        if numbers[place] >= 0:
            _number(keys[place], larger, empty, numbers[place])
    return larger, empty


@compiled
def _cube_key(organ: Any, x: float, y: float, z: float, edge: float) -> Any:
    """The cube of an organ that a point lies in; cubes repeat after 2^14 edges."""
    i, j, k = np.int64(np.floor(x / edge)), np.int64(np.floor(y / edge)), np.int64(np.floor(z / edge))
    return (np.int64(organ) << 42) | ((i & 0x3FFF) << 28) | ((j & 0x3FFF) << 14) | (k & 0x3FFF)


@compiled
def cube_numbers(
    points: NDArray[np.float32], organs: NDArray[np.int32], edge: float
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """`(n,)` numbers of the cubes of organs that points lie in, and the first point of each cube."""
    keys, table, count = np.zeros(1024, np.int64), np.full(1024, -1, np.int32), 0
    numbers, first = np.empty(len(points), np.int32), np.empty(len(points), np.int64)
    for k in range(len(points)):
        key = _cube_key(organs[k], points[k, 0], points[k, 1], points[k, 2], edge)
        numbers[k] = _number(key, keys, table, count)
        if numbers[k] == count:
            first[count] = k
            count += 1
            if 2 * count > len(keys):
                keys, table = _grown(keys, table)
    return numbers, first[:count].copy()


@compiled
def face_cells(
    vertices: NDArray[np.float32],
    faces: NDArray[np.uint32],
    instances: NDArray[np.uint32],
    edge: float,
    division_bits: int,
) -> tuple[NDArray[np.int64], int, NDArray[np.float32], NDArray[np.int32]]:
    """Entries of the faces as in `SurfaceCells`, the number of cells, and their points and organs.

    `edge` is that of a cell, and `division_bits` where the divisions of a face begin in its entry.
    """
    keys, table, count = np.zeros(1024, np.int64), np.full(1024, -1, np.int32), 0
    entries = np.empty(len(faces), np.int64)
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        square = 0.0
        for i, j in ((0, 1), (1, 2), (2, 0)):
            square += ((b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i])) ** 2
        area = 0.5 * np.sqrt(square)
        log_parts = min(max(int(np.ceil(0.5 * np.log2(max(area, 1e-20) / _PIECE_M2))), 0), _MOST_DIVISIONS)
        if log_parts:
            # A large triangle has cells of its own.
            entries[f] = np.int64(count) | (np.int64(log_parts) << division_bits)
            count += 4**log_parts
            continue
        x, y, z = (a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3
        entries[f] = _number(_cube_key(instances[f], x, y, z, edge), keys, table, count)
        if entries[f] == count:
            count += 1
            if 2 * count > len(keys):
                keys, table = _grown(keys, table)

    # The point of a cell is the centroid of one of its triangles, or the middle of its part of one.
    points, organs = np.empty((count, 3), np.float32), np.empty(count, np.int32)
    for f in range(len(faces)):
        parts, cell = 2 ** (entries[f] >> division_bits), entries[f] & ((1 << division_bits) - 1)
        middle = 1 / 3 if parts == 1 else 0.5
        for i in range(parts):
            for j in range(parts):
                u, v = (i + middle) / parts, (j + middle) / parts
                for axis in range(3):
                    a = vertices[faces[f, 0], axis]
                    b, c = vertices[faces[f, 1], axis], vertices[faces[f, 2], axis]
                    points[cell, axis] = a + u * (b - a) + v * (c - a)
                organs[cell] = instances[f]
                cell += 1
    return entries, count, points, organs

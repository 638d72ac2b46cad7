"""Small places on one side of an organ: where the light that a surface sends out is nearly the same.

Incident light is smooth over about two centimetres of one side of an organ, and unrelated between organs that
only look close to each other. A cell is a cube of `CELL_M` within an organ, seen from one side. A triangle
belongs to the cell of its centroid; one that is much larger than a cell is divided along its barycentric
coordinates. Cells are joined to larger ones, whose means serve where a cell has little light of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry import Mesh
from pepperscene.geometry.contacts.compiled import compiled
from pepperscene.render.arrays import device_array
from pepperscene.render.variant import mitsuba_modules

CELL_M: Final = 0.03
"""Edge of a cell, metres. Chosen among 1.5, 3 and 6 cm, which differ by 3 % in the error of a frame."""
_JOINED_M: Final = (0.15, 0.45)  # edges of larger cells; chosen. Each contains whole smaller ones.
_PIECE_M2: Final = 0.02  # area of the parts of a large triangle, square metres; chosen
_MOST_DIVISIONS: Final = 8  # log2 of the parts of a triangle's edge; chosen: .2 m on a floor of 60 m
_DIVISION_BITS: Final = 28  # of a face's entry: its first cell is below them, its divisions above


@dataclass(frozen=True, eq=False)
class SurfaceCells:
    """Cells of the faces of a mesh, and the larger cells that they belong to.

    Each cell has two sides: side 2 k is the front of cell k, 2 k + 1 its back.

    Attributes:
        faces: `(f,)` on the device: first cell of a face, and log2 of the divisions of its edges.
        count: number of cells.
        parents: numbers of the larger cells: for each cell that of `_JOINED_M[0]` in its organ, for each of
            these that of all organs, and for each of these that of `_JOINED_M[1]`.
    """

    faces: Any
    count: int
    parents: tuple[NDArray[np.int32], ...]

    def at(self, si: Any, hit: Any, active: Any) -> Any:
        """Number of the cell's side that is seen at surface interactions of preliminary hits."""
        mi, dr = mitsuba_modules()
        entry = dr.gather(mi.UInt32, self.faces, hit.prim_index, active)
        parts = mi.UInt32(1) << (entry >> _DIVISION_BITS)
        u, v = (
            dr.minimum(mi.UInt32(coordinate * mi.Float(parts)), parts - 1)
            for coordinate in (hit.prim_uv.x, hit.prim_uv.y)
        )
        cell = (entry & ((1 << _DIVISION_BITS) - 1)) + u * parts + v
        return 2 * cell + dr.select(si.wi.z > 0.0, mi.UInt32(0), mi.UInt32(1))


def surface_cells(mesh: Mesh) -> SurfaceCells:
    """Divide the surfaces of a mesh into cells.

    Raises:
        ValueError: there are more than 2^28.
    """
    entries, cells, points, organs = _face_cells(mesh.vertices, mesh.faces, mesh.face_instance)
    if cells >= 1 << _DIVISION_BITS:
        raise ValueError(f"the scene is too large: its surfaces have {cells} cells of {CELL_M:g} m")
    parents = []
    for edge, is_shared in zip((_JOINED_M[0], *_JOINED_M), (False, True, True), strict=True):
        if is_shared:
            organs = np.zeros_like(organs)
        numbers, first = _cube_numbers(points, organs, edge)
        parents.append(numbers)
        points, organs = points[first], organs[first]
    return SurfaceCells(device_array(entries, np.uint32), cells, tuple(parents))


# Below, numbers of cells count from 0 in the order in which cells are met first.


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
def _cube_numbers(
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
def _face_cells(
    vertices: NDArray[np.float32], faces: NDArray[np.uint32], instances: NDArray[np.uint32]
) -> tuple[NDArray[np.int64], int, NDArray[np.float32], NDArray[np.int32]]:
    """Entries of the faces as in `SurfaceCells`, the number of cells, and their points and organs."""
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
            entries[f] = np.int64(count) | (np.int64(log_parts) << _DIVISION_BITS)
            count += 4**log_parts
            continue
        x, y, z = (a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3
        entries[f] = _number(_cube_key(instances[f], x, y, z, CELL_M), keys, table, count)
        if entries[f] == count:
            count += 1
            if 2 * count > len(keys):
                keys, table = _grown(keys, table)

    # The point of a cell is the centroid of one of its triangles, or the middle of its part of one.
    points, organs = np.empty((count, 3), np.float32), np.empty(count, np.int32)
    for f in range(len(faces)):
        parts, cell = 2 ** (entries[f] >> _DIVISION_BITS), entries[f] & ((1 << _DIVISION_BITS) - 1)
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

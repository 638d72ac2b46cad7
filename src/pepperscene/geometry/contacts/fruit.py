"""How deep points lie inside a fruit: the plane of its wall in every direction from its centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.organs import Indices, Organs, Points, Vectors

_CELLS: Final = 64  # along either side of the map of directions: cells of 3 degrees, 2 mm on a fruit
_STEP: Final = 0.06  # rad; a triangle is entered into the map at points no farther apart than this
_PRODUCTS: Final = 1 << 17
"""Chosen: of a matrix product at a time. Larger ones, in OpenBLAS from 2^18 on, are shared out to threads,
which costs more than it gains where the cores have other work."""


@dataclass(frozen=True, eq=False)
class Wall:
    """A fruit's wall, seen from its centre.

    A point is inside where it lies under the plane of the triangle that its direction meets, and that plane
    also tells how deep. So the wall is exact but for directions within a cell of a triangle's edge; where the
    fruit is not star-shaped, the outermost wall counts.

    Attributes:
        centre: `(3,)` metres, in the fruit as grown.
        reach: metres, from the centre to the farthest point.
        planes: `(cells, 4)` normal and distance from the centre, by octahedral cell of the direction
            (Cigolle et al. 2014, "A survey of efficient representations for independent unit vectors").
    """

    centre: Vectors
    reach: float
    planes: NDArray[np.float32]

    def depth(self, points: Points) -> NDArray[np.float32]:
        """`(p,)` metres that points `(3, p)`, told from the centre, lie below the wall; negative outside."""
        return _below(self.planes, 0, points)


class Walls:
    """The walls of many fruit in one table, and the balls that hold them; each is made when first asked for.

    Args:
        organs: of a mesh.
        fruit: `(f,)` which of them are fruit, ascending.
    """

    def __init__(self, organs: Organs, fruit: Indices) -> None:
        self._organs, self._fruit = organs, fruit
        self._held = np.zeros(len(fruit), dtype=bool)
        self._made = np.zeros(len(fruit), dtype=bool)
        self._planes = np.empty((len(fruit) * _CELLS * _CELLS, 4), dtype=np.float32)
        self._centre = np.empty((len(fruit), 3))
        self._reach = np.empty(len(fruit))

    def bodies(self, fruit: Sequence[int] | Indices) -> Balls:
        """Some fruit as they stand."""
        place = np.searchsorted(self._fruit, fruit)
        missing = np.unique(place[~self._held[place]])
        if len(missing):
            grown = [self._organs.vertices(one) for one in self._fruit[missing].tolist()]
            self._centre[missing], self._reach[missing] = _balls(grown)
            self._held[missing] = True
        which = self._fruit[place]
        turned, shift, centre = self._organs.rotation[which], self._organs.shift[which], self._centre[place]
        return Balls(place, turned, np.einsum("fij,fj->fi", turned, centre) + shift, self._reach[place])

    def depth(
        self, row: Indices, points: Points, matrix: Points, offset: Points, far: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """How deep the deepest point of each patch lies in a fruit.

        Args:
            row: `(h,)` of the fruit in the table.
            points: `(3, s, h)` metres.
            matrix: `(3, 3, h)` and
            offset: `(3, h)` metres: matrix @ point + offset is told from the fruit's centre.
            far: `(h,)` metres from that centre; what is farther off is not looked at.

        Returns:
            `(h,)` metres; minus infinity where all is far off.
        """
        missing = np.unique(row[~self._made[row]])
        if len(missing):
            made = walls(self._organs, self._fruit[missing].tolist())
            for one, wall in zip(missing.tolist(), made, strict=True):
                self._planes[one * _CELLS**2 : (one + 1) * _CELLS**2] = wall.planes
            self._made[missing] = True
        x, y, z = points
        local = np.empty_like(points)
        square = np.zeros_like(x)
        for axis, (one, other, third) in enumerate(matrix):
            local[axis] = one * x + other * y + third * z + offset[axis]
            square += local[axis] * local[axis]
        number, patch = np.nonzero(square < far * far)
        depth = np.full(x.shape, -np.inf, dtype=np.float32)
        depth[number, patch] = _below(self._planes, row[patch] * _CELLS**2, local[:, number, patch])
        return np.asarray(depth.max(axis=0))


@dataclass(frozen=True, eq=False)
class Balls:
    """The balls that hold some fruit, as these stand.

    Attributes:
        row: `(n,)` of each fruit in the table.
        turned: `(n, 3, 3)` how it is turned from where it grew.
        centre: `(n, 3)` metres.
        reach: `(n,)` metres.
    """

    row: Indices
    turned: Vectors
    centre: Vectors
    reach: NDArray[np.float64]


def _below(planes: NDArray[np.float32], first: Indices | int, points: Points) -> NDArray[np.float32]:
    """`(p,)` metres that points `(3, p)` lie below the wall whose map starts in some row of a table."""
    x, y, z = points
    plane = planes[_cell(x, y, z) + first]
    return np.asarray(plane[:, 3] - plane[:, 0] * x - plane[:, 1] * y - plane[:, 2] * z)


def walls(organs: Organs, fruit: Sequence[int]) -> list[Wall]:
    """The walls of some fruit, as grown."""
    if not len(fruit):
        return []
    centre, reach = _balls([organs.vertices(one) for one in fruit])
    corners, number = organs.triangles(fruit)
    corners -= centre[number][:, None]
    a, b, c = (np.ascontiguousarray(corners[:, corner]) for corner in range(3))
    planes = _planes(a, b, c)
    # How finely each triangle has to be cut so that it is entered into all cells that it covers.
    width = np.maximum(np.maximum(_squared(b - a), _squared(c - b)), _squared(a - c))
    off = np.minimum(np.minimum(_squared(a), _squared(b)), _squared(c))
    pieces = np.clip(np.ceil(np.sqrt(width / off) / _STEP), 1, _CELLS).astype(np.intp)
    # Of the triangles in a cell the outermost stays: keys are distances, then numbers.
    key = (planes[:, 3] * 1e6).astype(np.int64) << 32 | np.arange(len(planes))
    held = np.full(len(fruit) * _CELLS * _CELLS, -1)
    for count in np.unique(pieces):
        alike, weights = np.flatnonzero(pieces == count), _weights(int(count))
        block = max(_PRODUCTS // weights.size, 1)
        for start in range(0, len(alike), block):
            rows = alike[start : start + block]
            spots = weights @ corners[rows].transpose(2, 1, 0)
            cell = _cell(*spots.reshape(3, -1)).reshape(-1, len(rows)) + _CELLS * _CELLS * number[rows]
            np.maximum.at(held, cell.ravel(), np.broadcast_to(key[rows], cell.shape).ravel())
    held = np.where(held >= 0, held & (2**32 - 1), -1)
    held = _filled(held.reshape(len(fruit), _CELLS, _CELLS))
    maps = planes[held].reshape(len(fruit), -1, 4)
    return [
        Wall(middle.astype(np.float64), float(far), one)
        for middle, far, one in zip(centre, reach, maps, strict=True)
    ]


def _balls(bodies: Sequence[Points]) -> tuple[Points, NDArray[np.float32]]:
    """`(n, 3)` middles of the boxes around bodies, and `(n,)` metres from there to the farthest point."""
    centre = np.stack([0.5 * (some.min(axis=0) + some.max(axis=0)) for some in bodies])
    reach = [np.sqrt(_squared(some - one).max()) for some, one in zip(bodies, centre, strict=True)]
    return centre, np.array(reach)


def _planes(a: Points, b: Points, c: Points) -> NDArray[np.float32]:
    """`(f, 4)` outward normals and distances from the origin of the planes through corners `(f, 3)`."""
    ab, ac = (b - a).T, (c - a).T
    middle = (a + b + c) / 3.0
    normal = np.empty_like(a)
    for axis in range(3):
        y, z = axis - 2, axis - 1
        normal[:, axis] = ab[y] * ac[z] - ab[z] * ac[y]
    length, distance = np.sqrt(_squared(normal)), np.sqrt(_squared(middle))
    height = np.einsum("fi,fi->f", normal, middle)
    # A wall that stands on edge to the line of sight, or is seen from behind, counts as one across it.
    steep = np.flatnonzero(height <= 0.05 * length * distance)
    normal[steep], height[steep], length[steep] = middle[steep], distance[steep] ** 2, distance[steep]
    planes = np.concatenate([normal, height[:, None]], axis=1) / np.maximum(length, 1e-12)[:, None]
    return planes.astype(np.float32)


def _cell(x: Points, y: Points, z: Points) -> Indices:
    """`(p,)` which cell of the map the direction of each point falls into."""
    scale = 1.0 / (np.abs(x) + np.abs(y) + np.abs(z) + np.float32(1e-12))
    u, v = x * scale, y * scale
    # The lower half of the octahedron is folded out over the corners of the square.
    below = np.flatnonzero(z < 0.0)
    x, y = u[below], v[below]
    u[below], v[below] = np.copysign(1.0 - np.abs(y), x), np.copysign(1.0 - np.abs(x), y)
    half, last = np.float32(0.5 * _CELLS), _CELLS - 1
    column = np.minimum((u * half + half).astype(np.int32), last)
    row = np.minimum((v * half + half).astype(np.int32), last)
    return np.asarray(row * _CELLS + column)


def _filled(maps: Indices) -> Indices:
    """Maps `(n, rows, columns)` with their empty cells, -1, filled from the cells beside."""
    while np.any(maps < 0):
        beside = np.pad(maps, ((0, 0), (1, 1), (1, 1)), constant_values=-1)
        around = [beside[:, 1:-1, :-2], beside[:, 1:-1, 2:], beside[:, :-2, 1:-1], beside[:, 2:, 1:-1]]
        maps = np.where(maps < 0, np.maximum.reduce(around), maps)
    return maps


def _squared(vectors: Points) -> NDArray[np.float32]:
    return np.asarray(np.einsum("ij,ij->i", vectors, vectors))


@cache
def _weights(pieces: int) -> NDArray[np.float32]:
    """`(w, 3)` barycentric coordinates of the points that cut a triangle's edges into so many pieces."""
    i, j = np.mgrid[0 : pieces + 1, 0 : pieces + 1]
    kept = i + j <= pieces
    i, j = i[kept], j[kept]
    return (np.stack([i, j, pieces - i - j], axis=1) / pieces).astype(np.float32)

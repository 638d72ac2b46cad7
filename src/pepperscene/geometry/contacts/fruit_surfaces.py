"""Penetration depth of points in fruit, as star-shaped surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from pepperscene.geometry import compilation
from pepperscene.geometry.contacts.organs import Organs
from pepperscene.geometry.contacts.patches import Patches, squared_lengths
from pepperscene.geometry.mesh import FloatArray, IndexArray, SingleArray

_CELLS: Final = 64  # along either side of the map of directions: cells of 3 degrees, 2 mm on a fruit
_STEP: Final = 0.06  # rad, maximum distance of the points at which a triangle is entered into the map
_PRODUCTS: Final = 1 << 17
"""Chosen: size of a matrix product. OpenBLAS splits larger ones, from 2^18 on, over threads, which costs more
than it gains on busy cores."""


@dataclass(frozen=True, eq=False)
class BoundingSpheres:
    """Bounding spheres of some fruit at their current poses."""

    row: IndexArray  # `(n,)` row of each fruit in the table of surfaces
    rotation: FloatArray  # `(n, 3, 3)` of the fruit
    centre: FloatArray  # `(n, 3)` metres
    radius: FloatArray  # `(n,)` metres


class FruitSurfaces:
    """The surfaces of fruit, computed on first use.

    A surface is a map from directions, seen from the centre, to the plane of the triangle there. A point is
    inside if it is below the plane of its direction, which also gives the depth. So depths are exact except
    for directions within a cell of a triangle's edge; where a fruit is not star-shaped, its outermost surface
    counts. Cells are those of an octahedron (Cigolle et al. 2014, "A survey of efficient representations for
    independent unit vectors"). Indices of the fruit must be ascending.
    """

    def __init__(self, organs: Organs, fruit: IndexArray) -> None:
        self._organs, self._fruit = organs, fruit
        self._has_sphere, self._has_planes = np.zeros((2, len(fruit)), dtype=bool)
        # Normal and distance from the centre of the plane in each cell.
        self._planes = np.empty((len(fruit), _CELLS * _CELLS, 4), dtype=np.float32)
        self._centre = np.empty((len(fruit), 3), dtype=np.float32)  # at the original pose
        self._radius = np.empty(len(fruit))

    def spheres(self, fruit: IndexArray) -> BoundingSpheres:
        """Bounding spheres of some fruit."""
        row = np.searchsorted(self._fruit, fruit)
        for missing in np.unique(row[~self._has_sphere[row]]).tolist():
            points = self._organs.original_vertices(int(self._fruit[missing]))
            centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
            self._centre[missing] = centre
            self._radius[missing] = np.sqrt(squared_lengths(points - centre).max())
            self._has_sphere[missing] = True
        organ = self._fruit[row]
        rotation, shift = self._organs.rotation[organ], self._organs.shift[organ]
        centre = np.einsum("fij,fj->fi", rotation, self._centre[row].astype(np.float64)) + shift
        return BoundingSpheres(row, rotation, centre, self._radius[row])

    def depth(
        self,
        row: IndexArray,
        points: SingleArray,
        matrix: SingleArray,
        offset: SingleArray,
        limit: SingleArray,
    ) -> SingleArray:
        """Compute the depth of the deepest point of each patch in a fruit.

        Args:
            row: `(h,)` of the fruit in the table, from `spheres`.
            points: `(3, s, h)` metres.
            matrix: `(3, 3, h)` and
            offset: `(3, h)` metres: matrix @ point + offset is relative to the fruit's centre.
            limit: `(h,)` metres from that centre; points farther away are ignored.

        Returns:
            `(h,)` metres, negative outside; minus infinity where all points are ignored.
        """
        self._map_planes(row)
        x, y, z = points
        local = np.empty_like(points)
        square = np.zeros_like(x)
        for axis, (a, b, c) in enumerate(matrix):
            local[axis] = a * x + b * y + c * z + offset[axis]
            square += local[axis] * local[axis]
        near = np.flatnonzero(square < limit * limit)
        depth = np.full(x.shape, -np.inf, dtype=np.float32)
        x, y, z = local.reshape(3, -1).take(near, axis=1)
        first = np.broadcast_to(row * _CELLS**2, depth.shape).ravel().take(near)
        a, b, c, d = self._planes.reshape(-1, 4).take(_cell(x, y, z) + first, axis=0).T
        depth.ravel()[near] = d - a * x - b * y - c * z
        return np.asarray(depth.max(axis=0))

    def patch_depths(
        self,
        row: IndexArray,
        matrix: SingleArray,
        offset: SingleArray,
        limit: SingleArray,
        hit: IndexArray,
        patches: Patches,
        patch: IndexArray,
        stride: int = 1,
    ) -> SingleArray:
        """Compute the depth of the deepest point of patches of some organs, each in a fruit.

        Args:
            row: `(h,)` of the fruit in the table, from `spheres`.
            matrix: `(h, 3, 3)` and
            offset: `(h, 3)` metres, as for `depth`.
            limit: `(h,)` metres, as for `depth`.
            hit: `(m,)` index of each patch's organ among these.
            patches: all patches.
            patch: `(m,)` of these.
            stride: use every `stride`-th point.

        Returns:
            `(m,)`, as `depth`.
        """
        if not compilation.AVAILABLE:
            motion = np.ascontiguousarray(matrix.transpose(1, 2, 0)), np.ascontiguousarray(offset.T)
            transforms = motion[0].take(hit, axis=2), motion[1].take(hit, axis=1)
            return self.depth(row[hit], patches.coordinates(patch, stride), *transforms, limit[hit])
        from pepperscene.geometry.contacts.depth_kernel import depths_in_fruit

        self._map_planes(row[hit])
        points = patches.points.transpose(2, 0, 1)
        return depths_in_fruit(self._planes, _CELLS, row, matrix, offset, limit, hit, points, patch, stride)

    def _map_planes(self, rows: IndexArray) -> None:
        """Compute the planes of some fruit that have none yet."""
        missing = np.unique(rows[~self._has_planes[rows]])
        if len(missing):
            centre = self._centre[missing]
            self._planes[missing] = _plane_maps(self._organs, self._fruit[missing].tolist(), centre)
            self._has_planes[missing] = True


def _plane_maps(organs: Organs, fruit: Sequence[int], centre: SingleArray) -> SingleArray:
    """`(f, cells, 4)` planes of some fruit around their centres `(f, 3)`, at the original pose."""
    corners, number = organs.original_triangles(fruit)
    corners -= centre[number][:, None]
    a, b, c = (np.ascontiguousarray(corners[:, corner]) for corner in range(3))
    planes = _triangle_planes(a, b, c)
    # Subdivide each triangle so finely that it is entered into all cells that it covers.
    width = np.maximum(np.maximum(squared_lengths(b - a), squared_lengths(c - b)), squared_lengths(a - c))
    distance = np.minimum(np.minimum(squared_lengths(a), squared_lengths(b)), squared_lengths(c))
    pieces = np.clip(np.ceil(np.sqrt(width / distance) / _STEP), 1, _CELLS).astype(np.intp)
    # The outermost of the triangles in a cell counts: keys are distances, then indices.
    key = (planes[:, 3] * 1e6).astype(np.int64) << 32 | np.arange(len(planes))
    maps = np.full(len(fruit) * _CELLS * _CELLS, -1)
    for count in np.unique(pieces):
        group, weights = np.flatnonzero(pieces == count), _barycentric_grid(int(count))
        block = max(_PRODUCTS // weights.size, 1)
        for start in range(0, len(group), block):
            rows = group[start : start + block]
            points = weights @ corners[rows].transpose(2, 1, 0)
            cell = _cell(*points.reshape(3, -1)).reshape(-1, len(rows)) + _CELLS * _CELLS * number[rows]
            np.maximum.at(maps, cell.ravel(), np.broadcast_to(key[rows], cell.shape).ravel())
    triangle = np.where(maps >= 0, maps & (2**32 - 1), -1).reshape(len(fruit), _CELLS, _CELLS)
    # Empty cells get the triangle of a neighbour.
    while np.any(triangle < 0):
        padded = np.pad(triangle, ((0, 0), (1, 1), (1, 1)), constant_values=-1)
        around = [padded[:, 1:-1, :-2], padded[:, 1:-1, 2:], padded[:, :-2, 1:-1], padded[:, 2:, 1:-1]]
        triangle = np.where(triangle < 0, np.maximum.reduce(around), triangle)
    return planes[triangle].reshape(len(fruit), -1, 4)


def _triangle_planes(a: SingleArray, b: SingleArray, c: SingleArray) -> SingleArray:
    """`(f, 4)` outward normals and distances from the origin of the planes through corners `(f, 3)`."""
    ab, ac = (b - a).T, (c - a).T
    middle = (a + b + c) / 3.0
    normal = np.empty_like(a)  # single precision, which `cross` does not keep
    for axis in range(3):
        y, z = axis - 2, axis - 1
        normal[:, axis] = ab[y] * ac[z] - ab[z] * ac[y]
    length, distance = np.sqrt(squared_lengths(normal)), np.sqrt(squared_lengths(middle))
    height = np.einsum("fi,fi->f", normal, middle)
    # A triangle seen edge-on or from behind counts as one across the line of sight.
    steep = np.flatnonzero(height <= 0.05 * length * distance)
    normal[steep], height[steep], length[steep] = middle[steep], distance[steep] ** 2, distance[steep]
    planes = np.concatenate([normal, height[:, None]], axis=1) / np.maximum(length, 1e-12)[:, None]
    return planes.astype(np.float32)


def _cell(x: SingleArray, y: SingleArray, z: SingleArray) -> IndexArray:
    """`(p,)` cell of the direction of each point."""
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


@cache
def _barycentric_grid(pieces: int) -> SingleArray:
    """`(w, 3)` barycentric coordinates of the points that divide a triangle's edges into so many pieces."""
    i, j = np.mgrid[0 : pieces + 1, 0 : pieces + 1]
    kept = i + j <= pieces
    i, j = i[kept], j[kept]
    return (np.stack([i, j, pieces - i - j], axis=1) / pieces).astype(np.float32)

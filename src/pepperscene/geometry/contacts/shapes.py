"""Penetration depth of points: in fruit, as star-shaped surfaces; in stems and twine, as capsules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final

import numpy as np

from pepperscene.geometry.contacts.organs import Organs
from pepperscene.geometry.contacts.patches import Patches, squared_lengths
from pepperscene.geometry.mesh import FloatArray, IndexArray, SingleArray, expand_counts

_CELLS: Final = 64  # along either side of the map of directions: cells of 3 degrees, 2 mm on a fruit
_STEP: Final = 0.06  # rad, maximum distance of the points at which a triangle is entered into the map
_PRODUCTS: Final = 1 << 17
"""Chosen: size of a matrix product. OpenBLAS splits larger ones, from 2^18 on, over threads, which costs more
than it gains on busy cores."""
_PIECE: Final = 0.01  # m, chosen: stems bend so little that straight pieces of about this length are close


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
            offset: `(h, 3)` metres: matrix @ point + offset is relative to the fruit's centre.
            limit: `(h,)` metres from that centre; points farther away are ignored.
            hit: `(m,)` index of each patch's organ among these.
            patches: all patches.
            patch: `(m,)` of these.
            stride: use every `stride`-th point.

        Returns:
            `(m,)` metres, negative outside; minus infinity where all points are ignored.
        """
        from pepperscene.geometry.contacts.depth_kernel import FruitPlaces, depths_in_fruit

        # Compute the planes of those fruit that have none yet.
        rows = row[hit]
        missing = np.unique(rows[~self._has_planes[rows]])
        if len(missing):
            centre = self._centre[missing]
            self._planes[missing] = _plane_maps(self._organs, self._fruit[missing].tolist(), centre)
            self._has_planes[missing] = True
        points = patches.coordinates
        places = FruitPlaces(row, matrix, offset, limit)
        return depths_in_fruit(self._planes, _CELLS, places, hit, points, patch, stride)


def _plane_maps(organs: Organs, fruit: Sequence[int], centre: SingleArray) -> SingleArray:
    """`(f, cells, 4)` planes of some fruit around their centres `(f, 3)`, at the original pose."""
    from pepperscene.geometry.contacts.depth_kernel import direction_cells

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
            cell = direction_cells(points.reshape(3, -1), _CELLS).reshape(-1, len(rows))
            cell += _CELLS * _CELLS * number[rows]
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


@cache
def _barycentric_grid(pieces: int) -> SingleArray:
    """`(w, 3)` barycentric coordinates of the points that divide a triangle's edges into so many pieces."""
    i, j = np.mgrid[0 : pieces + 1, 0 : pieces + 1]
    kept = i + j <= pieces
    i, j = i[kept], j[kept]
    return (np.stack([i, j, pieces - i - j], axis=1) / pieces).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Capsules:
    """Cylinders with hemispherical ends."""

    start: FloatArray  # `(c, 3)` metres
    span: FloatArray  # `(c, 3)` metres, from start to end
    radius: FloatArray  # `(c,)` metres

    @cached_property
    def low(self) -> FloatArray:
        """`(c, 3)` metres, lower corners of the bounding boxes."""
        return np.asarray(np.minimum(self.start, self.start + self.span) - self.radius[:, None])

    @cached_property
    def high(self) -> FloatArray:
        """`(c, 3)` metres, upper corners of the bounding boxes."""
        return np.asarray(np.maximum(self.start, self.start + self.span) + self.radius[:, None])

    def select(self, indices: IndexArray) -> Capsules:
        """Some of the capsules."""
        return Capsules(self.start[indices], self.span[indices], self.radius[indices])

    def depths(self, capsule: IndexArray, points: SingleArray, patch: IndexArray, stride: int) -> SingleArray:
        """`(m,)` metres: depth in capsules `(m,)` of the deepest point of patches `(m,)` of `(3, p, s)`."""
        from pepperscene.geometry.contacts.depth_kernel import depths_in_capsules

        start, span = self.start.astype(np.float32), self.span.astype(np.float32)
        x, y, z = span.T
        square = np.maximum(x * x + y * y + z * z, np.float32(1e-12))
        radius = self.radius.astype(np.float32)
        return depths_in_capsules(start, span, square, radius, capsule, points, patch, stride)


class StemCapsules:
    """The capsules of stems and twine, which never move, computed on first use."""

    def __init__(self, organs: Organs) -> None:
        self._organs = organs
        self._first = np.zeros(len(organs), dtype=np.intp)
        self._count = np.full(len(organs), -1)
        self._capsules = Capsules(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))

    def of_tubes(self, tubes: IndexArray) -> tuple[Capsules, IndexArray, IndexArray]:
        """All capsules so far, `(m,)` indices of those of some tubes, and `(m,)` positions of their tube."""
        missing = np.unique(tubes[self._count[tubes] < 0])
        if len(missing):
            old = self._capsules
            new, count = _tube_capsules(self._organs, missing.tolist())
            self._first[missing] = len(old.radius) + np.cumsum(count) - count
            self._count[missing] = count
            self._capsules = Capsules(
                np.concatenate([old.start, new.start]),
                np.concatenate([old.span, new.span]),
                np.concatenate([old.radius, new.radius]),
            )
        position, number = expand_counts(self._count[tubes])
        return self._capsules, self._first[tubes][position] + number, position


def _tube_capsules(organs: Organs, tubes: Sequence[int]) -> tuple[Capsules, IndexArray]:
    """Capsules of tubes, each as thick as the wider of the rings at its ends, and `(t,)` their numbers."""
    vertices = [
        organs.original_vertices(tube) @ organs.rotation[tube].T + organs.shift[tube] for tube in tubes
    ]
    owner = np.repeat(np.arange(len(tubes)), [len(group) for group in vertices])
    points = np.concatenate(vertices)
    # The vertices of a ring follow one another and have the same v; along twine v repeats.
    v = np.round(np.concatenate([organs.vertex_v(tube) for tube in tubes]).astype(np.float64) * 1e5)
    starts_ring = (np.diff(v, prepend=-1.0) != 0.0) | (np.diff(owner, prepend=-1) != 0)
    ring = np.cumsum(starts_ring) - 1
    tube_of = owner[starts_ring]
    number = np.bincount(ring)
    centre = np.stack([np.bincount(ring, column) for column in points.T], axis=1) / number[:, None]
    radius = np.zeros(len(tube_of))
    np.maximum.at(radius, ring, np.sqrt(np.square(points - centre[ring]).sum(axis=1)))
    # A piece starts at the first ring of each centimetre, and ends where the next starts or at the last ring.
    first = np.searchsorted(tube_of, np.arange(len(tubes)))
    last = np.append(first[1:], len(tube_of)) - 1
    steps = np.sqrt(np.square(np.diff(centre, axis=0, prepend=centre[:1])).sum(axis=1))
    steps[first] = 0.0
    along = np.cumsum(steps)
    along -= along[first][tube_of]
    starts = np.diff(np.floor(along / _PIECE), prepend=-1.0) > 0.0
    starts[first] = True
    starts[last] = False
    starts[first[first == last]] = True
    start = np.flatnonzero(starts)
    end = np.minimum(np.append(start[1:], len(tube_of)), last[tube_of[start]])
    widest = np.maximum(np.maximum.reduceat(radius, start), radius[end])
    capsules = Capsules(centre[start], centre[end] - centre[start], widest)
    return capsules, np.bincount(tube_of[start], minlength=len(tubes))

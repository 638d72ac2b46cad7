"""The organs of a mesh as rigid bodies: poses, boxes, sample points and parents."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry.contacts.patches import PATCH_SIZE, Patches, build_patches, fill_triangles
from pepperscene.geometry.mesh import FloatArray, IndexArray, Mesh, SingleArray, expand_counts

# Plain integers: members of an enumeration are slow to look up. An organ without a class is a flower.
FLOWER, LEAF, FRUIT, STALK, STEM, SHOOT, WIRE = (
    int(item)
    for item in (
        OrganClass.BACKGROUND, OrganClass.LEAF, OrganClass.PEPPER, OrganClass.PEDUNCLE, OrganClass.STEM,
        OrganClass.SHOOT, OrganClass.WIRE,
    )
)  # fmt: skip

_Corners = FloatArray | SingleArray
_BLOCK: Final = 64  # boxes compared at a time, chosen


def boxes_overlap(
    low: _Corners, high: _Corners, other_low: _Corners, other_high: _Corners
) -> NDArray[np.bool_]:
    """Whether boxes with corners `(..., 3)` overlap; comparing axis by axis is faster than `np.all`."""
    result = np.ones(np.broadcast_shapes(low.shape, other_low.shape)[:-1], dtype=bool)
    for axis in range(3):
        result &= low[..., axis] < other_high[..., axis]
        result &= high[..., axis] > other_low[..., axis]
    return result


def overlapping_boxes(
    low: FloatArray, high: FloatArray, other_low: FloatArray, other_high: FloatArray
) -> tuple[IndexArray, IndexArray]:
    """Rows of two tables of boxes, `(n, 3)` and `(m, 3)` corners, that overlap; ascending."""
    if not len(low) or not len(other_low):
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    # Sweep along the longest axis: compare a block of neighbours with the others in the same range only.
    # The second longest axis comes first, as it leaves few pairs.
    axes = np.argsort(other_low.min(axis=0) - other_high.max(axis=0))
    a, b, c = (tuple(np.ascontiguousarray(side[:, axis]) for side in (low, high)) for axis in axes)
    d, e, f = (
        tuple(np.ascontiguousarray(side[:, axis]) for side in (other_low, other_high)) for axis in axes
    )
    order = np.argsort(a[0], kind="stable")
    found = []
    for start in range(0, len(order), _BLOCK):
        block = order[start : start + _BLOCK]
        near = np.flatnonzero((d[0] < a[1][block].max()) & (d[1] > a[0][block].min()))
        overlap = b[0][block][:, None] < e[1][near]
        overlap &= b[1][block][:, None] > e[0][near]
        row, column = np.divmod(np.flatnonzero(overlap), max(len(near), 1))
        row, column = block[row], near[column]
        for own, others in ((a, d), (c, f)):
            kept = np.flatnonzero(
                (own[0].take(row) < others[1].take(column)) & (own[1].take(row) > others[0].take(column))
            )
            row, column = row.take(kept), column.take(kept)
        found.append(row * len(other_low) + column)
    row, column = np.divmod(np.sort(np.concatenate(found)), len(other_low))
    return row, column


def bounds_of_runs(points: SingleArray, position: IndexArray) -> tuple[SingleArray, SingleArray]:
    """`(m, 3)` corners of the boxes around runs of points `(3, p)` with equal positions `(p,)`."""
    starts = np.flatnonzero(np.diff(position, prepend=-1))
    low = np.stack([np.minimum.reduceat(axis, starts) for axis in points], axis=1)
    return low, np.stack([np.maximum.reduceat(axis, starts) for axis in points], axis=1)


class Organs:
    """The instances of a mesh, each a rigid body with a current pose.

    Args:
        mesh: one or more plants; the index of a parent need not be below those of its children.

    Attributes:
        parent: `(n,)` index of the parent, -1 for none.
        organ_class: `(n,)`.
        plant: `(n,)`.
        solid: `(n,)` whether it can touch others: it has triangles, and a class or a parent, unlike scenery.
        low, high: `(n, 3)` metres, corners of the current bounding box of each organ.
        moves: number of moves so far.
        moved_at: `(n,)` value of `moves` after the last move of each organ, 0 if it never moved.
        rotation, shift: `(n, 3, 3)` and `(n, 3)` pose: current point = rotation @ original point + shift.
        all_patches: the patches of all organs sampled so far, at their current poses.
        patch_first, patch_count: `(n,)` first patch of each organ and their number, -1 if not sampled.

    Raises:
        ValueError: two instances share vertices, so that one cannot move without the other.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.parent = np.array([item.parent for item in mesh.instances], dtype=np.intp)
        self.organ_class = np.array([int(item.organ_class) for item in mesh.instances], dtype=np.intp)
        self.plant = np.array([item.plant for item in mesh.instances], dtype=np.intp)
        self._vertices = mesh.vertex_runs
        scenery = (self.organ_class == FLOWER) & (self.parent < 0)
        self.solid = (self._vertices.count > 0) & ~scenery
        self.low, self.high = np.zeros((2, len(self.parent), 3))
        used = np.flatnonzero(self._vertices.count)
        rows, position = self._vertices.rows_of(used)
        self.low[used], self.high[used] = bounds_of_runs(mesh.vertices[rows].T, position)
        self._original_low = self.low.astype(np.float32)
        self._original_extent = (self.high - self.low).max(axis=1).astype(np.float32)
        self.moved_at = np.zeros(len(self.parent), dtype=np.intp)
        self.moves = 0
        self.rotation = np.tile(np.eye(3), (len(self.parent), 1, 1))
        self.shift = np.zeros((len(self.parent), 3))
        self.all_patches, self._used = Patches.empty(0), 0
        self.patch_first = np.zeros(len(self.parent), dtype=np.intp)
        self.patch_count = np.full(len(self.parent), -1)
        self._feet = np.full((len(self.parent), 3), np.nan)  # at the original pose, on first use

    def __len__(self) -> int:
        return len(self.parent)

    def of_class(self, *classes: int) -> IndexArray:
        """Indices of the solid organs of some classes."""
        return np.flatnonzero(np.isin(self.organ_class, classes) & self.solid)

    def close_pairs(
        self, organs: IndexArray, others: IndexArray, margin: float
    ) -> tuple[IndexArray, IndexArray]:
        """Positions in `organs` and in `others` of pairs whose boxes are closer than `margin` metres."""
        low, high = self.low[others] - margin, self.high[others] + margin
        return overlapping_boxes(self.low[organs], self.high[organs], low, high)

    def original_vertices(self, organ: int) -> SingleArray:
        """`(v, 3)` vertices of an organ before all moves."""
        return self.mesh.vertices[self._vertices.rows(organ)]

    def vertex_v(self, organ: int) -> SingleArray:
        """`(v,)` surface coordinate v of an organ's vertices: 0 at its base, 1 at its tip."""
        return self.mesh.uv[self._vertices.rows(organ), 1]

    def original_triangles(self, organs: Sequence[int]) -> tuple[SingleArray, IndexArray]:
        """`(f, 3, 3)` triangles of some organs before all moves, and `(f,)` position of their organ."""
        faces = [self.mesh.faces[self.mesh.face_runs.rows(organ)] for organ in organs]
        owner = np.repeat(np.arange(len(faces)), [len(group) for group in faces])
        return self.mesh.vertices[np.concatenate(faces)], owner

    def feet(self, organs: IndexArray) -> FloatArray:
        """`(n, 3)` current starts of organs: the means of their vertices with the smallest v."""
        for organ in organs[np.isnan(self._feet[organs, 0])].tolist():
            v = self.vertex_v(organ)
            base = self.original_vertices(organ)[v <= v.min() + 1e-6]
            self._feet[organ] = base.mean(axis=0, dtype=np.float64)
        return np.einsum("nij,nj->ni", self.rotation[organs], self._feet[organs]) + self.shift[organs]

    def extent(self, organ: int) -> float:
        """Longest side of an organ's bounding box before all moves, metres."""
        return float(self._original_extent[organ])

    def box_centres(self, organs: IndexArray) -> FloatArray:
        """`(n, 3)` centres of the current bounding boxes of organs."""
        return np.asarray(0.5 * (self.low[organs] + self.high[organs]))

    def sample(self, organs: IndexArray) -> None:
        """Place sample points on those organs that have none; a single call for many is faster."""
        missing = np.unique(organs[self.patch_count[organs] < 0])
        if not len(missing):
            return
        numbers = missing.tolist()
        corners, owner = self.original_triangles(numbers)
        points, triangle = fill_triangles(corners)
        vertices = [self.original_vertices(organ) for organ in numbers]
        owner = np.concatenate(
            [np.repeat(np.arange(len(missing)), [len(group) for group in vertices]), owner[triangle]]
        )
        patches, count = build_patches(
            np.concatenate([*vertices, points]),
            owner,
            self._original_low[missing],
            self._original_extent[missing],
        )
        if self._used + len(patches) > len(self.all_patches):
            larger = Patches.empty(2 * (self._used + len(patches)))
            larger.write(0, self.all_patches, self._used)
            self.all_patches = larger
        self.all_patches.write(self._used, patches, len(patches))
        self.patch_first[missing] = self._used + np.cumsum(count) - count
        self.patch_count[missing] = count
        self._used += len(patches)
        moved = missing[self.moved_at[missing] > 0]
        self._move_patches(moved, self.rotation[moved], self.shift[moved])

    def _move_patches(self, organs: IndexArray, rotation: FloatArray, shift: FloatArray) -> None:
        """Move the patches of some organs `(m,)` by transforms `(m, 3, 3)` and `(m, 3)`."""
        if not len(organs):
            return
        position, number = expand_counts(self.patch_count[organs])
        patch = self.patch_first[organs][position] + number
        points, centre = self.all_patches.coordinates, self.all_patches.centre.T
        moved = _transform(points[:, patch], rotation, shift, position)
        points[:, patch] = moved
        centre[:, patch] = _transform(centre[:, patch], rotation, shift, position)
        boxes = bounds_of_runs(moved.reshape(3, -1), np.repeat(position, PATCH_SIZE))
        self.low[organs], self.high[organs] = boxes

    def patches(self, organs: IndexArray) -> tuple[Patches, IndexArray, IndexArray]:
        """Sample points on the surfaces of some organs at their current poses, in patches.

        Returns:
            All patches sampled so far; `(m,)` indices of those of the organs, organ after organ; and `(m,)`
            the position of each one's organ.
        """
        self.sample(organs)
        position, number = expand_counts(self.patch_count[organs])
        return self.all_patches, self.patch_first[organs][position] + number, position

    def subtree(self, root: int) -> list[int]:
        """An organ and all its descendants, in ascending order."""
        result, stack = [], [root]
        while stack:
            organ = stack.pop()
            result.append(organ)
            stack += self._children[organ]
        return sorted(result)

    def ancestors(self, organ: int) -> Iterator[int]:
        """Parent, grandparent and so on."""
        while (organ := self._parents[organ]) >= 0:
            yield organ

    def move(self, organs: IndexArray, rotation: FloatArray, shift: FloatArray) -> None:
        """Move every point p of each of some organs `(m,)` to rotation @ p + shift, `(m, 3, 3)`, `(m, 3)`."""
        self.moves += 1
        self.rotation[organs], self.shift[organs] = self._poses_after(organs, rotation, shift)
        self.moved_at[organs] = self.moves
        # The box of an organ is that of its patches or else of its vertices.
        solid, is_sampled = self.solid[organs], self.patch_count[organs] >= 0
        sampled = np.flatnonzero(solid & is_sampled)
        self._move_patches(organs[sampled], rotation[sampled], shift[sampled])
        others = organs[solid & ~is_sampled]
        if len(others):
            self.low[others], self.high[others] = self._vertex_boxes(
                others, self.rotation[others], self.shift[others]
            )

    def boxes_after(
        self, organs: IndexArray, rotation: FloatArray, shift: FloatArray
    ) -> tuple[SingleArray, SingleArray]:
        """`(m, 3)` corners of the boxes that solid organs will have after a move by transforms."""
        return self._vertex_boxes(organs, *self._poses_after(organs, rotation, shift))

    def _poses_after(
        self, organs: IndexArray, rotation: FloatArray, shift: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Rotation and shift from the original points of organs, after a further move."""
        turned = np.matmul(rotation, self.shift[organs][:, :, None])[:, :, 0]
        return np.matmul(rotation, self.rotation[organs]), turned + shift

    def _vertex_boxes(
        self, organs: IndexArray, rotation: FloatArray, shift: FloatArray
    ) -> tuple[SingleArray, SingleArray]:
        """Corners of the boxes around the vertices of organs at poses."""
        rows, position = self._vertices.rows_of(organs)
        return bounds_of_runs(_transform(self.mesh.vertices[rows].T, rotation, shift, position), position)

    def current_mesh(self) -> Mesh:
        """The mesh with every organ at its current pose; the original object if none has moved."""
        if not self.moves:
            return self.mesh
        vertices, normals = self.mesh.vertices.copy(), self.mesh.normals.copy()
        for organ in np.flatnonzero(self.moved_at).tolist():
            rows = self._vertices.rows(organ)
            vertices[rows] = vertices[rows] @ self.rotation[organ].T + self.shift[organ]
            normals[rows] = normals[rows] @ self.rotation[organ].T
        return replace(self.mesh, vertices=vertices, normals=normals)

    @cached_property
    def _parents(self) -> list[int]:
        return self.parent.tolist()

    @cached_property
    def _children(self) -> list[list[int]]:
        children: list[list[int]] = [[] for _ in self.parent]
        for organ, above in enumerate(self.parent.tolist()):
            if above >= 0:
                children[above].append(organ)
        return children


def _transform(
    points: SingleArray, rotation: FloatArray, shift: FloatArray, position: IndexArray
) -> SingleArray:
    """`(3, p, ...)` points moved by the transform at the position of each."""
    result = np.empty(points.shape, dtype=np.float32)
    shape = (-1, *[1] * (points.ndim - 2))
    matrix, offset = rotation.transpose(1, 2, 0).take(position, axis=2), shift.T.take(position, axis=1)
    for axis in range(3):
        a, b, c = (column.reshape(shape) for column in matrix[axis])
        result[axis] = a * points[0] + b * points[1] + c * points[2] + offset[axis].reshape(shape)
    return result

"""The free space of a scene: distances from points to the nearest surface, and points inside surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.poses.generators import as_points
from pepperscene.geometry import Mesh

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]

_SMALLEST_CLASS_M: Final = 0.008
"""Largest triangle of the first class, from its centroid to a corner. Chosen: three quarters of the triangles
of a row are smaller, and the shell of this thickness around a ball holds few of them."""
_FEW: Final = 2000
"""Chosen: a class of at most this many triangles has no tree; to test all against a point takes 0.3 ms."""
_SINGLE: Final = 1e-6
"""Margin, more than the relative rounding error of a few operations in single precision."""
_INSIDE: Final = 0.5
"""Absolute winding number above which a point is inside; it is a whole number except for rounding."""


@dataclass(frozen=True, eq=False)
class _SizeClass:
    """Triangles of similar size."""

    faces: NDArray[np.intp]  # `(n,)` indices of the triangles
    reach_m: float  # no corner is farther from its triangle's centroid
    tree: cKDTree | None  # of the centroids; None for so few triangles that all are tested

    def candidates(
        self, points: FloatArray, radius_m: FloatArray
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Pairs of a point and a triangle: all that are within `(n,)` radii of `(n, 3)` points, and more."""
        if self.tree is None:
            point = np.repeat(np.arange(len(points)), len(self.faces))
            return point, np.tile(self.faces, len(points))
        found = self.tree.query_ball_point(points, radius_m + self.reach_m, return_sorted=True)
        point = np.repeat(np.arange(len(points)), [len(rows) for rows in found])
        return point, self.faces[np.concatenate([*found, []]).astype(np.intp)]


@dataclass(frozen=True, eq=False)
class ClosedParts:
    """Closed surfaces."""

    triangles: FloatArray  # `(n, 3, 3)`, those of a part together
    begins: NDArray[np.intp]  # `(p + 1,)` first triangle of each part, and their number
    low: FloatArray  # `(p, 3)` lowest coordinates of each part
    high: FloatArray  # `(p, 3)` highest coordinates

    def contain(self, point: FloatArray) -> bool:
        """Whether a point is inside a part."""
        near = np.flatnonzero(((self.low <= point) & (point <= self.high)).all(axis=1))
        return any(
            abs(winding_number(point, self.triangles[self.begins[part] : self.begins[part + 1]])) > _INSIDE
            for part in near
        )


class FreeSpace:
    """The space between the surfaces of a mesh.

    Args:
        mesh: of a scene, with at least one triangle. It must not be culled for cameras elsewhere.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self._closed_parts: dict[int, ClosedParts] = {}
        self._classes = _size_classes(mesh)

    def clearance(self, points: ArrayLike) -> FloatArray:
        """`(n,)` exact distance in metres from `(n, 3)` points to the nearest triangle."""
        return self.nearest(points)[0]

    def nearest(self, points: ArrayLike) -> tuple[FloatArray, NDArray[np.intp]]:
        """`(n,)` distance in metres from `(n, 3)` points to the nearest triangle, and `(n,)` its index."""
        points = as_points(points)
        # A centroid is a point of a surface, so nothing beyond the nearest one matters.
        nearest, nearest_face = np.full(len(points), np.inf), np.zeros(len(points), np.intp)
        for group in self._classes:
            if group.tree is not None:
                nearest = np.minimum(nearest, group.tree.query(points)[0])
        reach, nearest = nearest * (1.0 + _SINGLE), np.full(len(points), np.inf)
        for group in self._classes:
            point, face = group.candidates(points, np.minimum(reach, nearest))
            distance = triangle_distances(points[point], self._triangles(face))
            # The last of several assignments counts, that of the smallest distance.
            order = np.argsort(-distance, kind="stable")
            order = order[distance[order] < nearest[point[order]]]
            nearest[point[order]], nearest_face[point[order]] = distance[order], face[order]
        return nearest, nearest_face

    def is_free(self, points: ArrayLike, clearance_m: float) -> NDArray[np.bool_]:
        """`(n,)` whether no surface is within a distance of `(n, 3)` points; faster than `clearance`."""
        points = as_points(points)
        free = np.ones(len(points), dtype=bool)
        for group in self._classes:
            rows = np.flatnonzero(free)
            if group.tree is not None:
                # No triangle of the class is near a point that is this far from all its centroids.
                far = group.reach_m + clearance_m
                distance = group.tree.query(points[rows], distance_upper_bound=np.nextafter(far, np.inf))[0]
                free[rows] = distance > clearance_m
                rows = rows[(distance > clearance_m) & np.isfinite(distance)]
            # Only between these limits does the answer depend on the triangles themselves.
            point, face = group.candidates(points[rows], np.full(len(rows), clearance_m))
            near = triangle_distances(points[rows[point]], self._triangles(face)) <= clearance_m
            free[rows[point[near]]] = False
        return free

    def inside(self, points: ArrayLike) -> NDArray[np.bool_]:
        """`(n,)` whether `(n, 3)` points are inside a closed surface: a fruit, a stem, a pipe.

        Surfaces with a border, such as blades, have no inside.
        """
        points = as_points(points)
        instances, low, high = self._boxes
        result = np.zeros(len(points), dtype=bool)
        for row, point in enumerate(points):
            near = instances[((low <= point) & (point <= high)).all(axis=1)]
            result[row] = any(self._parts(instance).contain(point) for instance in near.tolist())
        return result

    def is_closed(self, instance: int) -> bool:
        """Whether the surface of an instance has no border."""
        runs = self._mesh.face_runs
        return len(self._parts(instance).triangles) == int(runs.stop[instance] - runs.first[instance])

    def _triangles(self, faces: NDArray[np.intp]) -> FloatArray:
        """`(n, 3, 3)` corners of triangles."""
        return self._mesh.vertices[self._mesh.faces[faces]].astype(np.float64)

    @cached_property
    def _boxes(self) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
        """`(i,)` instances that have triangles, and `(i, 3)` lowest and highest coordinates of each."""
        mesh, runs = self._mesh, self._mesh.face_runs
        instances = np.flatnonzero(runs.stop > runs.first)
        instances = instances[np.argsort(runs.first[instances])]
        faces = mesh.faces if runs.order is None else mesh.faces[runs.order]
        low, high = np.empty((2, len(instances), 3))
        for axis in range(3):
            corners = mesh.vertices[:, axis][faces].ravel()
            low[:, axis] = np.minimum.reduceat(corners, 3 * runs.first[instances])
            high[:, axis] = np.maximum.reduceat(corners, 3 * runs.first[instances])
        return instances, low, high

    def _parts(self, instance: int) -> ClosedParts:
        """The closed parts of an instance; found when a point is first inside its box."""
        if instance not in self._closed_parts:
            triangles = self._mesh.vertices[self._mesh.faces[self._mesh.face_runs.rows(instance)]]
            self._closed_parts[instance] = closed_parts(triangles)
        return self._closed_parts[instance]


def _size_classes(mesh: Mesh) -> list[_SizeClass]:
    """Sort triangles into classes, each twice as large as the one before."""
    from scipy.spatial import cKDTree

    # Centroids in double precision are points of the surface, as far as distances are computed.
    centres, squared = np.zeros((len(mesh.faces), 3)), np.zeros((3, len(mesh.faces)), np.float32)
    # One axis at a time: NumPy reduces short axes slowly.
    for axis in range(3):
        corners = [mesh.vertices[:, axis][mesh.faces[:, corner]] for corner in range(3)]
        centre = centres[:, axis]
        for values in corners:
            centre += values
        centre /= 3.0
        for corner, values in enumerate(corners):
            squared[corner] += (values - centre) ** 2
    reach = np.sqrt(squared.max(axis=0)) * np.float32(1.0 + _SINGLE)
    number = np.maximum(np.ceil(np.log2(np.maximum(reach, 1e-30) / _SMALLEST_CLASS_M)), 0.0).astype(np.int8)
    classes = []
    few: list[NDArray[np.intp]] = []
    for value in np.unique(number):
        faces = np.flatnonzero(number == value)
        if len(faces) <= _FEW:
            few.append(faces)
            continue
        # A balanced tree would take three times as long to build, and half as long to search.
        tree = cKDTree(centres[faces], leafsize=32, compact_nodes=False, balanced_tree=False)
        classes.append(_SizeClass(faces, float(reach[faces].max()), tree))
    classes.sort(key=lambda group: -len(group.faces))
    if few:
        classes.append(_SizeClass(np.concatenate(few), 0.0, None))
    return classes


def triangle_distances(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """`(n,)` distance from `(n, 3)` points to `(n, 3, 3)` triangles, one each."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    to_point = points[:, None] - triangles
    # Nearest point on each side.
    squared = np.einsum("nij,nij->ni", edges, edges)
    along = np.einsum("nij,nij->ni", to_point, edges) / np.where(squared > 0.0, squared, 1.0)
    beside = to_point - np.clip(along, 0.0, 1.0)[..., None] * edges
    distance = np.sqrt(np.einsum("nij,nij->ni", beside, beside).min(axis=1, initial=np.inf))
    # The plane counts where the point is above the triangle; a triangle without area has none.
    normal = np.cross(edges[:, 0], edges[:, 1])
    area = np.linalg.norm(normal, axis=1)
    inward = np.cross(normal[:, None], edges)
    above = (np.einsum("nij,nij->ni", inward, to_point) >= 0.0).all(axis=1) & (area > 0.0)
    height = np.abs(np.einsum("ni,ni->n", normal, to_point[:, 0])) / np.where(area > 0.0, area, 1.0)
    return np.where(above, height, distance)


def closed_parts(triangles: NDArray[np.floating[Any]]) -> ClosedParts:
    """The connected parts without a border of `(n, 3, 3)` triangles.

    Triangles are connected where they have corners at the same position.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Number the positions.
    corners = triangles.reshape(-1, 3)
    order = np.lexsort(corners.T)
    is_new = np.append(True, (np.diff(corners[order], axis=0) != 0.0).any(axis=1))
    position = np.empty(len(corners), dtype=np.int64)
    position[order] = np.cumsum(is_new) - 1
    count, faces = int(is_new.sum()), position.reshape(-1, 3)

    # A side without a neighbour that runs the other way is a border.
    start, end = position, np.roll(faces, -1, axis=1).ravel()
    side, row = np.unique(np.minimum(start, end) * count + np.maximum(start, end), return_inverse=True)
    balance = np.bincount(row, np.sign(end - start), len(side))
    parts, part = connected_components(coo_array((np.ones(len(start)), (start, end)), (count, count)))
    is_closed = np.ones(parts, dtype=bool)
    is_closed[part[start[balance[row] != 0.0]]] = False

    # Their triangles, those of a part together.
    face_part = part[faces[:, 0]]
    order = np.argsort(face_part, kind="stable")
    order = order[is_closed[face_part[order]]]
    begins = np.flatnonzero(np.diff(face_part[order], prepend=-1))
    chosen = triangles[order].astype(float)
    if not len(chosen):
        return ClosedParts(chosen, begins, np.empty((0, 3)), np.empty((0, 3)))
    low, high = (
        np.minimum.reduceat(chosen.min(axis=1), begins),
        np.maximum.reduceat(chosen.max(axis=1), begins),
    )
    return ClosedParts(chosen, np.append(begins, len(chosen)), low, high)


def winding_number(point: FloatArray, triangles: FloatArray) -> float:
    """How often `(n, 3, 3)` triangles of a closed surface surround a point: 0 outside, 1 or -1 inside.

    Their solid angles over that of the sphere (A. Van Oosterom and J. Strackee, "The solid angle of a plane
    triangle", IEEE Trans. Biomed. Eng. 30 (1983) 125).
    """
    a, b, c = (triangles - point).transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("ni,ni->n", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ni,ni->n", *pair) for pair in ((a, b), (b, c), (c, a)))
    angles = np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(angles.sum() / (2.0 * np.pi))

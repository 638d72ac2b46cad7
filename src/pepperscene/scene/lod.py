"""Simplified organs for indirect light: far fewer triangles, with nearly the same position, area and surface.

Organs with the same triangulation are simplified together, by clustering vertices in the surface's own
coordinates (after Rossignac & Borrel 1993). The remaining vertices are the organ's own, so a simplified organ
stays inside the organ's convex hull, and thin organs stay whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh

Index = NDArray[np.intp]

_STEPS: Final = {
    OrganClass.LEAF: (4, 6),
    OrganClass.PEPPER: (6, 5),
    OrganClass.STEM: (4, 1),
    OrganClass.SHOOT: (4, 3),
    OrganClass.PEDUNCLE: (4, 3),
    OrganClass.CUT: (4, 2),
}
"""Grid steps of u and v that are left, by class. Chosen: areas change by a few per cent."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """New triangles on vertices of a mesh."""

    vertices: Index  # `(k,)` indices of the mesh's vertices
    faces: NDArray[np.integer]  # `(m, 3)` indices into `vertices`
    source: Index  # `(m,)` index of the mesh's face that each triangle takes its instance and others from

    def taken_from(self, mesh: Mesh) -> Mesh:
        """The mesh of these triangles; instances, surfaces and appearances keep their numbers."""
        return replace(
            mesh,
            vertices=mesh.vertices.take(self.vertices, axis=0),
            normals=mesh.normals.take(self.vertices, axis=0),
            uv=mesh.uv.take(self.vertices, axis=0),
            state=mesh.state[self.vertices],
            faces=self.faces.astype(np.uint32, copy=False),
            face_instance=mesh.face_instance[self.source],
            face_surface=mesh.face_surface[self.source],
            face_appearance=mesh.face_appearance[self.source],
            colour=mesh.colours_of(self.vertices),
        )


def join_triangles(parts: Sequence[Triangles]) -> Triangles:
    """Several sets of triangles on the same mesh as one."""
    starts = accumulate((len(part.vertices) for part in parts), initial=0)
    return Triangles(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.source for part in parts]),
    )


def cluster_vertices(
    uv: NDArray[np.float32],
    faces: NDArray[np.integer],
    steps: ArrayLike,
    closed: ArrayLike,
    owner: ArrayLike = 0,
) -> Triangles:
    """Merge the vertices around each node of a coarse grid in uv into the one that is nearest to the node.

    Args:
        uv: `(v, 2)` surface coordinates in [0, 1].
        faces: `(f, 3)` vertex indices.
        steps: `(2,)` or `(v, 2)` grid steps in u and v, at most 15; organs with 0 steps are removed.
        closed: `()` or `(v,)`, whether u is periodic, so that its last grid column is its first.
        owner: `()` or `(v,)` organ of each vertex; vertices of different organs are not merged.
    """
    steps = np.asarray(steps)
    position = uv * steps.astype(float)
    node = np.rint(position).astype(np.intp)
    column = np.where(closed, node[:, 0] % np.maximum(steps[..., 0], 1), node[:, 0])
    _, cluster = np.unique((np.asarray(owner) * 16 + column) * 16 + node[:, 1], return_inverse=True)

    # Of each cluster, keep the vertex nearest to its node.
    squared_distance = ((position - node) ** 2).sum(axis=1)
    order = np.lexsort((squared_distance, cluster))
    nearest = order[np.searchsorted(cluster[order], np.arange(cluster.max() + 1))]

    # Drop triangles that have collapsed to a line, and all but the first of those with the same corners.
    merged = cluster[faces]
    has_area = (
        (merged[:, 0] != merged[:, 1]) & (merged[:, 1] != merged[:, 2]) & (merged[:, 2] != merged[:, 0])
    )
    _, first = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
    source = np.sort(first[has_area[first]])
    used, renumbered = np.unique(merged[source], return_inverse=True)
    return Triangles(nearest[used], renumbered.reshape(-1, 3), source)


def simplify_organs(
    mesh: Mesh, face_ranges: Index, vertex_ranges: Index
) -> tuple[list[Triangles], NDArray[np.bool_]]:
    """The triangles of simplified organs, and `(n,)` which organs were simplified.

    `face_ranges` and `vertex_ranges`, `(n, 2)`, are the half-open ranges of each organ.
    """
    simplified = np.zeros(len(face_ranges), dtype=bool)
    parts = []
    for steps, closed, members in _same_size_organs(mesh, face_ranges, vertex_ranges):
        # Simplify the first organ; the result holds for all whose triangulation is the same.
        first, start = face_ranges[members, 0], vertex_ranges[members, 0]
        base = mesh.faces[slice(*face_ranges[members[0]])].astype(np.intp) - start[0]
        model = cluster_vertices(mesh.uv[slice(*vertex_ranges[members[0]])], base, steps, closed)
        if not 0 < len(model.source) < len(base):
            continue
        faces = mesh.faces[first[:, None] + model.source].astype(np.intp) - start[:, None, None]
        same = (faces == base[model.source]).all(axis=(1, 2))
        simplified[members[same]] = True
        copies = len(model.vertices) * np.arange(np.count_nonzero(same))
        parts.append(
            Triangles(
                (start[same, None] + model.vertices).ravel(),
                (copies[:, None, None] + model.faces).reshape(-1, 3),
                (first[same, None] + model.source).ravel(),
            )
        )
    return parts, simplified


def _same_size_organs(
    mesh: Mesh, face_ranges: Index, vertex_ranges: Index
) -> Iterator[tuple[tuple[int, int], bool, Index]]:
    """Grid steps, whether u is periodic, and the numbers of the organs, for each kind and size of organ."""
    members: dict[tuple[OrganClass, str, int, int], list[int]] = {}
    instances = [mesh.instances[owner] for owner in mesh.face_instance[face_ranges[:, 0]].tolist()]
    sizes = zip(np.ptp(face_ranges, axis=1).tolist(), np.ptp(vertex_ranges, axis=1).tolist(), strict=True)
    for number, (instance, size) in enumerate(zip(instances, sizes, strict=True)):
        key = (OrganClass(instance.organ_class), instance.kind, *size)
        members.setdefault(key, []).append(number)
    for (organ_class, *_), numbers in members.items():
        if organ_class in _STEPS:
            yield _STEPS[organ_class], organ_class != OrganClass.LEAF, np.array(numbers)

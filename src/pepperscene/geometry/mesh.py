"""Triangles with what the renderer and the ground truth need to know of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import Instance


@dataclass(frozen=True, eq=False)
class Mesh:
    """An indexed triangle mesh in metres, z up.

    Attributes:
        vertices: `(v, 3)` float32, metres.
        normals: `(v, 3)` float32, unit shading normals, out of solids and out of a leaf's upper side.
        uv: `(v, 2)` float32, surface coordinates in [0, 1].
        state: `(v,)` float32, the pigment state in [0, 1] (see `materials.Surface`).
        faces: `(f, 3)` uint32, counter-clockwise seen from the side that the normals point to.
        face_instance: `(f,)` uint32, index into `instances`; the class of a face is its instance's.
        face_surface: `(f,)` uint8, index into `surfaces`.
        surfaces: names of the surfaces used.
        instances: the organs that the mesh is made of.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    uv: NDArray[np.float32]
    state: NDArray[np.float32]
    faces: NDArray[np.uint32]
    face_instance: NDArray[np.uint32]
    face_surface: NDArray[np.uint8]
    surfaces: tuple[str, ...]
    instances: tuple[Instance, ...]

    @property
    def face_class(self) -> NDArray[np.uint8]:
        """`(f,)` the `OrganClass` of each face."""
        return np.array([item.organ_class for item in self.instances], dtype=np.uint8)[self.face_instance]

    @cached_property
    def bounds(self) -> NDArray[np.float32]:
        """`(2, 3)` least and greatest coordinates of all vertices, metres; NaN where a vertex is.

        Raises:
            ValueError: there are no vertices.
        """
        # Axis by axis: along the longer one NumPy is 25 times as fast.
        return np.array([[axis.min() for axis in self.vertices.T], [axis.max() for axis in self.vertices.T]])

    @cached_property
    def vertex_instance(self) -> NDArray[np.uint32]:
        """`(v,)` index into `instances` of the organ that each vertex belongs to.

        Raises:
            ValueError: instances share a vertex, or a vertex belongs to none.
        """
        owner = np.full(len(self.vertices), len(self.instances), dtype=np.uint32)
        owner[self.faces] = self.face_instance[:, None]
        shared = any(np.any(owner[self.faces[:, corner]] != self.face_instance) for corner in range(3))
        if shared or np.any(owner == len(self.instances)):
            raise ValueError("each vertex must belong to one instance")
        return owner

    @cached_property
    def instance_vertices(self) -> NDArray[np.intp]:
        """`(i, 2)` first vertex of each instance and the one after its last; both 0 where it has none.

        Raises:
            ValueError: the vertices of an instance do not lie together.
        """
        owner = self.vertex_instance
        starts = np.concatenate([[0], 1 + np.flatnonzero(owner[1:] != owner[:-1])])
        runs = owner[starts]
        if len(np.unique(runs)) < len(runs):
            raise ValueError("the vertices of each instance must lie together")
        found = np.zeros((len(self.instances), 2), dtype=np.intp)
        found[runs, 0], found[runs, 1] = starts, np.append(starts[1:], len(owner))
        return found

    def moved(self, rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> Mesh:
        """The mesh rotated by a `(3, 3)` matrix, then translated by `(3,)` metres.

        Raises:
            ValueError: the matrix mirrors or stretches, so that faces would show their backs or normals tilt.
        """
        turn = np.asarray(rotation, dtype=float)
        if not (np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0.0):
            raise ValueError("rotation must be a rotation: orthogonal, with a determinant of 1")
        vertices = _turned(self.vertices, turn, np.asarray(translation, dtype=float))
        return replace(self, vertices=vertices, normals=_turned(self.normals, turn, np.zeros(3)))

    def select_instances(self, chosen: Sequence[int]) -> Mesh:
        """The part of the mesh that belongs to some instances, numbered anew in the order given.

        Args:
            chosen: indices into `instances`; a parent that is not among them is forgotten.

        Raises:
            ValueError: none is chosen, one twice, or one that is not there.
        """
        wanted = [int(index) for index in chosen]
        if (
            not wanted
            or len(set(wanted)) < len(wanted)
            or not 0 <= min(wanted) <= max(wanted) < len(self.instances)
        ):
            raise ValueError(f"{wanted} are not instances among {len(self.instances)}, each once")
        place = np.full(len(self.instances), -1)
        place[wanted] = np.arange(len(wanted))
        kept = place[self.face_instance] >= 0
        old_faces = self.faces[kept]
        used = np.zeros(len(self.vertices), dtype=bool)
        used[old_faces] = True
        faces = (np.cumsum(used) - 1)[old_faces]
        surfaces, face_surface = np.unique(self.face_surface[kept], return_inverse=True)
        instances = [self.instances[index] for index in wanted]
        return Mesh(
            vertices=self.vertices[used],
            normals=self.normals[used],
            uv=self.uv[used],
            state=self.state[used],
            faces=faces.astype(np.uint32),
            face_instance=place[self.face_instance[kept]].astype(np.uint32),
            face_surface=face_surface.astype(np.uint8),
            surfaces=tuple(self.surfaces[index] for index in surfaces),
            instances=tuple(
                replace(one, parent=int(place[one.parent]) if one.parent >= 0 else -1) for one in instances
            ),
        )

    def select_plant(self, plant: int) -> Mesh:
        """The same mesh with its instances assigned to plant number `plant` of a scene."""
        return replace(
            self,
            instances=tuple(
                Instance(one.organ_class, one.kind, plant, one.phytomer, one.parent) for one in self.instances
            ),
        )


def _turned(
    points: NDArray[np.float32], turn: NDArray[np.float64], shift: NDArray[np.float64]
) -> NDArray[np.float32]:
    """`(n, 3)` points after a turn and a shift.

    Coordinate by coordinate: the matrix library shares such tall products out to threads, which wait for each
    other far longer than they compute where the cores have other work, and its last bits depend on them.
    """
    x, y, z = np.ascontiguousarray(points.T).astype(np.float64)
    found = np.empty((len(points), 3), dtype=np.float32)
    for axis, (one, other, third) in enumerate(turn):
        found[:, axis] = one * x + other * y + third * z + shift[axis]
    return found


def concatenate_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh out of several; instances are numbered on, surfaces of equal name become one.

    Raises:
        ValueError: no meshes are given.
    """
    if not meshes:
        raise ValueError("at least one mesh is needed")
    names = tuple(dict.fromkeys(name for mesh in meshes for name in mesh.surfaces))
    faces, face_instances, face_surfaces = [], [], []
    instances: list[Instance] = []
    vertex_offset = 0
    for mesh in meshes:
        renumber = np.array([names.index(name) for name in mesh.surfaces], dtype=np.uint8)
        first = len(instances)
        faces.append(mesh.faces + np.uint32(vertex_offset))
        face_instances.append(mesh.face_instance + np.uint32(first))
        face_surfaces.append(renumber[mesh.face_surface])
        instances += [
            Instance(one.organ_class, one.kind, one.plant, one.phytomer, one.parent + first)
            if first and one.parent >= 0
            else one
            for one in mesh.instances
        ]
        vertex_offset += len(mesh.vertices)
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        uv=np.concatenate([mesh.uv for mesh in meshes]),
        state=np.concatenate([mesh.state for mesh in meshes]),
        faces=np.concatenate(faces),
        face_instance=np.concatenate(face_instances),
        face_surface=np.concatenate(face_surfaces),
        surfaces=names,
        instances=tuple(instances),
    )


Indices = NDArray[np.intp]


def face_runs(mesh: Mesh) -> tuple[NDArray[np.uint32], Indices, Indices]:
    """The faces with those of one instance together, and `(n,)` where each instance's start and stop."""
    count, instance, faces = len(mesh.instances), mesh.face_instance, mesh.faces
    first, stop = np.zeros(count, dtype=np.intp), np.zeros(count, dtype=np.intp)
    start = np.flatnonzero(np.append(True, instance[1:] != instance[:-1])) if len(instance) else first[:0]
    if len(np.unique(instance[start])) < len(start):
        # Whole numbers of two bytes are sorted by their digits, much faster.
        small = instance.astype(np.uint16) if count < 2**16 else instance
        order = np.argsort(small, kind="stable")
        faces, instance = faces[order], instance[order]
        start = np.flatnonzero(np.append(True, instance[1:] != instance[:-1]))
    first[instance[start]], stop[instance[start]] = start, np.append(start[1:], len(instance))
    return faces, first, stop


def vertex_runs(
    mesh: Mesh, faces: NDArray[np.uint32], face_first: Indices, face_stop: Indices
) -> tuple[Indices | None, Indices, Indices]:
    """Where the vertices of each instance start and stop, in the mesh's order or else in the one returned."""
    count = len(mesh.instances)
    first, stop = np.zeros(count, dtype=np.intp), np.zeros(count, dtype=np.intp)
    used = np.flatnonzero(face_stop > face_first)
    if not len(used):
        return None, first, stop
    # As they lie one after the other, each run ends where the next starts.
    used = used[np.argsort(face_first[used])]
    first[used] = np.minimum.reduceat(faces.ravel(), 3 * face_first[used])
    stop[used] = np.maximum.reduceat(faces.ravel(), 3 * face_first[used]).astype(np.intp) + 1
    along = used[np.argsort(first[used])]
    if np.all(stop[along][:-1] <= first[along][1:]):
        return None, first, stop
    # Organs whose vertices are mixed are sorted out.
    owner = np.full(len(mesh.vertices), count, dtype=np.intp)
    owner[mesh.faces] = mesh.face_instance[:, None]
    if not np.array_equal(owner[mesh.faces], np.repeat(mesh.face_instance, 3).reshape(-1, 3)):
        raise ValueError("instances that share vertices cannot be moved one by one")
    order = np.argsort(owner, kind="stable")
    runs = np.searchsorted(owner[order], np.arange(count + 1))
    return order, runs[:-1], runs[1:]

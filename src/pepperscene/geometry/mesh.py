"""Triangle meshes with an organ and a surface for each face: parts, motion, and joining."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import Appearance, Instance, OrganClass

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IndexArray = NDArray[np.intp]


PIGMENTS: Final = -1.0
"""In place of each component of a vertex colour: the pigments of the surface give the colour."""


@dataclass(frozen=True, eq=False)
class InstanceRuns:
    """The faces or the vertices of a mesh, grouped by instance."""

    order: IndexArray | None  # `(n,)` indices, those of one instance together; None: as in the mesh
    first: IndexArray  # `(i,)` where the run of each instance starts in that order
    stop: IndexArray  # `(i,)` where it stops; equal to `first` if it is empty

    def rows(self, instance: int) -> slice | IndexArray:
        """Indices of the faces or vertices of one instance."""
        run = slice(int(self.first[instance]), int(self.stop[instance]))
        return run if self.order is None else self.order[run]

    @cached_property
    def count(self) -> IndexArray:
        """`(i,)` number of items of each instance."""
        return np.asarray(self.stop - self.first)

    def rows_of(self, instances: IndexArray) -> tuple[IndexArray, IndexArray]:
        """`(m,)` items of some instances, one after another, and the position of the instance of each."""
        position, number = expand_counts(self.count[instances])
        rows = self.first[instances].take(position) + number
        return rows if self.order is None else self.order[rows], position


def expand_counts(counts: IndexArray) -> tuple[IndexArray, IndexArray]:
    """For counts c, the numbers 0 to c - 1 in a row: index of the count that each is for, and the number."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


@dataclass(frozen=True, eq=False)
class Mesh:
    """An indexed triangle mesh in metres, z up.

    Attributes:
        vertices: `(v, 3)` float32, metres.
        normals: `(v, 3)` float32, unit shading normals: out of solids, out of the upper side of a leaf.
        uv: `(v, 2)` float32, surface coordinates in [0, 1].
        state: `(v,)` float32, the pigment state in [0, 1] (see `materials.Surface`).
        faces: `(f, 3)` uint32, counter-clockwise seen from the side that the normals point to.
        face_instance: `(f,)` uint32, index into `instances`, which also give the class of a face.
        face_surface: `(f,)` uint8, index into `surfaces`.
        face_appearance: `(f,)` uint32, index into `appearances`.
        surfaces: names of the surfaces used.
        instances: the organs that the mesh consists of, as labels distinguish them.
        appearances: of organs, as light distinguishes them. Organs that are merged into one instance keep
            theirs, so that light does not depend on labels.
        colour: `(v, 3)` float32, reflectance as linear sRGB in [0, 1] of organs that have it from a scan, and
            `PIGMENTS` for others; None if no organ has it. All vertices of an organ have it, or none.
        cultivars: whose pigments give the colours of its plants; different ones, none if they are unknown.
    """

    vertices: SingleArray
    normals: SingleArray
    uv: SingleArray
    state: SingleArray
    faces: NDArray[np.uint32]
    face_instance: NDArray[np.uint32]
    face_surface: NDArray[np.uint8]
    face_appearance: NDArray[np.uint32]
    surfaces: tuple[str, ...]
    instances: tuple[Instance, ...]
    appearances: tuple[Appearance, ...]
    colour: SingleArray | None = None
    cultivars: tuple[Cultivar, ...] = ()

    @property
    def face_class(self) -> NDArray[np.uint8]:
        """`(f,)` the `OrganClass` of each face, or `IGNORE_CLASS`."""
        return self.instance_class[self.face_instance]

    @cached_property
    def instance_class(self) -> NDArray[np.uint8]:
        """`(i,)` the `OrganClass` of each instance, or `IGNORE_CLASS`."""
        return np.array([item.class_id for item in self.instances], dtype=np.uint8)

    @cached_property
    def bounds(self) -> SingleArray:
        """`(2, 3)` minimum and maximum coordinates of all vertices, metres; NaN where a vertex has NaN.

        Raises:
            ValueError: there are no vertices.
        """
        # One axis at a time: NumPy reduces along the long axis 25 times as fast.
        return np.array([[axis.min() for axis in self.vertices.T], [axis.max() for axis in self.vertices.T]])

    @cached_property
    def vertex_instance(self) -> NDArray[np.uint32]:
        """`(v,)` index into `instances` of the organ that each vertex belongs to.

        Raises:
            ValueError: instances share a vertex, or a vertex belongs to none.
        """
        if np.any(self._vertex_owners == len(self.instances)):
            raise ValueError("every vertex must belong to a face")
        return self._vertex_owners

    @cached_property
    def face_runs(self) -> InstanceRuns:
        """Faces by instance."""
        count, instance = len(self.instances), self.face_instance
        first, stop = np.zeros((2, count), dtype=np.intp)
        order = None
        start = np.flatnonzero(np.append(True, instance[1:] != instance[:-1])) if len(instance) else first[:0]
        if len(np.unique(instance[start])) < len(start):
            # NumPy sorts two-byte integers by radix, which is much faster.
            order = np.argsort(instance.astype(np.uint16) if count < 2**16 else instance, kind="stable")
            instance = instance[order]
            start = np.flatnonzero(np.append(True, instance[1:] != instance[:-1]))
        first[instance[start]], stop[instance[start]] = start, np.append(start[1:], len(instance))
        return InstanceRuns(order, first, stop)

    @cached_property
    def vertex_runs(self) -> InstanceRuns:
        """Vertices by instance.

        Raises:
            ValueError: instances share a vertex.
        """
        count, runs = len(self.instances), self.face_runs
        corners = (self.faces if runs.order is None else self.faces[runs.order]).ravel()
        first, stop = np.zeros((2, count), dtype=np.intp)
        used = np.flatnonzero(runs.stop > runs.first)
        if not len(used):
            return InstanceRuns(None, first, stop)
        used = used[np.argsort(runs.first[used])]
        first[used] = np.minimum.reduceat(corners, 3 * runs.first[used])
        stop[used] = np.maximum.reduceat(corners, 3 * runs.first[used]).astype(np.intp) + 1
        along = used[np.argsort(first[used])]
        if np.all(stop[along][:-1] <= first[along][1:]):
            return InstanceRuns(None, first, stop)
        # The vertices of several instances are mixed.
        order = np.argsort(self._vertex_owners, kind="stable")
        edges = np.searchsorted(self._vertex_owners[order], np.arange(count + 1))
        return InstanceRuns(order, edges[:-1], edges[1:])

    @cached_property
    def _vertex_owners(self) -> NDArray[np.uint32]:
        """`(v,)` instance of each vertex; the number of instances for a vertex without faces."""
        owner = np.full(len(self.vertices), len(self.instances), dtype=np.uint32)
        owner[self.faces] = self.face_instance[:, None]
        if any(np.any(owner[self.faces[:, corner]] != self.face_instance) for corner in range(3)):
            raise ValueError("instances must not share vertices")
        return owner

    def moved(self, rotation: FloatArray, translation: FloatArray) -> Mesh:
        """Return the mesh rotated by a `(3, 3)` matrix, then translated by `(3,)` metres.

        Raises:
            ValueError: the matrix is not a rotation (scaling or mirroring would spoil normals), or
                the translation does not have three coordinates.
        """
        matrix, shift = np.asarray(rotation, dtype=float), np.asarray(translation, dtype=float)
        if matrix.shape != (3, 3) or shift.shape != (3,):
            shapes = f"{matrix.shape} and {shift.shape}"
            raise ValueError(f"rotation must be (3, 3) and translation (3,), not {shapes}")
        if not (np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6) and np.linalg.det(matrix) > 0.0):
            raise ValueError("rotation must be orthogonal, with determinant 1")
        vertices = _transform(self.vertices, matrix, shift)
        return replace(self, vertices=vertices, normals=_transform(self.normals, matrix, np.zeros(3)))

    def select_instances(self, chosen: Sequence[int]) -> Mesh:
        """Return the part of the mesh that belongs to some instances, renumbered in the given order.

        Args:
            chosen: indices into `instances`; a parent that is not among them becomes -1.

        Raises:
            ValueError: `chosen` is empty, has duplicates, or has an index out of range.
        """
        indices, count = [int(index) for index in chosen], len(self.instances)
        if not indices or len(set(indices)) < len(indices) or not 0 <= min(indices) <= max(indices) < count:
            raise ValueError(f"chosen must be different indices of {count} instances, not {indices}")
        new_index = np.full(count, -1)
        new_index[indices] = np.arange(len(indices))
        part = self.select_faces(np.flatnonzero(new_index[self.face_instance] >= 0))
        surfaces, face_surface = np.unique(part.face_surface, return_inverse=True)
        appearances, face_appearance = np.unique(part.face_appearance, return_inverse=True)
        return replace(
            part,
            face_instance=new_index[part.face_instance].astype(np.uint32),
            face_surface=face_surface.astype(np.uint8),
            face_appearance=face_appearance.astype(np.uint32),
            surfaces=tuple(self.surfaces[index] for index in surfaces),
            instances=tuple(
                replace(item, parent=int(new_index[item.parent]) if item.parent >= 0 else -1)
                for item in (self.instances[index] for index in indices)
            ),
            appearances=tuple(self.appearances[index] for index in appearances),
        )

    def without_triangles(self, instances: IndexArray) -> Mesh:
        """Return the mesh without the triangles of some instances; all instances keep their numbers."""
        gone = np.zeros(len(self.instances), dtype=bool)
        gone[instances] = True
        # Taking rows by index is five times as fast as by a mask.
        return self.select_faces(np.flatnonzero(~gone[self.face_instance]))

    def select_faces(self, kept: IndexArray) -> Mesh:
        """Return the mesh with some of its triangles, by index; all instances keep their numbers."""
        faces = self.faces.take(kept, axis=0)
        is_used = np.zeros(len(self.vertices), dtype=bool)
        is_used[faces] = True
        used = np.flatnonzero(is_used)
        return replace(
            self,
            vertices=self.vertices.take(used, axis=0),
            normals=self.normals.take(used, axis=0),
            uv=self.uv.take(used, axis=0),
            state=self.state.take(used),
            faces=(np.cumsum(is_used, dtype=np.uint32) - np.uint32(1))[faces],
            face_instance=self.face_instance.take(kept),
            face_surface=self.face_surface.take(kept),
            face_appearance=self.face_appearance.take(kept),
            colour=self.colours_of(used),
        )

    def colours_of(self, vertices: NDArray[np.bool_] | NDArray[np.integer] | slice) -> SingleArray | None:
        """Colours of some vertices, or None if the mesh has none."""
        return None if self.colour is None else self.colour[vertices]

    def with_plant(self, plant: int) -> Mesh:
        """Return the mesh with all its instances assigned to a plant of a scene, by its number."""
        return replace(
            self, instances=tuple(item.numbered(plant, item.parent, item.far_row) for item in self.instances)
        )


def _transform(points: SingleArray, rotation: FloatArray, translation: FloatArray) -> SingleArray:
    """`(n, 3)` points rotated and translated.

    Written out per coordinate: BLAS splits such tall products over threads, which wait for each other far
    longer than they compute on busy cores, and the last bits of the result depend on their number.
    """
    x, y, z = np.ascontiguousarray(points.T).astype(np.float64)
    result = np.empty((len(points), 3), dtype=np.float32)
    for axis, (a, b, c) in enumerate(rotation):
        result[:, axis] = a * x + b * y + c * z + translation[axis]
    return result


def concatenate_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes; instances are renumbered in order.

    Surfaces of equal name become one, and so do equal appearances.

    Raises:
        ValueError: no meshes are given.
    """
    if not meshes:
        raise ValueError("at least one mesh is needed")
    names = tuple(dict.fromkeys(name for mesh in meshes for name in mesh.surfaces))
    faces, face_instances, face_surfaces, face_appearances = [], [], [], []
    instances: list[Instance] = []
    number: dict[Appearance, int] = {}
    vertex_offset = 0
    for mesh in meshes:
        surface_index = np.array([names.index(name) for name in mesh.surfaces], dtype=np.uint8)
        offset = len(instances)
        faces.append(mesh.faces + np.uint32(vertex_offset))
        face_instances.append(mesh.face_instance + np.uint32(offset))
        face_surfaces.append(surface_index[mesh.face_surface])
        appearance_index = np.array([number.setdefault(item, len(number)) for item in mesh.appearances])
        face_appearances.append(appearance_index.astype(np.uint32)[mesh.face_appearance])
        instances += [
            item.numbered(item.plant, item.parent + offset, item.far_row)
            if offset and item.parent >= 0
            else item
            for item in mesh.instances
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
        face_appearance=np.concatenate(face_appearances),
        surfaces=names,
        instances=tuple(instances),
        appearances=tuple(number),
        colour=join_colours([(mesh.colour, len(mesh.vertices)) for mesh in meshes]),
        cultivars=_different_cultivars(meshes),
    )


def _different_cultivars(meshes: Sequence[Mesh]) -> tuple[Cultivar, ...]:
    """The cultivars of all meshes, each once."""
    found: list[Cultivar] = []
    for cultivar in (cultivar for mesh in meshes for cultivar in mesh.cultivars):
        if not any(cultivar is known or cultivar == known for known in found):
            found.append(cultivar)
    return tuple(found)


def join_colours(
    parts: Sequence[tuple[NDArray[np.floating[Any]] | None, int]], missing: float = PIGMENTS
) -> NDArray[Any] | None:
    """Colours of the points of several parts, one value for those without; None if no part has any.

    Args:
        parts: colours `(..., 3)` or None, and the number of points.
        missing: the value.
    """
    if all(colour is None for colour, _ in parts):
        return None
    return np.concatenate(
        [
            np.full((count, 3), missing, np.float32) if colour is None else colour.reshape(-1, 3)
            for colour, count in parts
        ]
    )


def single_instance_mesh(
    vertices: FloatArray,
    normals: FloatArray,
    uv: FloatArray,
    state: FloatArray,
    faces: NDArray[np.integer],
    organ_class: OrganClass,
    kind: str,
    surface: str,
) -> Mesh:
    """Build a mesh of one instance and one surface; shapes and units as in `Mesh`."""
    return Mesh(
        vertices=vertices.astype(np.float32),
        normals=normals.astype(np.float32),
        uv=uv.astype(np.float32),
        state=state.astype(np.float32),
        faces=faces.astype(np.uint32),
        face_instance=np.zeros(len(faces), dtype=np.uint32),
        face_surface=np.zeros(len(faces), dtype=np.uint8),
        face_appearance=np.zeros(len(faces), dtype=np.uint32),
        surfaces=(surface,),
        instances=(Instance(organ_class, kind),),
        appearances=(Appearance(),),
    )

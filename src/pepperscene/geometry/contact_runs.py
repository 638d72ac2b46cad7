"""Where the faces and the vertices of each instance of a mesh lie, in runs one after the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.mesh import Mesh

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

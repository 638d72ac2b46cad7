"""The same bodies out of more triangles, to see what triangles alone cost."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry import Mesh


def quartered(mesh: Mesh) -> Mesh:
    """The mesh with each triangle cut into four at the middles of its sides, which leaves all as it is seen.

    Instances keep their vertices together, as `Mesh.instance_vertices` asks for.
    """
    sides = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    sides, where = np.unique(sides, axis=0, return_inverse=True)
    owner = np.concatenate([mesh.vertex_instance, mesh.vertex_instance[sides[:, 0]]])
    order = np.argsort(owner, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(order.size)

    def halved(values: NDArray[np.float32]) -> NDArray[np.float32]:
        middles = values[sides].mean(axis=1, dtype=np.float32)
        return np.concatenate([values, middles])[order]

    corners: list[Any] = [place[column] for column in mesh.faces.T]
    middles: list[Any] = [place[column + len(mesh.vertices)] for column in where.reshape(-1, 3).T]
    (a, b, c), (ab, bc, ca) = corners, middles
    parts = np.array([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    normals = halved(mesh.normals)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(
        mesh,
        vertices=halved(mesh.vertices),
        normals=(normals / np.maximum(lengths, 1e-12)).astype(np.float32),
        uv=halved(mesh.uv),
        state=halved(mesh.state),
        # The four parts of a triangle lie side by side, as what belongs to a face is repeated.
        faces=parts.transpose(2, 0, 1).reshape(-1, 3).astype(np.uint32),
        face_instance=np.repeat(mesh.face_instance, 4),
        face_surface=np.repeat(mesh.face_surface, 4),
    )

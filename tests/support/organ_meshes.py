"""Meshes of hand-made organs, and checks that every mesh must pass."""

from __future__ import annotations

import numpy as np
import trimesh

from pepperscene.classes import OrganClass
from pepperscene.cultivar.organs import DEFAULT_KINDS, OrganKind
from pepperscene.geometry import Mesh, mesh_plant
from pepperscene.grammar.plant import Organ, Plant

KINDS = {**DEFAULT_KINDS, "shoot": OrganKind("stalk", OrganClass.SHOOT, "stem")}


def organ(kind, base=(0.0, 0.0, 0.0), tip=(0.0, 0.1, 0.0), *, up=(0.0, 0.0, 1.0), parent=-1, **measures):
    """A straight organ of phytomer 0."""
    curve = np.array([base, tip], dtype=float)
    return Organ(kind, parent, 0, curve, np.array(up, dtype=float), measures)


def mesh_organs(*organs, detail=1.0, kinds=KINDS) -> Mesh:
    return mesh_plant(Plant("hand-made", tuple(organs), kinds), detail)


def merged(mesh: Mesh, instance: int | None = None) -> trimesh.Trimesh:
    """A mesh or one instance of it, with the duplicate vertices at the seam of uv merged."""
    faces = mesh.faces if instance is None else mesh.faces[mesh.face_instance == instance]
    points, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(points.astype(float), index.ravel()[faces], process=False)


def face_normals(mesh: Mesh) -> np.ndarray:
    """`(f, 3)` with twice the area of the faces as length."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(float) for corner in range(3))
    return np.cross(b - a, c - a)


def shading_agreement(mesh: Mesh) -> float:
    """The least projection of the mean of a face's shading normals on its own unit normal."""
    flat = face_normals(mesh)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    return float(np.sum(flat * mesh.normals[mesh.faces].mean(axis=1), axis=1).min())


def check_mesh(mesh: Mesh) -> None:
    """Properties of any mesh."""
    for array in (mesh.vertices, mesh.normals, mesh.uv, mesh.state):
        assert np.all(np.isfinite(array))
        assert array.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
    for array in (mesh.uv, mesh.state):
        assert 0.0 <= array.min() <= array.max() <= 1.0
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert np.all(np.linalg.norm(face_normals(mesh), axis=1) > 0.0)


def check_solid(mesh: Mesh) -> None:
    """Properties of the mesh of a closed organ."""
    check_mesh(mesh)
    body = merged(mesh)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume > 0.0
    assert len(np.unique(np.sort(body.faces, axis=1), axis=0)) == len(body.faces)

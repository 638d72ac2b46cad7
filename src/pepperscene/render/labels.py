"""Ground truth by one ray through each pixel's centre: exact, and nearly free."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh
from pepperscene.render.variant import kernel
from pepperscene.render.view import View


@dataclass(frozen=True, eq=False)
class Hits:
    """The first hit behind each pixel's centre.

    Attributes:
        face: `(h, w)` int64, index of the triangle hit, -1 for the background.
        distance: `(h, w)` float32, metres along the ray, inf for the background.
    """

    face: NDArray[np.int64]
    distance: NDArray[np.float32]


def first_hits(scene: Any, view: View) -> Hits:
    """One ray per pixel against the scene; no material, light or attribute is touched."""
    mi, dr = kernel()
    pixel = dr.arange(mi.UInt32, view.width * view.height)
    row = pixel // view.width
    towards = view.directions(pixel - row * view.width, row, mi.Float(0.5), mi.Float(0.5))
    found = scene.ray_intersect_preliminary(mi.Ray3f(view.origin, towards), coherent=True)
    hit = found.is_valid()
    distance = dr.select(hit, found.t, dr.inf)
    face = dr.select(hit, mi.Int32(found.prim_index), -1)
    dr.eval(distance, face)
    shape = (view.height, view.width)
    return Hits(np.asarray(face).reshape(shape).astype(np.int64), np.asarray(distance).reshape(shape))


def class_ids(mesh: Mesh, hits: Hits) -> NDArray[np.uint8]:
    """`(h, w)` the `OrganClass` at each pixel; 0 in the background."""
    return _by_face(np.append(mesh.face_class, np.uint8(0)), hits)


def instance_ids(mesh: Mesh, hits: Hits) -> NDArray[np.uint16]:
    """`(h, w)` index into the mesh's instances plus 1; 0 in the background.

    Raises:
        ValueError: there are more instances than 16 bits can tell apart.
    """
    if len(mesh.instances) > np.iinfo(np.uint16).max:
        raise ValueError(f"{len(mesh.instances)} instances do not fit into a 16-bit image")
    return _by_face(np.append(mesh.face_instance + 1, 0).astype(np.uint16), hits)


def normals(mesh: Mesh, hits: Hits, camera: Camera) -> NDArray[np.float32]:
    """`(h, w, 3)` unit geometric normals in the world, on the side that the camera sees; 0 without a hit."""
    corners = mesh.vertices[mesh.faces[np.maximum(hits.face, 0)]].astype(np.float64)
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    towards = camera.pixel_directions() @ camera.pose[:3, :3].T
    normal *= -np.sign(np.sum(normal * towards, axis=-1, keepdims=True))
    return np.where(hits.face[..., None] >= 0, normal, 0.0).astype(np.float32)


def depth_z(hits: Hits, camera: Camera) -> NDArray[np.float32]:
    """`(h, w)` metres along the optical axis; inf in the background."""
    return (hits.distance * camera.pixel_directions()[..., 2]).astype(np.float32)


def _by_face(of_face: NDArray[Any], hits: Hits) -> NDArray[Any]:
    """A per-face value at each pixel; the last entry, which index -1 finds, is the background's."""
    return of_face[hits.face]

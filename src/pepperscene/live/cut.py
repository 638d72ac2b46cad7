"""A tube cut across: the part on one side of a plane, with a flat end."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry import Mesh
from pepperscene.geometry.fruit.fruits import axis_frames

_NEAR: Final = 4.0  # chosen: radii of the tube around the cut within which the plane decides


def cut_tube(mesh: Mesh, point: NDArray[np.float64], towards: NDArray[np.float64], radius_m: float) -> Mesh:
    """The part of a tube before a plane, closed by a flat end.

    Args:
        mesh: of a single instance, surface and appearance, with v along the tube.
        point: `(3,)` on the plane and the tube's centreline.
        towards: `(3,)` unit normal of the plane, into the part that goes.
        radius_m: of the tube.
    """
    import trimesh

    # A bent tube may meet the plane again: far from the cut, v decides.
    offset, near = mesh.vertices.astype(np.float64) - point, _NEAR * radius_m
    distance = np.linalg.norm(offset, axis=1)
    along = mesh.uv[:, 1] - mesh.uv[distance.argmin(), 1]
    height = np.where(distance < near, offset @ towards, np.where(along > 0.0, near, -near))
    columns = [mesh.normals, mesh.uv, mesh.state[:, None]]
    attributes = np.hstack(columns if mesh.colour is None else [*columns, mesh.colour]).astype(np.float64)
    vertices, faces, attributes = trimesh.intersections.slice_faces_plane(
        point + offset, mesh.faces.astype(np.int64), -towards, point, uv=attributes, cached_dots=-height
    )

    # The end is a fan around the mean of the rim.
    rim = np.flatnonzero(np.abs((vertices - point) @ towards) < 1e-7)
    if len(rim):
        side, right, _ = axis_frames(towards[None], mesh.normals[:1].astype(np.float64))[0]
        centre = vertices[rim].mean(axis=0)
        angle = np.arctan2((vertices[rim] - centre) @ right, (vertices[rim] - centre) @ side)
        ring = rim[np.argsort(angle, kind="stable")]
        own = len(vertices) + np.arange(len(ring))
        fan = np.stack([own, np.roll(own, -1), np.full(len(ring), own[-1] + 1)], axis=1)
        end = np.vstack([attributes[ring], attributes[ring].mean(axis=0)])
        end[:, :3] = towards
        vertices, faces = np.vstack([vertices, vertices[ring], centre]), np.vstack([faces, fan])
        attributes = np.vstack([attributes, end])
    single: NDArray[np.float32] = attributes.astype(np.float32)
    normals = single[:, :3] / np.maximum(np.linalg.norm(single[:, :3], axis=1, keepdims=True), 1e-12)
    return replace(
        mesh,
        vertices=vertices.astype(np.float32),
        normals=normals.astype(np.float32),
        uv=np.clip(single[:, 3:5], 0.0, 1.0),
        state=np.clip(single[:, 5], 0.0, 1.0),
        colour=None if mesh.colour is None else single[:, 6:],
        faces=faces.astype(np.uint32),
        face_instance=np.repeat(mesh.face_instance[:1], len(faces)),
        face_surface=np.repeat(mesh.face_surface[:1], len(faces)),
        face_appearance=np.repeat(mesh.face_appearance[:1], len(faces)),
    )

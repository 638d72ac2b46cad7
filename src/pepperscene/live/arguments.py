"""Checks of what callers give: poses in the axes of other programs, meshes, capsules."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.poses.generators import as_poses, check_poses
from pepperscene.classes import OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.geometry import Mesh, single_instance_mesh

if TYPE_CHECKING:
    from trimesh import Trimesh

FloatArray = NDArray[np.float64]

CameraAxes = Literal["optical", "opengl", "body"]
"""Axes of a camera: x right, y down, z forward, as here, in OpenCV and in optical frames of ROS; x right, y
up, z backwards, as in OpenGL, Blender and nerfstudio; x forward, y left, z up, as in body frames of ROS."""

_FARTHEST_M: Final = 1e5  # chosen: single precision rounds positions to a centimetre there
_TO_OPTICAL: Final = {
    "optical": np.eye(3),
    "opengl": np.diag([1.0, -1.0, -1.0]),
    "body": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}
"""Our camera axes in columns, in the other axes."""


def check_axes(axes: str) -> None:
    """Raise `ArgumentError` unless the name of camera axes is known."""
    if axes not in get_args(CameraAxes):
        raise ArgumentError("axes", f"must be one of {', '.join(get_args(CameraAxes))}", value=axes)


def camera_poses(poses: ArrayLike, axes: str) -> FloatArray:
    """`(n, 4, 4)` camera poses in our axes.

    Raises:
        ArgumentError: they have another shape, or are no rigid motions.
    """
    checked = rigid_motions(poses, "pose")
    if axes != "optical":
        checked = checked.copy()
        checked[:, :3, :3] = checked[:, :3, :3] @ _TO_OPTICAL[axes]
    return checked


def rigid_motions(poses: ArrayLike, name: str) -> FloatArray:
    """`(n, 4, 4)` rotations and translations.

    Raises:
        ArgumentError: they have another shape, are something else, or lead too far away.
    """
    checked = as_poses(poses, name)
    try:
        check_poses(checked)
    except ValueError as error:
        raise ArgumentError(name, str(error)) from None
    if not len(checked) or np.abs(checked[:, :3, 3]).max() > _FARTHEST_M:
        raise ArgumentError(name, f"must be at least one, within {_FARTHEST_M:g} m of the origin")
    return checked


def rigid_motion(pose: ArrayLike, name: str = "pose") -> FloatArray:
    """One `(4, 4)` rotation and translation; errors as of `rigid_motions`."""
    checked = rigid_motions(pose, name)
    if len(checked) != 1:
        raise ArgumentError(name, f"must be one pose, not {len(checked)}")
    return checked[0]


def object_mesh(mesh: Mesh | Trimesh, kind: str) -> Mesh:
    """A body as a mesh of one instance of the background.

    Raises:
        ArgumentError: it is no mesh, has no triangles, or has numbers that are not finite.
    """
    vertices, faces = triangles_of(mesh)
    count = len(vertices)
    if isinstance(mesh, Mesh):
        normals, uv, state = (np.asarray(values, float) for values in (mesh.normals, mesh.uv, mesh.state))
    else:
        normals = np.asarray(mesh.vertex_normals, float)
        uv, state = np.full((count, 2), 0.5), np.full(count, 0.5)
    for name, values in (("normals", normals), ("uv", uv), ("state", state)):
        if len(values) != count or not np.isfinite(values).all():
            raise ArgumentError("mesh", f"must have {count} finite {name}, one for each vertex")
    return single_instance_mesh(vertices, normals, uv, state, faces, OrganClass.BACKGROUND, kind, "object")


def body_triangles(mesh: Mesh | Trimesh, pose: FloatArray) -> FloatArray:
    """`(n, 3, 3)` corners of a body's triangles in the world; errors as of `object_mesh`."""
    vertices, faces = triangles_of(mesh)
    return np.asarray((vertices @ pose[:3, :3].T + pose[:3, 3])[faces])


def capsule_meshes(capsules: Any) -> list[Trimesh]:
    """Capsules `(n, 7)` as meshes.

    Raises:
        ArgumentError: they have another shape, a number is not finite, or a radius is not above 0.
    """
    import trimesh

    try:
        values = np.atleast_2d(np.array(capsules, dtype=float))
    except (TypeError, ValueError):
        values = np.zeros((0, 0))
    if values.ndim != 2 or values.shape[1] != 7 or not np.isfinite(values).all() or (values[:, 6] <= 0).any():
        problem = "must be a mesh, or capsules (n, 7): both ends of the axis and the radius, in metres"
        raise ArgumentError("body", problem)
    meshes = []
    for start, end, radius in ((row[:3], row[3:6], row[6]) for row in values):
        length = float(np.linalg.norm(end - start))
        meshes.append(trimesh.creation.capsule(length, radius, count=(24, 24)))
        direction = (end - start) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], direction)
        turn[:3, 3] = 0.5 * (start + end)
        # Versions of trimesh differ in where it is.
        meshes[-1].apply_translation(-meshes[-1].bounds.mean(axis=0)).apply_transform(turn)
    return meshes


def triangles_of(mesh: Any) -> tuple[FloatArray, NDArray[np.integer[Any]]]:
    """`(v, 3)` vertices and `(f, 3)` faces of a `Mesh` or a trimesh; errors as of `object_mesh`."""
    if not (hasattr(mesh, "vertices") and hasattr(mesh, "faces")):
        raise ArgumentError("mesh", f"must be a Mesh or a trimesh.Trimesh, not {type(mesh).__name__}")
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    if faces.ndim != 2 or faces.shape[1:] != (3,) or not len(faces) or vertices.shape[1:] != (3,):
        raise ArgumentError("mesh", "must have triangles")
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > _FARTHEST_M:
        raise ArgumentError("mesh", f"must have finite vertices within {_FARTHEST_M:g} m of the origin")
    if not (faces.dtype.kind in "iu" and 0 <= int(faces.min()) <= int(faces.max()) < len(vertices)):
        raise ArgumentError("mesh", f"must have faces that count its {len(vertices)} vertices")
    return vertices, faces

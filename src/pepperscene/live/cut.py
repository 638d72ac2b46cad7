"""A tube cut across: the part on one side of a plane, with a flat end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry import Mesh

_NEAR: Final = 4.0  # chosen: radii of the tube around the cut within which the plane decides

_Rows = NDArray[np.integer[Any]]


def cut_tube(mesh: Mesh, point: NDArray[np.float64], towards: NDArray[np.float64], radius_m: float) -> Mesh:
    """The part of a tube before a plane, closed by a flat end.

    Args:
        mesh: of a single instance, with v along the tube.
        point: `(3,)` on the plane and the tube's centreline.
        towards: `(3,)` unit normal of the plane, into the part that goes.
        radius_m: of the tube.

    Returns:
        The rest. What new vertices have is linear between the corners of the triangle that is cut.
    """
    height = _heights(mesh, point, towards, radius_m)
    corners_beyond = (height > 0.0)[mesh.faces].sum(axis=1)
    whole = np.flatnonzero(corners_beyond == 0)
    faces: list[_Rows] = [mesh.faces[whole].astype(np.intp)]
    source, pairs, rims = [whole], [], []
    count = len(mesh.vertices)
    for number in (1, 2):
        rows = np.flatnonzero(corners_beyond == number)
        # The corner that is alone on its side comes first; the order of the corners stays.
        is_alone = (height > 0.0)[mesh.faces[rows]] == (number == 1)
        turned = (is_alone.argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(mesh.faces[rows].astype(np.intp), turned, axis=1).T
        ab = count + np.arange(len(rows))
        ac = ab + len(rows)
        count += 2 * len(rows)
        pairs += [np.stack([a, b], axis=1), np.stack([a, c], axis=1)]
        parts = [(ab, b, c), (ab, c, ac)] if number == 1 else [(a, ab, ac)]
        faces += [np.stack(part, axis=1) for part in parts]
        source += [rows] * len(parts)
        # The new side of the rest, in the direction of its neighbour in the flat end.
        rims.append(np.stack((ab, ac) if number == 1 else (ac, ab), axis=1))
    clipped = _with_new_vertices(mesh, np.concatenate(pairs), height)
    return _closed(clipped, np.concatenate(faces), np.concatenate(source), np.concatenate(rims), towards)


def _heights(
    mesh: Mesh, point: NDArray[np.float64], towards: NDArray[np.float64], radius_m: float
) -> NDArray[np.float64]:
    """`(v,)` metres beyond the plane; far from the cut, where a bent tube may cross it again, by v alone."""
    offset = mesh.vertices.astype(np.float64) - point
    distance = np.linalg.norm(offset, axis=1)
    along = mesh.uv[:, 1] - mesh.uv[distance.argmin(), 1]
    near = _NEAR * radius_m
    return np.where(distance < near, offset @ towards, np.where(along > 0.0, near, -near))


def _with_new_vertices(mesh: Mesh, pairs: _Rows, height: NDArray[np.float64]) -> Mesh:
    """The mesh with a further vertex between each pair `(n, 2)` of vertices, where the height is 0."""
    first, second = pairs.T
    share = (height[first] / (height[first] - height[second])).astype(np.float32)

    def extended(values: Any) -> Any:
        weight = share if values.ndim == 1 else share[:, None]
        return np.concatenate([values, values[first] + weight * (values[second] - values[first])])

    normals = extended(mesh.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-12))
    return replace(
        mesh,
        vertices=extended(mesh.vertices),
        normals=normals,
        uv=extended(mesh.uv),
        state=extended(mesh.state),
        colour=None if mesh.colour is None else extended(mesh.colour),
    )


def _closed(mesh: Mesh, faces: _Rows, source: _Rows, rims: _Rows, towards: NDArray[np.float64]) -> Mesh:
    """The mesh with other faces, and a fan of triangles over the rim; only vertices in use are kept.

    Args:
        mesh: has all vertices.
        faces: `(f, 3)` of its vertices.
        source: `(f,)` face of the mesh that each takes its surface from.
        rims: `(n, 2)` vertices at the ends of the rim's sides.
        towards: `(3,)` normal of the fan.
    """
    used, renumbered = np.unique(faces, return_inverse=True)
    rim = rims.ravel()
    vertices = np.concatenate([used, rim])
    values = {name: getattr(mesh, name)[vertices] for name in ("vertices", "normals", "uv", "state")}
    values["normals"][len(used) :] = towards
    colour = mesh.colours_of(vertices)
    faces = renumbered.reshape(-1, 3)
    if len(rim):
        # The centre of the fan is the mean of the rim.
        for name, array in values.items():
            values[name] = np.concatenate([array, array[len(used) :].mean(axis=0, keepdims=True)])
        if colour is not None:
            colour = np.concatenate([colour, colour[-1:]])
        ends = len(used) + np.arange(len(rim)).reshape(-1, 2)
        fan = np.column_stack([ends, np.full(len(ends), len(vertices))])
        faces, source = np.concatenate([faces, fan]), np.append(source, np.repeat(source[:1], len(fan)))
    return replace(
        mesh,
        **values,
        colour=colour,
        faces=faces.astype(np.uint32),
        face_instance=mesh.face_instance[source],
        face_surface=mesh.face_surface[source],
        face_appearance=mesh.face_appearance[source],
    )

"""One body as a mesh with one instance, and simple bodies for tests and reference cards."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry.body import Bodies
from pepperscene.geometry.mesh import Mesh


def single(bodies: Bodies, organ_class: OrganClass, kind: str, surface: str) -> Mesh:
    """The first of the bodies as a mesh of its own.

    Args:
        bodies: as the shape makers return them.
        organ_class: class of all its faces.
        kind: its instance's kind.
        surface: name of its surface.
    """
    return one_instance(
        bodies.vertices[0], bodies.normals[0], bodies.uv[0], bodies.state[0], bodies.faces,
        organ_class, kind, surface,
    )  # fmt: skip


def sphere(
    centre: ArrayLike,
    radius_m: float,
    surface: str = "fruit",
    organ_class: OrganClass = OrganClass.PEPPER,
    subdivisions: int = 3,
) -> Mesh:
    """A closed sphere out of a subdivided icosahedron; its vertices lie on the sphere.

    Args:
        centre: `(3,)` metres.
        radius_m: metres.
        surface: name of its surface.
        organ_class: class of all its faces.
        subdivisions: each makes four triangles of one; 0 is the icosahedron.

    Returns:
        u is the longitude, v runs from the top (0) to the bottom (1), state is 0.5; one instance "sphere".
    """
    import trimesh

    if not radius_m > 0.0:
        raise ValueError(f"radius_m must be above zero, not {radius_m}")
    body = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    normals = np.asarray(body.vertices, dtype=float)
    longitude = np.arctan2(normals[:, 1], normals[:, 0]) / (2.0 * np.pi) % 1.0
    uv = np.stack([longitude, np.arccos(np.clip(normals[:, 2], -1.0, 1.0)) / np.pi], axis=1)
    vertices = np.asarray(centre, dtype=float) + radius_m * normals
    state = np.full(len(vertices), 0.5)
    return one_instance(vertices, normals, uv, state, np.asarray(body.faces), organ_class, "sphere", surface)


def rectangle(
    centre: ArrayLike,
    right: ArrayLike,
    up: ArrayLike,
    surface: str = "leaf",
    organ_class: OrganClass = OrganClass.LEAF,
) -> Mesh:
    """A flat rectangle or parallelogram; its normal is right x up.

    Args:
        centre: `(3,)` metres.
        right: `(3,)` metres, the whole lower edge from left to right.
        up: `(3,)` metres, the whole left edge from bottom to top.
        surface: name of its surface.
        organ_class: class of both faces.

    Returns:
        u along `right` and v along `up`, both 0 to 1; state is 0.5; one instance "rectangle".
    """
    along, rise = np.asarray(right, dtype=float), np.asarray(up, dtype=float)
    normal = np.cross(along, rise)
    area = float(np.linalg.norm(normal))
    if not area > 0.0:
        raise ValueError("right and up must span a rectangle")
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    vertices = np.asarray(centre, dtype=float) + (uv - 0.5) @ np.stack([along, rise])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    normals, state = np.tile(normal / area, (4, 1)), np.full(4, 0.5)
    return one_instance(vertices, normals, uv, state, faces, organ_class, "rectangle", surface)


def one_instance(
    vertices: NDArray[np.float64],
    normals: NDArray[np.float64],
    uv: NDArray[np.float64],
    state: NDArray[np.float64],
    faces: NDArray[np.integer],
    organ_class: OrganClass,
    kind: str,
    surface: str,
) -> Mesh:
    """A mesh of one instance and one surface.

    Args:
        vertices: `(v, 3)` metres, and with them
        normals: `(v, 3)`,
        uv: `(v, 2)`,
        state: `(v,)`.
        faces: `(f, 3)`.
        organ_class: class of all faces.
        kind: its instance's.
        surface: its name.
    """
    return Mesh(
        vertices=vertices.astype(np.float32),
        normals=normals.astype(np.float32),
        uv=uv.astype(np.float32),
        state=state.astype(np.float32),
        faces=faces.astype(np.uint32),
        face_instance=np.zeros(len(faces), dtype=np.uint32),
        face_surface=np.zeros(len(faces), dtype=np.uint8),
        surfaces=(surface,),
        instances=(Instance(organ_class, kind),),
    )

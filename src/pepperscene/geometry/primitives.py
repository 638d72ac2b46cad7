"""Simple shapes as meshes of one instance: sphere and rectangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.classes import OrganClass
from pepperscene.geometry.mesh import Mesh, single_instance_mesh


def sphere(
    centre: ArrayLike,
    radius_m: float,
    surface: str = "fruit",
    organ_class: OrganClass = OrganClass.PEPPER,
    subdivisions: int = 3,
) -> Mesh:
    """Build a closed sphere from a subdivided icosahedron.

    Args:
        centre: `(3,)` metres.
        radius_m: distance of the vertices from the centre, metres.
        surface: name of its surface.
        organ_class: class of all its faces.
        subdivisions: each splits a triangle into four; 0 is the icosahedron.

    Returns:
        One instance "sphere"; u is the longitude, v runs from the top (0) to the bottom (1), state is 0.5.

    Raises:
        ValueError: the radius is not above zero.
    """
    import trimesh

    if not radius_m > 0.0:
        raise ValueError(f"radius_m must be above zero, not {radius_m}")
    unit_sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    normals, faces = np.asarray(unit_sphere.vertices, dtype=float), np.asarray(unit_sphere.faces)
    longitude = np.arctan2(normals[:, 1], normals[:, 0]) / (2.0 * np.pi) % 1.0
    uv = np.stack([longitude, np.arccos(np.clip(normals[:, 2], -1.0, 1.0)) / np.pi], axis=1)
    vertices, state = np.asarray(centre, dtype=float) + radius_m * normals, np.full(len(normals), 0.5)
    return single_instance_mesh(vertices, normals, uv, state, faces, organ_class, "sphere", surface)


def rectangle(
    centre: ArrayLike,
    right: ArrayLike,
    up: ArrayLike,
    surface: str = "leaf",
    organ_class: OrganClass = OrganClass.LEAF,
) -> Mesh:
    """Build a flat rectangle or parallelogram with the normal right x up.

    Args:
        centre: `(3,)` metres.
        right: `(3,)` metres, the lower edge from left to right.
        up: `(3,)` metres, the left edge from bottom to top.
        surface: name of its surface.
        organ_class: class of both faces.

    Returns:
        One instance "rectangle"; u runs along `right`, v along `up`, state is 0.5.

    Raises:
        ValueError: the edges are parallel or one has no length.
    """
    edges = np.stack([np.asarray(right, dtype=float), np.asarray(up, dtype=float)])
    normal = np.cross(*edges)
    area = float(np.linalg.norm(normal))
    if not area > 0.0:
        raise ValueError("right and up must span a rectangle")
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    vertices = np.asarray(centre, dtype=float) + (uv - 0.5) @ edges
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    normals, state = np.tile(normal / area, (4, 1)), np.full(4, 0.5)
    return single_instance_mesh(vertices, normals, uv, state, faces, organ_class, "rectangle", surface)

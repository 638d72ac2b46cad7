"""Many organs with one grid of triangles: sheets, and solids made of rings around a centreline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry.mesh import Mesh
from pepperscene.geometry.spine import Spines


@dataclass(frozen=True, eq=False)
class MeshBatch:
    """n organs that share one topology.

    Attributes:
        vertices: `(n, v, 3)` metres.
        normals: `(n, v, 3)` unit.
        uv: `(n, v, 2)`.
        state: `(n, v)`.
        faces: `(f, 3)` of each organ.
    """

    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64]
    state: NDArray[np.float64]
    faces: NDArray[np.intp]


def fineness(count: int, detail: float, least: int) -> int:
    """How many pieces a grid line gets: `count` at detail 1, in proportion elsewhere, never below `least`."""
    return max(least, round(count * detail))


def solids(
    spine: Spines,
    along: NDArray[np.float64],
    radius: NDArray[np.float64],
    ends: tuple[NDArray[np.float64], NDArray[np.float64]],
    state: NDArray[np.float64],
) -> MeshBatch:
    """Closed bodies out of r rings of c points around each centreline, and a point at either end.

    Args:
        spine: the centrelines of n organs.
        along: `(n, r, c)` distance of each ring point along the centreline, metres.
        radius: `(n, r, c)` its distance from the centreline; column 0 lies on the upper side, the columns
            run right-handed about the centreline.
        ends: `(n,)` and `(n,)` distance of the first and the last point along the centreline.
        state: `(n, 2 + r * c)` pigment state: first point, rings, last point.
    """
    n, rings, sides = along.shape
    angle = 2.0 * np.pi * np.arange(sides) / sides
    right, up = radius * np.sin(angle), radius * np.cos(angle)
    zero = np.zeros((n, 1))
    flat = spine.place(
        np.concatenate([ends[0][:, None], along.reshape(n, -1), ends[1][:, None]], axis=1),
        np.concatenate([zero, right.reshape(n, -1), zero], axis=1),
        np.concatenate([zero, up.reshape(n, -1), zero], axis=1),
    )
    # Column 0 is repeated at the seam, where u jumps from 1 to 0.
    source, faces, uv = _ring_grid(rings, sides)
    normals = vertex_normals(flat, source[faces])
    return MeshBatch(
        flat[:, source],
        normals[:, source],
        np.broadcast_to(uv, (n, *uv.shape)),
        np.clip(state[:, source], 0.0, 1.0),
        faces,
    )


def vertex_normals(vertices: NDArray[np.float64], faces: NDArray[np.intp]) -> NDArray[np.float64]:
    """`(n, v, 3)` unit normals: the mean of the faces around each vertex, weighted by area."""
    # Bodies come last in memory, so that what a face gathers from its corners lies in one piece.
    corners = np.ascontiguousarray(vertices.transpose(1, 2, 0))
    origin = corners[faces[:, 0]]
    p, q = corners[faces[:, 1]] - origin, corners[faces[:, 2]] - origin
    doubled_area = np.empty_like(p)
    for axis in range(3):
        second, third = (axis + 1) % 3, (axis + 2) % 3
        doubled_area[:, axis] = p[:, second] * q[:, third] - p[:, third] * q[:, second]
    # The k-th face of every vertex that has so many, k = 0, 1, ...
    order = np.argsort(faces, axis=None, kind="stable")
    ends = np.searchsorted(faces.ravel()[order], np.arange(vertices.shape[1] + 1))
    around = order // 3
    total = np.zeros_like(corners)
    for k in range(int(np.diff(ends).max(initial=0))):
        there = np.flatnonzero(np.diff(ends) > k)
        total[there] += doubled_area[around[ends[there] + k]]
    length = np.sqrt(np.einsum("vin,vin->vn", total, total))
    total /= np.where(length > 0.0, length, 1.0)[:, None]
    return np.ascontiguousarray(total.transpose(2, 0, 1))


@lru_cache(maxsize=64)
def ring_faces(rings: int, sides: int) -> NDArray[np.intp]:
    """`(f, 3)` of a closed body: a first point, `rings` rows of `sides + 1` vertices, and a last point.

    In each row the last vertex lies on the first: the seam, where u jumps from 1 to 0.
    """
    row, column = np.mgrid[0:rings, 0 : sides + 1]
    last = 1 + rings * (sides + 1)
    corner = (1 + row * (sides + 1) + column)[:, :-1]
    a, b, d, c = corner[:-1], corner[:-1] + 1, corner[1:], corner[1:] + 1
    return np.concatenate(
        [
            np.stack([np.zeros(sides, dtype=np.intp), corner[0] + 1, corner[0]], axis=1),
            np.stack([a, b, c], axis=-1).reshape(-1, 3),
            np.stack([a, c, d], axis=-1).reshape(-1, 3),
            np.stack([np.full(sides, last), corner[-1], corner[-1] + 1], axis=1),
        ]
    )


def ring_uv(heights: NDArray[np.float64], sides: int) -> NDArray[np.float64]:
    """`(v, 2)` of the vertices of `ring_faces`: u around, v as given for each row, 0 and 1 at the ends."""
    row, column = np.mgrid[0 : len(heights), 0 : sides + 1]
    u, v = (column / sides).ravel(), heights[row].ravel()
    return np.stack([np.concatenate([[0.5], u, [0.5]]), np.concatenate([[0.0], v, [1.0]])], axis=1)


@lru_cache(maxsize=64)
def _ring_grid(rings: int, sides: int) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Which ring point each vertex is, the faces, and uv."""
    row, column = np.mgrid[0:rings, 0 : sides + 1]
    source = np.concatenate([[0], (1 + row * sides + column % sides).ravel(), [1 + rings * sides]])
    return source, ring_faces(rings, sides), ring_uv(np.arange(1, rings + 1) / (rings + 1), sides)


def single(bodies: MeshBatch, organ_class: OrganClass, kind: str, surface: str) -> Mesh:
    """The first of the bodies as a mesh of its own.

    Args:
        bodies: as the shape makers return them.
        organ_class: class of all its faces.
        kind: its instance's kind.
        surface: name of its surface.
    """
    return single_instance_mesh(
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
    return single_instance_mesh(
        vertices, normals, uv, state, np.asarray(body.faces), organ_class, "sphere", surface
    )


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
    return single_instance_mesh(vertices, normals, uv, state, faces, organ_class, "rectangle", surface)


def single_instance_mesh(
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

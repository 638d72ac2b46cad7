"""A scanned surface as one closed body: simplified, and cleaned of what scanners and programs leave."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from pepperscene.errors import InputError
from pepperscene.geometry.fruit.scan_triangles import ALLOWED_SCAN
from pepperscene.geometry.mesh import FloatArray, IndexArray

if TYPE_CHECKING:
    import trimesh

MAX_TRIANGLES: Final = 25_000
"""Of one scanned fruit; chosen: twelve times a modelled one; points are 1.4 mm apart on a fruit of 80 mm."""

_DECIMALS: Final = 6  # of the greatest extent, to which points are equal; chosen: a tenth of a micrometre
_SIMPLIFICATIONS: Final = 5  # chosen: two suffice for the poles of a sphere of a thousand meridians
_DEBRIS: Final = 0.1  # chosen: loose parts below this fraction of the largest one's area are dropped
_HOLE: Final = 0.15  # chosen: holes up to this fraction of the greatest extent are closed
_FLAT: Final = 0.02  # chosen: least extent over the greatest; the slimmest peppers have a tenth


def simplify_scan(path: Path, vertices: FloatArray, faces: IndexArray) -> tuple[FloatArray, IndexArray]:
    """Return the surface itself, or a simplified one if it has too many triangles.

    It comes before cleaning, which takes a minute for a million triangles. The method is that of Garland &
    Heckbert 1997, "Surface simplification using quadric error metrics".

    Raises:
        InputError: the surface is flat, or the package fast-simplification is not installed.
    """
    if len(faces) <= MAX_TRIANGLES:
        return vertices, faces
    try:
        from fast_simplification import simplify
    except ImportError:
        problem = (
            f"has {len(faces):,} triangles, and {MAX_TRIANGLES:,} are used; "
            "`pip install 'pepperscene[scan]'` installs what simplifies it"
        )
        raise InputError(path, problem) from None
    import trimesh

    # In units of its size, because the package computes in single precision; with equal points merged.
    low, extent = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    if not extent > 0.0:
        raise InputError(path, f"is flat; {ALLOWED_SCAN}")
    mesh = trimesh.Trimesh((vertices - low) / extent, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=_DECIMALS)
    mesh.update_faces((mesh.faces != np.roll(mesh.faces, 1, axis=1)).all(axis=1))
    points, triangles = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    # It can stop early on needles, and goes on when it starts again.
    for _ in range(_SIMPLIFICATIONS):
        fraction = 1.0 - MAX_TRIANGLES / max(len(triangles), MAX_TRIANGLES + 1)
        points, triangles = simplify(points, triangles, target_reduction=fraction)
        if len(triangles) <= MAX_TRIANGLES:
            return low + extent * points.astype(float), triangles.astype(np.intp)
    problem = (
        f"cannot be simplified to {MAX_TRIANGLES:,} triangles, only to {len(triangles):,}: remesh it before"
    )
    raise InputError(path, problem)


@dataclass(frozen=True, eq=False)
class CleanBody:
    """One closed body with its faces outwards, its middle at the origin and its greatest extent 1."""

    mesh: trimesh.Trimesh
    middle: FloatArray  # `(3,)` of the surface as it was
    extent: float  # its greatest


def clean_scan(path: Path, vertices: FloatArray, faces: IndexArray) -> CleanBody:
    """Merge equal points, drop degenerate triangles and debris, close small holes, turn faces outwards.

    Raises:
        InputError: the surface is flat, has several parts or a large hole, or is still not closed.
    """
    import trimesh

    no_triangles = InputError(path, f"has no triangle of three different corners; {ALLOWED_SCAN}")
    if len(faces) == 0:
        raise no_triangles
    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    extent = high - low
    if not extent.min() > _FLAT * extent.max():
        raise InputError(path, f"is flat; {ALLOWED_SCAN}")
    middle, size = 0.5 * (low + high), float(extent.max())
    mesh = trimesh.Trimesh((vertices - middle) / size, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=_DECIMALS)
    # Needles without area stay if their three points differ: without them the surface would be open.
    distinct = (mesh.faces != np.roll(mesh.faces, 1, axis=1)).all(axis=1)
    mesh.update_faces(distinct & mesh.unique_faces())
    if len(mesh.faces) == 0:
        raise no_triangles
    _keep_largest(path, mesh)
    trimesh.repair.fix_winding(mesh)
    mesh = _close_holes(path, mesh)
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        raise InputError(path, f"is not closed, or three triangles share an edge; {ALLOWED_SCAN}")
    if mesh.volume < 0.0:
        mesh.invert()
    if not mesh.volume > _FLAT * float(np.prod(mesh.extents)):
        raise InputError(path, f"encloses no volume; {ALLOWED_SCAN}")
    return CleanBody(mesh, middle, size)


def _keep_largest(path: Path, mesh: trimesh.Trimesh) -> None:
    """Drop loose debris; refuse a second part that is too large for debris."""
    import trimesh

    part = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    area = np.bincount(part, weights=mesh.area_faces)
    ascending = np.sort(area)
    if len(area) > 1 and ascending[-2] > _DEBRIS * ascending[-1]:
        size = f"{ascending[-2] / ascending[-1]:.0%}"
        raise InputError(path, f"has several parts, the second {size} as large as the first; {ALLOWED_SCAN}")
    mesh.update_faces(part == np.argmax(area))
    mesh.remove_unreferenced_vertices()


def _close_holes(path: Path, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with a fan of triangles around the centre of each small hole; trimesh's have no centre."""
    import trimesh

    single = trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)
    if len(single) == 0:
        return mesh
    edges = mesh.edges[single]
    loop = trimesh.graph.connected_component_labels(edges, node_count=len(mesh.vertices))[edges[:, 0]]
    vertices, faces = [mesh.vertices], [mesh.faces]
    for number, label in enumerate(np.unique(loop)):
        rim = edges[loop == label]
        points = mesh.vertices[rim[:, 0]]
        width = float(np.ptp(points, axis=0).max())
        if width > _HOLE:
            size = f"{width:.0%} of its size, and holes are closed up to {_HOLE:.0%}"
            raise InputError(path, f"has a hole of {size}; {ALLOWED_SCAN}")
        vertices.append(points.mean(axis=0, keepdims=True))
        # A new triangle runs along the edge of the hole the other way than the old one.
        middle = np.full(len(rim), len(mesh.vertices) + number)
        faces.append(np.stack([rim[:, 1], rim[:, 0], middle], axis=1))
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)

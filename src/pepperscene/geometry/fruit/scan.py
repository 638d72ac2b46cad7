"""Scanned fruit: a mesh out of a file, cleaned and brought to unit size, so that any fruit can wear it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.geometry.fruit.crown import CROWN, CROWN_COLUMNS, CROWN_STEPS

if TYPE_CHECKING:
    import trimesh


FloatArray = NDArray[np.float64]

FORMATS: Final = (".obj", ".ply", ".stl")
MOST_TRIANGLES: Final = 25_000
"""Of one scanned fruit; chosen: twelve times a modelled one; points lie 1.4 mm apart on a fruit of 80 mm."""

_FINE: Final = (
    6  # decimals of the greatest extent by which points are the same; chosen: a tenth of a micrometre
)
_DEBRIS: Final = 0.1  # chosen: loose parts below this share of the largest one's area are dropped
_HOLE: Final = 0.15  # chosen: holes up to this share of the greatest extent are closed
_FLAT: Final = 0.02  # chosen: least extent over the greatest; the slimmest peppers have a tenth
_ALLOWED: Final = "a scanned fruit must be an OBJ, PLY or STL file with one closed surface, z up at its stalk"


@dataclass(frozen=True, eq=False)
class Scan:
    """A closed fruit of length 1 and greatest diameter 1, the stalk's foot at the origin.

    Attributes:
        points: `(v, 3)` up, to the right and along, as `fruit.Frames` has them; the shoulders lie below zero.
        normals: `(v, 3)` unit, outwards.
        uv: `(v, 2)` u around from the upper side, v the angle at the middle from the stalk, over pi.
        faces: `(f, 3)` counter-clockwise seen from outside.
        reach: `(c,)` how far from the axis the crown goes at c equal angles.
        crown: `(q, c)` along, at q equal steps of the radius from 0 to the reach.
    """

    points: FloatArray
    normals: FloatArray
    uv: FloatArray
    faces: NDArray[np.intp]
    reach: FloatArray
    crown: FloatArray


def load_scan(path: Path) -> Scan:
    """A scanned fruit, read once for as long as its file stays the same.

    The file's z axis is the fruit's, its stalk end on top and the stalk itself cut off; units and place do
    not matter. Equal points are merged, degenerate and double triangles and loose crumbs dropped, small
    holes closed, faces turned outwards. Above 25,000 triangles it is simplified if the package
    fast-simplification is there (Garland & Heckbert 1997, "Surface simplification using quadric error
    metrics").

    Raises:
        InputError: there is no such file, it cannot be read, or what is left is not one closed body.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(path, _ALLOWED)
    try:
        told = path.stat()
    except OSError:
        raise InputError(path, f"there is no such file; {_ALLOWED}") from None
    return _scan(path, told.st_mtime_ns, told.st_size)


@lru_cache(maxsize=16)
def _scan(path: Path, _changed_ns: int, _size: int) -> Scan:
    """The scan in a file of that age and size."""
    vertices, faces = _triangles(path)
    mesh = _small_enough(path, _cleaned(path, vertices, faces))
    return _unit_sized(
        path, np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.intp), mesh
    )


def _triangles(path: Path) -> tuple[FloatArray, NDArray[np.intp]]:
    """All triangles of the file, whatever its groups and materials."""
    import trimesh

    try:
        read = trimesh.load(path, process=False, skip_materials=True)
    except Exception as fault:  # readers of many formats raise what they like
        raise InputError(path, f"cannot be read as a mesh ({fault}); {_ALLOWED}") from fault
    bodies = list(read.geometry.values()) if isinstance(read, trimesh.Scene) else [read]
    bodies = [body for body in bodies if len(getattr(body, "faces", ())) > 0]
    if not bodies:
        raise InputError(path, f"has no triangles; {_ALLOWED}")
    offsets = np.cumsum([0, *(len(body.vertices) for body in bodies)])
    faces = [
        np.asarray(body.faces, dtype=np.intp) + first for body, first in zip(bodies, offsets, strict=False)
    ]
    return np.concatenate([np.asarray(body.vertices, dtype=float) for body in bodies]), np.concatenate(faces)


def _cleaned(path: Path, vertices: FloatArray, faces: NDArray[np.intp]) -> trimesh.Trimesh:
    """One closed body with its faces outwards, its middle at the origin and its greatest extent 1."""
    import trimesh

    used = vertices[np.unique(faces)]
    if not np.all(np.isfinite(used)):
        raise InputError(path, f"has points that are not finite numbers; {_ALLOWED}")
    low, high = used.min(axis=0), used.max(axis=0)
    extent = high - low
    if not extent.min() > _FLAT * extent.max():
        raise InputError(path, f"is flat; {_ALLOWED}")
    mesh = trimesh.Trimesh((vertices - 0.5 * (low + high)) / extent.max(), faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=_FINE)
    # Needles of no area are kept where their three points differ: without them the surface would be open.
    three = np.array([len(set(face)) == 3 for face in mesh.faces.tolist()], dtype=bool)
    mesh.update_faces(three & mesh.unique_faces())
    _keep_largest(path, mesh)
    trimesh.repair.fix_winding(mesh)
    mesh = _closed(path, mesh)
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        raise InputError(path, f"is not closed, or triangles share an edge by three; {_ALLOWED}")
    if mesh.volume < 0.0:
        mesh.invert()
    if not mesh.volume > _FLAT * float(np.prod(mesh.extents)):
        raise InputError(path, f"encloses no volume; {_ALLOWED}")
    return mesh


def _keep_largest(path: Path, mesh: trimesh.Trimesh) -> None:
    """Drop loose crumbs; a second part of some size is not a crumb."""
    import trimesh

    part = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    area = np.sort(np.bincount(part, weights=mesh.area_faces))
    if len(area) > 1 and area[-2] > _DEBRIS * area[-1]:
        size = f"{area[-2] / area[-1]:.0%}"
        raise InputError(path, f"has several parts, the second {size} as large as the first; {_ALLOWED}")
    mesh.update_faces(part == np.argmax(np.bincount(part, weights=mesh.area_faces)))
    mesh.remove_unreferenced_vertices()


def _closed(path: Path, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with a fan of triangles over each small hole."""
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
            raise InputError(path, f"has a hole of {size}; {_ALLOWED}")
        vertices.append(points.mean(axis=0, keepdims=True))
        # A new triangle runs along the hole's edge the other way than the old one.
        middle = np.full(len(rim), len(mesh.vertices) + number)
        faces.append(np.stack([rim[:, 1], rim[:, 0], middle], axis=1))
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)


def _small_enough(path: Path, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh itself, or a simpler one where it is too fine."""
    count = len(mesh.faces)
    if count <= MOST_TRIANGLES:
        return mesh
    try:
        simple = mesh.simplify_quadric_decimation(face_count=MOST_TRIANGLES)
    except ImportError:
        size = f"{count} triangles, and {MOST_TRIANGLES} are allowed"
        problem = f"has {size}; with the package fast-simplification installed it would be simplified"
        raise InputError(path, problem) from None
    return _cleaned(path, np.asarray(simple.vertices, dtype=float), np.asarray(simple.faces, dtype=np.intp))


def _unit_sized(path: Path, vertices: FloatArray, faces: NDArray[np.intp], mesh: trimesh.Trimesh) -> Scan:
    """The scan about its axis, which runs down through the body's centre of mass."""
    # Up, to the right and along: x, -y and -z of the file.
    points = (vertices - mesh.center_mass) * [1.0, -1.0, -1.0]
    points[:, 2] /= np.ptp(points[:, 2])
    points[:, :2] /= _diameter(points)
    foot = _surface_above(points[faces], np.zeros((1, 2)))[0]
    if not np.isfinite(foot):
        raise InputError(path, f"has no surface over its middle; {_ALLOWED}")
    points[:, 2] -= foot
    normals = _normals(points, faces)
    points, normals, uv, faces = _with_seam(points, normals, faces)
    reach, crown = _crown(points, faces)
    return Scan(points, normals, uv, faces, reach, crown)


def _diameter(points: FloatArray) -> float:
    """Greatest width of a body seen along its axis."""
    from scipy.spatial import ConvexHull

    hull = points[ConvexHull(points[:, :2]).vertices, :2]
    return float(np.linalg.norm(hull[:, None] - hull, axis=2).max())


def _normals(points: FloatArray, faces: NDArray[np.intp]) -> FloatArray:
    """`(v, 3)` means of the normals of the faces around each point, weighted by their angles there."""
    import trimesh

    return np.array(trimesh.Trimesh(points, faces, process=False).vertex_normals, dtype=float)


def _with_seam(
    points: FloatArray, normals: FloatArray, faces: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.intp]]:
    """The mesh with surface coordinates; points beyond the seam are doubled and get u = 1.

    The triangles that the seam runs through are not cut: on them u is off by up to their own width.
    """
    u = np.mod(np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi), 1.0)
    middle = 0.5 * (points[:, 2].min() + points[:, 2].max())
    v = np.arctan2(np.hypot(points[:, 0], points[:, 1]), middle - points[:, 2]) / np.pi
    around = u[faces]
    crossing = np.ptp(around, axis=1) > 0.5
    beyond = crossing[:, None] & (around < 0.5)
    doubled, place = np.unique(faces[beyond], return_inverse=True)
    seamed = faces.copy()
    seamed[beyond] = len(points) + place
    # A point that only faces beyond the seam use is not left behind.
    kept, seamed = np.unique(seamed, return_inverse=True)
    uv = np.stack([np.append(u, np.ones(len(doubled))), np.append(v, v[doubled])], axis=1)
    both = np.append(np.arange(len(points)), doubled)[kept]
    return points[both], normals[both], uv[kept], seamed.reshape(-1, 3)


def _crown(points: FloatArray, faces: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """How far the side that faces the stalk goes at each angle, and its heights."""
    angle = 2.0 * np.pi * np.arange(CROWN_COLUMNS) / CROWN_COLUMNS
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    triangles = points[faces]
    # The outline by steps of a hundredth of the diameter, then the heights within it.
    tried = np.arange(1, 100) / 100.0
    hit = np.isfinite(_surface_above(triangles, (tried[:, None, None] * direction).reshape(-1, 2)))
    inside = np.logical_and.accumulate(hit.reshape(len(tried), -1), axis=0)
    reach = CROWN * np.maximum(inside.sum(axis=0), 1) / 100.0
    steps = np.arange(CROWN_STEPS + 1) / CROWN_STEPS
    grid = (steps[:, None] * reach)[..., None] * direction
    found = _surface_above(triangles, grid.reshape(-1, 2)).reshape(len(steps), -1)
    # A grid point that falls between two triangles takes its neighbour's height.
    for row in range(1, len(found)):
        found[row] = np.where(np.isfinite(found[row]), found[row], found[row - 1])
    return reach, found


def _surface_above(triangles: FloatArray, places: FloatArray) -> FloatArray:
    """`(m,)` least `along` where lines through `(m, 2)` places meet triangles; infinity where none do."""
    # Only what faces the stalk can be met first.
    a, b, c = (triangles[:, corner] for corner in range(3))
    doubled = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    facing = doubled < 0.0
    a, b, c, doubled = a[facing], b[facing], c[facing], doubled[facing]
    found = np.full(len(places), np.inf)
    for start in range(0, len(places), 64):
        p = places[start : start + 64, None]
        weight_b = (p[..., 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (p[..., 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        weight_c = (b[:, 0] - a[:, 0]) * (p[..., 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (p[..., 0] - a[:, 0])
        weight_b, weight_c = weight_b / doubled, weight_c / doubled
        inside = (weight_b >= -1e-9) & (weight_c >= -1e-9) & (weight_b + weight_c <= 1.0 + 1e-9)
        along = a[:, 2] + weight_b * (b[:, 2] - a[:, 2]) + weight_c * (c[:, 2] - a[:, 2])
        found[start : start + 64] = np.where(inside, along, np.inf).min(axis=1, initial=np.inf)
    return found

"""Scanned fruit: a mesh from a file, cleaned and scaled to unit size, which any fruit can use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from pepperscene.cultivar.organs import ScanAxis
from pepperscene.errors import InputError
from pepperscene.geometry.batch import MeshBatch, read_positive
from pepperscene.geometry.fruit.fruits import (
    SHOULDER_COLUMNS,
    SHOULDER_EXTENT,
    SHOULDER_STEPS,
    Shoulders,
    fruit_frames,
    ripeness,
)
from pepperscene.geometry.fruit.scan_file import ALLOWED_SCAN, FORMATS, read_triangles
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.geometry.spine import normalize
from pepperscene.grammar.plant import Organ

if TYPE_CHECKING:
    import trimesh

MAX_TRIANGLES: Final = 25_000
"""Of one scanned fruit; chosen: twelve times a modelled one; points are 1.4 mm apart on a fruit of 80 mm."""

_DECIMALS: Final = 6  # of the greatest extent, to which points are equal; chosen: a tenth of a micrometre
_DEBRIS: Final = 0.1  # chosen: loose parts below this fraction of the largest one's area are dropped
_HOLE: Final = 0.15  # chosen: holes up to this fraction of the greatest extent are closed
_FLAT: Final = 0.02  # chosen: least extent over the greatest; the slimmest peppers have a tenth


_UPRIGHT: Final[dict[ScanAxis, FloatArray]] = {
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "-x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
}
"""Rotations that turn an axis of the file up."""


@dataclass(frozen=True, eq=False)
class Scan:
    """A closed fruit of length 1 and greatest diameter 1, the stalk's foot at the origin."""

    points: FloatArray  # `(v, 3)` up, right and along, as in `FruitFrames`; the shoulders are below zero
    normals: FloatArray  # `(v, 3)` unit, outwards
    uv: FloatArray  # `(v, 2)` u around from the upper side, v the angle at the middle from the stalk, over pi
    faces: IndexArray  # `(f, 3)` counter-clockwise seen from outside
    shoulders: Shoulders  # of this one fruit


def mesh_scanned_fruits(organs: Sequence[Organ], scan: Scan) -> MeshBatch:
    """Build fruit that all use one scan, each stretched to its own length and diameter.

    Measures: length_m (along the axis), diameter_m, ripeness, ripeness_spread, seed.
    """
    length, diameter = read_positive(organs, "length_m"), read_positive(organs, "diameter_m")
    stretch = np.stack([diameter, diameter, length], axis=1)[:, None]
    frames = fruit_frames(organs)
    local = scan.points * stretch
    return MeshBatch(
        frames.to_plant(local),
        # Normals transform with the inverse of the stretch.
        normalize(scan.normals / stretch) @ frames.axes,
        np.broadcast_to(scan.uv, (len(organs), *scan.uv.shape)),
        np.clip(ripeness(organs, local / (0.5 * diameter)[:, None, None]), 0.0, 1.0),
        scan.faces,
    )


def scan_shoulders(organs: Sequence[Organ], scan: Scan) -> Shoulders:
    """Scale the shoulders of a scan to the fruit that use it."""
    length, diameter = read_positive(organs, "length_m"), read_positive(organs, "diameter_m")
    return Shoulders(diameter[:, None] * scan.shoulders.extent, length[:, None, None] * scan.shoulders.along)


def load_scan(path: Path, up: ScanAxis = "z") -> Scan:
    """Load a scanned fruit; it is cached until its file changes.

    Units and position do not matter. Equal points are merged, degenerate and duplicate triangles and loose
    debris dropped, small holes closed, faces turned outwards. Above 25,000 triangles it is simplified by the
    package fast-simplification (Garland & Heckbert 1997, "Surface simplification using quadric error
    metrics").

    Args:
        path: OBJ, PLY or STL file, with the stalk cut off.
        up: axis of the file that points to the stalk end.

    Raises:
        InputError: the file does not exist, cannot be read, is not one closed body after cleaning, or has too
            many triangles and the extra `scan` is not installed.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(path, ALLOWED_SCAN)
    try:
        status = path.stat()
    except OSError:
        raise InputError(path, f"there is no such file; {ALLOWED_SCAN}") from None
    return _load(path, up, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)
def _load(path: Path, up: ScanAxis, _changed_ns: int, _size: int) -> Scan:
    """The scan in a file of that modification time and size."""
    vertices, faces = read_triangles(path)
    return _unit_size(path, _clean(path, *_simplify(path, vertices @ _UPRIGHT[up].T, faces)))


def _clean(path: Path, vertices: FloatArray, faces: IndexArray) -> trimesh.Trimesh:
    """One closed body with its faces outwards, its middle at the origin and its greatest extent 1."""
    import trimesh

    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    extent = high - low
    if not extent.min() > _FLAT * extent.max():
        raise InputError(path, f"is flat; {ALLOWED_SCAN}")
    mesh = trimesh.Trimesh((vertices - 0.5 * (low + high)) / extent.max(), faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=_DECIMALS)
    # Needles without area stay if their three points differ: without them the surface would be open.
    distinct = (mesh.faces != np.roll(mesh.faces, 1, axis=1)).all(axis=1)
    mesh.update_faces(distinct & mesh.unique_faces())
    _keep_largest(path, mesh)
    trimesh.repair.fix_winding(mesh)
    mesh = _close_holes(path, mesh)
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        raise InputError(path, f"is not closed, or three triangles share an edge; {ALLOWED_SCAN}")
    if mesh.volume < 0.0:
        mesh.invert()
    if not mesh.volume > _FLAT * float(np.prod(mesh.extents)):
        raise InputError(path, f"encloses no volume; {ALLOWED_SCAN}")
    return mesh


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


def _simplify(path: Path, vertices: FloatArray, faces: IndexArray) -> tuple[FloatArray, IndexArray]:
    """The surface itself, or a simplified one if it has too many triangles.

    It comes before cleaning, which takes a minute for a million triangles.
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
    fraction = 1.0 - MAX_TRIANGLES / max(len(mesh.faces), MAX_TRIANGLES + 1)
    points, triangles = simplify(
        np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32), target_reduction=fraction
    )
    return low + extent * points.astype(float), triangles.astype(np.intp)


def _unit_size(path: Path, mesh: trimesh.Trimesh) -> Scan:
    """The scan about its axis, which runs down through the body's centre of mass."""
    import trimesh
    from scipy.spatial import ConvexHull

    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.intp)
    # Up, right and along are x, -y and -z of the file.
    points = (vertices - mesh.center_mass) * [1.0, -1.0, -1.0]
    points[:, 2] /= np.ptp(points[:, 2])
    hull = points[ConvexHull(points[:, :2]).vertices, :2]
    points[:, :2] /= float(np.linalg.norm(hull[:, None] - hull, axis=2).max())
    foot = _first_hits(points[faces], np.zeros((1, 2)))[0]
    if not np.isfinite(foot):
        raise InputError(path, f"has no surface over its middle; {ALLOWED_SCAN}")
    points[:, 2] -= foot
    normals = np.array(trimesh.Trimesh(points, faces, process=False).vertex_normals, dtype=float)
    points, normals, uv, faces = _add_seam(points, normals, faces)
    return Scan(points, normals, uv, faces, _shoulders(points[faces]))


def _add_seam(
    points: FloatArray, normals: FloatArray, faces: IndexArray
) -> tuple[FloatArray, FloatArray, FloatArray, IndexArray]:
    """The mesh with surface coordinates; points beyond the seam are duplicated and get u = 1.

    Triangles across the seam are not cut: on them u is off by up to their own width.
    """
    u = np.mod(np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi), 1.0)
    middle = 0.5 * (points[:, 2].min() + points[:, 2].max())
    v = np.arctan2(np.hypot(points[:, 0], points[:, 1]), middle - points[:, 2]) / np.pi
    face_u = u[faces]
    crossing = np.ptp(face_u, axis=1) > 0.5
    beyond = crossing[:, None] & (face_u < 0.5)
    duplicated, position = np.unique(faces[beyond], return_inverse=True)
    new_faces = faces.copy()
    new_faces[beyond] = len(points) + position
    # Drop points that only faces beyond the seam used.
    kept, new_faces = np.unique(new_faces, return_inverse=True)
    uv = np.stack([np.append(u, np.ones(len(duplicated))), np.append(v, v[duplicated])], axis=1)
    source = np.append(np.arange(len(points)), duplicated)[kept]
    return points[source], normals[source], uv[kept], new_faces.reshape(-1, 3)


def _shoulders(triangles: FloatArray) -> Shoulders:
    """The shoulders of the unit fruit."""
    angle = 2.0 * np.pi * np.arange(SHOULDER_COLUMNS) / SHOULDER_COLUMNS
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # The outline in steps of a hundredth of the diameter, then the surface within it.
    radii = np.arange(1, 100) / 100.0
    hit = np.isfinite(_first_hits(triangles, (radii[:, None, None] * direction).reshape(-1, 2)))
    inside = np.logical_and.accumulate(hit.reshape(len(radii), -1), axis=0)
    extent = SHOULDER_EXTENT * np.maximum(inside.sum(axis=0), 1) / 100.0
    steps = np.arange(SHOULDER_STEPS + 1) / SHOULDER_STEPS
    grid = (steps[:, None] * extent)[..., None] * direction
    along = _first_hits(triangles, grid.reshape(-1, 2)).reshape(len(steps), -1)
    # A grid point that falls between two triangles gets the depth of its inner neighbour.
    for row in range(1, len(along)):
        along[row] = np.where(np.isfinite(along[row]), along[row], along[row - 1])
    return Shoulders(extent[None], along[None])


def _first_hits(triangles: FloatArray, positions: FloatArray) -> FloatArray:
    """`(m,)` least `along` where lines parallel to the axis at `(m, 2)` meet triangles, or infinity."""
    # Only triangles that face the stalk can be met first.
    a, b, c = (triangles[:, corner] for corner in range(3))
    doubled = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    facing = doubled < 0.0
    a, b, c, doubled = a[facing], b[facing], c[facing], doubled[facing]
    result = np.full(len(positions), np.inf)
    for start in range(0, len(positions), 64):
        p = positions[start : start + 64, None]
        weight_b = (p[..., 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (p[..., 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        weight_c = (b[:, 0] - a[:, 0]) * (p[..., 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (p[..., 0] - a[:, 0])
        weight_b, weight_c = weight_b / doubled, weight_c / doubled
        inside = (weight_b >= -1e-9) & (weight_c >= -1e-9) & (weight_b + weight_c <= 1.0 + 1e-9)
        along = a[:, 2] + weight_b * (b[:, 2] - a[:, 2]) + weight_c * (c[:, 2] - a[:, 2])
        result[start : start + 64] = np.where(inside, along, np.inf).min(axis=1, initial=np.inf)
    return result

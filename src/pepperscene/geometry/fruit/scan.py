"""Scanned fruit: a mesh from a file, cleaned and scaled to unit size, which any fruit can use."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.cultivar.organs import SCAN_SUFFIXES, UNIT_M, FruitScans, ScanAxis, ScanUnit
from pepperscene.errors import InputError
from pepperscene.geometry.batch import MeshBatch, hash_uniform, read_measure, read_positive
from pepperscene.geometry.fruit.fruits import (
    SHOULDER_COLUMNS,
    SHOULDER_EXTENT,
    SHOULDER_STEPS,
    Shoulders,
    fruit_frames,
    ripeness,
)
from pepperscene.geometry.fruit.scan_clean import CleanBody, clean_scan, simplify_scan
from pepperscene.geometry.fruit.scan_file import read_triangles
from pepperscene.geometry.fruit.scan_triangles import ALLOWED_SCAN
from pepperscene.geometry.mesh import FloatArray, IndexArray, SingleArray
from pepperscene.geometry.spine import normalize
from pepperscene.grammar.plant import Organ

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
    diameter: float  # of the body in the file's unit
    colours: SingleArray | None = None  # `(v, 3)` linear sRGB, or None if they are not used


_WHICH_SCAN: Final = 341  # salt


def choose_scans(organs: Sequence[Organ], scans: FruitScans) -> list[Path]:
    """Choose the file of each fruit by the weights; it depends on the seed of the fruit alone."""
    if len(scans.files) == 1:
        return [scans.files[0]] * len(organs)
    weights = np.array(scans.weights or [1.0] * len(scans.files))
    bounds = np.cumsum(weights[:-1]) / weights.sum()
    chance = hash_uniform(read_measure(organs, "seed", 0.0), _WHICH_SCAN, 1)[:, 0]
    return [scans.files[number] for number in np.searchsorted(bounds, chance, side="right")]


def mesh_scanned_fruits(organs: Sequence[Organ], scan: Scan) -> MeshBatch:
    """Build fruit that all use one scan, each stretched to its own length and diameter.

    Measures: length_m (along the axis), diameter_m, ripeness, ripeness_spread, seed.
    """
    length, diameter = read_positive(organs, "length_m"), read_positive(organs, "diameter_m")
    stretch = np.stack([diameter, diameter, length], axis=1)[:, None]
    frames = fruit_frames(organs)
    local, colour = scan.points * stretch, None
    if scan.colours is not None:
        colour = np.broadcast_to(scan.colours, (len(organs), *scan.colours.shape))
    return MeshBatch(
        frames.to_plant(local),
        # Normals transform with the inverse of the stretch.
        normalize(scan.normals / stretch) @ frames.axes,
        np.broadcast_to(scan.uv, (len(organs), *scan.uv.shape)),
        np.clip(ripeness(organs, local / (0.5 * diameter)[:, None, None]), 0.0, 1.0),
        scan.faces,
        colour,
    )


def scan_shoulders(organs: Sequence[Organ], scan: Scan) -> Shoulders:
    """Scale the shoulders of a scan to the fruit that use it."""
    length, diameter = read_positive(organs, "length_m"), read_positive(organs, "diameter_m")
    return Shoulders(diameter[:, None] * scan.shoulders.extent, length[:, None, None] * scan.shoulders.along)


def load_scan(path: Path, up: ScanAxis | None = None, *, colour: bool = False) -> Scan:
    """Load a scanned fruit; it is cached until its file changes.

    Units and position do not matter. Equal points are merged, degenerate and duplicate triangles and loose
    debris dropped, small holes closed, faces turned outwards. Above 25,000 triangles it is simplified.

    Args:
        path: GLB, OBJ, PLY or STL file, with the stalk cut off.
        up: axis of the file that points to the stalk end; None for y in a GLB and z in other files.
        colour: whether to read its colours.

    Raises:
        InputError: the file does not exist, cannot be read, is not one closed body after cleaning, has no
            colours, is too large, or has many triangles and the extra `scan` is not installed.
    """
    if path.suffix.lower() not in SCAN_SUFFIXES:
        raise InputError(path, ALLOWED_SCAN)
    try:
        status = path.stat()
    except (OSError, ValueError):
        raise InputError(path, f"there is no such file; {ALLOWED_SCAN}") from None
    if up is None:
        up = "y" if path.suffix.lower() == ".glb" else "z"
    try:
        return _load(path, up, colour, status.st_mtime_ns, status.st_size)
    except MemoryError:
        raise InputError(path, "needs more memory than there is: simplify it before") from None


def check_unit(path: Path, scan: Scan, unit: ScanUnit, diameter_m: float) -> None:
    """Check that a scan has the order of magnitude of the fruit that use it.

    Raises:
        InputError: its diameter is off by more than half a decade; the message names the unit that fits.
    """

    def decades(unit: ScanUnit) -> float:
        return abs(math.log10(scan.diameter * UNIT_M[unit] / diameter_m))

    if decades(unit) <= 0.5:
        return
    likely = min(UNIT_M, key=decades)
    advice = "no unit fits: scale the file, or leave scan_unit out to use its shape alone"
    if decades(likely) <= 0.5:
        size = f"{1e3 * scan.diameter * UNIT_M[likely]:.3g} mm"
        advice = f'it is probably in {likely}, {size}: set scan_unit = "{likely}"'
    fruit = f"fruit of this kind {1e3 * diameter_m:.3g} mm on average"
    raise InputError(path, f"has a diameter of {scan.diameter:.3g} {unit}, and {fruit}; {advice}")


@lru_cache(maxsize=16)
def _load(path: Path, up: ScanAxis, colour: bool, _changed_ns: int, _size: int) -> Scan:
    """The scan in a file of that modification time and size."""
    read = read_triangles(path, colour=colour)
    if colour and read.colours is None:
        problem = (
            "has no colours, which scan_colour asks for: save it as PLY, OBJ or GLB with coloured points, "
            "or as GLB with its texture"
        )
        raise InputError(path, problem)
    upright = read.vertices @ _UPRIGHT[up].T
    # The volume of a surface may be 0 or beyond a number, which is refused.
    with np.errstate(all="ignore"):
        body = clean_scan(path, *simplify_scan(path, upright, read.faces))
    colours = None
    if read.colours is not None:
        used = np.unique(read.faces)
        points = np.asarray(body.mesh.vertices) * body.extent + body.middle
        colours = _transfer_colours(points, upright[used], read.colours[used])
    return _unit_size(path, body, colours)


def _transfer_colours(points: FloatArray, scanned: FloatArray, colours: FloatArray) -> SingleArray:
    """Return `(v, 3)` colours of points: the mean of those of the scanned points nearest to each.

    A point that is nearest to none, such as the centre of a closed hole, has the colour of the scanned point
    nearest to it.

    Args:
        points: `(v, 3)` in the coordinates of the scanned ones.
        scanned: `(n, 3)`.
        colours: `(n, 3)` of the scanned points, linear.
    """
    from scipy.spatial import KDTree

    _, owner = KDTree(points).query(scanned)
    count = np.bincount(owner, minlength=len(points))
    total = [np.bincount(owner, channel, minlength=len(points)) for channel in colours.T]
    result = np.stack(total, axis=1) / np.maximum(count, 1)[:, None]
    alone = count == 0
    if alone.any():
        _, nearest = KDTree(scanned).query(points[alone])
        result[alone] = colours[nearest]
    return result.astype(np.float32)


def _unit_size(path: Path, body: CleanBody, colours: SingleArray | None) -> Scan:
    """The scan about its axis, which runs down through the body's centre of mass."""
    import trimesh
    from scipy.spatial import ConvexHull

    mesh = body.mesh
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.intp)
    # Up, right and along are x, -y and -z of the file.
    points = (vertices - mesh.center_mass) * [1.0, -1.0, -1.0]
    points[:, 2] /= np.ptp(points[:, 2])
    hull = points[ConvexHull(points[:, :2]).vertices, :2]
    diameter = float(np.linalg.norm(hull[:, None] - hull, axis=2).max())
    points[:, :2] /= diameter
    foot = _first_hits(points[faces], np.zeros((1, 2)))[0]
    if not np.isfinite(foot):
        raise InputError(path, f"has no surface over its middle; {ALLOWED_SCAN}")
    points[:, 2] -= foot
    normals = np.array(trimesh.Trimesh(points, faces, process=False).vertex_normals, dtype=float)
    source, uv, faces = _add_seam(points, faces)
    points = points[source]
    if colours is not None:
        colours = colours[source]
    shoulders = _shoulders(points[faces])
    return Scan(points, normals[source], uv, faces, shoulders, diameter * body.extent, colours)


def _add_seam(points: FloatArray, faces: IndexArray) -> tuple[IndexArray, FloatArray, IndexArray]:
    """Old number and surface coordinates of each point, and faces; points beyond the seam are added at u 1.

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
    return source, uv[kept], new_faces.reshape(-1, 3)


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

"""Culling: triangles that no view of a path can show are simplified or left out.

All poses of a path share one culled scene, so no frame depends on which others are rendered. An organ that no
pose can see, and that cannot shadow anything visible from the flash, only contributes indirect light; a
simplified organ contributes nearly the same. Far away its contribution is negligible, and it is left out.

Visible organs are never simplified, however far away, because labels must not change. An outline shift of d
pixels changes labels on d times the outline length. In `barth2018` at 800x600 that length is 0.07 per pixel,
so 0.05 % of the pixels allow a shift of 0.007 pixels. With half the grid lines, the points of a leaf move by
0.7 mm on average, which is that small only beyond 45 m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera
from pepperscene.camera.poses.generators import as_poses
from pepperscene.geometry import Mesh
from pepperscene.scene.lod import Triangles, join_triangles, simplify_organs
from pepperscene.scene.sky import SUN_ANGULAR_RADIUS

_LONG_INSTANCE: Final = 2500  # chosen: faces of what is split; twine and far rows, but no organ
_CHUNK: Final = 256  # chosen: faces of a part of a split instance, about the leaves of one node in a far row
_MAX_DAYLIGHT: Final = 0.03
"""Brightest daylight, as a fraction of the light, in which hidden organs are simplified. Chosen: they cover
some 15 % less of the sky; of 3 % of the light that is half a per cent, half a code at middle grey if there
were nothing else overhead."""

LIGHT_TOLERANCE: Final = 1e-3
"""Largest total change by everything that is left out, as a fraction of the light at the path's distance.
Chosen: a twentieth of an 8-bit code at middle grey."""


@dataclass(frozen=True)
class LightReach:
    """Light that invisible objects can shadow or scatter, as fractions of the light at the path's distance.

    Attributes:
        sky: skylight on an unobstructed level plane.
        sun: sunlight on a plane that faces the sun.
        stray: flash light just outside the image, at the path's distance.
        distance_m: distance from the path to its subject.
        flash_extent_m: distance from the projection centre to the furthest point of the flash.
    """

    sky: float
    sun: float
    stray: float
    distance_m: float
    flash_extent_m: float = 0.0


def light_reach(camera: Camera, distance_m: float, sky_lx: float, sun_lx: float = 0.0) -> LightReach:
    """Compare daylight and stray flash light with the light at the path's distance; see `LightReach`.

    A flash specified in W m-2 cannot be compared with lux: daylight then counts in full, as without a flash.
    """
    flash, (top, bottom, left, right) = camera.flash, camera.border_slopes()
    if flash is None:
        return LightReach(1.0, 1.0, 0.0, distance_m)
    # Everything outside the frustum is at least as far off the flash's axis as the nearest image border.
    slopes = top[:, 1], bottom[:, 1], left[:, 0], right[:, 0]
    # A flash that is turned may light anything with its highest intensity.
    nearest = np.arctan(min(np.abs(border).min() for border in slopes)) if flash.rotation is None else 0.0
    outside = np.linspace(nearest, np.pi / 2.0, 65)
    stray = float(np.max(flash.profile.at(outside)))
    extent = float(np.linalg.norm(flash.emitter_positions(), axis=1).max()) + flash.radius_m
    if flash.illuminance_lx is None:
        return LightReach(float(sky_lx > 0.0), float(sun_lx > 0.0), stray, distance_m, extent)
    # The flash may be shorter than the exposure.
    flash_lx = flash.illuminance_lx * (flash.at_m / distance_m) ** 2 * camera.flash_duty
    total = flash_lx + sky_lx + sun_lx
    return LightReach(sky_lx / total, sun_lx / total, stray * flash_lx / total, distance_m, extent)


def combine_reaches(reaches: Sequence[LightReach]) -> LightReach:
    """A reach at least as large as each of some: those of views with different cameras or light."""
    first = reaches[0]
    if len(reaches) == 1:
        return first
    # Stray light counts with the square of its distance.
    stray = max(reach.stray * reach.distance_m**2 for reach in reaches) / first.distance_m**2
    return LightReach(
        max(reach.sky for reach in reaches),
        max(reach.sun for reach in reaches),
        stray,
        first.distance_m,
        max(reach.flash_extent_m for reach in reaches),
    )


@dataclass(frozen=True, eq=False)
class Chunks:
    """Runs of faces that are kept or removed together: an instance, or a part of a long one or a far row."""

    faces: NDArray[np.intp]  # `(n + 1,)` first face of each chunk, and the end of the last
    vertices: NDArray[np.intp]  # `(n, 2)` first vertex that a chunk uses and the one after the last
    whole: NDArray[np.bool_]  # `(n,)` whether it contains all faces of its instance
    full: NDArray[np.bool_]  # `(n,)` whether it belongs to a plant of a far row that is grown in full
    centres: NDArray[np.float32]  # `(n, 3)` float32, metres, of its axis-aligned bounding box
    half_extents: NDArray[np.float32]  # `(n, 3)` float32, metres, of its axis-aligned bounding box
    radii: NDArray[np.float32]  # `(n,)` float32, metres, of the ball around the box


def mesh_chunks(mesh: Mesh) -> Chunks:
    """Split a mesh into its instances, and long instances and far rows into parts."""
    owner_of_face, is_far = _face_owners(mesh)
    change = 1 + np.flatnonzero(owner_of_face[1:] != owner_of_face[:-1])
    runs = np.concatenate([[0], change, [len(mesh.faces)]])
    size = np.diff(runs)
    parts = np.where(size > _LONG_INSTANCE, -(-size // _CHUNK), 1)
    # Part k of n begins at face k * size / n of its run.
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    starts = np.repeat(runs[:-1], parts) + number * np.repeat(size, parts) // np.repeat(parts, parts)
    owner = owner_of_face[starts]
    is_whole = (np.bincount(owner, minlength=len(mesh.instances))[owner] == 1) & ~is_far[owner]

    # The box of all vertices between a chunk's first and last contains the chunk.
    corners = mesh.faces.ravel()
    first = np.minimum.reduceat(corners, 3 * starts).astype(np.intp)
    stop = np.maximum.reduceat(corners, 3 * starts).astype(np.intp) + 1
    vertices = np.stack([first, stop], axis=1)
    points = np.concatenate([mesh.vertices, mesh.vertices[-1:]])  # `reduceat` needs a point at every stop
    lowest: NDArray[np.float32] = np.minimum.reduceat(points, vertices.ravel(), axis=0)[::2]
    greatest: NDArray[np.float32] = np.maximum.reduceat(points, vertices.ravel(), axis=0)[::2]
    half = (greatest - lowest) / 2.0
    return Chunks(
        np.append(starts, len(mesh.faces)),
        vertices,
        is_whole,
        np.array([item.full for item in mesh.instances])[owner],
        lowest + half,
        half,
        np.asarray(np.linalg.norm(half, axis=1)),
    )


def _face_owners(mesh: Mesh) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]:
    """`(f,)` the instance that a face is culled with, and `(i,)` which instances are of far rows.

    A far row counts as its first instance, or as two where some plants are grown in full: what is culled does
    not depend on how finely it is labelled.
    """
    rows = np.array([2 * item.far_row + item.full for item in mesh.instances])
    is_far = rows >= 0
    if not is_far.any():
        return mesh.face_instance, is_far
    _, first, row = np.unique(rows, return_index=True, return_inverse=True)
    owners = np.where(is_far, first[row], np.arange(len(rows))).astype(np.uint32)
    return owners[mesh.face_instance], is_far


def negligible(
    chunks: Chunks, visible: NDArray[np.bool_], frustums: ViewFrustums, light: LightReach
) -> NDArray[np.bool_]:
    """`(n,)` which chunks can be left out: the least significant ones, together below `LIGHT_TOLERANCE`.

    A ball of radius r at the distance d from a point covers at most (r / d)^2 of the cosine-weighted sky.
    It can shadow, or scatter to the point if it is white, that fraction of the light from sky and sun, and
    scatter that fraction of the flash's stray light, which falls with the squared distance from the flash.
    Of the sun's disc, of angular radius s, it can cover (r / d)^2 / s^2.
    """
    removed = np.zeros(len(visible), dtype=bool)
    hidden, seen = np.flatnonzero(~visible), np.flatnonzero(visible)
    centres, radii = chunks.centres[hidden], chunks.radii[hidden]
    from_flash = np.maximum(
        distances_to_balls(centres, frustums.positions) - radii - light.flash_extent_m, 1e-3
    )
    incident = light.sky + light.sun + light.stray * (light.distance_m / from_flash) ** 2

    def change(rows: NDArray[np.intp], others: NDArray[np.intp]) -> NDArray[np.float32]:
        """Largest change of light on the nearest of the other chunks."""
        distance = distances_to_balls(centres[rows], chunks.centres[others], chunks.radii[others])
        covered = (radii[rows] / np.maximum(distance, radii[rows])) ** 2
        shadow = light.sun * np.minimum(covered / SUN_ANGULAR_RADIUS**2, 1.0)
        return np.asarray(incident[rows] * covered + shadow)

    # A sample of the visible chunks gives lower bounds; only candidates below them are compared with all.
    candidates = _smallest_changes(change(np.arange(len(hidden)), seen[:: max(1, len(seen) // 64)]))
    if candidates.size:
        removed[hidden[candidates[_smallest_changes(change(candidates, seen))]]] = True
    return removed


def _smallest_changes(changes: NDArray[np.float32]) -> NDArray[np.intp]:
    """Indices of the smallest changes, as many as together stay below `LIGHT_TOLERANCE`."""
    order = np.argsort(changes, kind="stable")
    return order[np.cumsum(changes[order], dtype=float) <= LIGHT_TOLERANCE]


def cull_mesh(mesh: Mesh, frustums: ViewFrustums, light: LightReach) -> Mesh:
    """Simplify what no view can show, or leave it out where it is negligible.

    Instances keep their numbers. Triangles that a view can show, or that can be between what is visible and
    the camera or its flash, stay the same and in the same order. The faces of an instance must be
    consecutive.
    """
    chunks = mesh_chunks(mesh)
    # A plant that is grown in full stays whole, so that the truth of its fruit does.
    visible = frustums.intersects(chunks.centres, chunks.half_extents) | chunks.full
    if visible.all() or not visible.any():
        return mesh
    removed = negligible(chunks, visible, frustums, light)
    simple: list[Triangles] = []
    if light.sky + light.sun <= _MAX_DAYLIGHT:
        candidates = np.flatnonzero(~visible & ~removed & chunks.whole)
        face_ranges = np.stack([chunks.faces[candidates], chunks.faces[candidates + 1]], axis=1)
        simple, simplified = simplify_organs(mesh, face_ranges, chunks.vertices[candidates])
        removed[candidates[simplified]] = True
    elif not removed.any():
        return mesh

    # Keep the other faces and the vertices that they use, followed by the simplified organs.
    kept = np.repeat(~removed, np.diff(chunks.faces))
    faces = mesh.faces.compress(kept, axis=0)
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[faces] = True
    faces = (np.cumsum(used, dtype=np.uint32) - np.uint32(1))[faces]
    remaining = Triangles(np.flatnonzero(used), faces, np.flatnonzero(kept))
    return join_triangles([remaining, *simple]).taken_from(mesh)


_POSE_STRIDE: Final = 16  # chosen: every 16th pose sees most of what is visible; others only the rest
_PRODUCT_SIZE: Final = 1 << 17
"""Multiplications in one matrix product. Chosen: OpenBLAS distributes larger ones, from 2^18 on, over
threads, which costs more than it gains when the cores have other work."""
_BLOCK_ROWS: Final = 512  # chosen: rows of a distance table at a time, so that it stays in the cache


@dataclass(frozen=True, eq=False)
class ViewFrustums:
    """The half-spaces that bound each view of a path.

    Attributes:
        normals: `(p, k, 3)` float32, unit, into the view.
        offsets: `(p, k)` float32; a point x is inside where `normals @ x >= offsets`.
        positions: `(p, 3)` float32, the projection centres.
    """

    normals: NDArray[np.float32]
    offsets: NDArray[np.float32]
    positions: NDArray[np.float32]

    def intersects(
        self, centres: NDArray[np.float32], half_extents: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """`(n,)` whether axis-aligned boxes, `(n, 3)` and `(n, 3)`, may reach into any view."""
        visible = np.zeros(len(centres), dtype=bool)
        first = np.arange(0, len(self.positions), _POSE_STRIDE)
        for poses in (first, np.setdiff1d(np.arange(len(self.positions)), first)):
            remaining, block = np.flatnonzero(~visible), max(_PRODUCT_SIZE // (3 * max(len(poses), 1)), 1)
            for start in range(0, len(remaining), block):
                boxes = remaining[start : start + block]
                inside = np.ones((len(boxes), len(poses)), dtype=bool)
                for side in range(self.normals.shape[1]):
                    normal = self.normals[poses, side].T
                    furthest_corner = centres[boxes] @ normal + half_extents[boxes] @ np.abs(normal)
                    inside &= furthest_corner >= self.offsets[poses, side]
                visible[boxes] = inside.any(axis=1)
        return visible


def view_sides(camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The half-spaces that contain all that a camera shows at one moment, in its own axes.

    Returns:
        `(5, 3)` unit vectors into the view: left, right, top, bottom, front; and `(5,)` how far each
        half-space extends beyond the projection centre, metres, so that it contains pupil and flash.
    """
    # Beyond the focal plane, the rays of a pixel spread by the pupil's radius per focus distance.
    pupil = 0.0 if camera.focus_m is None else camera.aperture_radius_m
    spread = 0.0 if camera.focus_m is None else pupil / camera.focus_m
    lowest, highest = camera.slope_limits()
    (left, top), (right, bottom) = lowest - spread, highest + spread
    inward = np.array([[1, 0, -left], [-1, 0, right], [0, 1, -top], [0, -1, bottom], [0, 0, 1.0]])
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    # The flash may extend beyond half-spaces through the projection centre.
    margin = np.full(len(inward), pupil)
    if camera.flash is not None:
        extent = (camera.flash.radius_m - inward @ camera.flash.emitter_positions().T).max(axis=1)
        margin = np.maximum(margin, extent)
    return inward, margin


def view_frustums(camera: Camera, poses: ArrayLike) -> ViewFrustums:
    """The frustums of a camera at some poses; those of a line scanner, which sweeps, contain everything.

    Lens distortion may bend the image border: the half-spaces use its largest slopes. They also contain the
    entrance pupil, where camera rays start, and the flash, where shadow rays end, and so everything that can
    occlude or shadow what is visible. The poses are `(p, 4, 4)` camera to world; the camera's own is not
    used.
    """
    pose = as_poses(poses)
    inward, margin = view_sides(camera)
    if camera.sensor.line_scan:
        inward, margin = np.zeros_like(inward), np.ones_like(margin)
    normals = np.einsum("pij,kj->pki", pose[:, :3, :3], inward)
    offsets = np.einsum("pki,pi->pk", normals, pose[:, :3, 3]) - margin
    # Allow for rounding to single precision.
    offsets -= 1e-5 * (1.0 + np.abs(pose[:, :3, 3]).max(initial=0.0))
    return ViewFrustums(
        normals.astype(np.float32), offsets.astype(np.float32), pose[:, :3, 3].astype(np.float32)
    )


def distances_to_balls(
    points: NDArray[np.float32], centres: NDArray[np.float32], radii: NDArray[np.float32] | float = 0.0
) -> NDArray[np.float32]:
    """`(n,)` distance from points `(n, 3)` to the nearest ball's surface, `(m, 3)` and `(m,)`; < 0 inside."""
    nearest = np.empty(len(points), dtype=np.float32)
    squared_lengths = (centres**2).sum(axis=1)
    for start in range(0, len(points), _BLOCK_ROWS):
        rows = slice(start, start + _BLOCK_ROWS)
        squared = (
            (points[rows] ** 2).sum(axis=1)[:, None] + squared_lengths - 2.0 * (points[rows] @ centres.T)
        )
        nearest[rows] = (np.sqrt(np.maximum(squared, 0.0)) - radii).min(axis=1)
    return nearest

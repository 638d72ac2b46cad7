"""View frustums: for each pose of a path, half-spaces that contain everything the camera can show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera
from pepperscene.camera.poses.checks import as_poses

_POSE_STRIDE: Final = (
    16  # chosen: every 16th pose sees most of what is visible; the others are tested for the rest
)
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
    occlude or shadow what is visible.

    Args:
        camera: lens, sensor, focus and flash; its own pose is not used.
        poses: `(p, 4, 4)` camera to world.
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

"""Where the views of a path look: half-spaces for each pose that hold all it can show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera, Flash

_STRIDE: Final = 16  # chosen: every so many poses find most of what is seen; the others look for the rest
_PRODUCTS: Final = 1 << 17
"""Chosen: of a matrix product at a time. Larger ones, in OpenBLAS from 2^18 on, are shared out to threads,
which costs more than it gains where the cores have other work."""
_ROWS: Final = 512  # chosen: rows of a table of distances at a time, so that it stays in the cache


@dataclass(frozen=True, eq=False)
class ViewFrustums:
    """Where the views of a path look: for each pose the half-spaces that hold all it can show.

    Attributes:
        normals: `(p, k, 3)` float32, unit, into the view.
        offsets: `(p, k)` float32; a point x lies inside where `normals @ x >= offsets`.
        places: `(p, 3)` float32, the projection centres.
    """

    normals: NDArray[np.float32]
    offsets: NDArray[np.float32]
    places: NDArray[np.float32]

    def meets(self, centres: NDArray[np.float32], halves: NDArray[np.float32]) -> NDArray[np.bool_]:
        """`(n,)` whether a box may reach into any view; never False where it does.

        Args:
            centres: `(n, 3)` metres.
            halves: `(n, 3)` half of its extent along the world's axes, metres.
        """
        seen = np.zeros(len(centres), dtype=bool)
        first = np.arange(0, len(self.places), _STRIDE)
        for poses in (first, np.setdiff1d(np.arange(len(self.places)), first)):
            unseen, block = np.flatnonzero(~seen), max(_PRODUCTS // (3 * max(len(poses), 1)), 1)
            for start in range(0, len(unseen), block):
                left = unseen[start : start + block]
                inside = np.ones((len(left), len(poses)), dtype=bool)
                for side in range(self.normals.shape[1]):
                    into = self.normals[poses, side].T
                    # The corner that reaches furthest.
                    furthest = centres[left] @ into + halves[left] @ np.abs(into)
                    inside &= furthest >= self.offsets[poses, side]
                seen[left] = inside.any(axis=1)
        return seen

    def distances(self, centres: NDArray[np.float32], radii: NDArray[np.float32]) -> NDArray[np.float32]:
        """`(n,)` metres from each ball to the nearest pose, 0 where it holds one."""
        return gaps(centres, self.places) - radii


def view_frustums(camera: Camera, poses: ArrayLike) -> ViewFrustums:
    """Where a camera looks from some poses.

    The lens' distortion may bow the picture's border: the half-spaces go by its widest slopes. A ray starts
    anywhere on the entrance pupil, a shadow ray ends anywhere on the flash: the half-spaces hold both, and so
    all that stands between them and what is seen.

    Args:
        camera: its lens, sensor, focus and flash; its own pose is not used.
        poses: `(p, 4, 4)` camera to world.
    """
    pose = np.asarray(poses, dtype=float).reshape(-1, 4, 4)
    slopes = camera.ray_slopes().reshape(-1, 2)
    # Beyond the plane in focus the rays of a pixel spread by the pupil's radius per focus distance.
    pupil = 0.0 if camera.focus_m is None else camera.aperture_radius_m
    spread = 0.0 if camera.focus_m is None else pupil / camera.focus_m
    (left, top), (right, bottom) = slopes.min(axis=0) - spread, slopes.max(axis=0) + spread
    into = np.array([[1, 0, -left], [-1, 0, right], [0, 1, -top], [0, -1, bottom], [0, 0, 1.0]])
    into /= np.linalg.norm(into, axis=1, keepdims=True)
    behind = np.maximum(pupil, _behind(into, camera.flash))

    normals = np.einsum("pij,kj->pki", pose[:, :3, :3], into)
    offsets = np.einsum("pki,pi->pk", normals, pose[:, :3, 3]) - behind
    # Rounding to single precision is worth a hair's breadth.
    offsets -= 1e-5 * (1.0 + np.abs(pose[:, :3, 3]).max(initial=0.0))
    return ViewFrustums(
        normals.astype(np.float32), offsets.astype(np.float32), pose[:, :3, 3].astype(np.float32)
    )


def _behind(into: NDArray[np.float64], flash: Flash | None) -> NDArray[np.float64]:
    """`(k,)` how far the flash reaches out of half-spaces `(k, 3)` through the projection centre, metres."""
    if flash is None:
        return np.zeros(len(into))
    return np.maximum((flash.radius_m - into @ lamps(flash).T).max(axis=1), 0.0)


def lamps(flash: Flash) -> NDArray[np.float64]:
    """`(k, 3)` centres of its emitters in camera axes, metres."""
    return np.asarray(flash.offset_m) + np.pad(flash.emitters_m, ((0, 0), (0, 1)))


def gaps(
    points: NDArray[np.float32], others: NDArray[np.float32], radii: NDArray[np.float32] | float = 0.0
) -> NDArray[np.float32]:
    """`(n,)` distance from each point to the surface of the nearest of other balls, `(m, 3)` and `(m,)`."""
    nearest = np.empty(len(points), dtype=np.float32)
    lengths = (others**2).sum(axis=1)
    for start in range(0, len(points), _ROWS):
        rows = slice(start, start + _ROWS)
        squared = (points[rows] ** 2).sum(axis=1)[:, None] + lengths - 2.0 * (points[rows] @ others.T)
        nearest[rows] = (np.sqrt(np.maximum(squared, 0.0)) - radii).min(axis=1)
    return nearest

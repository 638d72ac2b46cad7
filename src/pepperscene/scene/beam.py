"""Long straight bodies along x with one convex cross-section: what a greenhouse is built of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry import Mesh, one_instance

_SIDES = 12  # chosen: a wire or a pipe is some pixels wide


def beam(section: ArrayLike, ends: tuple[float, float], surface: str, *, smooth: bool = False) -> Mesh:
    """A closed prism along x.

    Args:
        section: `(k, 2)` y and z of its convex cross-section in metres, counter-clockwise seen from +x.
        ends: x of its two ends in metres, the first one less.
        surface: name of its surface.
        smooth: whether its sides look round.

    Returns:
        u runs around, v along; state is 0.5; one instance "beam" of the background.

    Raises:
        ValueError: the section is not convex and counter-clockwise, or the ends are not in order.
    """
    corners = np.asarray(section, dtype=float)
    k = len(corners)
    edge = np.roll(corners, -1, axis=0) - corners
    turning = edge[:, 0] * np.roll(edge, -1, axis=0)[:, 1] - edge[:, 1] * np.roll(edge, -1, axis=0)[:, 0]
    if k < 3 or not np.all(turning > 0.0) or not ends[0] < ends[1]:
        raise ValueError("a beam needs a convex section, counter-clockwise, and two ends in order")
    out = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    # Four corners to a side: both ends of its first edge, then of its second.
    side = np.stack([np.arange(k), (np.arange(k) + 1) % k] * 2, axis=1)
    at = np.repeat(ends, 2)[None, :].repeat(k, axis=0)
    normals = np.repeat(out[:, None], 4, axis=1)
    if smooth:
        mean = out + np.roll(out, 1, axis=0)
        normals = (mean / np.linalg.norm(mean, axis=1, keepdims=True))[side]
    u = np.stack([np.arange(k), np.arange(k) + 1] * 2, axis=1) / k
    sides = np.dstack([at, corners[side]]), np.pad(normals, ((0, 0), (0, 0), (1, 0)))
    quads = 4 * np.arange(k)[:, None, None] + np.array([[0, 1, 3], [0, 3, 2]])
    # Lids are fans about their first corner.
    span = np.ptp(corners, axis=0)
    flat = (corners - corners.min(axis=0)) / span
    lids = [np.column_stack([np.full(k, x), corners]) for x in ends]
    facing = np.repeat([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], k, axis=0)
    fan = np.stack([np.zeros(k - 2, int), np.arange(1, k - 1), np.arange(2, k)], axis=1)
    faces = np.concatenate([quads.reshape(-1, 3), 4 * k + fan[:, ::-1], 5 * k + fan])
    along = np.tile([0.0, 0.0, 1.0, 1.0], k)
    vertices = np.concatenate([sides[0].reshape(-1, 3), *lids])
    normals = np.concatenate([sides[1].reshape(-1, 3), facing])
    uv = np.concatenate([np.column_stack([u.ravel(), along]), flat, flat])
    state = np.full(len(vertices), 0.5)
    return one_instance(vertices, normals, uv, state, faces, OrganClass.BACKGROUND, "beam", surface)


def box(y: tuple[float, float], z: tuple[float, float], ends: tuple[float, float], surface: str) -> Mesh:
    """A closed box between two values of each coordinate, in metres."""
    return beam([(y[0], z[0]), (y[1], z[0]), (y[1], z[1]), (y[0], z[1])], ends, surface)


def rod(y: float, z: float, radius_m: float, ends: tuple[float, float], surface: str) -> Mesh:
    """A closed round rod about the line at this y and z, in metres."""
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    section = np.column_stack([y + radius_m * np.cos(angle), z + radius_m * np.sin(angle)])
    return beam(section, ends, surface, smooth=True)


def as_one(mesh: Mesh, organ_class: OrganClass, kind: str) -> Mesh:
    """The mesh as a single instance."""
    whole = np.zeros(len(mesh.faces), dtype=np.uint32)
    return replace(mesh, face_instance=whole, instances=(Instance(organ_class, kind),))

"""Tubes: rings of points swept along a spine, closed by a cap at either end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from pepperscene.geometry.batch import MeshBatch, pack_rings, read_measure, ring_faces, ring_uv, smooth_field
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.geometry.spine import Spines, normalize
from pepperscene.grammar.frames import cross
from pepperscene.grammar.plant import Organ

DEFAULT_STATE: Final = 0.6  # chosen: pigment state (greenness) of organs without the measure state_mean
_STATE_SPREAD: Final = 0.12  # chosen: streaks of lighter and darker green along a stem
_STREAK_M: Final = 0.04  # chosen: height of stem on which streaks vary as much as once around it
_CAP_HEIGHT: Final = 0.6  # chosen: of a round cap, over the tube's radius
_CAP_V: Final = 0.01  # part of v that either cap takes


@dataclass(frozen=True, eq=False)
class Rings:
    """Cross-sections of n tubes: r rings of c points, right-handed about the spine."""

    along: FloatArray  # `(n, r)` or `(n, r, c)` metres from the base
    right: FloatArray  # `(n, r, c)` metres along the spine's binormal
    up: FloatArray  # `(n, r, c)` metres along the spine's normal, to the upper side
    v: FloatArray  # `(r,)` surface coordinate of each ring, 0 at the base and 1 at the tip, of all tubes
    state: FloatArray  # `(n, r, c)` pigment state; it is clipped to [0, 1]


@dataclass(frozen=True, eq=False)
class Cap:
    """The ends of n tubes: a smaller ring and a point, each displaced from the centre of the last ring."""

    ring: FloatArray  # `(n, 2)` metres further along the curve and to its upper side
    point: FloatArray  # `(n, 2)` likewise
    width: float = 0.75  # size of the cap's ring over that of the tube's last ring
    embedded: bool = True  # it is inside another organ that the tube joins: shading must not show the bend


def round_cap(radius: FloatArray, length: FloatArray) -> Cap:
    """Build caps that reach into the parents and close the joints, never higher than the tubes are long."""
    height = _CAP_HEIGHT * np.minimum(radius, length)
    zero = np.zeros_like(height)
    return Cap(np.stack([0.65 * height, zero], axis=1), np.stack([height, zero], axis=1))


def ring_angles(sides: int) -> FloatArray:
    """`(sides,)` angles of a ring's points: 0 on the upper side, a quarter turn to the right."""
    return 2.0 * np.pi * np.arange(sides) / sides


def centre_rings(right: FloatArray, up: FloatArray, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Move rings `(n, r, c)` so that their mean is on the spine, and scale them to a radius.

    The spine and the diameter over the ridges can then be recovered from the triangles.

    Args:
        right: along the binormal, in any unit.
        up: along the normal, in the same unit.
        radius: `(n, r)` greatest distance of a ring's points from their mean, metres.
    """
    right = right - right.mean(axis=2, keepdims=True)
    up = up - up.mean(axis=2, keepdims=True)
    scale = radius / np.sqrt(np.max(right * right + up * up, axis=2))
    return right * scale[..., None], up * scale[..., None]


def sweep_rings(spine: Spines, rings: Rings, base: Cap, tip: Cap) -> MeshBatch:
    """Build tubes from rings along spines, with a cap at either end.

    The vertices are the base's point, its cap's ring, the rings, the tip's cap's ring and its point; the
    first vertex of every ring is repeated at the seam, where u jumps from 1 to 0. Displacements of the base's
    cap along the curve count backwards.
    """
    # Mean position of each ring; slanted rings have one per point.
    centre = rings.along if rings.along.ndim == 2 else rings.along.mean(axis=2)
    before, after = base.ring * [-1.0, 1.0], tip.ring
    along = np.concatenate([centre[:, :1] + before[:, :1], centre, centre[:, -1:] + after[:, :1]], axis=1)
    # Rings of the caps are smaller copies of the outermost rings.
    right, up = (
        np.concatenate([base.width * offset[:, :1], offset, tip.width * offset[:, -1:]], axis=1)
        for offset in (rings.right, rings.up)
    )
    up[:, 0] += before[:, 1:]
    up[:, -1] += after[:, 1:]
    point, normal, binormal = spine.frames(along)
    tangent = cross(normal, binormal)
    grid = point[:, :, None] + right[..., None] * binormal[:, :, None] + up[..., None] * normal[:, :, None]
    if rings.along.ndim == 3:
        grid[:, 1:-1] += (rings.along - centre[..., None])[..., None] * tangent[:, 1:-1, None]
    ends = np.empty((len(grid), 2, 3))
    for end, ring, offset in ((0, 1, base.point * [-1.0, 1.0]), (1, -2, tip.point)):
        ends[:, end] = point[:, ring] + offset[:, :1] * tangent[:, ring] + offset[:, 1:] * normal[:, ring]
    return skin_rings(grid, ends, tangent, rings.v, rings.state, (base.embedded, tip.embedded))


def skin_rings(
    grid: FloatArray,
    ends: FloatArray,
    tangent: FloatArray,
    v: FloatArray,
    state: FloatArray,
    embedded: tuple[bool, bool],
) -> MeshBatch:
    """Triangulate the rings of tubes and of their caps.

    Args:
        grid: `(n, r + 2, c, 3)` points of the rings, metres, a cap's ring at either end.
        ends: `(n, 2, 3)` the caps' points.
        tangent: `(n, r + 2, 3)` unit vectors along the tubes.
        v: `(r,)` as in `Rings`.
        state: `(n, r, c)` as in `Rings`.
        embedded: of the base's and the tip's cap, as in `Cap`.
    """
    n, _, sides, _ = grid.shape
    # Surface tangents around and along the tubes, by central differences.
    around = np.roll(grid, -1, axis=2) - np.roll(grid, 1, axis=2)
    poles = np.repeat(ends[:, :, None], sides, axis=2)
    rows = np.concatenate([poles[:, :1], grid, poles[:, 1:]], axis=1)
    along = rows[:, 2:] - rows[:, :-2]
    # Where a tube joins another organ, it is shaded as if it continued.
    for joined, ring in zip(embedded, (1, -2), strict=True):
        if joined:
            along[:, ring] = tangent[:, ring, None]
    state = np.clip(state, 0.0, 1.0)
    state = np.concatenate([state[:, :1], state, state[:, -1:]], axis=1)
    faces, uv = _topology(tuple(v.tolist()), sides)
    return MeshBatch(
        pack_rings(ends, grid),
        pack_rings(tangent[:, [0, -1]] * np.array([-1.0, 1.0])[:, None], normalize(cross(around, along))),
        np.broadcast_to(uv, (n, *uv.shape)),
        pack_rings(state[:, [0, -1]].mean(axis=2, keepdims=True), state[..., None])[..., 0],
        faces,
    )


def state_with_streaks(organs: Sequence[Organ], along: FloatArray, sides: int) -> FloatArray:
    """Compute `(n, r, sides)` pigment states with streaks of lighter and darker green, long along the tubes.

    Args:
        organs: measures state_mean, state_spread, seed.
        along: `(n, r)` metres from the base, of each ring.
        sides: points of each ring.
    """
    n, count = along.shape
    angle = ring_angles(sides)
    # Noise on a unit cylinder has no seam.
    points = np.empty((n, count, sides, 3))
    points[..., 0], points[..., 1] = np.cos(angle), np.sin(angle)
    points[..., 2] = along[..., None] / _STREAK_M
    field = smooth_field(points.reshape(n, -1, 3), read_measure(organs, "seed", 0.5), 121, 4.0)
    # Streaks fade at both ends, so that no edge shows where organs meet.
    fraction = along / np.maximum(along[:, -1:], 1e-9)
    fade = np.sqrt(1.0 - (2.0 * fraction - 1.0) ** 2)
    spread = read_measure(organs, "state_spread", _STATE_SPREAD)[:, None] * fade
    mean = read_measure(organs, "state_mean", DEFAULT_STATE)[:, None, None]
    return np.asarray(mean + spread[..., None] * field.reshape(n, count, sides))


@lru_cache(maxsize=64)
def _topology(v: tuple[float, ...], sides: int) -> tuple[IndexArray, FloatArray]:
    """Faces and uv of a tube with rings at these v and a smaller ring in either cap."""
    rows = np.concatenate([[0.5 * _CAP_V], _CAP_V + (1.0 - 2.0 * _CAP_V) * np.array(v), [1.0 - 0.5 * _CAP_V]])
    return ring_faces(len(v) + 2, sides), ring_uv(rows, sides)

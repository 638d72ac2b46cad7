"""Round bodies along a centreline: rings of points, closed by rounded caps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.bodies import MeshBatch, ring_faces, ring_uv
from pepperscene.geometry.organ_arrays import organ_measure, smooth_field
from pepperscene.geometry.spine import Spines, spines, unit
from pepperscene.grammar.plant import Organ

STATE: Final = 0.6  # chosen: greenness of organs whose measures do not say
_STATE_SPREAD: Final = 0.12  # chosen: streaks of lighter and darker green along a stem
_STREAK_M: Final = 0.04  # chosen: height of stem on which streaks vary as much as once around it
_MARGIN: Final = 0.01  # part of v that either cap takes


@dataclass(frozen=True, eq=False)
class Rings:
    """The cross-sections of n tubes: r rings of c points, right-handed about the centreline.

    Attributes:
        along: `(n, r)` or `(n, r, c)` metres from the base.
        right: `(n, r, c)` metres to the right of the centreline, as in `Spines`.
        up: `(n, r, c)` metres above it, towards the upper side.
        part: `(r,)` v of each ring, 0 at the base and 1 at the tip, the same for all tubes.
        state: `(n, r, c)` pigment state; what is beyond [0, 1] is cut.
    """

    along: NDArray[np.float64]
    right: NDArray[np.float64]
    up: NDArray[np.float64]
    part: NDArray[np.float64]
    state: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cap:
    """How n tubes end: a smaller ring and a point, each displaced from the last ring's centre.

    Attributes:
        ring: `(n, 2)` metres on along the curve and to its upper side.
        point: `(n, 2)` likewise.
        width: the ring's size over that of the tube's last ring.
        within: it lies inside another organ that the tube joins, so light must not see the bend into it.
    """

    ring: NDArray[np.float64]
    point: NDArray[np.float64]
    width: float = 0.75
    within: bool = True


def rounded(radius: NDArray[np.float64], length: NDArray[np.float64], height: float = 0.6) -> Cap:
    """A cap that is `height` radii high, but never more than the tube is long.

    It reaches into the parent and closes the joint.

    Args:
        radius: `(n,)` metres.
        length: `(n,)` metres, of the tube.
        height: of the cap, in radii (.6 chosen).
    """
    reach = height * np.minimum(radius, length)
    level = np.zeros_like(reach)
    return Cap(np.stack([0.65 * reach, level], axis=1), np.stack([reach, level], axis=1))


def centrelines(organs: Sequence[Organ], steps: int) -> Spines:
    """The organs' centrelines."""
    return spines([organ.curve for organ in organs], [organ.up for organ in organs], steps)


def circle(sides: int) -> NDArray[np.float64]:
    """`(sides,)` angles of a ring's points: 0 on the upper side, a quarter turn to the right."""
    return 2.0 * np.pi * np.arange(sides) / sides


def centred(
    right: NDArray[np.float64], up: NDArray[np.float64], radius: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rings of any shape `(n, r, c)`, moved so that their mean lies on the centreline and scaled to a radius.

    So the centreline and the diameter over the ridges can be measured back on the triangles.

    Args:
        right: to the right, any unit.
        up: to the upper side, the same unit.
        radius: `(n, r)` greatest distance of a ring's points from their mean, metres.
    """
    right = right - right.mean(axis=2, keepdims=True)
    up = up - up.mean(axis=2, keepdims=True)
    scale = radius / np.sqrt(np.max(right * right + up * up, axis=2))
    return right * scale[..., None], up * scale[..., None]


def closed(spine: Spines, rings: Rings, base: Cap, tip: Cap) -> MeshBatch:
    """Tubes out of rings, with a cap at either end.

    Vertices are the base's point, its cap's ring, the rings, the tip's cap's ring and its point; every ring's
    first vertex comes twice, as u jumps there.

    Args:
        spine: n centrelines.
        rings: their cross-sections.
        base: before the first ring; its displacement along the curve counts backwards.
        tip: after the last ring.
    """
    n = len(rings.right)
    level = _level(rings)
    # Caps are made of the outermost rings.
    before, after = base.ring * [-1.0, 1.0], tip.ring
    places = np.concatenate([level[:, :1] + before[:, :1], level, level[:, -1:] + after[:, :1]], axis=1)
    right, up = _capped(rings.right, base, tip), _capped(rings.up, base, tip)
    up[:, 0] += before[:, 1:]
    up[:, -1] += after[:, 1:]
    point, normal, across = spine.frames(places)
    tangent = np.cross(normal, across)
    grid = point[:, :, None] + right[..., None] * across[:, :, None] + up[..., None] * normal[:, :, None]
    if rings.along.ndim == 3:
        # Slanted rings.
        grid[:, 1:-1] += (rings.along - level[..., None])[..., None] * tangent[:, 1:-1, None]
    ends = np.empty((n, 2, 3))
    for end, outermost, by in ((0, 1, base.point * [-1.0, 1.0]), (1, -2, tip.point)):
        ends[:, end] = (
            point[:, outermost] + by[:, :1] * tangent[:, outermost] + by[:, 1:] * normal[:, outermost]
        )
    return skin(grid, ends, tangent, rings.part, rings.state, (base.within, tip.within))


def skin(
    grid: NDArray[np.float64],
    ends: NDArray[np.float64],
    tangent: NDArray[np.float64],
    part: NDArray[np.float64],
    state: NDArray[np.float64],
    within: tuple[bool, bool],
) -> MeshBatch:
    """Triangles over the rings of tubes and of their caps.

    Args:
        grid: `(n, r + 2, c, 3)` points of the rings, metres, a cap's ring at either end.
        ends: `(n, 2, 3)` the caps' points.
        tangent: `(n, r + 2, 3)` unit vectors along the tubes.
        part: `(r,)` as in `Rings`.
        state: `(n, r, c)` as in `Rings`.
        within: whether the base and the tip lie inside another organ, as in `Cap`.
    """
    n, _, sides, _ = grid.shape
    around, along = _directions(grid, ends)
    # Where a tube joins another organ, it is lit as if it went on.
    for joined, ring in zip(within, (1, -2), strict=True):
        if joined:
            along[:, ring] = tangent[:, ring, None]
    poles = tangent[:, [0, -1]] * np.array([-1.0, 1.0])[:, None]
    state = np.clip(state, 0.0, 1.0)
    state = np.concatenate([state[:, :1], state, state[:, -1:]], axis=1)
    faces, uv = _topology(tuple(part.tolist()), sides)
    return MeshBatch(
        _woven(ends, grid),
        _woven(poles, unit(_cross(around, along))),
        np.broadcast_to(uv, (n, *uv.shape)),
        _woven(state[:, [0, -1]].mean(axis=2, keepdims=True), state[..., None])[..., 0],
        faces,
    )


def streaked(organs: Sequence[Organ], rings_along: NDArray[np.float64], sides: int) -> NDArray[np.float64]:
    """`(n, r, sides)` the organs' state with streaks of lighter and darker green, long along the tubes.

    Args:
        organs: measures state_mean, state_spread, seed.
        rings_along: `(n, r)` metres from the base.
        sides: points of each ring.
    """
    n, count = rings_along.shape
    angle = circle(sides)
    # On a unit cylinder, so that there is no seam.
    points = np.empty((n, count, sides, 3))
    points[..., 0], points[..., 1] = np.cos(angle), np.sin(angle)
    points[..., 2] = rings_along[..., None] / _STREAK_M
    field = smooth_field(points.reshape(n, -1, 3), organ_measure(organs, "seed", 0.5), 121, 4.0)
    # They fade at both ends, so that no ring shows where organs meet.
    place = rings_along / np.maximum(rings_along[:, -1:], 1e-9)
    spread = organ_measure(organs, "state_spread", _STATE_SPREAD)[:, None] * np.sqrt(
        1.0 - (2.0 * place - 1.0) ** 2
    )
    mean = organ_measure(organs, "state_mean", STATE)[:, None, None]
    return np.asarray(mean + spread[..., None] * field.reshape(n, count, sides))


def _level(rings: Rings) -> NDArray[np.float64]:
    """`(n, r)` how far along the rings' centres are."""
    return rings.along if rings.along.ndim == 2 else rings.along.mean(axis=2)


def _capped(offset: NDArray[np.float64], base: Cap, tip: Cap) -> NDArray[np.float64]:
    """`(n, r + 2, c)` with the caps' rings, which are smaller copies of the outermost ones."""
    return np.concatenate([base.width * offset[:, :1], offset, tip.width * offset[:, -1:]], axis=1)


def _directions(
    grid: NDArray[np.float64], ends: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions around and along the tubes at the points of the rings, those of the caps as well."""
    around = np.empty_like(grid)
    around[:, :, 1:-1] = grid[:, :, 2:] - grid[:, :, :-2]
    around[:, :, 0], around[:, :, -1] = grid[:, :, 1] - grid[:, :, -1], grid[:, :, 0] - grid[:, :, -2]
    along = np.empty_like(grid)
    along[:, 1:-1] = grid[:, 2:] - grid[:, :-2]
    along[:, 0] = grid[:, 1] - ends[:, 0, None]
    along[:, -1] = ends[:, 1, None] - grid[:, -2]
    return around, along


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vector products; `numpy.cross` takes several times as long for small arrays."""
    found = np.empty_like(a)
    found[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    found[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    found[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return found


def _woven(ends: NDArray[np.float64], grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n, v, k)` out of two ends `(n, 2, k)` and rings `(n, r, c, k)`, whose first column comes again."""
    n, rings, sides, width = grid.shape
    found = np.empty((n, 2 + rings * (sides + 1), width))
    found[:, 0], found[:, -1] = ends[:, 0], ends[:, 1]
    inner = found[:, 1:-1].reshape(n, rings, sides + 1, width)
    inner[:, :, :-1], inner[:, :, -1] = grid, grid[:, :, 0]
    return found


@lru_cache(maxsize=64)
def _topology(part: tuple[float, ...], sides: int) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Faces and uv of a tube with rings at these parts of its length and a smaller ring in either cap."""
    height = np.concatenate([[0.5 * _MARGIN], _MARGIN + (1.0 - 2.0 * _MARGIN) * np.array(part)])
    height = np.concatenate([height, [1.0 - 0.5 * _MARGIN]])
    return ring_faces(len(part) + 2, sides), ring_uv(height, sides)

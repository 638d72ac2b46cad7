"""Damage to the margins of blades: bites of insects, and tears along lateral veins.

The triangles of a blade are the same with damage and without it. In the plane of the flat blade vertices move
out of the tissue that is missing, and on the blade in space they stay on its surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.batch import hash_uniform, read_measure
from pepperscene.geometry.blade.grid import Grid
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.grammar.plant import Organ

_MAX_NUMBER: Final = 12  # chosen: bites or tears of a blade; with more, hardly any margin is left
_CENTRE: Final = 0.5  # chosen: distance of a bite's centre from the margin, in radii, outside of the blade
_ZONE: Final = 2.5  # chosen: radii within which the tissue's vertices move
_RANGE: Final = (0.4, 0.88)  # chosen: of the margin; below, triangles are too long to show a bite
_CLUSTER: Final = 0.6  # chosen: fraction of bites that are beside the one before, as a larva feeds
_GAP: Final = 0.14  # chosen: width of a tear at the margin over its length
_FLAP: Final = 0.1  # chosen: distance of its edges from the surface, one above and one below, likewise
_MIN_AREA: Final = 0.02  # chosen: of a triangle, relative to its area before; thinner ones are inverted soon
_MIDRIB: Final = np.array([0.5, 0.0])  # uv of the base
_ROUNDING: Final = 1e-6  # of barycentric coordinates
_ATTEMPTS: Final = 4  # chosen: each with a cut two thirds as large

_Move = Callable[[FloatArray, float], tuple[IndexArray, FloatArray] | None]
"""From the flat vertices `(v, 2)` and a factor of the size to the moved vertices and their new positions."""


@dataclass(eq=False)
class _Sheet:
    """One blade: its flat vertices in metres, and what is defined on them."""

    flat: FloatArray  # `(v, 2)` to the right of the midrib and along it
    values: FloatArray  # `(v, 4)` position in space, pigment state
    faces: IndexArray  # `(f, 3)`

    def cut(self, move: _Move) -> IndexArray:
        """Move vertices on the surface, less far if a triangle were inverted; returns the moved ones."""
        for attempt in range(_ATTEMPTS):
            moved = move(self.flat, (2.0 / 3.0) ** attempt)
            if moved is None:
                break
            vertices, positions = moved
            flat = self.flat.copy()
            flat[vertices] = positions
            near = np.zeros(len(flat), dtype=bool)
            near[vertices] = True
            faces = self.faces[near[self.faces].any(axis=1)]
            if np.all(_areas(flat, faces) > _MIN_AREA * _areas(self.flat, faces)):
                values = self._interpolate(positions, faces)
                if values is None:
                    # A position is beyond the triangles that move.
                    near[faces] = True
                    values = self._interpolate(positions, self.faces[near[self.faces].any(axis=1)])
                if values is not None:
                    self.values[vertices], self.flat = values, flat
                    return vertices
        return np.empty(0, dtype=np.intp)

    def _interpolate(self, positions: FloatArray, faces: IndexArray) -> FloatArray | None:
        """`(k, 4)` values at positions `(k, 2)`; None if one is in none of these triangles."""
        a, b, c = (self.flat[faces[:, corner]] for corner in range(3))
        area = _areas(self.flat, faces)
        # Barycentric coordinates of every position in every triangle; the right one has no negative.
        second = _cross(positions[:, None] - a, c - a) / area
        third = _cross(b - a, positions[:, None] - a) / area
        weights = np.stack([1.0 - second - third, second, third], axis=-1)
        least = weights.min(axis=2)
        best = least.argmax(axis=1)
        if not np.all(least[np.arange(len(positions)), best] > -_ROUNDING):
            return None
        weight = np.clip(weights[np.arange(len(positions)), best], 0.0, None)
        weight /= weight.sum(axis=1, keepdims=True)
        return np.einsum("kc,kcv->kv", weight, self.values[faces[best]])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Signed area of the parallelogram of plane vectors."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _areas(flat: FloatArray, faces: IndexArray) -> FloatArray:
    """`(f,)` doubled signed areas of triangles in the plane."""
    a, b, c = (flat[faces[:, corner]] for corner in range(3))
    return _cross(b - a, c - a)


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Vertices of n blades before and after damage, which changes the arrays in place."""

    vertices: FloatArray  # `(n, v, 3)` metres
    uv: FloatArray  # `(n, v, 2)`
    state: FloatArray  # `(n, v)`
    size: FloatArray  # `(n, 2)` metres, extents of u and v on the flat blade


def damage_margins(organs: Sequence[Organ], surfaces: Surfaces, grid: Grid) -> None:
    """Bite and tear the margins of blades, in place.

    Measures, optional: bites (number, rounded down), bite_width_m (mean diameter), tears (number, rounded
    down), tear_depth (mean length over the way from margin to midrib), seed.

    Args:
        organs: n blades.
        surfaces: their vertices.
        grid: their triangles.
    """
    bites = np.minimum(read_measure(organs, "bites", 0.0), _MAX_NUMBER).astype(int)
    tears = np.minimum(read_measure(organs, "tears", 0.0), _MAX_NUMBER).astype(int)
    damaged = np.flatnonzero((bites > 0) | (tears > 0))
    if damaged.size == 0:
        return
    margins = grid.margin_vertices
    seed, width = read_measure(organs, "seed", 0.0), read_measure(organs, "bite_width_m", 0.01)
    depth = read_measure(organs, "tear_depth", 0.5)
    all_draws = hash_uniform(seed[damaged], 281, 8 * _MAX_NUMBER).reshape(-1, 2, _MAX_NUMBER, 4)
    for k, draws in zip(damaged.tolist(), all_draws, strict=True):
        flat = (surfaces.uv[k] - _MIDRIB) * surfaces.size[k]
        values = np.concatenate([surfaces.vertices[k], surfaces.state[k][:, None]], axis=1)
        sheet = _Sheet(flat, values, grid.faces)
        # Tears first: they follow rows of the grid, which bites bend.
        for draw in draws[0, : tears[k]].tolist():
            _tear(sheet, grid, margins, float(depth[k]), draw)
        place = (0.0, 0.0)
        for draw in draws[1, : bites[k]].tolist():
            place = _bite(sheet, margins, float(width[k]), draw, place)
        surfaces.vertices[k], surfaces.state[k] = sheet.values[:, :3], sheet.values[:, 3]
        surfaces.uv[k] = np.clip(sheet.flat / surfaces.size[k] + _MIDRIB, 0.0, 1.0)


def _bite(
    sheet: _Sheet, margins: IndexArray, width: float, draw: list[float], before: tuple[float, float]
) -> tuple[float, float]:
    """Take a round bite out of a margin; returns its side and position, as `before` of the last one."""
    radius = 0.5 * width * (0.5 + draw[2])
    if draw[3] < _CLUSTER and before[1] > 0.0:
        side, at = before[0], float(np.clip(before[1] + 0.3 * draw[1] - 0.15, *_RANGE))
    else:
        side, at = float(draw[0] < 0.5), _RANGE[0] + (_RANGE[1] - _RANGE[0]) * draw[1]
    margin = margins[int(side)]
    line = sheet.flat[margin]
    # At a vertex of the margin, so that the smallest bite has one.
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    index = int(np.clip(np.searchsorted(length, at * length[-1]), 2, len(line) - 3))
    tangent = line[index + 2] - line[index - 2]
    outwards = np.array([tangent[1], -tangent[0]]) * (1.0 if side else -1.0) / np.hypot(*tangent)
    start = line[index]

    def move(flat: FloatArray, factor: float) -> tuple[IndexArray, FloatArray] | None:
        # The bite and the tissue that moves stay on this side of the midrib.
        r = min(factor * radius, 0.4 * abs(start[0]))
        if r < 1e-3 or outwards[0] * start[0] <= 0.0:
            return None
        centre = start + _CENTRE * r * outwards
        zone = min(_ZONE * r, abs(start[0]))
        offset = flat - centre
        distance = np.hypot(offset[:, 0], offset[:, 1])
        inwards = -(offset @ outwards)
        rows = np.flatnonzero((distance < zone) & (inwards > 0.2 * distance))
        d = distance[rows]
        # Along each ray from the centre, the way from a straight margin to the zone's end shrinks to the way
        # from the circle: one to one, so nothing folds over.
        straight = _CENTRE * r * d / inwards[rows]
        inner = np.maximum(r, straight)
        share = np.clip((d - straight) / np.maximum(zone - straight, 1e-9), 0.0, 1.0)
        target = np.where(straight < zone, inner + share * (zone - inner), d)
        return rows, centre + offset[rows] * (np.maximum(target, d) / d)[:, None]

    sheet.cut(move)
    return side, at


def _tear(sheet: _Sheet, grid: Grid, margins: IndexArray, depth: float, draw: list[float]) -> None:
    """Tear a blade from the margin inwards along a lateral vein: a narrow notch with parted edges."""
    side, columns = int(draw[0] < 0.5), len(grid.across)
    veins = np.flatnonzero((np.abs(grid.number - np.round(grid.number)) < 1e-6) & (grid.number >= 0.0))
    veins = veins[grid.number[veins] < 5.5]
    if veins.size == 0:
        return
    row = int(veins[int(draw[1] * veins.size)])
    first = 1 + row * columns
    half = np.arange(grid.side, columns) if side else np.arange(grid.side, -1, -1)
    vertices, margin = first + half, margins[side]
    index = 1 + int(grid.row_in_margin[row])
    before, after = int(margin[index - 1]), int(margin[index + 1])

    def move(flat: FloatArray, factor: float) -> tuple[IndexArray, FloatArray] | None:
        line = flat[vertices]
        at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        if not at[-1] > 0.0:
            return None
        at /= at[-1]
        end = 1.0 - min(factor * depth * (0.6 + 0.8 * draw[2]), 0.85)
        start = max(end - 0.3, 0.05)
        outer = at > start
        anchor = np.array([np.interp(start, at, line[:, axis]) for axis in range(2)])
        tip = line[-1]
        # Straight beyond `start`, so that both edges of the notch are beside the row.
        share = (at[outer] - start) / (1.0 - start) * (end - start) / (1.0 - start)
        gap = 0.5 * _GAP * (0.5 + draw[3]) * (1.0 - end) * float(np.hypot(*(tip - line[0])))
        edges = np.array([_towards(tip, flat[vertex], gap) for vertex in (before, after)])
        return (
            np.concatenate([vertices[outer], [before, after]]),
            np.concatenate([anchor + share[:, None] * (tip - anchor), edges]),
        )

    moved = sheet.cut(move)
    if moved.size:
        # One edge is above the other.
        a, b, c = (sheet.values[vertex, :3] for vertex in (vertices[-1], before, after))
        across = np.cross(b - a, c - a)
        length, area = float(np.linalg.norm(b - a)), float(np.linalg.norm(across))
        part = _FLAP * (2.0 * draw[3] - 1.0) * length / max(area, 1e-12)
        sheet.values[before, :3] += part * across
        sheet.values[after, :3] -= part * across


def _towards(start: FloatArray, end: FloatArray, distance: float) -> FloatArray:
    """The point at a distance from `start` on the way to `end`, at most half of the way."""
    step = end - start
    return np.asarray(start + step * min(distance / max(float(np.hypot(*step)), 1e-9), 0.5))

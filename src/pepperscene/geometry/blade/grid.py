"""The triangle grid of a blade, whose rows follow the secondary veins that the material draws.

Lengths are fractions of the flat blade, like its uv: `out` is 0 at the midrib and 1 at half the width,
`along` is 0 at the base and 1 at the tip. The formula of the veins is that of `materials.venation`, which
draws one pattern for all blades of a cultivar, stretched to each: on narrow blades veins are steeper.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import Final

import numpy as np

from pepperscene.geometry.batch import subdivisions
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.materials.venation import VEIN_ARC, VEIN_ASPECT, VEIN_COT_BASE, VEIN_COT_TIP, VEIN_PAIRS

_COT_CHANGE: Final = VEIN_COT_TIP - VEIN_COT_BASE
_MEAN_OFFSET: Final = 0.325  # of the numbers that the material adds to a vein's, uniform in 0.15 to 0.5


def vein_origin(number: FloatArray) -> FloatArray:
    """Position where secondary vein `number` (0 the lowest, or a fraction) leaves the midrib."""
    return 0.02 + 0.85 * (np.maximum(number + _MEAN_OFFSET, 0.0) / VEIN_PAIRS) ** 1.15


def vein_number(origin: float) -> float:
    """Number of the vein with that origin, the inverse of `vein_origin`."""
    return float(VEIN_PAIRS * ((origin - 0.02) / 0.85) ** (1.0 / 1.15) - _MEAN_OFFSET)


def vein_rise(origin: FloatArray, out: FloatArray) -> FloatArray:
    """Distance along the blade that a vein has risen from its origin at `out` from the midrib."""
    half = 0.5 * VEIN_ASPECT * out
    return (VEIN_COT_BASE + _COT_CHANGE * origin) * half + VEIN_ARC * VEIN_ASPECT / 6.0 * out**3


def origin_of_vein_at(along: FloatArray, out: FloatArray) -> FloatArray:
    """Origin of the vein through a position, the inverse of `vein_rise`; may be below the base."""
    half = 0.5 * VEIN_ASPECT * out
    return (along - VEIN_COT_BASE * half - VEIN_ARC * VEIN_ASPECT / 6.0 * out**3) / (1.0 + _COT_CHANGE * half)


def vein_density(out: FloatArray, origin: float) -> FloatArray:
    """Veins per half-width that a straight cut across the blade meets, at the vein with that origin."""
    half = 0.5 * VEIN_ASPECT
    slope = (VEIN_COT_BASE + _COT_CHANGE * origin) * half + 0.5 * VEIN_ARC * VEIN_ASPECT * out**2
    # d number / d origin, from `vein_origin`.
    crowding = VEIN_PAIRS / (1.15 * 0.85) * ((origin - 0.02) / 0.85) ** (1.0 / 1.15 - 1.0)
    return crowding * slope / (1.0 + _COT_CHANGE * half * out)


# Chosen so that detail 1 gives some 650 triangles, of 5 to 10 mm on a blade of 135 mm. Half of its surface is
# then within 0.1 mm of that of detail 4, a ninth of a pixel from 40 cm; from 10 cm both look the same.
_FAN: Final = 5  # rows below the first vein
_PER_VEIN: Final = 3  # rows from one vein to the next: the vein and the flanks of the bulge
_SIDE: Final = 6  # columns in each half, the fewest that show how tertiary veins divide bulges
_MARGIN: Final = 48  # chosen: pieces of an entire margin at any detail from 0.5 to 2
_PER_LOBE: Final = 10  # chosen: rows to a lobe, likewise
_LOBED_SIDE: Final = 4  # chosen: columns in each half of a lobed blade
_PALMATE_SIDE: Final = 8  # chosen: of a palmate one, which is large
_PALMATE_LENGTH: Final = (-1.0, 0.0, 1.0, 2.0), (0.0, 0.28, 0.42, 0.55)
"""Fractions of the margin of a palmate blade below the points of these numbers: chosen, as of cucumber."""
_PER_TOOTH: Final = 5  # chosen: pieces of a margin to a tooth
_TEETH_STEP: Final = 8  # chosen: numbers of teeth between which blades share a grid, as it is kept

FAN_POWER: Final = 1.5
"""Chosen: row i of k below the first vein meets the margin at (i/k)^1.5 of the way, evenly along a round
base."""

TIP_NUMBER: Final = vein_number(1.0)

_BELOW: Final = 0.45  # approximate fraction of a margin's length below the end of the first vein


@dataclass(frozen=True, eq=False)
class Grid:
    """Topology of a blade: the base, r rows of c columns, e extra points of the margins, and the tip."""

    # `(r,)` the secondary vein that a row follows, 0 the lowest, with fractions between veins; below the
    # first vein from -1 at the base to 0, above the last to `TIP_NUMBER` at the tip
    number: FloatArray
    across: FloatArray  # `(c,)` -1 left margin, 0 midrib, 1 right margin
    side: int  # columns in each half
    margin: FloatArray  # `(m,)` like `number`, of all points of a margin without base and tip
    row_in_margin: IndexArray  # `(r,)` indices into `margin` of the ends of the rows
    extra_in_margin: IndexArray  # `(e / 2,)` indices into `margin` of the extra points
    faces: IndexArray  # `(f, 3)`

    @property
    def margin_vertices(self) -> IndexArray:
        """`(2, m + 2)` vertices of the left and the right margin, from the base to the tip."""
        rows, columns, extra = len(self.number), len(self.across), len(self.extra_in_margin)
        tip = 1 + rows * columns + 2 * extra
        vertices = np.empty((2, len(self.margin) + 2), dtype=np.intp)
        vertices[:, 0], vertices[:, -1] = 0, tip
        ends = columns * np.arange(rows)
        vertices[:, 1 + self.row_in_margin] = np.stack([1 + ends, columns + ends])
        extras = 1 + rows * columns + np.arange(extra)
        vertices[:, 1 + self.extra_in_margin] = np.stack([extras, extras + extra])
        return vertices

    def split_halves(self, rows: FloatArray) -> FloatArray:
        """`(n, 2, r, s)` left and right half, from the midrib outwards, of values `(n, r, c)`."""
        return np.stack([rows[..., self.side - 1 :: -1], rows[..., self.side + 1 :]], axis=1)

    def interpolate_extra(self, values: FloatArray) -> FloatArray:
        """`(..., e / 2)` values at the extra points of a margin, from those at the ends of rows `(..., r)`.

        Beyond the first and the last row they are constant.
        """
        extra = self.margin[self.extra_in_margin]
        low = np.clip(np.searchsorted(self.number, extra) - 1, 0, len(self.number) - 2)
        fraction = (extra - self.number[low]) / (self.number[low + 1] - self.number[low])
        fraction = np.clip(fraction, 0.0, 1.0)
        return np.asarray(values[..., low] * (1.0 - fraction) + values[..., low + 1] * fraction)

    def pack(
        self,
        halves: FloatArray,
        midrib: FloatArray | float,
        extra: FloatArray,
        ends: tuple[FloatArray | float, FloatArray | float] = (0.0, 0.0),
    ) -> FloatArray:
        """`(n, v)` values in the order of the vertices.

        Args:
            halves: `(n, 2, r, s)` as from `split_halves`.
            midrib: `(n, r)`, `(r,)` or one for all.
            extra: `(n, 2, e / 2)` of the extra points of the margins.
            ends: `(n,)` or one for all, of base and tip.
        """
        n, columns = len(halves), len(self.across)
        last = 1 + len(self.number) * columns
        values = np.empty((n, last + 2 * len(self.extra_in_margin) + 1))
        rows = values[:, 1:last].reshape(n, -1, columns)  # a view
        rows[..., : self.side] = halves[:, 0, :, ::-1]
        rows[..., self.side] = midrib
        rows[..., self.side + 1 :] = halves[:, 1]
        values[:, last:-1] = extra.reshape(n, -1)
        values[:, 0], values[:, -1] = ends
        return values


def blade_grid(detail: float, lobes: float, teeth: float | None = None) -> Grid:
    """Build the grid for a fineness and a number of lobes along each margin.

    Args:
        detail: fineness, 1 as designed.
        lobes: along a margin, those of palmate blades left out.
        teeth: along a margin of a palmate blade; None if there is no palmate blade.
    """
    return _grid(*_grid_size(detail, lobes, teeth), palmate=teeth is not None)


def max_blade_triangles(detail: float, lobes: float, teeth: float | None = None) -> int:
    """An upper bound of the triangles of `blade_grid`, close to their number, without building it."""
    fan, per_vein, side, pieces = _grid_size(detail, lobes, teeth)
    rows = fan + per_vein * VEIN_PAIRS
    # A disc of v vertices, b of them on its edge, has 2 v - b - 2 triangles.
    edge = 2 * max(pieces, rows) + 2
    return 2 * (2 * side - 1) * rows + 2 * rows + edge


def _grid_size(detail: float, lobes: float, teeth: float | None) -> tuple[int, int, int, int]:
    """Rows below the first vein and from vein to vein, columns in each half, and pieces of a margin."""
    # Margins stay fine where the inside is coarse, so that the outline is the same.
    margin_detail = min(1.0, 2.0 * detail)
    fan, per_vein = subdivisions(_FAN, detail, 3), subdivisions(_PER_VEIN, detail, 2 if detail >= 0.2 else 1)
    side, pieces = _SIDE, _MARGIN
    if teeth is not None:
        side, pieces = _PALMATE_SIDE, max(_MARGIN, _PER_TOOTH * _TEETH_STEP * ceil(teeth / _TEETH_STEP))
    if lobes <= 0.0:
        return fan, per_vein, subdivisions(side, detail, 3), subdivisions(pieces, margin_detail, 16)
    # Every point of a lobe has its row, because the inside must follow it.
    rows = _PER_LOBE * lobes * max(min(1.0, 0.3 + 1.5 * detail), detail)
    fan, per_vein = max(fan, round(_BELOW * rows)), max(per_vein, round((1.0 - _BELOW) * rows / TIP_NUMBER))
    side, pieces = (_LOBED_SIDE, 1) if teeth is None else (side, subdivisions(pieces, margin_detail, 16))
    return fan, per_vein, subdivisions(side, detail, 3), pieces


@lru_cache(maxsize=16)
def _grid(fan: int, per_vein: int, side: int, pieces: int, *, palmate: bool) -> Grid:
    """A grid of `2 * side + 1` columns; margins have about `pieces` pieces, at least one per row."""
    # Rows are closer together near the veins, where the blade is creased.
    even = np.arange(per_vein * VEIN_PAIRS + 1) / per_vein
    veined = even - 0.3 / (2.0 * np.pi) * np.sin(2.0 * np.pi * even)
    number = np.concatenate([np.arange(1, fan) / fan - 1.0, veined])
    # Columns are a little closer together at the midrib.
    half = (np.arange(1, side + 1) / side) ** 1.12
    across = np.concatenate([-half[::-1], [0.0], half])
    # Extra points cut the margin between neighbouring rows into pieces of about equal lengths.
    knots = np.concatenate([[-1.0], number, [TIP_NUMBER]])
    cuts = np.maximum((np.diff(_margin_length(knots, palmate)) * pieces).astype(int), 1)
    parts = [np.arange(cut) / cut for cut in cuts]
    at = [low + (high - low) * part for low, high, part in zip(knots[:-1], knots[1:], parts, strict=True)]
    margin = np.concatenate([*at, [TIP_NUMBER]])
    rows_at = np.cumsum(cuts)[:-1]
    extra = np.setdiff1d(np.arange(1, len(margin) - 1), rows_at)
    faces = _faces(len(number), half, cuts, extra)
    # The base and the tip belong to neither margin.
    return Grid(number, across, side, margin[1:-1], rows_at - 1, extra - 1, faces)


def _margin_length(number: FloatArray, palmate: bool) -> FloatArray:
    """Approximate fraction of a margin below its point of this number."""
    if palmate:
        numbers, lengths = _PALMATE_LENGTH
        return np.interp(number, (*numbers, TIP_NUMBER), (*lengths, 1.0))
    first = vein_origin(np.zeros(1))
    above = (vein_origin(np.maximum(number, 0.0)) - first) / (1.0 - first)
    return _BELOW * (np.minimum(number, 0.0) + 1.0) + (1.0 - _BELOW) * above


def _faces(rows: int, half: FloatArray, cuts: IndexArray, extra: IndexArray) -> IndexArray:
    """Triangles, counter-clockwise from above with the base below and the tip above.

    `cuts` are the pieces of the margin from base to row, from row to row, and from row to tip; `extra` the
    indices along the margin, counted from the base, of points that belong to no row.
    """
    side = len(half)
    columns = 2 * side + 1
    corner = 1 + np.arange(rows * columns).reshape(rows, columns)
    tip = 1 + rows * columns + 2 * len(extra)
    # Inner cells, cut along the shorter diagonal; rows rise away from the midrib.
    cell = corner[:, 1:-1]
    a, b, d, c = cell[:-1, :-1], cell[:-1, 1:], cell[1:, :-1], cell[1:, 1:]
    left = (np.arange(columns - 3) < side - 1)[:, None]
    lower = np.where(left, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    upper = np.where(left, np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    faces = [lower.reshape(-1, 3), upper.reshape(-1, 3)]
    ends = np.concatenate([[0], np.cumsum(cuts)])
    for right in (False, True):
        rim = np.empty(ends[-1] + 1, dtype=np.intp)
        rim[0], rim[-1] = 0, tip
        rim[ends[1:-1]] = corner[:, -1 if right else 0]
        rim[extra] = 1 + rows * columns + right * len(extra) + np.arange(len(extra))
        # The outermost cells.
        outer: list[tuple[int, int, int]] = []
        inside = corner[:, -2 if right else 1]
        for k in range(rows - 1):
            outer += _strip(rim[ends[k + 1] : ends[k + 2] + 1], int(inside[k]), int(inside[k + 1]))
        # Between the base and the first row, and between the last row and the tip.
        first, last = (line[side:] if right else line[side::-1] for line in (corner[0], corner[-1]))
        outer += _zip_rows(rim[: ends[1] + 1], first, half)
        outer += [(a, c, b) for a, b, c in _zip_rows(rim[: ends[-2] - 1 : -1], last, half)]
        faces.append(np.array(outer, dtype=np.intp)[:, :: 1 if right else -1])
    return np.concatenate(faces)


def _strip(rim: IndexArray, low: int, high: int) -> list[tuple[int, int, int]]:
    """Triangles between a piece of the right margin and the two inner corners next to it."""
    middle = len(rim) // 2
    faces = [(low, int(rim[k]), int(rim[k + 1])) for k in range(middle)]
    faces += [(high, int(rim[k]), int(rim[k + 1])) for k in range(middle, len(rim) - 1)]
    return [*faces, (low, int(rim[middle]), high)]


def _zip_rows(rim: IndexArray, row: IndexArray, half: FloatArray) -> list[tuple[int, int, int]]:
    """Triangles between the right margin at the base and the row above it; both end in the same vertex."""
    # Advance on the side that stays closer to the midrib; for the margin, as on a round base.
    rim_at = (np.arange(len(rim)) / (len(rim) - 1)) ** 1.35
    row_at = np.concatenate([[0.0], half])
    faces = []
    i = j = 0
    while i + j < len(rim) + len(row) - 3:
        if i + 1 < len(rim) and (j + 2 == len(row) or rim_at[i + 1] <= row_at[j + 1]):
            faces.append((int(rim[i]), int(rim[i + 1]), int(row[j])))
            i += 1
        else:
            faces.append((int(rim[i]), int(row[j + 1]), int(row[j])))
            j += 1
    return faces

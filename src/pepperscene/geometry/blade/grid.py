"""Where the secondary veins of a blade run, so that bulges rise between the veins that the material draws.

All lengths are shares of the flat blade, as its uv are: the way out from the midrib is 0 there and 1 at half
the width, the way along is 0 at the base and 1 at the tip. The law is that of `materials.venation`, which
draws one pattern for all blades of a cultivar, stretched to each: on narrow ones veins are steeper.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.bodies import fineness
from pepperscene.materials.patterns import ARC, ASPECT, BASE_COT, PAIRS, TIP_COT

Array = NDArray[np.float64]

_TURN: Final = TIP_COT - BASE_COT
_MEAN_OFFSET: Final = 0.325  # of the numbers that the material adds to a vein's, uniform in .15 to .5


def vein_start(number: Array) -> Array:
    """Where secondary vein `number` (0 the lowest; any fraction) leaves the midrib: closer at the base."""
    return 0.02 + 0.85 * (np.maximum(number + _MEAN_OFFSET, 0.0) / PAIRS) ** 1.15


def vein_at(start: float) -> float:
    """The number of the vein that would start there, the inverse of `vein_start`."""
    return float(PAIRS * ((start - 0.02) / 0.85) ** (1.0 / 1.15) - _MEAN_OFFSET)


def vein_rise(start: Array, out: Array) -> Array:
    """How far along the blade a vein has risen when it has come `out` from the midrib."""
    half = 0.5 * ASPECT * out
    return (BASE_COT + _TURN * start) * half + ARC * ASPECT / 6.0 * out**3


def vein_through(along: Array, out: Array) -> Array:
    """Where the vein through a place leaves the midrib, the inverse of `vein_rise`; may be below the base."""
    half = 0.5 * ASPECT * out
    return (along - BASE_COT * half - ARC * ASPECT / 6.0 * out**3) / (1.0 + _TURN * half)


def veins_crossed(out: Array, start: float) -> Array:
    """How many veins a straight cut across the blade meets per half-width, at the vein that starts there."""
    half = 0.5 * ASPECT
    climb = (BASE_COT + _TURN * start) * half + 0.5 * ARC * ASPECT * out**2
    # d number / d start by the law of `vein_start`.
    crowding = PAIRS / (1.15 * 0.85) * ((start - 0.02) / 0.85) ** (1.0 / 1.15 - 1.0)
    return crowding * climb / (1.0 + _TURN * half * out)


Index = NDArray[np.intp]

# Chosen so that detail 1 gives some 650 triangles, of 5 to 10 mm on a blade of 135 mm. Half of its surface
# then lies within 0.1 mm of that of detail 4, a ninth of a pixel from 40 cm; from 10 cm both look alike.
_FAN: Final = 5  # rows below the first vein
_PER_VEIN: Final = 3  # rows from one vein to the next: the vein and the flanks of the bulge
_SIDE: Final = 6  # columns in each half, the fewest that show how tertiary veins part bulges
_MARGIN: Final = 48  # pieces of an entire margin at any detail from 0.5 to 2
_PER_LOBE: Final = 10  # rows to a lobe, likewise
_LOBED_SIDE: Final = 4  # columns in each half of a lobed blade

FAN_POWER: Final = 1.5
"""Row i of k below the first vein meets the margin at (i/k)^1.5 of the way: evenly along a round base."""

TOP: Final = vein_at(1.0)
"""The number of the tip."""

_BELOW: Final = 0.45  # of a margin's length, about, lies below the first vein's end


@dataclass(frozen=True, eq=False)
class Grid:
    """Vertices are the base, r rows of c columns each, the e further points of the margins, and the tip.

    Attributes:
        number: `(r,)` the secondary vein that a row runs along, 0 the lowest, with fractions between veins;
            below the first vein it goes from -1 at the base to 0, above the last to `TOP` at the tip.
        across: `(c,)` -1 left margin, 0 midrib, 1 right margin.
        side: columns in each half.
        margin: `(m,)` the same number of every point of a margin, base and tip left out.
        row_in_margin: `(r,)` which of them the rows end in.
        extra_in_margin: `(e / 2,)` which of them are further points.
        faces: `(f, 3)`.
    """

    number: Array
    across: Array
    side: int
    margin: Array
    row_in_margin: Index
    extra_in_margin: Index
    faces: Index

    def halves(self, rows: Array) -> Array:
        """`(n, 2, r, s)` left and right half, from the midrib outwards, of values `(n, r, c)`."""
        return np.stack([rows[..., self.side - 1 :: -1], rows[..., self.side + 1 :]], axis=1)

    def between(self, values: Array) -> Array:
        """`(..., e / 2)` values at further points of a margin, out of those of its rows `(..., r)`.

        Beyond the first and the last row they are those rows'.
        """
        extra = self.margin[self.extra_in_margin]
        low = np.clip(np.searchsorted(self.number, extra) - 1, 0, len(self.number) - 2)
        part = np.clip((extra - self.number[low]) / (self.number[low + 1] - self.number[low]), 0.0, 1.0)
        return np.asarray(values[..., low] * (1.0 - part) + values[..., low + 1] * part)

    def joined(
        self,
        halves: Array,
        midrib: Array | float,
        extra: Array,
        ends: tuple[Array | float, Array | float] = (0.0, 0.0),
    ) -> Array:
        """`(n, v)` values in the order of the vertices.

        Args:
            halves: `(n, 2, r, s)` of the columns of either half, from the midrib outwards.
            midrib: `(n, r)`, `(r,)` or one for all.
            extra: `(n, 2, e / 2)` of the margins' further points.
            ends: `(n,)` or one for all, of base and tip.
        """
        n, columns = len(halves), len(self.across)
        last = 1 + len(self.number) * columns
        every = np.empty((n, last + 2 * len(self.extra_in_margin) + 1))
        rows = every[:, 1:last].reshape(n, -1, columns)  # a view
        rows[..., : self.side] = halves[:, 0, :, ::-1]
        rows[..., self.side] = midrib
        rows[..., self.side + 1 :] = halves[:, 1]
        every[:, last:-1] = extra.reshape(n, -1)
        every[:, 0], every[:, -1] = ends
        return every


def blade_grid(detail: float, lobes: float) -> Grid:
    """The grid for a fineness and a number of lobes along each margin."""
    # Margins stay fine where the inside is coarse, so that the outline is the same.
    share = min(1.0, 2.0 * detail)
    fan, veined = fineness(_FAN, detail, 3), fineness(_PER_VEIN, detail, 2 if detail >= 0.2 else 1)
    if lobes <= 0.0:
        return _grid(fan, veined, fineness(_SIDE, detail, 3), fineness(_MARGIN, share, 16))
    # Every point of a lobe has its row, for the inside must follow it.
    rows = _PER_LOBE * lobes * max(min(1.0, 0.3 + 1.5 * detail), detail)
    fan, veined = max(fan, round(_BELOW * rows)), max(veined, round((1.0 - _BELOW) * rows / TOP))
    return _grid(fan, veined, fineness(_LOBED_SIDE, detail, 3), 1)


@lru_cache(maxsize=16)
def _grid(fan: int, per_vein: int, side: int, pieces: int) -> Grid:
    """A grid of rows of `2 * side + 1` columns; margins have about so many pieces, no fewer than rows."""
    # Rows stand closer beside the veins, where the blade is creased.
    even = np.arange(per_vein * PAIRS + 1) / per_vein
    veined = even - 0.3 / (2.0 * np.pi) * np.sin(2.0 * np.pi * even)
    number = np.concatenate([np.arange(1, fan) / fan - 1.0, veined])
    # Columns stand a little closer at the midrib.
    half = (np.arange(1, side + 1) / side) ** 1.12
    across = np.concatenate([-half[::-1], [0.0], half])
    # Further points cut each piece of the margin between rows to about equal lengths.
    knots = np.concatenate([[-1.0], number, [TOP]])
    cuts = np.maximum((np.diff(_margin_length(knots)) * pieces).astype(int), 1)
    parts = [np.arange(cut) / cut for cut in cuts]
    at = [low + (high - low) * part for low, high, part in zip(knots[:-1], knots[1:], parts, strict=True)]
    margin = np.concatenate([*at, [TOP]])
    rows_at = np.cumsum(cuts)[:-1]
    extra = np.setdiff1d(np.arange(1, len(margin) - 1), rows_at)
    # The base and the tip are no points of either margin.
    faces = _faces(len(number), half, cuts, extra)
    return Grid(number, across, side, margin[1:-1], rows_at - 1, extra - 1, faces)


def _margin_length(number: Array) -> Array:
    """About which share of a margin lies below its point of this number."""
    first = vein_start(np.zeros(1))
    above = (vein_start(np.maximum(number, 0.0)) - first) / (1.0 - first)
    return _BELOW * (np.minimum(number, 0.0) + 1.0) + (1.0 - _BELOW) * above


def _faces(rows: int, half: Array, cuts: NDArray[np.int_], extra: Index) -> Index:
    """Triangles, counter-clockwise from above with the base below and the tip above.

    Args:
        rows: how many.
        half: `(s,)` where the columns of a half stand between the midrib and the margin.
        cuts: pieces of the margin from base to row, from row to row, and from row to tip.
        extra: places along the margin, counted from the base, of points that are no row's.
    """
    side = len(half)
    columns = 2 * side + 1
    corner = 1 + np.arange(rows * columns).reshape(rows, columns)
    tip = 1 + rows * columns + 2 * len(extra)
    # Inner cells; the diagonal is the shorter one, for rows rise away from the midrib.
    cell = corner[:, 1:-1]
    a, b, d, c = cell[:-1, :-1], cell[:-1, 1:], cell[1:, :-1], cell[1:, 1:]
    left = (np.arange(columns - 3) < side - 1)[:, None]
    one = np.where(left, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    two = np.where(left, np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    made = [one.reshape(-1, 3), two.reshape(-1, 3)]
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
        outer += _zipped(rim[: ends[1] + 1], first, half)
        outer += [(a, c, b) for a, b, c in _zipped(rim[: ends[-2] - 1 : -1], last, half)]
        made.append(np.array(outer, dtype=np.intp)[:, :: 1 if right else -1])
    return np.concatenate(made)


def _strip(rim: Index, low: int, high: int) -> list[tuple[int, int, int]]:
    """Triangles between a piece of the right margin and the two inner corners beside it."""
    middle = len(rim) // 2
    made = [(low, int(rim[k]), int(rim[k + 1])) for k in range(middle)]
    made += [(high, int(rim[k]), int(rim[k + 1])) for k in range(middle, len(rim) - 1)]
    return [*made, (low, int(rim[middle]), high)]


def _zipped(rim: Index, row: Index, half: Array) -> list[tuple[int, int, int]]:
    """Triangles between the right margin's piece at the base and the row above it; both end in one vertex."""
    # The one or the other goes on, whichever stays closer to the midrib; on a round base, about.
    rim_at = (np.arange(len(rim)) / (len(rim) - 1)) ** 1.35
    row_at = np.concatenate([[0.0], half])
    made = []
    i = j = 0
    while i + j < len(rim) + len(row) - 3:
        if i + 1 < len(rim) and (j + 2 == len(row) or rim_at[i + 1] <= row_at[j + 1]):
            made.append((int(rim[i]), int(rim[i + 1]), int(row[j])))
            i += 1
        else:
            made.append((int(rim[i]), int(row[j + 1]), int(row[j])))
            j += 1
    return made

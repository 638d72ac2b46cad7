"""Blades on the flat: where the vertices of the grid lie before a blade is bent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.lamina_grid import FAN_POWER, Grid
from pepperscene.geometry.lamina_outline import Outlines
from pepperscene.geometry.lamina_veins import vein_rise, vein_start, vein_through

Array = NDArray[np.float64]

_TABLE = np.linspace(0.0, 1.0, 161)  # chosen: places along a margin between which rows' ends are interpolated


@dataclass(frozen=True, eq=False)
class Flat:
    """Vertices of n flat blades, a left and a right half each.

    Attributes:
        margin: `(n, 2, m)` share of the length at which the margin's points would lie without lobes.
        reach: `(n, 2, m)` metres from the midrib to the margin's points.
        rim: `(n, 2, r)` what `margin` is for the rows' ends.
        start: `(r,)` share of the length at which rows leave the midrib.
        edge: `(n, 2, r)` metres from the midrib to the rows' ends.
        part: `(s,)` of the way from the midrib to the row's end, for the s columns of a half.
        out: `(n, 2, r, s)` metres from the midrib.
        along: `(n, 2, r, s)` share of the length.
        extra_edge: `(n, 2, e)` metres from the midrib to the further points of the margins.
        extra_along: `(n, 2, e)` share of the length.
    """

    margin: Array
    reach: Array
    rim: Array
    start: Array
    edge: Array
    part: Array
    out: Array
    along: Array
    extra_edge: Array
    extra_along: Array


def flat_blades(outline: Outlines, grid: Grid) -> Flat:
    """Rows along the veins, from the midrib to wherever the outline has its margin."""
    n, number = len(outline.length), grid.margin
    low = number < 0.0
    ends = _row_ends(outline, np.concatenate([[0.0], number[~low]]))
    # Below the first vein rows spread evenly from the foot of the blade to the margin.
    spread = np.where(low, 1.0 + number, 1.0)
    along = np.empty((n, 2, len(number)))
    along[..., ~low] = ends[..., 1:]
    along[..., low] = ends[..., :1] * spread[low] ** FAN_POWER
    start = vein_start(np.maximum(number, 0.0)) * np.minimum(spread**0.8, 5.0 * spread**FAN_POWER)
    start[~low] = vein_start(number[~low])
    # Lobes are cut along the rows, so that they point where the veins do, and less deep where rows graze the
    # margin.
    whole = outline.reach(along)
    lobed = 1.0 - (1.0 - outline.lobed(along)) * (0.3 + 0.7 * spread)
    edge = whole * lobed
    part = grid.across[-grid.side :]
    rows, extra = grid.row_in_margin, grid.extra_in_margin

    share, bow = _courses(outline, along, start, spread)

    def climbed(of: NDArray[np.intp], out: Array) -> Array:
        """Share of the length at `out` metres from the midrib, both `(n, 2, o, s)`, on rows to `of`."""
        begin, full = start[of, None], whole[:, :, of, None]
        extent = outline.half_extent[:, None, None, None]
        climb = vein_rise(begin, out / extent) / vein_rise(begin, full / extent)
        if np.any(share[:, :, of] < 1.0):
            straight = (out / full) ** bow[:, :, of, None]
            climb = straight + share[:, :, of, None] * (climb - straight)
        return begin + (along[:, :, of, None] - begin) * climb

    # The inside follows the lobes, the less the closer to the midrib.
    deep = 1.0 - lobed[..., rows, None]
    out = whole[..., rows, None] * (part * (1.0 - deep * np.sqrt(part)))
    return Flat(
        along, edge, along[..., rows], start[rows], edge[..., rows], part, out, climbed(rows, out),
        edge[..., extra], climbed(extra, edge[..., extra, None])[..., 0],
    )  # fmt: skip


def _row_ends(outline: Outlines, number: Array) -> Array:
    """`(n, 2, k)` where the veins `(k,)` meet the margin, as a share of the length."""
    out = outline.reach(_TABLE) / outline.half_extent[:, None, None]
    starts = vein_through(_TABLE, out)
    # Under a broad base the margin runs down and up again through the same veins: the upper crossing counts.
    starts = np.minimum.accumulate(starts[..., ::-1], axis=2)[..., ::-1] + 1e-9 * _TABLE
    wanted = vein_start(number)
    ends = [np.interp(wanted, one, _TABLE) for one in starts.reshape(-1, len(_TABLE))]
    return np.array(ends).reshape(*starts.shape[:2], len(number))


def _courses(outline: Outlines, along: Array, start: Array, spread: Array) -> tuple[Array, Array]:
    """How rows run, `(n, 2, m)` each: the share of the vein's course, and the power of the rest.

    A row must reach the margin from within. Where the margin grows as a power p of the length (p > 1 on a
    wedge-shaped base), what a row climbs above its start may grow at most as the way out to the power
    along / (along - start) / p; a vein's course grows as the power `steep`.

    Args:
        outline: of the blades.
        along: `(n, 2, m)` where rows end.
        start: `(m,)` where they leave the midrib.
        spread: `(m,)` the share of the vein's course where the margin does not forbid it.
    """
    step = 1.0 + 1e-4
    reach = outline.reach(along)
    power = np.log(outline.reach(np.minimum(along * step, 1.0 - 1e-12)) / reach) / np.log(step)
    most = 0.65 * along / (np.maximum(along - start, 1e-9) * np.maximum(power, 1e-3))
    out = reach / outline.half_extent[:, None, None]
    rise = vein_rise(start, out)
    steep = (vein_rise(start, out * step) / rise - 1.0) / (step - 1.0)
    bow = np.minimum(most, 1.0)
    return np.clip((most - bow) / np.maximum(steep - bow, 1e-9), 0.0, spread), bow

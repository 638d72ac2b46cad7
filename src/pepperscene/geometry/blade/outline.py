"""The outline of a flat blade: ovate, drawn out to a tip, rounded or wedge-shaped at its base, lobed or not.

Places along a margin are told by `along`, the share of the length that the outline without lobes has there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.blade.grid import FAN_POWER, Grid, vein_rise, vein_start, vein_through
from pepperscene.geometry.organ_arrays import hashed, organ_measure, size
from pepperscene.grammar.plant import Organ

Array = NDArray[np.float64]

_WIDEST: Final = 0.35  # chosen with _BASE by eye from photographs: rounded-cuneate base, drawn-out tip
_BASE: Final = 0.8
_FINEST_TIP: Final = 2.2  # power of the outline at the tip, chosen
_RUNNING_DOWN: Final = 0.012  # chosen: below it, as a share of the length, the blade runs down the stalk
_TABLE: Final = 0.5 - 0.5 * np.cos(
    np.pi * np.arange(193) / 192
)  # where outlines are searched for their widest
_MOST_LOBES: Final = 24  # along a margin; finer teeth need more triangles than a blade should have


@dataclass(frozen=True, eq=False)
class Outlines:
    """The outlines of n blades, a left and a right margin each.

    Attributes:
        length: `(n,)` metres.
        half_width: `(n, 2)` metres, of the left and the right half where it is widest.
        half_extent: `(n,)` metres, the larger of the two; the material's veins reach so far.
        base: `(n, 1, 1)` power of the outline at the base.
        widest: `(n, 1, 1)` where it is widest.
        scale: `(n, 2, 1)` makes the greatest reach 1.
        lobes: `(n, 2, 4 + k)` hashed numbers that place the lobes and tell how deep each is.
        count: `(n, 1, 1)` lobes along a margin.
        depth: `(n, 1, 1)` of the lobes, as a share of the half-width.
    """

    length: Array
    half_width: Array
    half_extent: Array
    base: Array
    widest: Array
    scale: Array
    lobes: Array
    count: Array
    depth: Array

    def reach(self, along: Array) -> Array:
        """`(n, 2, m)` metres from the midrib to the margin without lobes.

        Args:
            along: `(n, 2, m)` shares of the length, or `(m,)` for all margins.
        """
        return self.half_width[..., None] * self.scale * _beta(along, self.base, self.widest)

    def lobed(self, along: Array) -> Array:
        """`(n, 2, m)` the part of the reach that the margin has with its lobes; 1 for an entire margin."""
        if not np.any(self.depth * self.count > 0.0):
            return np.ones(np.broadcast_shapes(along.shape, self.scale.shape))
        return _lobed(along, self.lobes, self.count, self.depth)


def outlines(organs: Sequence[Organ], seed: Array) -> Outlines:
    """The outlines of blades, out of their measures (see `laminae`)."""
    length, width = size(organs, "length_m"), size(organs, "width_m")
    widest = np.clip(organ_measure(organs, "widest", _WIDEST), 0.2, 0.45)[:, None, None]
    # A tip whose power is beyond that would be a thread.
    finest = _FINEST_TIP * widest / (1.0 - widest)
    base = np.minimum(np.clip(organ_measure(organs, "base", _BASE), 0.3, 1.1)[:, None, None], finest)
    uneven = np.clip(organ_measure(organs, "asymmetry", 0.0), -0.5, 0.5)[:, None]
    half = 0.5 * width[:, None] * (1.0 + uneven * np.array([-1.0, 1.0]))
    count = np.clip(organ_measure(organs, "lobes", 0.0), 0.0, _MOST_LOBES)[:, None, None]
    depth = np.clip(organ_measure(organs, "lobe_depth", 0.0), 0.0, 0.6)[:, None, None]
    numbers = 4 + 2 * int(np.ceil(count.max())) + 3
    lobes = hashed(seed, 251, 2 * numbers).reshape(len(organs), 2, numbers)
    # The width is that over the lobes; an entire margin reaches 1 where it is widest.
    scale = np.ones((len(organs), 2, 1))
    if np.any(depth * count > 0.0):
        profile = _beta(_TABLE, base, widest) * _lobed(_TABLE, lobes, count, depth)
        scale = np.where(depth * count > 0.0, 1.0 / profile.max(axis=2, keepdims=True), scale)
    return Outlines(length, half, half.max(axis=1), base, widest, scale, lobes, count, depth)


def _beta(along: Array, base: Array, widest: Array) -> Array:
    """Half-width over the greatest, 0 at both ends, 1 at `widest`: a beta curve, hollow at its very foot."""
    other = base * (1.0 - widest) / widest
    body = (along / widest) ** base * ((1.0 - along) / (1.0 - widest)) ** other
    return body * -np.expm1(-along / _RUNNING_DOWN)


def _lobed(along: Array, lobes: Array, count: Array, depth: Array) -> Array:
    """What lobes of uneven width and depth leave of the reach; foot and tip of a margin are entire."""
    one, two, ends, shift = (lobes[..., None, k] for k in range(4))
    # The share of the margin's length; the count runs unevenly along it, but never backwards.
    at = np.broadcast_to(along, np.broadcast_shapes(along.shape, one.shape)) ** 0.8
    warp = 0.03 * np.sin(2.0 * np.pi * (1.3 * at + one)) + 0.015 * np.sin(2.0 * np.pi * (2.6 * at + two))
    running = count * (at + warp) + shift
    index = np.floor(running).astype(np.intp)
    # Between a notch and the next: a long side towards the base, a round top, a short side towards the tip.
    below, above, top = (_looked_up(lobes, index + k) for k in (0, 1, 2))
    part = running - index
    notch = (0.4 + 0.6 * below) * np.maximum(1.0 - part / 0.7, 0.0) ** 1.8
    notch += (0.4 + 0.6 * above) * np.maximum(1.0 - (1.0 - part) / 0.5, 0.0) ** 1.5
    notch += 0.25 * top * np.sin(np.pi * part) ** 2
    free = _step((at - 0.05 - 0.08 * ends) / 0.25) * _step((1.0 - at) / 0.35)
    return 1.0 - depth * free * np.minimum(notch, 1.0)


def _looked_up(lobes: Array, index: NDArray[np.intp]) -> Array:
    """The hashed number of each lobe or notch, `(n, 2, m)`."""
    table = lobes[..., 4:]
    return np.take_along_axis(table, index % table.shape[2], axis=2)


def _step(part: Array) -> Array:
    """0 below 0, 1 above 1, smooth between."""
    part = np.clip(part, 0.0, 1.0)
    return part * part * (3.0 - 2.0 * part)


_COURSE_STEPS = np.linspace(0.0, 1.0, 161)
"""Chosen: places along a margin between which the ends of rows are interpolated."""


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
    out = outline.reach(_COURSE_STEPS) / outline.half_extent[:, None, None]
    starts = vein_through(_COURSE_STEPS, out)
    # Under a broad base the margin runs down and up again through the same veins: the upper crossing counts.
    starts = np.minimum.accumulate(starts[..., ::-1], axis=2)[..., ::-1] + 1e-9 * _COURSE_STEPS
    wanted = vein_start(number)
    ends = [np.interp(wanted, one, _COURSE_STEPS) for one in starts.reshape(-1, len(_COURSE_STEPS))]
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

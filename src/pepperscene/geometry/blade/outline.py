"""The outline of a flat blade: ovate, with a drawn-out tip, a rounded or wedge-shaped base, lobed or not.

Positions on a margin are given as `along`, the fraction of the length in the outline without lobes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.batch import hash_uniform, read_measure, read_positive
from pepperscene.geometry.blade.grid import FAN_POWER, Grid, origin_of_vein_at, vein_origin, vein_rise
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.grammar.plant import Organ
from pepperscene.materials.venation import outline_reach

_WIDEST: Final = 0.35  # chosen with _BASE from photographs: rounded-cuneate base, drawn-out tip
_BASE: Final = 0.8
_SAMPLES: Final = 0.5 - 0.5 * np.cos(np.pi * np.arange(193) / 192)  # positions searched for the widest one
_MAX_LOBES: Final = 24  # along a margin; finer teeth need more triangles than a blade should have


@dataclass(frozen=True, eq=False)
class Outlines:
    """The outlines of n blades, a left and a right margin each."""

    half_width: FloatArray  # `(n, 2)` metres, of the left and the right half where it is widest
    half_extent: FloatArray  # `(n,)` metres, the larger of the two; the extent of the material's veins
    base: FloatArray  # `(n, 1, 1)` power of the outline at the base
    widest: FloatArray  # `(n, 1, 1)` position where it is widest
    scale: FloatArray  # `(n, 2, 1)` factor that makes the greatest reach 1
    lobes: FloatArray  # `(n, 2, 4 + k)` hashed numbers for the position and depth of each lobe
    count: FloatArray  # `(n, 1, 1)` lobes along a margin
    depth: FloatArray  # `(n, 1, 1)` of the lobes, as a fraction of the half-width

    def reach(self, along: FloatArray) -> FloatArray:
        """`(n, 2, m)` metres from midrib to margin without lobes, at positions `(n, 2, m)` or `(m,)`."""
        return self.half_width[..., None] * self.scale * outline_reach(along, self.widest, self.base)

    def lobe_factor(self, along: FloatArray) -> FloatArray:
        """`(n, 2, m)` reach of the margin with lobes over that without; 1 for an entire margin."""
        if not np.any(self.depth * self.count > 0.0):
            return np.ones(np.broadcast_shapes(along.shape, self.scale.shape))
        return _lobe_factor(along, self.lobes, self.count, self.depth)


def build_outlines(organs: Sequence[Organ], seed: FloatArray) -> Outlines:
    """Build the outlines of blades from their measures (see `mesh_blades`)."""
    width = read_positive(organs, "width_m")
    widest = np.clip(read_measure(organs, "widest", _WIDEST), 0.2, 0.45)[:, None, None]
    base = np.clip(read_measure(organs, "base", _BASE), 0.3, 1.1)[:, None, None]
    uneven = np.clip(read_measure(organs, "asymmetry", 0.0), -0.5, 0.5)[:, None]
    half = 0.5 * width[:, None] * (1.0 + uneven * np.array([-1.0, 1.0]))
    count = np.clip(read_measure(organs, "lobes", 0.0), 0.0, _MAX_LOBES)[:, None, None]
    # The lobes of palmate blades are made by `spread_rows`.
    pinnate = read_measure(organs, "palmate", 0.0) == 0.0
    depth = np.where(pinnate, np.clip(read_measure(organs, "lobe_depth", 0.0), 0.0, 0.6), 0.0)[:, None, None]
    numbers = 4 + 2 * int(np.ceil(count.max())) + 3
    lobes = hash_uniform(seed, 251, 2 * numbers).reshape(len(organs), 2, numbers)
    # The stated width is that over the lobes; an entire margin reaches 1 where it is widest.
    scale = np.ones((len(organs), 2, 1))
    if np.any(depth * count > 0.0):
        profile = outline_reach(_SAMPLES, widest, base) * _lobe_factor(_SAMPLES, lobes, count, depth)
        scale = np.where(depth * count > 0.0, 1.0 / profile.max(axis=2, keepdims=True), scale)
    return Outlines(half, half.max(axis=1), base, widest, scale, lobes, count, depth)


def _lobe_factor(along: FloatArray, lobes: FloatArray, count: FloatArray, depth: FloatArray) -> FloatArray:
    """Fraction of the reach left by lobes of uneven width and depth; foot and tip of a margin are entire."""
    phase_1, phase_2, end, shift = (lobes[..., None, k] for k in range(4))
    # Fraction of the margin's length; lobes are unevenly spaced along it, but always in order.
    at = np.broadcast_to(along, np.broadcast_shapes(along.shape, phase_1.shape)) ** 0.8
    warp = 0.03 * np.sin(2.0 * np.pi * (1.3 * at + phase_1))
    warp = warp + 0.015 * np.sin(2.0 * np.pi * (2.6 * at + phase_2))
    position = count * (at + warp) + shift
    index = np.floor(position).astype(np.intp)
    # From one notch to the next: a long side towards the base, a round top, a short side towards the tip.
    table = lobes[..., 4:]
    below, above, top = (np.take_along_axis(table, (index + k) % table.shape[2], 2) for k in (0, 1, 2))
    part = position - index
    notch = (0.4 + 0.6 * below) * np.maximum(1.0 - part / 0.7, 0.0) ** 1.8
    notch += (0.4 + 0.6 * above) * np.maximum(1.0 - (1.0 - part) / 0.5, 0.0) ** 1.5
    notch += 0.25 * top * np.sin(np.pi * part) ** 2
    inside = _smooth_step((at - 0.05 - 0.08 * end) / 0.25) * _smooth_step((1.0 - at) / 0.35)
    return 1.0 - depth * inside * np.minimum(notch, 1.0)


def _smooth_step(x: FloatArray) -> FloatArray:
    """0 below 0, 1 above 1, smooth between."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


_MARGIN_SAMPLES: Final = np.linspace(0.0, 1.0, 161)
"""Chosen: positions along a margin between which the ends of rows are interpolated."""


@dataclass(frozen=True, eq=False)
class FlatBlades:
    """Vertices of n flat blades, a left and a right half each; `along` values are fractions of the length."""

    margin: FloatArray  # `(n, 2, m)` along, of the margin's points as if there were no lobes
    reach: FloatArray  # `(n, 2, m)` metres from the midrib to the margin's points
    rim: FloatArray  # `(n, 2, r)` the values of `margin` at the ends of the rows
    origin: FloatArray  # `(r,)` along, where rows leave the midrib of a blade with pinnate veins
    midrib: FloatArray  # `(n, r)` along, where they leave that of this blade
    edge: FloatArray  # `(n, 2, r)` metres from the midrib to the ends of the rows
    column: FloatArray  # `(s,)` columns of a half, from 0 at the midrib to 1 at the end of the row
    out: FloatArray  # `(n, 2, r, s)` metres from the midrib
    along: FloatArray  # `(n, 2, r, s)`
    extra_edge: FloatArray  # `(n, 2, e)` metres from the midrib to the extra points of the margins
    extra_along: FloatArray  # `(n, 2, e)` along
    half_width: FloatArray  # `(n, 2)` metres, as in `Outlines`
    seed: FloatArray  # `(n,)` of the blades
    grid: Grid  # of the blades


def flat_blades(outline: Outlines, grid: Grid, seed: FloatArray) -> FlatBlades:
    """Lay out rows along the veins, from the midrib to the margin."""
    n, number = len(outline.half_extent), grid.margin
    low = number < 0.0
    ends = _row_ends(outline, np.concatenate([[0.0], number[~low]]))
    # Below the first vein rows spread evenly from the foot of the blade to the margin.
    spread = np.where(low, 1.0 + number, 1.0)
    along = np.empty((n, 2, len(number)))
    along[..., ~low] = ends[..., 1:]
    along[..., low] = ends[..., :1] * spread[low] ** FAN_POWER
    origin = vein_origin(np.maximum(number, 0.0)) * np.minimum(spread**0.8, 5.0 * spread**FAN_POWER)
    origin[~low] = vein_origin(number[~low])
    # Lobes are cut along the rows, so that they point where the veins do, less deep at grazing angles.
    entire = outline.reach(along)
    lobed = 1.0 - (1.0 - outline.lobe_factor(along)) * (0.3 + 0.7 * spread)
    edge = entire * lobed
    column = grid.across[-grid.side :]
    rows, extra = grid.row_in_margin, grid.extra_in_margin
    weight, power = _row_shapes(outline, along, origin, spread)

    def row_along(row: IndexArray, out: FloatArray) -> FloatArray:
        """Along at `(n, 2, o, s)` metres from the midrib, on rows to `(o,)` points of the margin."""
        start, end = origin[row, None], entire[:, :, row, None]
        extent = outline.half_extent[:, None, None, None]
        climb = vein_rise(start, out / extent) / vein_rise(start, end / extent)
        if np.any(weight[:, :, row] < 1.0):
            fraction = (out / end) ** power[:, :, row, None]
            climb = fraction + weight[:, :, row, None] * (climb - fraction)
        return start + (along[:, :, row, None] - start) * climb

    # The inside follows the lobes, less so towards the midrib.
    depth = 1.0 - lobed[..., rows, None]
    out = entire[..., rows, None] * (column * (1.0 - depth * np.sqrt(column)))
    return FlatBlades(
        margin=along,
        reach=edge,
        rim=along[..., rows],
        origin=origin[rows],
        midrib=np.broadcast_to(origin[rows], (n, len(rows))),
        edge=edge[..., rows],
        column=column,
        out=out,
        along=row_along(rows, out),
        extra_edge=edge[..., extra],
        extra_along=row_along(extra, edge[..., extra, None])[..., 0],
        half_width=outline.half_width,
        seed=seed,
        grid=grid,
    )


def _row_ends(outline: Outlines, number: FloatArray) -> FloatArray:
    """`(n, 2, k)` along, where the veins `(k,)` meet the margin."""
    out = outline.reach(_MARGIN_SAMPLES) / outline.half_extent[:, None, None]
    origins = origin_of_vein_at(_MARGIN_SAMPLES, out)
    # Under a broad base the margin crosses the same veins on the way down and up: the upper crossing counts.
    origins = np.minimum.accumulate(origins[..., ::-1], axis=2)[..., ::-1] + 1e-9 * _MARGIN_SAMPLES
    origin = vein_origin(number)
    rows = origins.reshape(-1, len(_MARGIN_SAMPLES))
    return np.array([np.interp(origin, row, _MARGIN_SAMPLES) for row in rows]).reshape(*origins.shape[:2], -1)


def _row_shapes(
    outline: Outlines, along: FloatArray, origin: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Course of the rows, `(n, 2, m)` each: the weight of the vein's course, and the power of the rest.

    A row must reach the margin from within. Where the margin grows as a power p of the length (p > 1 on a
    wedge-shaped base), the climb of a row above its origin may grow at most as `out` to the power
    along / (along - origin) / p; a vein's course grows as the power `steep`. `spread` is the weight of the
    vein's course where the margin allows it.
    """
    step = 1.0 + 1e-4
    reach = outline.reach(along)
    growth = np.log(outline.reach(np.minimum(along * step, 1.0 - 1e-12)) / reach) / np.log(step)
    limit = 0.65 * along / (np.maximum(along - origin, 1e-9) * np.maximum(growth, 1e-3))
    out = reach / outline.half_extent[:, None, None]
    rise = vein_rise(origin, out)
    steep = (vein_rise(origin, out * step) / rise - 1.0) / (step - 1.0)
    power = np.minimum(limit, 1.0)
    return np.clip((limit - power) / np.maximum(steep - power, 1e-9), 0.0, spread), power

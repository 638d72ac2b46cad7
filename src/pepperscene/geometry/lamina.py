"""Leaf blades: ovate, drawn out to a tip, folded at the midrib, wavy at the margin, bulging between veins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.body import Bodies, fineness, vertex_normals
from pepperscene.geometry.lamina_flat import Flat, flat_blades
from pepperscene.geometry.lamina_form import hooked, liveliness, slopes
from pepperscene.geometry.lamina_grid import Grid, blade_grid
from pepperscene.geometry.lamina_outline import outlines
from pepperscene.geometry.lamina_relief import bulges, grid_noise, lifted, margin_waves, slack
from pepperscene.geometry.measures import measure, size
from pepperscene.geometry.spine import spines
from pepperscene.grammar.plant import Organ

Array = NDArray[np.float64]


def laminae(organs: Sequence[Organ], detail: float) -> Bodies:
    """Leaf blades as single sheets; normals leave the upper (adaxial) side.

    Measures: length_m (of the midrib) and width_m (of the flat leaf), fold_rad (each half rises by it),
    curl_rad (how much further a half has turned up at the margin, negative is down), twist_rad, margin_wave_m
    (amplitude), margin_waves (count along a margin), blister_m (bulge between veins), vein_m (depth of the
    sunken veins), asymmetry (by this part the right half is wider than the mean half, and the left narrower),
    widest (share of the length), base (power of the outline there), lobes (along each margin), lobe_depth
    (share of the half-width), state_mean, state_spread, seed. All but the sizes may be missing. Measures that
    would tear a blade are cut: fold at 80 degrees, curl at 150, bulges at a tenth of the width, waves at an
    eighth.
    """
    width, seed = size(organs, "width_m"), measure(organs, "seed", 0.0)
    outline = outlines(organs, seed)
    grid = blade_grid(detail, float(measure(organs, "lobes", 0.0).max()))
    flat = flat_blades(outline, grid)
    lively = liveliness(organs, width)
    right, up = _sections(organs, flat, grid, outline.half_width, lively, seed)
    spine = spines(
        [organ.curve for organ in organs],
        [organ.up for organ in organs],
        fineness(32, detail, 12),
        measure(organs, "twist_rad", 0.0),
    )
    spine = hooked(spine, lively, seed)
    v = grid.joined(flat.along, flat.start, flat.extra_along, (0.0, 1.0))
    vertices = spine.place(v * spine.lengths[:, None], right, up)
    # The pattern of the veins is as wide as the wider half, on either side.
    out = grid.joined(_SIDES * flat.out, 0.0, _SIDES[..., 0] * flat.extra_edge)
    u = 0.5 + 0.5 * out / outline.half_extent[:, None]
    uv = np.clip(np.stack([u, v], axis=-1), 0.0, 1.0)
    normals = vertex_normals(vertices, grid.faces)
    return Bodies(vertices, normals, uv, _state(organs, flat, grid, seed), grid.faces)


_SIDES: Final = np.array([-1.0, 1.0])[:, None, None]  # left and right halves


def _sections(
    organs: Sequence[Organ], flat: Flat, grid: Grid, half_width: Array, lively: Array, seed: Array
) -> tuple[Array, Array]:
    """`(n, v)` metres by which vertices lie to the right of the midrib and above it, in its frame.

    Each row is a polyline from the midrib outwards that keeps its length; relief stands on it.
    """
    slope = slopes(organs, flat, half_width, seed)
    step = np.diff(flat.out, prepend=0.0, axis=3) * slack(organs, flat, half_width)
    level, rise = np.cos(slope), np.sin(slope)
    out, up = np.cumsum(step * level, axis=3), np.cumsum(step * rise, axis=3)
    # The slope at a column is the mean of those beside it.
    for one in (level, rise):
        one[..., :-1] = 0.5 * (one[..., :-1] + one[..., 1:])
    margin = np.stack([*margin_waves(organs, flat, half_width, lively, seed), flat.reach])
    lift, short = lifted(margin[..., grid.row_in_margin, None], flat.part)
    lift += bulges(organs, flat, grid, half_width, seed)
    halves = out - lift * rise - short * level, up + lift * level - short * rise
    # The further points of a margin lie on sections between those of the rows.
    scaled = out[..., -1] / flat.edge, up[..., -1] / flat.edge, rise[..., -1], level[..., -1]
    out, up, rise, level = (grid.between(one) for one in scaled)
    lift, short = lifted(margin[..., grid.extra_in_margin], 1.0)
    extra = (
        flat.extra_edge * out - lift * rise - short * level,
        flat.extra_edge * up + lift * level - short * rise,
    )
    return grid.joined(_SIDES * halves[0], 0.0, _SIDES[..., 0] * extra[0]), grid.joined(
        halves[1], 0.0, extra[1]
    )


def _state(organs: Sequence[Organ], flat: Flat, grid: Grid, seed: Array) -> Array:
    """`(n, v)` pigment states: greener and paler patches, a few over the blade."""
    mean, spread = measure(organs, "state_mean", 0.7), measure(organs, "state_spread", 0.1)
    patches = grid_noise(flat, grid, seed, 211, 0.9)
    halves, midrib = grid.halves(patches), patches[..., grid.side]
    ends = midrib[:, 0], midrib[:, -1]
    return np.clip(
        mean[:, None] + spread[:, None] * grid.joined(halves, midrib, grid.between(halves[..., -1]), ends),
        0,
        1,
    )

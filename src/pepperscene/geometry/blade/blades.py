"""How a blade is bent: the midrib's tip, the fold along it, and margins that turn up or down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.blade.grid import Grid, blade_grid
from pepperscene.geometry.blade.outline import Flat, flat_blades, outlines
from pepperscene.geometry.blade.relief import bulges, grid_noise, lifted, margin_waves, slack
from pepperscene.geometry.bodies import MeshBatch, fineness, vertex_normals
from pepperscene.geometry.organ_arrays import hashed, organ_measure, signed, size
from pepperscene.geometry.spine import Spines, spines
from pepperscene.grammar.plant import Organ

Array = NDArray[np.float64]


def liveliness(organs: Sequence[Organ], width: Array) -> Array:
    """`(n,)` 0 for a blade as flat as in a herbarium, towards 1 for one with wavy margins.

    What every living leaf has and no measure tells (a hooked tip, a winding midrib, an edge that turns over
    here and there) goes with the waves of its margin. Chosen: half of it at waves of 1 % of the width.
    """
    wave = np.abs(organ_measure(organs, "margin_wave_m", 0.0))
    return wave / (wave + 0.01 * width)


def hooked(spine: Spines, lively: Array, seed: Array) -> Spines:
    """Midribs that wind a little and whose tip is bent down and to one side; their lengths stay.

    Args:
        spine: midribs with the blade's upper side as normals.
        lively: `(n,)` how much of it, see `liveliness`.
        seed: `(n,)` of the blades.
    """
    steps = spine.points.shape[1] - 1
    at = np.linspace(0.0, 1.0, steps + 1)
    chance, turn = hashed(seed, 261, 4)[..., None], signed(seed, 262, 2)[..., None]
    # Chosen: the last quarter bends down by 9 to 31 degrees and aside by up to 20; the rest winds by 4.
    tip = np.clip((at - 0.72) / 0.28, 0.0, None) ** 1.5
    winding = np.sin(2.0 * np.pi * (1.1 * at + chance[:, 2])) - np.sin(2.0 * np.pi * chance[:, 2])
    down = lively[:, None] * ((0.15 + 0.4 * chance[:, 0]) * tip + 0.07 * winding * turn[:, 1])
    aside = lively[:, None] * turn[:, 0] * (0.35 * tip + 0.12 * at**2)
    tangents = np.cross(spine.normals, spine.across)
    tangents, normals, across = _turned(tangents, spine.normals, spine.across, down, aside)
    # Each piece of the midrib turns with the mean of its ends.
    pieces = np.diff(spine.points, axis=1)
    up, right = _square(pieces, spine.normals[:, 1:] + spine.normals[:, :-1])
    bent, _, _ = _turned(pieces, up, right, _between(down), _between(aside))
    points = np.concatenate([spine.points[:, :1], spine.points[:, :1] + np.cumsum(bent, axis=1)], axis=1)
    return replace(spine, points=points, normals=normals, across=across)


def _between(values: Array) -> Array:
    """Means of neighbours along the last axis."""
    return 0.5 * (values[..., 1:] + values[..., :-1])


def _turned(along: Array, up: Array, right: Array, down: Array, aside: Array) -> tuple[Array, Array, Array]:
    """A frame pitched down about its right hand, then turned to the right about its own upper side.

    `up` and `right` may have any equal length, which `along` takes on as it is; only angles change.
    """
    c, s = np.cos(down)[..., None], np.sin(down)[..., None]
    along, up = c * along - s * up, c * up + s * along
    c, s = np.cos(aside)[..., None], np.sin(aside)[..., None]
    return c * along + s * right, up, c * right - s * along


def _square(along: Array, up: Array) -> tuple[Array, Array]:
    """`up` made perpendicular to `along`, and what is to the right of both; all as long as `along`."""
    length = np.sqrt(np.sum(along * along, axis=-1, keepdims=True))
    right = np.cross(along, up)
    right *= length / np.sqrt(np.sum(right * right, axis=-1, keepdims=True))
    return np.cross(right, along) / length, right


def slopes(organs: Sequence[Organ], flat: Flat, half_width: Array, seed: Array) -> Array:
    """`(n, 2, r, s)` radians by which a half rises against the blade's plane, from each column to the next.

    Args:
        organs: n blades with fold_rad and curl_rad.
        flat: their vertices.
        half_width: `(n, 2)` metres.
        seed: `(n,)` of the blades.
    """
    fold = np.clip(organ_measure(organs, "fold_rad", 0.0), -1.4, 1.4)[:, None]
    curl = np.clip(organ_measure(organs, "curl_rad", 0.0), -2.6, 2.6)[:, None]
    along, wide = flat.start, flat.edge / half_width[..., None]
    chance, vary = hashed(seed, 271, 4).reshape(-1, 2, 2), signed(seed, 201, 4).reshape(-1, 2, 2)
    # The fold: each half differs by up to a quarter, opens and closes along the blade, flattens outwards.
    folded = (fold * (1.0 + 0.25 * vary[:, 0]))[..., None] * (
        1.0 + 0.25 * np.sin(2.0 * np.pi * (0.6 * along + chance[..., 0, None]))
    )
    middle = _between(np.concatenate([[0.0], flat.part]))
    opening = (0.7 + 0.6 * np.exp(-middle / 0.3)) / (0.7 + 0.18 * (1.0 - np.exp(-1.0 / 0.3)))
    # The curl: margins that turn far do it near the rim; some stretches do more of it than others.
    power = 1.0 + np.minimum(np.abs(curl), 2.0)
    rim = flat.rim
    stretches = 1.0 + 0.5 * np.sin(2.0 * np.pi * (1.2 * rim + chance[..., 1, None]))
    curled = (curl * (1.0 + 0.3 * vary[:, 1]))[..., None] * stretches * wide
    power = power[..., None]
    return folded[..., None] * opening + curled[..., None] * (middle**power)[:, None]


def laminae(organs: Sequence[Organ], detail: float) -> MeshBatch:
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
    width, seed = size(organs, "width_m"), organ_measure(organs, "seed", 0.0)
    outline = outlines(organs, seed)
    grid = blade_grid(detail, float(organ_measure(organs, "lobes", 0.0).max()))
    flat = flat_blades(outline, grid)
    lively = liveliness(organs, width)
    right, up = _sections(organs, flat, grid, outline.half_width, lively, seed)
    spine = spines(
        [organ.curve for organ in organs],
        [organ.up for organ in organs],
        fineness(32, detail, 12),
        organ_measure(organs, "twist_rad", 0.0),
    )
    spine = hooked(spine, lively, seed)
    v = grid.joined(flat.along, flat.start, flat.extra_along, (0.0, 1.0))
    vertices = spine.place(v * spine.lengths[:, None], right, up)
    # The pattern of the veins is as wide as the wider half, on either side.
    out = grid.joined(_SIDES * flat.out, 0.0, _SIDES[..., 0] * flat.extra_edge)
    u = 0.5 + 0.5 * out / outline.half_extent[:, None]
    uv = np.clip(np.stack([u, v], axis=-1), 0.0, 1.0)
    normals = vertex_normals(vertices, grid.faces)
    return MeshBatch(vertices, normals, uv, _state(organs, flat, grid, seed), grid.faces)


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
    mean, spread = organ_measure(organs, "state_mean", 0.7), organ_measure(organs, "state_spread", 0.1)
    patches = grid_noise(flat, grid, seed, 211, 0.9)
    halves, midrib = grid.halves(patches), patches[..., grid.side]
    ends = midrib[:, 0], midrib[:, -1]
    return np.clip(
        mean[:, None] + spread[:, None] * grid.joined(halves, midrib, grid.between(halves[..., -1]), ends),
        0,
        1,
    )

"""Leaf blades in space: fold, curl and relief across, the bent midrib along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from pepperscene.geometry.batch import (
    MeshBatch,
    hash_signed,
    hash_uniform,
    read_measure,
    read_positive,
    subdivisions,
    vertex_normals,
)
from pepperscene.geometry.blade.damage import Surfaces, damage_margins
from pepperscene.geometry.blade.grid import Grid, blade_grid
from pepperscene.geometry.blade.outline import FlatBlades, build_outlines, flat_blades
from pepperscene.geometry.blade.palmate import spread_rows
from pepperscene.geometry.blade.relief import (
    bulge_shrinkage,
    grid_noise,
    margin_relief,
    margin_waves,
    rim_crumples,
    vein_bulges,
)
from pepperscene.geometry.mesh import FloatArray
from pepperscene.geometry.spine import Spines, spines
from pepperscene.grammar.frames import cross
from pepperscene.grammar.plant import Organ

_MAX_ROLLED: Final = np.radians(240.0)  # chosen: beyond it the tubes of both halves touch
_ROLL_START: Final = 0.3  # chosen: fraction of the half-width from the midrib where the tube begins
_DRYING: Final = (0.4, 0.9)  # chosen: ageing between which a blade rolls up, as its tissue dries

_SIDES: Final = np.array([-1.0, 1.0])[:, None, None]  # left and right halves


def mesh_blades(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Build leaf blades as single sheets with normals out of the upper (adaxial) side.

    Measures: length_m (of the midrib) and width_m (of the flat leaf), fold_rad (inclination of each half),
    curl_rad (additional inclination at the margin, negative is down), rolled_rad (angle by which the outer
    part of each half is rolled up, negative is down), twist_rad, margin_wave_m (amplitude), margin_waves
    (count along a margin), blister_m (bulge between veins), vein_m (depth of the sunken veins), asymmetry
    (fraction by which the right half is wider than the mean half, and the left narrower), widest (fraction of
    the length), base (power of the outline there), lobes (along each margin), lobe_depth (fraction of the
    half-width), those of `spread_rows` and of `damage_margins`, ageing (a blade that dries rolls up, and its
    rim is crumpled), state_mean, state_spread, seed. All but the sizes are optional. Measures that would tear
    a blade are limited: fold 80 degrees, curl 150, roll 240, bulges 1/10 of the width, waves 1/8.
    """
    read_positive(organs, "length_m")  # the curve has this length; here it is only checked
    width, seed = read_positive(organs, "width_m"), read_measure(organs, "seed", 0.0)
    outline = build_outlines(organs, seed)
    grid = _grid(organs, detail)
    layout = flat_blades(outline, grid, seed)
    flat = spread_rows(organs, layout)
    waviness = _waviness(organs, width)
    right, up = _cross_sections(organs, flat, waviness)
    spine = spines(
        [organ.curve for organ in organs],
        [organ.up for organ in organs],
        subdivisions(32, detail, 12),
        read_measure(organs, "twist_rad", 0.0),
    )
    spine = _bend_tips(spine, waviness, seed)
    along = grid.pack(flat.along, flat.midrib, flat.extra_along, (0.0, 1.0))
    vertices = spine.place(along * spine.lengths[:, None], right, up)
    # The vein pattern of the material is as wide as the wider half, on either side; its veins are pinnate.
    out = grid.pack(_SIDES * layout.out, 0.0, _SIDES[..., 0] * layout.extra_edge)
    u = 0.5 + 0.5 * out / outline.half_extent[:, None]
    v = grid.pack(layout.along, layout.midrib, layout.extra_along, (0.0, 1.0))
    uv = np.clip(np.stack([u, v], axis=-1), 0.0, 1.0)
    state = _state(organs, flat)
    extents = np.stack([2.0 * outline.half_extent, spine.lengths], axis=1)
    damage_margins(organs, Surfaces(vertices, uv, state, extents), grid)
    return MeshBatch(vertices, vertex_normals(vertices, grid.faces), uv, state, grid.faces)


def _grid(organs: Sequence[Organ], detail: float) -> Grid:
    """The grid that all blades share, fine enough for the lobes and teeth of each."""
    palmate = read_measure(organs, "palmate", 0.0) > 0.0
    lobes = np.where(palmate, 0.0, read_measure(organs, "lobes", 0.0)).max()
    teeth = float(read_measure(organs, "teeth", 0.0)[palmate].max()) if palmate.any() else None
    return blade_grid(detail, float(lobes), teeth)


def _waviness(organs: Sequence[Organ], width: FloatArray) -> FloatArray:
    """`(n,)` 0 for a blade as flat as in a herbarium, towards 1 for one with wavy margins.

    Features of living leaves without a measure (a bent tip, a winding midrib, a margin that turns over here
    and there) grow with the waves of the margin. Chosen: half of them at waves of 1 % of the width.
    """
    wave = np.abs(read_measure(organs, "margin_wave_m", 0.0))
    return wave / (wave + 0.01 * width)


def _bend_tips(spine: Spines, waviness: FloatArray, seed: FloatArray) -> Spines:
    """Midribs that wind a little, with the tip bent down and to one side; they keep their lengths."""
    steps = spine.points.shape[1] - 1
    at = np.linspace(0.0, 1.0, steps + 1)
    draws, sign = hash_uniform(seed, 261, 4)[..., None], hash_signed(seed, 262, 2)[..., None]
    # Chosen: the last quarter bends down by 9 to 31 degrees and aside by up to 20; the rest winds by 4.
    tip = np.clip((at - 0.72) / 0.28, 0.0, None) ** 1.5
    winding = np.sin(2.0 * np.pi * (1.1 * at + draws[:, 2])) - np.sin(2.0 * np.pi * draws[:, 2])
    down = waviness[:, None] * ((0.15 + 0.4 * draws[:, 0]) * tip + 0.07 * winding * sign[:, 1])
    aside = waviness[:, None] * sign[:, 0] * (0.35 * tip + 0.12 * at**2)
    tangents = cross(spine.normals, spine.binormals)
    _, normals, binormals = _pitch_and_yaw(tangents, spine.normals, spine.binormals, down, aside)
    # Each piece of the midrib turns by the mean of the angles at its ends.
    pieces = np.diff(spine.points, axis=1)
    length = np.sqrt(np.sum(pieces * pieces, axis=-1, keepdims=True))
    right = cross(pieces, spine.normals[:, 1:] + spine.normals[:, :-1])
    right *= length / np.sqrt(np.sum(right * right, axis=-1, keepdims=True))
    up = cross(right, pieces) / length
    bent, _, _ = _pitch_and_yaw(pieces, up, right, _neighbour_means(down), _neighbour_means(aside))
    points = np.concatenate([spine.points[:, :1], spine.points[:, :1] + np.cumsum(bent, axis=1)], axis=1)
    return replace(spine, points=points, normals=normals, binormals=binormals)


def _neighbour_means(values: FloatArray) -> FloatArray:
    """Means of neighbours along the last axis."""
    return 0.5 * (values[..., 1:] + values[..., :-1])


def _pitch_and_yaw(
    along: FloatArray, up: FloatArray, right: FloatArray, down: FloatArray, aside: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A frame of vectors of equal lengths, pitched down about `right`, then yawed to the right about `up`."""
    c, s = np.cos(down)[..., None], np.sin(down)[..., None]
    along, up = c * along - s * up, c * up + s * along
    c, s = np.cos(aside)[..., None], np.sin(aside)[..., None]
    return c * along + s * right, up, c * right - s * along


def roll_angles(organs: Sequence[Organ], seed: FloatArray) -> FloatArray:
    """`(n, 2)` radians by which the halves are rolled up, negative down; dry blades are rolled completely."""
    drawn = read_measure(organs, "rolled_rad", 0.0)
    draws = hash_uniform(seed, 275, 3)
    low, high = _DRYING
    dry = np.clip((read_measure(organs, "ageing", 0.0) - low) / (high - low), 0.0, 1.0)
    # Chosen: a dry blade goes on rolling as it began, mostly up if it was flat, by 170 to 240 degrees.
    way = np.where(drawn == 0.0, np.where(draws[:, 0] < 0.8, 1.0, -1.0), np.sign(drawn))
    total = drawn + dry * (way * (0.7 + 0.3 * draws[:, 1]) * _MAX_ROLLED - drawn)
    # Halves differ by up to a fifth.
    uneven = 1.0 + 0.2 * (2.0 * draws[:, 2:] - 1.0) * np.array([-1.0, 1.0])
    return np.clip(total[:, None] * uneven, -_MAX_ROLLED, _MAX_ROLLED)


def _section_slopes(
    organs: Sequence[Organ], flat: FlatBlades, rolled: FloatArray, flatter: FloatArray
) -> FloatArray:
    """`(n, 2, r, s)` radians by which a half rises from each column to the next, from fold, curl and roll."""
    # Rolled halves fold less, so that they do not touch each other.
    fold = np.clip(read_measure(organs, "fold_rad", 0.0), -1.4, 1.4)[:, None] * (0.4 + 0.6 * flatter)
    curl = np.clip(read_measure(organs, "curl_rad", 0.0), -2.6, 2.6)[:, None] * flatter
    along, wide = flat.origin, flat.edge / flat.half_width[..., None]
    draws = hash_uniform(flat.seed, 271, 4).reshape(-1, 2, 2)
    vary = hash_signed(flat.seed, 201, 4).reshape(-1, 2, 2)
    # Fold: it varies by up to a quarter between halves, and along the blade; it flattens outwards.
    folded = (fold * (1.0 + 0.25 * vary[:, 0]))[..., None] * (
        1.0 + 0.25 * np.sin(2.0 * np.pi * (0.6 * along + draws[..., 0, None]))
    )
    middle = _neighbour_means(np.concatenate([[0.0], flat.column]))
    opening = (0.7 + 0.6 * np.exp(-middle / 0.3)) / (0.7 + 0.18 * (1.0 - np.exp(-1.0 / 0.3)))
    # Curl: strong curl is concentrated near the margin; it varies along the margin.
    power = 1.0 + np.minimum(np.abs(curl), 2.0)
    stretches = 1.0 + 0.5 * np.sin(2.0 * np.pi * (1.2 * flat.rim + draws[..., 1, None]))
    curled = (curl * (1.0 + 0.3 * vary[:, 1]))[..., None] * stretches * wide
    slopes = folded[..., None] * opening + curled[..., None] * middle ** power[..., None, None]
    # Roll: a tube of even radius beside the midrib, wider and narrower along the blade.
    tube = np.clip((middle - _ROLL_START) / (1.0 - _ROLL_START), 0.0, 1.0)
    return slopes + (rolled[..., None] * (0.625 + 0.25 * stretches) * wide)[..., None] * tube


def _cross_sections(
    organs: Sequence[Organ], flat: FlatBlades, waviness: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """`(n, v)` metres of the vertices to the right of the midrib and above it, in its frame.

    Each row is a polyline from the midrib outwards that keeps its length; the relief is added to it.
    """
    grid, rolled = flat.grid, roll_angles(organs, flat.seed)
    # A half that is rolled up is stiff: it curls and waves less.
    flatter = 1.0 - np.abs(rolled) / _MAX_ROLLED
    slope = _section_slopes(organs, flat, rolled, flatter)
    step = np.diff(flat.out, prepend=0.0, axis=3) * bulge_shrinkage(organs, flat)
    level, rise = np.cos(slope), np.sin(slope)
    out, up = np.cumsum(step * level, axis=3), np.cumsum(step * rise, axis=3)
    # The slope at a column is the mean of those on either side.
    for values in (level, rise):
        values[..., :-1] = 0.5 * (values[..., :-1] + values[..., 1:])
    waves, turned = (height * flatter[..., None] for height in margin_waves(organs, flat, waviness))
    margin = np.stack([waves + rim_crumples(organs, flat), turned, flat.reach])
    height, width = margin_relief(margin[..., grid.row_in_margin, None], flat.column)
    height += vein_bulges(organs, flat)
    halves = out - height * rise - width * level, up + height * level - width * rise
    # The extra points of a margin are on sections between those of the rows.
    scaled = out[..., -1] / flat.edge, up[..., -1] / flat.edge, rise[..., -1], level[..., -1]
    out, up, rise, level = (grid.interpolate_extra(values) for values in scaled)
    height, width = margin_relief(margin[..., grid.extra_in_margin], 1.0)
    extra_out = flat.extra_edge * out - height * rise - width * level
    extra_up = flat.extra_edge * up + height * level - width * rise
    right = grid.pack(_SIDES * halves[0], 0.0, _SIDES[..., 0] * extra_out)
    return right, grid.pack(halves[1], 0.0, extra_up)


def _state(organs: Sequence[Organ], flat: FlatBlades) -> FloatArray:
    """`(n, v)` pigment states: a few greener and paler patches over the blade."""
    mean, spread = read_measure(organs, "state_mean", 0.7), read_measure(organs, "state_spread", 0.1)
    patches = grid_noise(flat, 211, 0.9)
    grid = flat.grid
    halves, midrib = grid.split_halves(patches), patches[..., grid.side]
    extra, ends = grid.interpolate_extra(halves[..., -1]), (midrib[:, 0], midrib[:, -1])
    return np.clip(mean[:, None] + spread[:, None] * grid.pack(halves, midrib, extra, ends), 0, 1)

"""Leaf blades: ovate, drawn out to a tip, folded at the midrib, wavy at the margin, bulging between veins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.body import Bodies, fineness, vertex_normals
from pepperscene.geometry.measures import measure, size
from pepperscene.geometry.noise import hashed, signed, smooth_field
from pepperscene.geometry.spine import spines
from pepperscene.grammar.plant import Organ
from pepperscene.materials.venation import ARC, BASE_COT, PAIRS, TIP_COT

_BASE_POWER: Final = 0.8  # chosen with _WIDEST by eye from photographs: rounded-cuneate base, drawn-out tip
_WIDEST: Final = 0.35  # chosen: part of the length at which the blade is widest
_FAN: Final = 7  # rows below the first vein at detail 1, chosen: the rounded base looks round
_PER_VEIN: Final = 3  # rows from one vein to the next at detail 1: the vein and both flanks of the bulge


def laminae(organs: Sequence[Organ], detail: float) -> Bodies:
    """Leaf blades as single sheets; normals leave the upper (adaxial) side.

    Measures: length_m and width_m (of the flat leaf), fold_rad (each half rises by it), curl_rad (how much
    further a half has turned up at the margin, negative is down), twist_rad, margin_wave_m (amplitude),
    margin_waves (count along a margin), blister_m (bulge between veins), asymmetry (by this part the right
    half is wider than the mean half, and the left narrower), state_mean, state_spread, seed.
    """
    length, width, seed = size(organs, "length_m"), size(organs, "width_m"), measure(organs, "seed", 0.0)
    grid = _grid(fineness(_FAN, detail, 2), fineness(_PER_VEIN, detail, 1), fineness(6, detail, 2))
    flat = _flat_blades(organs, length, width, seed, grid)
    spine = spines(
        [organ.curve for organ in organs],
        [organ.up for organ in organs],
        fineness(32, detail, 12),
        measure(organs, "twist_rad", 0.0),
    )
    # Cross-sections: each half leaves the midrib at the fold angle and turns on by the curl.
    half = 0.5 * width[:, None]
    fold = _per_side(measure(organs, "fold_rad", 0.0)[:, None] * (1.0 + 0.25 * signed(seed, 201, 2)), grid)
    curl = measure(organs, "curl_rad", 0.0)[:, None] * flat.reach / half
    side_of = np.sign(grid.across)
    middle = fold + 0.5 * curl
    shrink = np.sinc(0.5 * curl / np.pi)  # an arc's chord over its length
    lift = _relief(organs, flat, seed, grid, detail)
    slope = fold + curl
    right = flat.bend + side_of * (flat.reach * shrink * np.cos(middle) - lift * np.sin(slope))
    up = flat.reach * shrink * np.sin(middle) + lift * np.cos(slope)
    vertices = spine.place(flat.v * spine.lengths[:, None], right, up)
    # Greener and paler patches, a few over the blade; v runs a little faster than u.
    patches = smooth_field(np.stack([side_of * flat.reach / half, 2.0 * flat.v], axis=-1), seed, 211, 0.9)
    state = (
        measure(organs, "state_mean", 0.7)[:, None] + measure(organs, "state_spread", 0.1)[:, None] * patches
    )
    uv = np.stack([flat.u, flat.v], axis=-1)
    normals = vertex_normals(vertices, grid.faces)
    return Bodies(vertices, normals, np.clip(uv, 0.0, 1.0), np.clip(state, 0.0, 1.0), grid.faces)


@dataclass(frozen=True, eq=False)
class _Grid:
    """The shared grid: rows run along the secondary veins, from the midrib to either margin.

    Attributes:
        start: `(v,)` where each vertex's row leaves the midrib, 0 base to 1 tip.
        rows: `(r, 2)` the same for each row, and which part of the way to the first vein's end it reaches up
            the margin; 1 from the first vein on.
        across: `(v,)` -1 left margin, 0 midrib, 1 right margin.
        row: `(v,)` number of the row; the base and the tip are rows of one vertex.
        faces: `(f, 3)`.
    """

    start: NDArray[np.float64]
    rows: NDArray[np.float64]
    across: NDArray[np.float64]
    row: NDArray[np.intp]
    faces: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class _Flat:
    """Vertices on the flat blades.

    Attributes:
        reach: `(n, v)` metres from the midrib, at most the half's width there.
        bend: `(n, v)` metres by which the midrib is bent to the right.
        u: `(n, v)` surface coordinate, 0.5 at the midrib.
        v: `(n, v)` part of the length.
        vein: `(n, v)` a whole number on every secondary vein.
    """

    reach: NDArray[np.float64]
    bend: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    vein: NDArray[np.float64]


@lru_cache(maxsize=16)
def _grid(fan: int, per_vein: int, side: int) -> _Grid:
    """A grid of rows of `2 * side + 1` columns, and a point at the base and the tip.

    Args:
        fan: rows that spread from the midrib's foot to the margin below the first vein.
        per_vein: rows from each vein to the next.
        side: columns in each half.
    """
    # Rows follow the veins, so that bulges between veins need few rows; columns are closer at the midrib.
    number = np.arange(per_vein * PAIRS + 1) / per_vein
    first = vein_start(np.zeros(1))
    low = np.arange(1, fan) / fan
    start = np.concatenate([first * low, vein_start(number)])
    spread = np.concatenate([low**1.25, np.ones(len(number))])
    rows = len(start)
    half = (np.arange(1, side + 1) / side) ** 1.2
    across = np.concatenate([-half[::-1], [0.0], half])
    columns = len(across)
    corner = 1 + np.arange(rows * columns).reshape(rows, columns)
    a, b, d, c = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    # The shorter diagonal: rows rise away from the midrib.
    left = np.arange(columns - 1) < side
    first = np.where(left[:, None], np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(left[:, None], np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    tip = 1 + rows * columns
    base_fan = np.stack([np.zeros(columns - 1, dtype=np.intp), corner[0, 1:], corner[0, :-1]], axis=1)
    tip_fan = np.stack([np.full(columns - 1, tip), corner[-1, :-1], corner[-1, 1:]], axis=1)
    faces = np.concatenate([base_fan, first.reshape(-1, 3), second.reshape(-1, 3), tip_fan])
    return _Grid(
        np.concatenate([[0.0], np.repeat(start, columns), [1.0]]),
        np.concatenate([[[0.0, 0.0]], np.stack([start, spread], axis=1), [[1.0, 1.0]]]),
        np.concatenate([[0.0], np.tile(across, rows), [0.0]]),
        np.concatenate([[0], np.repeat(np.arange(1, rows + 1), columns), [rows + 1]]),
        faces,
    )


def _flat_blades(
    organs: Sequence[Organ],
    length: NDArray[np.float64],
    width: NDArray[np.float64],
    seed: NDArray[np.float64],
    grid: _Grid,
) -> _Flat:
    """Outline and grid of each blade before it is bent."""
    # Each half has its own outline: a little fuller or slimmer, widest a little higher or lower.
    power = _BASE_POWER * (1.0 + 0.12 * signed(seed, 221, 2))
    widest = _WIDEST + 0.03 * signed(seed, 222, 2)
    uneven = np.clip(measure(organs, "asymmetry", 0.0), -0.5, 0.5)
    half = 0.5 * width[:, None] * (1.0 + uneven[:, None] * np.array([-1.0, 1.0]))
    # Where each row meets the margin: on its vein, solved for by halving the interval. Very wide blades get
    # flatter rows, so that none cross.
    start, spread = grid.rows.T[..., None]
    flatter = np.minimum(1.0, length / width)[:, None, None]
    first = np.maximum(start, vein_start(np.zeros(1)))
    low, high = np.broadcast_to(first, (len(organs), len(start), 2)), np.ones((len(organs), len(start), 2))
    for _ in range(26):
        guess = 0.5 * (low + high)
        edge = half[:, None] * _outline(guess, power[:, None], widest[:, None])
        above = guess - first > flatter * _vein_rise(first, edge, length[:, None, None], width[:, None, None])
        low, high = np.where(above, low, guess), np.where(above, guess, high)
    # Below the first vein rows fan out and straighten.
    end = spread * 0.5 * (low + high)
    edge = half[:, None] * _outline(end, power[:, None], widest[:, None])
    # From the row's ends to its vertices; the base and the tip are rows of no width.
    right = (grid.across > 0.0).astype(np.intp)
    edge, end = edge[:, grid.row, right], end[:, grid.row, right]
    reach = np.abs(grid.across) * edge
    rise = _vein_rise(grid.start, reach, length[:, None], width[:, None])
    whole = _vein_rise(grid.start, edge, length[:, None], width[:, None])
    veined = grid.rows[grid.row, 1]
    along = veined * rise / np.where(whole > 0.0, whole, 1.0) + (1.0 - veined) * np.abs(grid.across)
    v = grid.start + (end - grid.start) * along
    # The tip of every leaf is bent to one side, by up to a twentieth of the length (chosen).
    bend = 0.05 * signed(seed, 223, 1) * length[:, None] * v**3
    u = 0.5 + (np.sign(grid.across) * reach + bend) / (width * (1.0 + np.abs(uneven)))[:, None]
    return _Flat(reach, bend, u, v, _vein_number(v, reach, length[:, None], width[:, None]))


def vein_start(number: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where secondary veins leave the midrib, as a part of its length: closer at the base.

    The mean of the layout that `materials.venation` draws from.
    """
    return 0.02 + 0.85 * ((number + 0.25) / PAIRS) ** 1.15


def _vein_rise(
    start: NDArray[np.float64],
    reach: NDArray[np.float64],
    length: NDArray[np.float64],
    width: NDArray[np.float64],
) -> NDArray[np.float64]:
    """How far a secondary vein has risen at a distance from the midrib, as a part of the length."""
    arc = ARC * width / 6.0 * (2.0 * reach / width) ** 3
    return ((BASE_COT + (TIP_COT - BASE_COT) * start) * reach + arc) / length


def _vein_number(
    v: NDArray[np.float64],
    reach: NDArray[np.float64],
    length: NDArray[np.float64],
    width: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The inverse of `vein_start` and `_vein_rise`: a whole number on every secondary vein."""
    arc = ARC * width / 6.0 * (2.0 * reach / width) ** 3
    start = (v * length - BASE_COT * reach - arc) / (length + (TIP_COT - BASE_COT) * reach)
    return PAIRS * (np.clip(start - 0.02, 0.0, None) / 0.85) ** (1.0 / 1.15) - 0.25


def _outline(
    v: NDArray[np.float64], power: NDArray[np.float64], widest: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Half-width over the greatest half-width, 0 at v = 0 and 1, 1 at `widest`: a beta curve."""
    other = power * (1.0 - widest) / widest
    v = np.clip(v, 0.0, 1.0)
    return (v / widest) ** power * ((1.0 - v) / (1.0 - widest)) ** other


def _per_side(values: NDArray[np.float64], grid: _Grid) -> NDArray[np.float64]:
    """`(n, v)` out of `(n, 2)` values for the left and the right half; the midrib counts as right."""
    return values[:, (grid.across >= 0.0).astype(np.intp)]


def _relief(
    organs: Sequence[Organ], flat: _Flat, seed: NDArray[np.float64], grid: _Grid, detail: float
) -> NDArray[np.float64]:
    """`(n, v)` metres by which the surface leaves the smooth blade, towards the upper side."""
    part, half = np.abs(grid.across), np.max(flat.reach, axis=1, keepdims=True)
    # Waves run along each margin with their own phase and die out towards midrib, base and tip.
    phase = _per_side(2.0 * np.pi * hashed(seed, 231, 2), grid)
    jitter = _per_side(signed(seed, 232, 2), grid)
    running = (
        2.0 * np.pi * measure(organs, "margin_waves", 0.0)[:, None] * (flat.v + 0.08 * jitter * flat.v**2)
    )
    ends = np.sqrt(np.sin(np.pi * np.clip(flat.v, 0.0, 1.0)))
    wave = measure(organs, "margin_wave_m", 0.0)[:, None] * np.sin(running + phase) * part * flat.reach / half
    # Bulges rise between secondary veins, sunken lines along them; tertiary veins part the bulges unevenly.
    # A grid with fewer than three rows to a vein cannot show their slopes.
    if fineness(_PER_VEIN, detail, 1) < 3:
        return wave
    bulge = np.abs(np.sin(np.pi * flat.vein)) ** 0.8
    profile = np.sqrt(part) * (1.0 - 0.6 * part**4) * ends
    points = np.stack([np.sign(grid.across) * flat.reach / half, 2.0 * flat.v], axis=-1)
    patch = smooth_field(points, seed, 241, 0.45)
    blister = (
        measure(organs, "blister_m", 0.0)[:, None] * profile * (bulge * (1.0 + 0.35 * patch) + 0.35 * patch)
    )
    return wave + blister

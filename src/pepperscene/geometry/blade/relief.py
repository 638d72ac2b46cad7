"""What a blade's surface has above its smooth form: waves of the margin, bulges between sunken veins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.blade.grid import Grid, veins_crossed
from pepperscene.geometry.blade.outline import Flat
from pepperscene.geometry.organ_arrays import hashed, organ_measure, signed
from pepperscene.grammar.plant import Organ
from pepperscene.materials.patterns import PAIRS

Array = NDArray[np.float64]

_DOME: Final = 0.8  # chosen: power of a half sine from vein to vein; bulges are round, creases narrow
_RISE: Final = 0.1  # of the half-width: how soon bulges rise beside the midrib
_CELLS: Final = 3.5  # tertiary veins part a bulge into so many at the widest place
_TURN: Final = 2.0 * np.pi
_FURROW: Final = 0.15  # half-width of a sunken vein, as a share of the way to the next


def margin_waves(
    organs: Sequence[Organ], flat: Flat, half_width: Array, lively: Array, seed: Array
) -> tuple[Array, Array]:
    """`(n, 2, m)` metres, twice: how high waves lift points of the margins, and a stretch that turns over.

    Lengths and heights of the waves vary along a margin, and ripples ride on them; each margin has its own.
    """
    # Waves higher than an eighth of the width are not those of a blade.
    half = half_width.mean(axis=1)
    height = np.clip(organ_measure(organs, "margin_wave_m", 0.0), -0.25 * half, 0.25 * half)[:, None, None]
    count = np.clip(organ_measure(organs, "margin_waves", 0.0), 0.0, 12.0)[:, None, None]
    chance = hashed(seed, 231, 16).reshape(-1, 2, 8, 1)
    one, two, three, phase, ripple, much, place, turn = (chance[:, :, k] for k in range(8))
    at, wide = flat.margin, np.minimum(flat.reach / half_width[..., None], 1.0)
    warp = 0.07 * np.sin(_TURN * (1.2 * at + one)) + 0.04 * np.sin(_TURN * (2.7 * at + two))
    turns = count * (at + warp) + phase
    high = 1.0 - (0.25 + 0.5 * much) * (0.5 + 0.5 * np.sin(_TURN * (0.9 * at + three)))
    waves = high * np.sin(_TURN * turns) + 0.1 * np.sin(_TURN * (2.6 * turns + ripple))
    # The stretch turns by up to so many radians at the margin, up or down; chosen.
    curl = np.minimum(np.abs(organ_measure(organs, "curl_rad", 0.0)), 1.5)
    most = (0.5 * lively + 0.4 * curl)[:, None, None]
    bump = np.exp(-(((at - 0.15 - 0.7 * place) / 0.16) ** 2))
    # Both die out towards base and tip, where the blade is narrow.
    return height * np.sqrt(wide) * waves, 0.2 * flat.reach * most * (2.0 * turn - 1.0) * bump


def lifted(ends: Array, x: Array | float) -> tuple[Array, Array]:
    """Metres by which a blade rises, and by which it falls short across, at a share x of the way to margins.

    Waves rise by w x^2 and the stretch by t x^5. Crests so run along the veins; what the blade climbs it
    lacks across: half the integral of the squared slope (2 w x + 5 t x^4) / reach.

    Args:
        ends: `(3, ...)` w, t and the reach of the margin, metres.
        x: that goes with `(...)`.
    """
    waves, turned, reach = ends
    cube = x * x * x
    wave, turn = waves * x, turned * (cube * x)
    short = (2 / 3 * wave**2 + 5 / 3 * wave * turn + 25 / 18 * turn**2) * (x / reach)
    return x * (wave + turn), short


def bulges(organs: Sequence[Organ], flat: Flat, grid: Grid, half_width: Array, seed: Array) -> Array:
    """`(n, 2, r, s)` metres by which the blade bulges between its veins; 0 on the margin."""
    number, part = grid.number, flat.part
    # Rows that miss the veins and the tops between them cannot show bulges.
    if np.count_nonzero((number >= 0.0) & (number < 1.0)) < 2:
        return np.zeros(flat.along.shape)
    width = 2.0 * half_width.mean(axis=1)
    height = np.clip(organ_measure(organs, "blister_m", 0.0), -0.1 * width, 0.1 * width)[:, None, None, None]
    sunken = np.clip(organ_measure(organs, "vein_m", 0.0), -0.05 * width, 0.05 * width)[:, None, None, None]
    # Two panels below the first vein, one between each vein and the next.
    panel = np.where(number < 0.0, np.floor(2.0 * number) + 2.0, np.floor(number) + 2.0).astype(np.intp)
    within = np.where(number < 0.0, 2.0 * number, number) % 1.0
    dome = np.sin(np.pi * within) ** _DOME
    outwards = (1.0 - np.exp(-part / _RISE)) * (1.0 - part**3)
    # Every panel bulges by its own measure, and is parted at its own places.
    panels = PAIRS + 3
    chance = hashed(seed, 241, 4 * panels).reshape(-1, 2, panels, 2)[:, :, panel]
    own = 0.7 + 0.6 * chance[..., 0]
    cells = _parted(flat, half_width, chance[..., 1]) if grid.side >= 6 else 0.75
    panelled = (own * dome)[..., None] * outwards * cells
    # Furrows run along the veins, shallower towards the margin.
    away = np.minimum(number % 1.0, -number % 1.0)
    furrow = np.where(number > -0.5, np.exp(-((away / _FURROW) ** 2)), 0.0)[:, None]
    taper = np.minimum(part / _RISE, 1.0) * (1.0 - 0.75 * part) * (1.0 - part**8)
    uneven = 0.3 * grid.halves(grid_noise(flat, grid, seed, 245, 0.5)) * outwards
    # Narrow panels bulge less.
    wide = np.minimum(flat.edge / half_width[..., None], 1.0)[..., None]
    return wide**0.7 * (height * (panelled + uneven) - sunken * (furrow * taper))


def _parted(flat: Flat, half_width: Array, shift: Array) -> Array:
    """`(n, 2, r, s)` how tertiary veins, across the panels, part the bulges: 1 between them, less on them."""
    out = flat.edge[..., None] * flat.part / half_width[..., None, None]
    return 0.75 - 0.25 * np.cos(2.0 * np.pi * (_CELLS * out + shift[..., None]))


def grid_noise(flat: Flat, grid: Grid, seed: Array, salt: int, size: float, waves: int = 8) -> Array:
    """`(n, r, c)` smooth noise of mean 0 and variance 1 over the grid, as `noise.smooth_field` makes it.

    Places are told in half-widths across and, along the midrib, by where a vein starts. There the waves are
    products of one factor for rows and one for columns, which saves most of the cosines.

    Args:
        flat: vertices of the blades.
        grid: of the blades.
        seed: `(n,)` of the blades.
        salt: tells one field of a blade from another.
        size: mean wavelength, in half-widths.
        waves: how many.
    """
    angle = 2.0 * np.pi * hashed(seed, salt, waves)
    number = 2.0 * np.pi / size * (1.0 + 0.4 * signed(seed, salt + 1, waves))
    phase = 2.0 * np.pi * hashed(seed, salt + 2, waves)
    # cos(a + b) = cos a cos b - sin a sin b, a from rows and b from columns.
    rows = 2.0 * flat.start[:, None] * (number * np.sin(angle))[:, None] + phase[:, None]
    columns = grid.across[:, None] * (number * np.cos(angle))[:, None]
    rows = np.concatenate([np.cos(rows), -np.sin(rows)], axis=2)
    columns = np.concatenate([np.cos(columns), np.sin(columns)], axis=2)
    return np.sqrt(2.0 / waves) * np.matmul(rows, columns.swapaxes(1, 2))


def slack(organs: Sequence[Organ], flat: Flat, half_width: Array) -> Array:
    """`(n, 1, 1, s)` by which a half shrinks across, column by column, to keep its width over all bulges.

    The arc over a surface of slope h' is longer by sqrt(1 + h'^2); bulges are quilted out of a blade of the
    stated width, not put on top of it. Slopes are those of the mean bulge at the widest place.
    """
    half = half_width.mean(axis=1)[:, None]
    part = 0.5 * (flat.part + np.concatenate([[0.0], flat.part[:-1]]))
    height = np.clip(np.abs(organ_measure(organs, "blister_m", 0.0))[:, None] / half, 0.0, 0.2)
    outwards = (1.0 - np.exp(-part / _RISE)) * (1.0 - part**3)
    # Mean squares: of a dome's slope from vein to vein, of its height, of the parts by tertiary veins.
    across = 5.3 * 0.6 * (outwards * veins_crossed(part, 0.2)) ** 2
    beside = 0.5 * 0.6 * (np.exp(-part / _RISE) / _RISE) ** 2
    parts = 0.5 * 0.5 * (outwards * 0.25 * 2.0 * np.pi * _CELLS) ** 2
    square = height**2 * (across + beside + parts)
    return (1.0 / np.sqrt(1.0 + square))[:, None, None]

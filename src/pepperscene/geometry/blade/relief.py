"""The relief of a blade above its smooth form: waves of the margin, bulges between sunken veins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from pepperscene.geometry.batch import hash_signed, hash_uniform, read_measure
from pepperscene.geometry.blade.grid import vein_density, vein_rise
from pepperscene.geometry.blade.outline import FlatBlades
from pepperscene.geometry.mesh import FloatArray
from pepperscene.grammar.plant import Organ
from pepperscene.materials.venation import VEIN_ASPECT, VEIN_PAIRS

_DOME: Final = 0.8  # chosen: power of a half sine from vein to vein; bulges are round, creases narrow
_RISE: Final = 0.1  # chosen, of the half-width: distance from the midrib within which bulges rise
# Chosen, as fractions of the stated height of bulges: the mean dome between two veins, and the standard
# deviation of blisters. So slopes along the veins and across them differ by less than a factor of 1.5.
_PANEL: Final = 0.45
_BLISTER: Final = 0.65
# Chosen, of the half-width: mean wavelength of blisters, the least that six columns in a half can show; finer
# ones are relief of the material.
_BLISTER_SIZE: Final = 0.5
_TURN: Final = 2.0 * np.pi
_FURROW: Final = 0.15  # chosen: half-width of a sunken vein, as a fraction of the distance to the next
# Chosen: amplitude of the crumples of a dry rim, of the half-width, and the ageing from which it is reached.
_CRUMPLE: Final = 0.022
_CRUMPLED: Final = 0.25
_NOISE_WAVES: Final = 8  # chosen
_MIDDLE: Final = np.array(0.4)  # chosen: origin of a vein as steep as most


def margin_waves(
    organs: Sequence[Organ], flat: FlatBlades, waviness: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute two heights `(n, 2, m)` of the margins' points, metres: waves, and a stretch that turns over.

    Lengths and heights of the waves vary along a margin and have ripples; each margin is different.
    """
    # Waves are limited to an eighth of the width.
    half = flat.half_width.mean(axis=1)
    height = np.clip(read_measure(organs, "margin_wave_m", 0.0), -0.25 * half, 0.25 * half)[:, None, None]
    count = np.clip(read_measure(organs, "margin_waves", 0.0), 0.0, 12.0)[:, None, None]
    draws = hash_uniform(flat.seed, 231, 16).reshape(-1, 2, 8, 1)
    phase_1, phase_2, phase_3, phase, ripple, amount, position, curl_angle = (
        draws[:, :, k] for k in range(8)
    )
    at, wide = flat.margin, np.minimum(flat.reach / flat.half_width[..., None], 1.0)
    warp = 0.07 * np.sin(_TURN * (1.2 * at + phase_1)) + 0.04 * np.sin(_TURN * (2.7 * at + phase_2))
    turns = count * (at + warp) + phase
    amplitude = 1.0 - (0.25 + 0.5 * amount) * (0.5 + 0.5 * np.sin(_TURN * (0.9 * at + phase_3)))
    waves = amplitude * np.sin(_TURN * turns) + 0.1 * np.sin(_TURN * (2.6 * turns + ripple))
    # Chosen: maximum angle at the margin of the stretch that turns over, radians up or down.
    curl = np.minimum(np.abs(read_measure(organs, "curl_rad", 0.0)), 1.5)
    max_angle = (0.5 * waviness + 0.4 * curl)[:, None, None]
    bump = np.exp(-(((at - 0.15 - 0.7 * position) / 0.16) ** 2))
    # Both vanish towards base and tip, where the blade is narrow.
    return height * np.sqrt(wide) * waves, 0.2 * flat.reach * max_angle * (2.0 * curl_angle - 1.0) * bump


def rim_crumples(organs: Sequence[Organ], flat: FlatBlades) -> FloatArray:
    """Compute heights `(n, 2, m)` of the margins' points, metres: the crumples of a rim that dries."""
    ageing = np.clip(read_measure(organs, "ageing", 0.0), 0.0, 1.0)
    if not ageing.any():
        return np.zeros(flat.margin.shape)
    phase = hash_uniform(flat.seed, 235, 4).reshape(-1, 2, 2, 1)
    at, wide = flat.margin, np.minimum(flat.reach / flat.half_width[..., None], 1.0)
    # Chosen: a rim of 3 to 10 mm that shrinks as it dries has folds of 14 mm, four pieces of the margin.
    turns = 11.0 * (at + 0.05 * np.sin(_TURN * (2.3 * at + phase[:, :, 0]))) + phase[:, :, 1]
    height = _CRUMPLE * np.minimum(ageing / _CRUMPLED, 1.0)[:, None, None] * flat.half_width[..., None]
    return height * wide * np.sin(_TURN * turns)


def margin_relief(margin: FloatArray, x: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Compute the height of the margin's relief, and the width that it takes up, metres, inside the blade.

    Waves rise as w x^2 and the stretch that turns over as t x^5, so crests run along the veins. The width is
    half the integral of the squared slope (2 w x + 5 t x^4) / reach.

    Args:
        margin: `(3, ...)` w, t and the reach of the margin, metres.
        x: fraction of the way from the midrib to the margin, broadcast against `(...)`.
    """
    waves, curled, reach = margin
    cube = x * x * x
    wave, curl = waves * x, curled * (cube * x)
    width = (2 / 3 * wave**2 + 5 / 3 * wave * curl + 25 / 18 * curl**2) * (x / reach)
    return x * (wave + curl), width


def vein_bulges(organs: Sequence[Organ], flat: FlatBlades) -> FloatArray:
    """Compute `(n, 2, r, s)` metres by which the blade bulges between its veins; 0 on the margin."""
    grid, column = flat.grid, flat.column
    number = grid.number
    # Rows that miss the veins and the tops between them cannot show bulges.
    if np.count_nonzero((number >= 0.0) & (number < 1.0)) < 2:
        return np.zeros(flat.along.shape)
    width = 2.0 * flat.half_width.mean(axis=1)
    height = np.clip(read_measure(organs, "blister_m", 0.0), -0.1 * width, 0.1 * width)[:, None, None, None]
    sunken = np.clip(read_measure(organs, "vein_m", 0.0), -0.05 * width, 0.05 * width)[:, None, None, None]
    # Two panels below the first vein, one between each vein and the next.
    panel = np.where(number < 0.0, np.floor(2.0 * number) + 2.0, np.floor(number) + 2.0).astype(np.intp)
    fraction = np.where(number < 0.0, 2.0 * number, number) % 1.0
    dome = np.sin(np.pi * fraction) ** _DOME
    # Panels differ in height.
    panels = VEIN_PAIRS + 3
    scale = 0.7 + 0.6 * hash_uniform(flat.seed, 241, 2 * panels).reshape(-1, 2, panels)[:, :, panel]
    panelled = _PANEL * (scale * dome)[..., None] * _dome_across(column)
    # Furrows run along the veins, shallower towards the margin.
    vein_distance = np.minimum(number % 1.0, -number % 1.0)
    furrow = np.where(number > -0.5, np.exp(-((vein_distance / _FURROW) ** 2)), 0.0)[:, None]
    taper = np.minimum(column / _RISE, 1.0) * (1.0 - 0.75 * column) * (1.0 - column**8)
    blisters = grid.split_halves(grid_noise(flat, 245, _BLISTER_SIZE)) * _dome_across(column)
    # Narrow panels bulge less.
    wide = np.minimum(flat.edge / flat.half_width[..., None], 1.0)[..., None]
    return wide**0.7 * (height * (panelled + _BLISTER * blisters) - sunken * (furrow * taper))


def _dome_across(column: FloatArray) -> FloatArray:
    """`(s,)` height of a bulge across a half: 0 at the midrib and at the margin."""
    return (1.0 - np.exp(-column / _RISE)) * (1.0 - column**3)


def grid_noise(flat: FlatBlades, salt: int, size: float) -> FloatArray:
    """Compute `(n, r, c)` smooth noise of mean 0 and variance 1 over the grid, like `smooth_field`.

    Positions are in half-widths on a blade of the veins' layout, with all rows as steep as one in the middle.
    There each wave is a product of a factor for rows and one for columns, which saves most of the cosines.
    """
    angle = 2.0 * np.pi * hash_uniform(flat.seed, salt, _NOISE_WAVES)
    wavenumber = 2.0 * np.pi / size * (1.0 + 0.4 * hash_signed(flat.seed, salt + 1, _NOISE_WAVES))
    phase = 2.0 * np.pi * hash_uniform(flat.seed, salt + 2, _NOISE_WAVES)
    # cos(a + b) = cos a cos b - sin a sin b, a from rows and b from columns.
    right, along = (wavenumber * np.cos(angle))[:, None], (wavenumber * np.sin(angle))[:, None]
    across, length = flat.grid.across[:, None], 2.0 / VEIN_ASPECT
    rows = length * flat.origin[:, None] * along + phase[:, None]
    columns = across * right + length * vein_rise(_MIDDLE, np.abs(across)) * along
    rows = np.concatenate([np.cos(rows), -np.sin(rows)], axis=2)
    columns = np.concatenate([np.cos(columns), np.sin(columns)], axis=2)
    return np.sqrt(2.0 / _NOISE_WAVES) * np.matmul(rows, columns.swapaxes(1, 2))


def bulge_shrinkage(organs: Sequence[Organ], flat: FlatBlades) -> FloatArray:
    """Compute `(n, 1, 1, s)` factors by which a half shrinks across to keep its width over all bulges.

    The arc over a surface of slope h' is longer by sqrt(1 + h'^2); bulges are formed from a blade of the
    stated width, not added to it. Slopes are those of the mean bulge at the widest position.
    """
    half = flat.half_width.mean(axis=1)[:, None]
    middle = 0.5 * (flat.column + np.concatenate([[0.0], flat.column[:-1]]))
    height = np.clip(np.abs(read_measure(organs, "blister_m", 0.0))[:, None] / half, 0.0, 0.2)
    dome = _dome_across(middle)
    # Mean squares: of a dome's slope from vein to vein, of its rise at the midrib, of the blisters.
    along = 5.3 * (_PANEL * dome * vein_density(middle, 0.2)) ** 2
    rise = 0.5 * (_PANEL * np.exp(-middle / _RISE) / _RISE) ** 2
    blisters = 0.5 * (_BLISTER * dome * 2.0 * np.pi / _BLISTER_SIZE) ** 2
    square = height**2 * (along + rise + blisters)
    return (1.0 / np.sqrt(1.0 + square))[:, None, None]

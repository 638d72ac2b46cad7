"""Where the secondary veins of a blade run, so that bulges rise between the veins that the material draws.

All lengths are shares of the flat blade, as its uv are: the way out from the midrib is 0 there and 1 at half
the width, the way along is 0 at the base and 1 at the tip. The law is that of `materials.venation`, which
draws one pattern for all blades of a cultivar, stretched to each: on narrow ones veins are steeper.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials.venation import ARC, ASPECT, BASE_COT, PAIRS, TIP_COT

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

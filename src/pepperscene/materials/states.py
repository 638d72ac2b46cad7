"""At how many states a surface has to be tabulated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOLERANCE: Final = 0.002
"""Largest error of a spectrum between two rows: chosen, half a step of an 8-bit image."""
FEWEST, MOST = 9, 513
CHECKED_NM: Final = np.arange(400.0, 1001.0, 10.0)
"""Where the error is looked for: finer than any pigment's band, and the same whatever grid is asked for."""


def enough_states(spectra: Callable[[Array, Array], Array]) -> Array:
    """Even states in [0, 1] between which linear interpolation follows a model of pigments.

    The intervals are halved until the new rows lie within `TOLERANCE` of the mean of their neighbours.

    Args:
        spectra: (wavelengths `(n,)`, states `(s,)`) -> `(s, ...)`.
    """
    count = FEWEST
    rows = spectra(CHECKED_NM, np.linspace(0.0, 1.0, count))
    while count < MOST:
        finer = np.linspace(0.0, 1.0, 2 * count - 1)
        middles = spectra(CHECKED_NM, finer[1::2])
        if np.abs(middles - 0.5 * (rows[1:] + rows[:-1])).max() <= TOLERANCE:
            break
        known = rows
        rows = np.empty((finer.size, *known.shape[1:]))
        rows[::2], rows[1::2] = known, middles
        count = finer.size
    return np.linspace(0.0, 1.0, count)

"""Photons and joules."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

PLANCK: Final = 6.62607015e-34
"""Planck constant, J s; exact in the SI of 2019."""

LIGHT_SPEED: Final = 299_792_458.0
"""Speed of light in vacuum, m s-1; exact."""


def photons_per_joule(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Photons in one joule of light, lambda / (h c), at each wavelength."""
    return np.asarray(wavelength_nm, dtype=float) * 1e-9 / (PLANCK * LIGHT_SPEED)

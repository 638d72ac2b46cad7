"""A flower's petals: thin, matt and translucent, bright with the air between their cells."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials.leaf import thin_surface
from pepperscene.materials.noise import noise_mm
from pepperscene.materials.surface import Surface

if TYPE_CHECKING:
    from pepperscene.cultivar import PigmentPath

PIXELS: Final = 64


def petal_surface(
    path: PigmentPath,
    wavelength_nm: NDArray[np.float64],
    size_mm: tuple[float, float],
    rng: np.random.Generator,
) -> Surface:
    """A petal: the model of a leaf's blade with a petal's pigments, without a leaf's veins.

    Args:
        path: pigments from the greenish bud (state 0) to the open flower (state 1).
        wavelength_nm: `(n,)`.
        size_mm: width and length of a petal.
        rng: draws faint streaks from base to tip.
    """
    # Streaks a millimetre wide along the petal: amount chosen by eye.
    streaks = 0.05 * noise_mm(rng, (PIXELS, PIXELS), size_mm, (0.5, 6.0))
    return replace(thin_surface("petal", path, wavelength_nm), pattern=streaks.astype(np.float32))

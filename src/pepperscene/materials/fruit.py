"""The fruit's wall: pigmented skin on white flesh under a smooth cuticle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials.noise import noise_mm
from pepperscene.materials.rind import rind_surface
from pepperscene.materials.surface import Surface

if TYPE_CHECKING:
    from pepperscene.cultivar import PigmentPath

PIXELS: Final = 256


def fruit_surface(
    path: PigmentPath,
    wavelength_nm: NDArray[np.float64],
    size_mm: tuple[float, float],
    rng: np.random.Generator,
) -> Surface:
    """A fruit, ripening in patches on top of the ripeness that the mesh gives to each of its points.

    Args:
        path: pigments from unripe (state 0) over breaker to ripe (state 1).
        wavelength_nm: `(n,)`.
        size_mm: girth and length.
        rng: draws the patches.
    """
    # Patches of centimetres turn earlier than others, with a faint speckle on top: amounts chosen by eye.
    grid = (PIXELS, PIXELS)
    patches = 0.045 * noise_mm(rng, grid, size_mm, (9.0, 14.0))
    speckle = 0.012 * noise_mm(rng, grid, size_mm, (0.7, 0.7))
    return rind_surface("fruit", path, wavelength_nm, patches + speckle)

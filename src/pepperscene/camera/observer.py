"""What the standard observer sees, and how far apart two colours look: CIE 1931, CIELAB, Bradford, sRGB.

The few formulas that a first picture needs. colour-science has them too, but its import takes a second.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.spectra import Spectrum, read_spectra

Array = NDArray[np.float64]

OBSERVER: Final = "light/cie_1931_observer"

SRGB_TO_XYZ: Final[Array] = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
XYZ_TO_SRGB: Final[Array] = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
"""Linear sRGB and XYZ (white at Y = 1), as IEC 61966-2-1 rounds them."""

D65_WHITE: Final[Array] = np.array([0.3127 / 0.3290, 1.0, (1.0 - 0.3127 - 0.3290) / 0.3290])
"""XYZ of sRGB's white, by its chromaticity in IEC 61966-2-1."""

_BRADFORD: Final[Array] = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
"""XYZ to the sharpened cone responses of Lam (1985), "Metamerism and colour constancy"."""

_KNEE: Final = (6.0 / 29.0) ** 3  # of CIELAB: below, its cube root becomes a line (CIE 15:2004)


@lru_cache(maxsize=1)
def observer() -> Spectrum:
    """CIE 1931 colour matching functions, `(3, n)`, 360 to 830 nm."""
    columns = read_spectra(OBSERVER)
    return Spectrum(columns["x"].wavelength_nm, np.stack([columns[name].values for name in "xyz"]))


def adaptation(white: ArrayLike) -> Array:
    """`(3, 3)` what brings XYZ seen under a light of the given white, `(3,)`, to D65: von Kries' rule in
    Bradford's space.
    """
    gains = (_BRADFORD @ D65_WHITE) / (_BRADFORD @ np.asarray(white, float))
    return np.asarray(np.linalg.inv(_BRADFORD) @ (gains[:, None] * _BRADFORD))


def lab(xyz: ArrayLike) -> Array:
    """`(..., 3)` CIELAB of XYZ (white at Y = 1) under D65."""
    share = np.asarray(xyz, float) / D65_WHITE
    line = share / (3.0 * (6.0 / 29.0) ** 2) + 4.0 / 29.0
    x, y, z = np.moveaxis(np.where(share > _KNEE, np.cbrt(share), line), -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)

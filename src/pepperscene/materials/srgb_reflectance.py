"""Reflectance spectra of sRGB colours, for surfaces whose colour was scanned and not modelled."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.spectra import colour_science
from pepperscene.spectra.spectrum import FloatArray


def srgb_basis(wavelength_nm: ArrayLike) -> FloatArray:
    """Reflectance `(3, n)` of the red, green and blue of sRGB (Mallett & Yuksel 2019, EGSR).

    The reflectance of the linear sRGB colour (r, g, b) is r times the first row plus g times the second plus
    b times the third. All three are in [0, 1] and sum to 1 at each wavelength, so that colours in [0, 1] give
    reflectances in [0, 1]; in D65, the CIE 1931 observer sees the colour itself. They are published for 380
    to 780 nm, and constant beyond: a colour says nothing about the infrared.

    Args:
        wavelength_nm: `(n,)`.
    """
    basis = colour_science().recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    rows = np.stack([np.interp(nm, basis.wavelengths, column) for column in basis.values.T])
    return np.asarray(rows / rows.sum(axis=0))

"""Reflectance of skin whose colour comes from a scan, in the kernel.

The colour (r, g, b) at a hit, linear sRGB, is that of the body under the cuticle, without its gloss: what a
scanner sees in cross-polarised light, and the base colour of glTF. The body's reflectance is the sum of the
three spectra of `srgb_basis` in these proportions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.render.arrays import channel_array, device_array
from pepperscene.render.variant import mitsuba_modules
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


@dataclass(frozen=True, eq=False)
class ScannedColours:
    """Spectra of the three components of a colour.

    Attributes:
        basis: `(n * 4,)` by wavelength or channel: of red, green and blue, and 0.
        variances: `(c * 4,)` by channel: their variances over the wavelength, and 0; None for wavelengths.
    """

    basis: Any
    variances: Any = None

    @classmethod
    def pack(cls, grid_nm: NDArray[np.float64]) -> ScannedColours:
        """Tabulate the spectra at `(n,)` wavelengths."""
        return cls(device_array(_padded(srgb_basis(grid_nm).T)))

    def by_channel(self, fractions: NDArray[np.float64]) -> ScannedColours:
        """Integrate the spectra over `(n, c)` shares of the wavelengths in what each channel detects."""
        basis = np.asarray(self.basis).reshape(-1, 4)[:, :3].astype(np.float64)
        means = fractions.T @ basis
        variances = np.maximum(fractions.T @ basis**2 - means**2, 0.0)
        return ScannedColours(device_array(_padded(means)), device_array(_padded(variances)))

    def body(self, columns: Any, colour: Any, active: Any) -> tuple[Any, Any]:
        """Reflectance of the body by wavelength or channel, and its variance in a channel.

        Args:
            columns: of the tables, as many as there are wavelengths or channels.
            colour: linear sRGB in [0, 1].
            active: mask.
        """
        mi, dr = mitsuba_modules()
        spectrum = channel_array(len(columns))
        r, g, b = (dr.clip(component, 0.0, 1.0) for component in (colour.x, colour.y, colour.z))
        is_channel = self.variances is not None
        reflectance, variance = spectrum(0.0), spectrum(0.0)
        for k, column in enumerate(columns):
            row = dr.gather(mi.Vector4f, self.basis, mi.UInt32(column), active)
            reflectance[k] = row.x * r + row.y * g + row.z * b
            if is_channel:
                # The three spectra sum to 1: the variance of one holds the covariances of the others.
                v = dr.gather(mi.Vector4f, self.variances, mi.UInt32(column), active)
                variance[k] = 0.5 * (
                    (v.x + v.y - v.z) * dr.square(r - g)
                    + (v.y + v.z - v.x) * dr.square(g - b)
                    + (v.z + v.x - v.y) * dr.square(b - r)
                )
        return reflectance, variance


def _padded(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n, 4)` rows of three numbers and 0, which the kernel gathers at once."""
    return np.pad(rows, ((0, 0), (0, 1)))

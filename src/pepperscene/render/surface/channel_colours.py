"""Spectra of surfaces on a wavelength grid, and their integrals to what the channels of a sensor see."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials import Surface


def channel_fractions(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n, c)` share of each wavelength in what a channel detects, from response times light."""
    total = weights.sum(axis=0)
    return np.asarray(weights / np.where(total > 0.0, total, 1.0))


def channel_colours(spectra: NDArray[Any], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Integrate spectra to colours; see `Optics.by_channel`.

    Args:
        spectra: `(r, n, 4)` front and back reflectance, transmittance, 0.
        weights: `(n, c)` response times light.

    Returns:
        `(r, c, 4)`; the last entry is the variance over wavelength of what a side scatters.
    """
    fractions = channel_fractions(weights)
    colours = np.einsum("rls,lc->rcs", spectra.astype(np.float64), fractions)
    # The variance hardly differs between front and back.
    for side in (0, 1):
        scattered = spectra[..., side].astype(np.float64) + spectra[..., 2]
        mean = colours[..., side] + colours[..., 2]
        squares = np.einsum("rl,lc->rc", scattered**2, fractions)
        colours[..., 3] += 0.5 * np.maximum(squares - mean**2, 0.0)
    return np.asarray(colours)


def spectra_rows(surface: Surface, grid_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(s, n, 4)` spectra of a surface by state: front and back reflectance, transmittance, 0."""

    def resample(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([np.interp(grid_nm, surface.wavelength_nm, row) for row in rows])

    front, back = resample(surface.reflectance[:, 0]), resample(surface.reflectance[:, 1])
    through = resample(surface.transmittance)
    return np.stack([front, back, through, np.zeros_like(front)], axis=-1)

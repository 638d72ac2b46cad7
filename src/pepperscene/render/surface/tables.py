"""Tables of a surface, as `pepperscene.render.surface.optics` packs them.

They hold its cuticle, and its spectra on a wavelength grid with their integrals over what the channels of a
sensor see.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials import Surface
from pepperscene.materials.gloss import BLUR_NODES, TABLE_SIZE, blur_nodes, blurred_transmittances


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


MIN_ALPHA: Final = 1e-3
"""Chosen: smoother cuticles are packed with this roughness, a mirror for every lens and safe in single
precision."""


def cuticle_tables(
    surface: Surface, narrowest: float | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Constants `(2, 4)` of a surface's sides, and `(2, BLUR_NODES - 1, NODES + 1, 4)` tables of openness.

    `narrowest` replaces `narrowest_alpha(surface)`, for a surface that differs from the packed one.
    """
    ior = max(float(surface.ior), 1.0)
    has_relief = surface.relief_mm is not None
    blurs = blur_nodes(narrowest or narrowest_alpha(surface)) if has_relief else np.zeros(1)
    sides, openness = np.zeros((2, 4)), np.zeros((2, BLUR_NODES - 1, TABLE_SIZE + 1, 4))
    for side, (alpha, wide, share) in enumerate(_lobes(surface)):
        sides[side] = alpha, wide, share, ior
        tables, means = blurred_transmittances(ior, (alpha, wide), share, blurs)
        if not has_relief:
            tables, means = np.repeat(tables, BLUR_NODES, axis=0), np.repeat(means, BLUR_NODES)
        steps = np.diff(tables, axis=1, append=tables[:, -1:])
        entries = np.zeros((BLUR_NODES, TABLE_SIZE + 1, 2))
        entries[:, :-1] = np.stack([tables, steps], axis=-1)
        entries[:, -1, 0] = means
        openness[side] = np.concatenate([entries[:-1], entries[1:]], axis=-1)
    return sides, openness


def narrowest_alpha(surface: Surface) -> float:
    """The smallest roughness of a surface's lobes, as packed."""
    return min(alpha for lobes in _lobes(surface) for alpha in lobes[:2])


def _lobes(surface: Surface) -> list[tuple[float, float, float]]:
    """Roughness of the two lobes of front and back, as packed, and share of the second; 0 without it."""
    wide = surface.wide_roughness
    share = 0.0 if wide is None else float(surface.wide_share)
    pairs = zip(surface.roughness, surface.roughness if wide is None else wide, strict=True)
    return [(max(float(a), MIN_ALPHA), max(float(b), MIN_ALPHA), share) for a, b in pairs]

"""Tables of a surface's cuticle, as `pepperscene.render.surface.optics` packs them."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials import Surface
from pepperscene.materials.gloss import BLUR_NODES, TABLE_SIZE, blur_nodes, blurred_transmittances

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

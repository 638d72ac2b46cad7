"""Open Image Denoise on what is stochastic; what is sharp is left alone.

Two things are: light that was scattered or comes from the sky, and the flash's half-shadows. The latter are
filtered as a share of the unshadowed flash (after Heitz et al. 2018, "Combining analytic direct illumination
and stochastic shadows"), so that highlights, veins and edges stay as rendered.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.transport import Light

_REACH: Final = 3  # chosen: pixels; the flash's share is kept as traced where it is even over such a square


def denoised(light: Light) -> NDArray[np.float32]:
    """`(h, w, c)` all light with its stochastic parts denoised, electrons s-1 m-2 sr-1."""
    return light.sky + _flash(light) + _soft(light)


def _soft(light: Light) -> NDArray[np.float32]:
    """The soft light, guided by albedo and normal."""
    level = float(light.soft.mean())
    if level <= 0.0:
        return light.soft
    # The filter expects values about 1.
    return np.maximum(_filtered(light.soft / level, light, hdr=True), 0.0) * np.float32(level)


def _flash(light: Light) -> NDArray[np.float32]:
    """The flash with the share of it that arrives denoised in half-shadows."""
    from scipy.ndimage import maximum_filter, minimum_filter

    full = light.open_flash.sum(axis=-1)
    share = np.where(
        full > 0.0, light.flash.sum(axis=-1) / np.maximum(full, np.float32(1e-30)), np.float32(1.0)
    )
    uneven = maximum_filter(share, _REACH) - minimum_filter(share, _REACH) > 1e-3
    if not uneven.any():
        return light.flash
    smooth = np.clip(_filtered(share[..., None], light, hdr=False)[..., 0], 0.0, 1.0)
    return np.where(uneven[..., None], light.open_flash * smooth[..., None], light.flash)


def _filtered(image: NDArray[np.float32], light: Light, *, hdr: bool) -> NDArray[np.float32]:
    """Filter "RT" of Open Image Denoise, which wants three channels; one is shown to it three times."""
    import pyoidn

    found = pyoidn.denoise(
        _three(image), albedo=_three(np.clip(light.albedo, 0.0, 1.0)), normal=_three(light.normal), hdr=hdr
    )
    filtered = np.asarray(found, np.float32)
    return filtered if image.shape[-1] == 3 else filtered.mean(axis=-1, keepdims=True)


def _three(image: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.broadcast_to(image, (*image.shape[:2], 3)), np.float32)

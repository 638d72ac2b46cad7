"""Open Image Denoise on what is stochastic; what is sharp is left alone.

Two things are: light that was scattered or comes from the sky, and the flash's half-shadows. The latter are
filtered as a share of the unshadowed flash (after Heitz et al. 2018, "Combining analytic direct illumination
and stochastic shadows"), so that highlights, veins and edges stay as rendered.

Before the sky, soft light ends where bodies do, and what the filter draws over that edge is missing from the
outermost pixels: a fifth to a third of it, a dark line round everything. So the filter is shown the light per
covered area, carried on past the edge, and the cover is multiplied back on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.transport import Light

_REACH: Final = 3  # chosen: pixels; the flash's share is kept as traced where it is even over such a square
_MARGIN: Final = 5
"""Pixels: the square over which bodies are carried on into the background. Chosen among 3, 5, 9 and 25: balls
and fruit before the sky keep their outermost pixels' soft light within 2 %, with 9 it is 5 % less."""


@dataclass(frozen=True, eq=False)
class Guides:
    """What the filter keeps to: `(h, w, c)` albedo and `(h, w, 3)` normals of the bodies."""

    albedo: NDArray[np.float32]
    normal: NDArray[np.float32]


def denoised(light: Light) -> NDArray[np.float32]:
    """`(h, w, c)` all light with its stochastic parts denoised, electrons s-1 m-2 sr-1."""
    if not (light.flash.any() or light.soft.any()):
        return light.total()
    covered = light.covered[..., :1]
    guides = Guides(np.clip(_carried_on(light.albedo, covered), 0.0, 1.0), _carried_on(light.normal, covered))
    return light.sky + _flash(light, guides) + _soft(light, guides)


def _soft(light: Light, guides: Guides) -> NDArray[np.float32]:
    """The soft light, guided by albedo and normal."""
    level = float(light.soft.mean())
    if level <= 0.0:
        return light.soft
    # The filter expects values about 1.
    body = _carried_on(light.soft / level, light.covered[..., 1:])
    seen = np.maximum(_filtered(body, guides, hdr=True), 0.0) * light.covered[..., :1]
    return seen * np.float32(level)


def _flash(light: Light, guides: Guides) -> NDArray[np.float32]:
    """The flash with the share of it that arrives denoised in half-shadows."""
    from scipy.ndimage import maximum_filter, minimum_filter

    full = light.open_flash.sum(axis=-1)
    share = np.where(
        full > 0.0, light.flash.sum(axis=-1) / np.maximum(full, np.float32(1e-30)), np.float32(1.0)
    )
    uneven = maximum_filter(share, _REACH) - minimum_filter(share, _REACH) > 1e-3
    if not uneven.any():
        return light.flash
    smooth = np.clip(_filtered(share[..., None], guides, hdr=False)[..., 0], 0.0, 1.0)
    return np.where(uneven[..., None], light.open_flash * smooth[..., None], light.flash)


def _carried_on(image: NDArray[np.float32], covered: NDArray[np.float32]) -> NDArray[np.float32]:
    """An image of what bodies send out, `(h, w, k)`, per area that they cover, `(h, w, 1)`.

    Pixels without any take the mean of the bodies about them, or 0 where there are none.
    """
    from scipy.ndimage import uniform_filter

    if covered.min() == 1.0:
        return image
    bodies = covered > 0.0
    per_area = np.divide(image, np.where(bodies, covered, 1.0), dtype=np.float32)
    if bodies.all():
        return per_area
    size = (_MARGIN, _MARGIN, 1)
    nearby = uniform_filter(covered, size, mode="nearest")
    # Running sums leave a trace of what they have passed: less than a tenth of any sample is nothing.
    some = nearby > 1e-5
    around = uniform_filter(image, size, mode="nearest") / np.where(some, nearby, np.float32(1.0))
    around *= some
    return np.where(bodies, per_area, around)


def _filtered(image: NDArray[np.float32], guides: Guides, *, hdr: bool) -> NDArray[np.float32]:
    """Filter "RT" of Open Image Denoise, which wants three channels; one is shown to it three times."""
    import pyoidn

    found = pyoidn.denoise(_three(image), albedo=_three(guides.albedo), normal=_three(guides.normal), hdr=hdr)
    filtered = np.asarray(found, np.float32)
    return filtered if image.shape[-1] == 3 else filtered.mean(axis=-1, keepdims=True)


def _three(image: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.broadcast_to(image, (*image.shape[:2], 3)), np.float32)

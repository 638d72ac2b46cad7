"""Ribs along the skin of fruit, and warts, as of cucumber."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.materials.rind_textures import FRUIT_TEXTURES, SHAPE, FruitBody, FruitTextures
from pepperscene.spectra.spectrum import FloatArray

# Chosen, as greenhouse cucumbers look.
_RIB_WARP: Final = 0.1  # by which ribs wander to either side, of the distance between two
_RIB_WAVE_MM: Final = (60.0, 120.0)  # wavelengths of that
_STREAKS: Final = 0.35  # decrease of the state along the crests of ribs, at the blossom end
_WART_SIZES: Final = 0.6, 1.4  # smallest and largest radius and height of warts, over the mean


@dataclass(frozen=True)
class FruitSkin:
    """What the skin of fruit has beside waves and scars; nothing by default."""

    ribs: int = 0
    rib_height_mm: float = 0.0  # of a crest over the furrows beside it
    warts_per_cm2: float = 0.0
    wart_height_mm: float = 0.0  # mean
    wart_width_mm: float = 1.0  # mean diameter


def add_skin(
    textures: FruitTextures, size_mm: tuple[float, float], skin: FruitSkin, rng: np.random.Generator
) -> FruitTextures:
    """Add ribs and warts to the relief of fruit, and pale streaks on the ribs to their pattern.

    Args:
        textures: of the fruit.
        size_mm: girth and height of the mean fruit.
        skin: numbers and sizes of ribs and warts.
        rng: draws the course of ribs, and the places and sizes of warts.
    """
    if skin.ribs == 0 and skin.warts_per_cm2 == 0.0:
        return textures
    pattern, relief_mm = textures.pattern, textures.relief_mm
    body = FruitBody.of(*size_mm)
    if skin.ribs > 0:
        crest = _crests(body, skin.ribs, rng)
        # Ribs end in both ends of the fruit; streaks begin at the blossom end and reach half of the way up.
        along = body.wall_mm / body.length_mm
        relief_mm = relief_mm + skin.rib_height_mm * crest * np.sqrt(np.sin(np.pi * along))[:, None]
        pattern = pattern - _STREAKS * crest**3 * (np.clip(2.0 * along - 1.0, 0.0, 1.0) ** 2)[:, None]
    if skin.warts_per_cm2 * skin.wart_height_mm > 0.0:
        relief_mm = relief_mm + _warts(body, skin, rng)
    return FruitTextures(pattern, relief_mm, textures.cover)


def _crests(body: FruitBody, ribs: int, rng: np.random.Generator) -> FloatArray:
    """`(t, h, w)` 1 on the crests of ribs, 0 in the furrows between them."""
    around = 2.0 * np.pi * (np.arange(SHAPE[1]) + 0.5) / SHAPE[1]
    warp = 2.0 * np.pi * _RIB_WARP * np.clip(body.noise(rng, _RIB_WAVE_MM), -1.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(ribs * around + warp))


def _warts(body: FruitBody, skin: FruitSkin, rng: np.random.Generator) -> FloatArray:
    """`(t, h, w)` millimetres: round warts, evenly scattered over the skin."""
    heights = np.zeros((FRUIT_TEXTURES, *SHAPE))
    girth_mm = 2.0 * np.pi * body.radius_mm
    step_mm = body.length_mm / SHAPE[0]
    # The chance of a row is its area.
    count = round(skin.warts_per_cm2 * girth_mm.sum() * step_mm / 100.0)
    for texture in heights:
        rows = rng.choice(SHAPE[0], count, p=girth_mm / girth_mm.sum())
        columns, sizes = rng.integers(SHAPE[1], size=count), rng.uniform(*_WART_SIZES, count)
        for row, column, size in zip(rows.tolist(), columns.tolist(), sizes.tolist(), strict=True):
            radius_mm = 0.5 * size * skin.wart_width_mm
            near = np.flatnonzero(np.abs(body.wall_mm - body.wall_mm[row]) < radius_mm)
            texel_mm = girth_mm[row] / SHAPE[1]
            reach = min(int(radius_mm / texel_mm), SHAPE[1] // 2 - 1)
            aside = np.arange(-reach, reach + 1)
            distance = np.hypot((body.wall_mm[near] - body.wall_mm[row])[:, None], aside * texel_mm)
            wart = size * skin.wart_height_mm * np.clip(1.0 - (distance / radius_mm) ** 2, 0.0, 1.0) ** 2
            part = np.ix_(near, (column + aside) % SHAPE[1])
            texture[part] = np.maximum(texture[part], wart)
    return heights

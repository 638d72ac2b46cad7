"""Fine textures of skins on the device: periodic tiles, averaged to the size of a pixel.

Texels keep their size in millimetres: a tile is repeated 2^k times along u and v, with the k that comes
nearest. Each repeat begins at another place of the tile: to a matcher no two places are alike. Lobes of the
gloss are narrower by the variance of the slopes that are shown: the sum is the same at every distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials import Surface
from pepperscene.materials.skin import TEXEL_MM, TILE, SkinTile
from pepperscene.render.arrays import device_array, device_float
from pepperscene.render.surface.textures import TextureSample
from pepperscene.render.variant import mitsuba_modules

LEVELS: Final = TILE.bit_length()
_TEXELS: Final = (4 * TILE**2 - 1) // 3  # of all levels of a tile
_MULTIPLIERS: Final = (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D)
"""Odd numbers with well mixed bits, primes of the hash function xxHash (Collet)."""


def changed_reflectance(reflectance: Any, transmittance: Any, change: Any) -> Any:
    """Reflectance with a relative change, in proportion to the light that is absorbed.

    So a thick body changes with its absorption, to the first order (Kubelka & Munk 1931). Reflectance and
    transmittance stay at most 1 together, and the mean is that of the changes.
    """
    return reflectance + change * reflectance * (1.0 - reflectance - transmittance)


@dataclass(frozen=True, eq=False)
class SkinTables:
    """Fine textures of all surfaces of a scene on the device.

    Attributes:
        tiles: `(k,)` number of a surface's tile; -1 for none.
        texels: `(n * 4,)` all levels of each tile: change, factor of the residue, both slopes.
        shown: `(n * LEVELS,)` variance of the slopes of each level.
        period: of a tile, local units.
    """

    tiles: Any
    texels: Any
    shown: Any
    period: Any

    @classmethod
    def pack(cls, surfaces: Sequence[Surface], unit_m: float) -> SkinTables | None:
        """Transfer the tiles of surfaces; None if no surface has one."""
        tiles = [surface.skin for surface in surfaces if surface.skin is not None]
        if not tiles:
            return None
        numbers = np.cumsum([surface.skin is not None for surface in surfaces]) - 1
        levels = [_levels(tile) for tile in tiles]
        shown = [[float((level[..., 2:] ** 2).mean(axis=(0, 1)).sum()) for level in tile] for tile in levels]
        return cls(
            tiles=device_array(np.where([surface.skin is None for surface in surfaces], -1, numbers)),
            texels=device_array(np.concatenate([level.ravel() for tile in levels for level in tile])),
            shown=device_array(shown),
            period=device_float(1e-3 * TILE * TEXEL_MM / unit_m),
        )

    def added_to(
        self, texel: TextureSample, si: Any, surface: Any, texture: Any, footprint: Any, active: Any
    ) -> tuple[TextureSample, Any, Any]:
        """Add the fine texture at hits of camera rays; arguments as of `TextureTables.look_up`.

        Returns:
            The textures; the relative change of the reflectance; and the variance of the slopes that are
            shown, the sum of both axes.
        """
        mi, dr = mitsuba_modules()
        number = dr.gather(mi.Float, self.tiles, surface, active)
        active = active & (number >= 0.0)
        first = mi.UInt32(dr.maximum(number, 0.0))

        # How often the tile is repeated along u and v.
        length_u, length_v = dr.norm(si.dp_du), dr.norm(si.dp_dv)
        repeats_u, repeats_v = (
            dr.exp2(dr.round(dr.log2(dr.maximum(length / self.period, 1e-3))))
            for length in (length_u, length_v)
        )
        x, y = si.uv.x * repeats_u, si.uv.y * repeats_v
        column, row = dr.floor(x), dr.floor(y)

        # Each repeat begins at another texel.
        seed = mi.UInt32(mi.Int32(column)) * _MULTIPLIERS[0] + mi.UInt32(mi.Int32(row)) * _MULTIPLIERS[1]
        seed = (seed + texture * _MULTIPLIERS[2]) * _MULTIPLIERS[0]
        seed = (seed ^ (seed >> 15)) * _MULTIPLIERS[1]
        seed ^= seed >> 13
        x = x - column + mi.Float(seed & (TILE - 1)) / TILE
        y = y - row + mi.Float((seed >> 16) & (TILE - 1)) / TILE
        x, y = x - dr.floor(x), y - dr.floor(y)

        # The level whose texels are half to one times as large as the pixel.
        area = dr.norm(dr.cross(si.dp_du, si.dp_dv)) / (repeats_u * repeats_v * TILE**2)
        level = dr.floor(0.5 * dr.log2(footprint / dr.maximum(area, 1e-30)))
        level = mi.UInt32(dr.select(level > 0.0, dr.minimum(level, LEVELS - 1.0), 0.0))
        side = mi.UInt32(TILE) >> level
        # Finer levels have 4 / 3 (TILE^2 - side^2) texels.
        start = first * _TEXELS + (TILE**2 - side * side) * 4 // 3
        cell = [dr.minimum(mi.UInt32(place * mi.Float(side)), side - 1) for place in (x, y)]
        fine = dr.gather(mi.Vector4f, self.texels, start + cell[1] * side + cell[0], active)
        # A masked gather gives 0.
        residue = texel.residue * dr.select(active, fine.y, 1.0)
        slope_u, slope_v = texel.slope_u + fine.z * length_u, texel.slope_v + fine.w * length_v
        shown = dr.gather(mi.Float, self.shown, first * LEVELS + level, active)
        return replace(texel, residue=residue, slope_u=slope_u, slope_v=slope_v), fine.x, shown


def _levels(tile: SkinTile) -> list[NDArray[np.float32]]:
    """`(n, n, 4)` of each level, down to a single texel."""
    levels = [np.concatenate([tile.change[..., None], tile.residue[..., None], tile.slopes], axis=-1)]
    while (n := len(levels[-1]) // 2) > 0:
        levels.append(levels[-1].reshape(n, 2, n, 2, 4).mean(axis=(1, 3)))
    return levels

"""Textures of leaves: pigment, relief, residue and the order of ageing over uv.

All shapes, amplitudes and shares in this module are chosen from close-ups of sweet pepper leaves, unless a
source is given.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.materials.patterns import Float32Array, PeriodicField, scatter_discs, stamp_discs
from pepperscene.materials.venation import ISLET_MM, RIPPLE_MM, BladeGrid, FieldTile, Venation, grow_veins
from pepperscene.spectra.spectrum import FloatArray

TEXTURES: Final = 8
"""Per surface: chosen. The renderer also mirrors them, so that sixteen leaves in a row can differ."""

BROAD_MM: Final = 18.0
"""Standard deviation of the filter of what varies from one part of a blade to another."""

SIGMAS_MM: Final = (0.8, 1.5, 3.5, RIPPLE_MM, BROAD_MM)  # of the noise that all textures share

BULGE_MM: Final = 1.85
"""Mean height of the bulging cells above their corners, before these are rounded off. Chosen, so that
nine tenths of a blade's relief are within 1.3 mm and its rms slope is 10 degrees each way."""
BULGE_RADIUS_MM: Final = 5.8  # from the centre of a cell to its corners

LAST_ORDER: Final = 0.75
"""Greatest order of ageing, so that an organ of ageing 1 is dry everywhere (`surface.AGEING_RANGE`)."""

_SHARE_PRECISION: Final = 9.0  # of the Dirichlet distribution of the shares of dust, spray and mildew
_SMALLEST_SHARE: Final = 1e-3  # instead of 0, which that distribution excludes
_DROPS_PER_CM2, _DROP_MM = 2.5, (0.5, 2.0)  # number and radii of dried spray drops
_SPOTS_PER_CM2, _SPOT_MM = 0.8, (1.0, 3.0)  # of spots that age first; radius where they are yellow


@dataclass(frozen=True, eq=False)
class LeafTextures:
    """Textures of a leaf surface, each `(t, h, w)` over uv; see `pepperscene.materials.Surface`."""

    pattern: Float32Array
    relief_mm: Float32Array
    residue_pattern: Float32Array
    ageing_order: Float32Array


def leaf_textures(
    grid: BladeGrid,
    rng: np.random.Generator,
    count: int = TEXTURES,
    residue_shares: ArrayLike = (1.0, 0.0, 0.0),
) -> LeafTextures:
    """Draw `count` textures of a leaf surface over the pixels of the mean blade.

    The residue has these mean shares of dust, dried spray and mildew.
    """
    tile = FieldTile.build(grid, SIGMAS_MM, rng)
    drops, spots = _spray_drops(grid, tile, rng), _spots(grid, tile, rng)

    def draw(part: np.random.Generator) -> tuple[Float32Array, ...]:
        veins = grow_veins(grid, tile, part)
        return (
            vein_pattern(veins, grid, tile, part),
            vein_relief(veins, grid, tile, part),
            residue_pattern(veins, grid, tile, drops, residue_shares, part),
            ageing_order(veins, grid, tile, spots, part),
        )

    # In parallel; each texture has its own generator, so the order does not matter.
    with ThreadPoolExecutor(2) as pool:
        textures = list(pool.map(draw, rng.spawn(count)))
    return LeafTextures(*(np.stack(maps) for maps in zip(*textures, strict=True)))


def vein_pattern(veins: Venation, grid: BladeGrid, tile: FieldTile, rng: np.random.Generator) -> Float32Array:
    """State offset over uv: veins are paler, down to -0.57 on the midrib, the blade between is mottled.

    An offset to the state moves along the pigments' path, so a vein's colour has its own spectrum. The
    offsets make the midrib lighter by 5 to 12 in CIELAB, and a lateral vein by about half as much.
    """
    # Veins become thinner towards the margin, and those near the tip are thinner from their origin. Lateral
    # veins are 1 mm wide at the midrib and 0.6 mm at their ends; half of that is where a ridge falls to 1/e.
    taper = (1.0 - 0.6 * veins.out) * (1.0 - 0.6 * grid.height**2)
    thick = 0.35 + 0.6 * (1.0 - grid.height) ** 0.7
    thick = thick * np.exp(rng.spawn(1)[0].normal(0.0, 0.2))
    paler = 0.57 * (1.0 - 0.3 * grid.height) * _ridge(veins.midrib_mm, thick)
    paler = np.maximum(paler, (0.08 + 0.17 * taper) * _ridge(veins.lateral_mm, 0.28 + 0.22 * taper))
    if veins.main_mm is not None:
        paler = np.maximum(paler, 0.5 * taper * _ridge(veins.main_mm, 0.35 + 0.55 * taper))
    # Tissue near the larger veins is somewhat paler than that further away.
    paler = np.maximum(paler, 0.05 * taper * _ridge(veins.lateral_mm, 1.5))
    paler = np.maximum(paler, 0.10 * _ridge(veins.islet_mm, 0.35))
    paler = np.maximum(paler, 0.07 * _ridge(veins.mesh_mm, 0.3))
    paler = np.maximum(paler, 0.03 * _ridge(veins.veinlet_mm, 0.25))
    mottle = 0.05 * _noise(grid, tile, 1.5, rng) + 0.06 * _noise(grid, tile, 3.5, rng)
    mottle += 0.04 * _noise(grid, tile, RIPPLE_MM, rng)
    return np.asarray(mottle - paler + 0.03, dtype=np.float32)


def vein_relief(veins: Venation, grid: BladeGrid, tile: FieldTile, rng: np.random.Generator) -> Float32Array:
    """Height in mm over uv: cells bulge between sunken veins, alike in all directions (a bullate blade).

    The blade is one surface, so furrows above are ridges below.
    """
    # Domes are parabolas about the centres of the cells. At the walls, which they meet with the slope
    # d / R^2 of their spacing d and radius R, the crease is rounded off over a millimetre.
    height = np.clip(BULGE_MM * (1.0 + 0.35 * _noise(grid, tile, RIPPLE_MM, rng)), 0.2, 2.4)
    dome = 1.0 - np.minimum(veins.bulge_mm / np.float32(BULGE_RADIUS_MM), 1.0) ** 2
    rounded = np.sqrt(veins.islet_mm**2 + 1.0) - veins.islet_mm
    dome += np.float32(ISLET_MM / BULGE_RADIUS_MM**2) * rounded
    # Flat at the mean level along large veins, which are furrows in it.
    pressed = (1.0 - 0.6 * _ridge(veins.lateral_mm, 2.0)) * (1.0 - _ridge(veins.midrib_mm, 2.5))
    relief = height * (dome - np.float32(0.6)) * pressed
    relief += 0.05 * _noise(grid, tile, 3.5, rng) + 0.006 * _noise(grid, tile, 0.8, rng)
    taper = (1.0 - 0.6 * veins.out) * (1.0 - 0.6 * grid.height**2)
    relief -= 0.45 * (1.0 - 0.6 * grid.height) * _ridge(veins.midrib_mm, 1.3)
    relief -= 0.22 * taper * _ridge(veins.lateral_mm, 0.9)
    if veins.main_mm is not None:
        relief -= 0.3 * taper * _ridge(veins.main_mm, 1.2)
    relief -= 0.07 * _ridge(veins.mesh_mm, 0.6)
    return np.asarray(relief, dtype=np.float32)


def residue_pattern(
    veins: Venation,
    grid: BladeGrid,
    tile: FieldTile,
    drops: PeriodicField,
    shares: ArrayLike,
    rng: np.random.Generator,
) -> Float32Array:
    """Factor of an organ's residue over uv, of mean 1 over the blade.

    Dust makes an even film, more in furrows; spray leaves dried drops with rims, and runs to the tip before
    it dries; mildew makes soft blotches. The shares of the three vary about their means.
    """
    # Nearly even: on the nearest leaves too, dust is greyness through which veins show, not spots.
    film = np.exp(
        0.42 * _noise(grid, tile, BROAD_MM, rng)
        + 0.10 * _noise(grid, tile, 3.5, rng)
        + 0.08 * _noise(grid, tile, 1.5, rng)
        + 0.12 * _noise(grid, tile, 0.8, rng)
    )
    film *= 1.0 + 0.6 * _ridge(veins.midrib_mm, 1.6) + 0.15 * _ridge(veins.lateral_mm, 1.2)
    wet = drops.crop(rng, grid.shape) * (0.6 + 0.8 * grid.height**2)
    # Pools at the tip, within its last centimetre, and along the midrib.
    pools = 0.15 * _ridge(veins.midrib_mm, 2.0) + 0.5 * np.exp((grid.y_mm - grid.size_mm[1]) / 6.0)
    wet += pools * np.exp(0.7 * _noise(grid, tile, 3.5, rng))
    spread = 0.85 * _noise(grid, tile, RIPPLE_MM, rng) + 0.8 * _noise(grid, tile, 3.5, rng)
    blotch = np.exp(0.4 * _noise(grid, tile, 0.8, rng)) / (1.0 + np.exp(4.0 * (1.1 - spread)))
    inside = grid.edge_mm > 0.0
    drawn = rng.dirichlet(_SHARE_PRECISION * np.maximum(shares, _SMALLEST_SHARE))
    parts = (
        share / part[inside].mean() * part for share, part in zip(drawn, (film, wet, blotch), strict=True)
    )
    return np.asarray(sum(parts), dtype=np.float32)


def ageing_order(
    veins: Venation, grid: BladeGrid, tile: FieldTile, spots: PeriodicField, rng: np.random.Generator
) -> Float32Array:
    """Ageing of an organ at which the tissue of each place begins to age, over uv.

    Rims and spots are first, then tissue between the veins, then the veins. With organs of ageing 0.2, rims
    are yellow or dry over some 2 mm and with 0.3 over some 5 mm; each texture has more of rims or of spots.
    """
    # Rims are uneven, broad in places and absent in others, and broader towards the tip.
    uneven = 0.9 * _noise(grid, tile, BROAD_MM, rng) + 0.6 * _noise(grid, tile, RIPPLE_MM, rng)
    uneven += 0.3 * _noise(grid, tile, 3.5, rng) + 0.8 * (0.5 - grid.height)
    speed = 0.042 * np.exp(rng.normal(0.0, 0.35))
    # Half a millimetre to 1.5 mm is within the variation of outlines about their mean.
    rim = speed * np.maximum(grid.edge_mm - 1.0, 0.0) * np.exp(uneven)
    order = np.minimum(rim, spots.crop(rng, grid.shape) + rng.uniform(-0.06, 0.2))
    between = 0.32 + 0.05 * _noise(grid, tile, RIPPLE_MM, rng) + 0.03 * _noise(grid, tile, 1.5, rng)
    between += 0.1 * _ridge(veins.lateral_mm, 2.2) + 0.025 * _ridge(veins.mesh_mm, 0.7)
    between = np.maximum(between, 0.65 * _ridge(veins.midrib_mm, 3.0))
    return np.asarray(np.clip(np.minimum(order, between), 0.0, LAST_ORDER), dtype=np.float32)


def _spray_drops(grid: BladeGrid, tile: FieldTile, rng: np.random.Generator) -> PeriodicField:
    """Relative residue of dried drops: most of it in a rim (the coffee ring), some in a film inside."""
    field = np.full((max(grid.shape),) * 2, 0.05, np.float32)
    discs = scatter_discs(rng, len(field), grid.pixel_mm, _DROPS_PER_CM2, _DROP_MM)

    def profile(distance: FloatArray, amount: float) -> FloatArray:
        rim = np.exp(-(((distance - 0.85) / 0.15) ** 2))
        return np.asarray((0.2 + amount) * (0.7 * rim + 0.4 * (distance < 0.85)))

    stamp_discs(field, discs, 1.3, profile, np.maximum)
    field *= np.exp(0.4 * tile.noise[1.5].values)
    return PeriodicField(field)


def _spots(grid: BladeGrid, tile: FieldTile, rng: np.random.Generator) -> PeriodicField:
    """Order of ageing of spots, infinite elsewhere; they begin in their middle and grow."""
    field = np.full((max(grid.shape),) * 2, np.inf, np.float32)
    discs = scatter_discs(rng, len(field), grid.pixel_mm, _SPOTS_PER_CM2, _SPOT_MM)

    def profile(distance: FloatArray, amount: float) -> FloatArray:
        return 0.4 * amount + 0.1 * distance**2

    stamp_discs(field, discs, 2.0, profile, np.minimum)
    return PeriodicField(field + np.float32(0.025) * tile.noise[0.8].values)


def _ridge(distance: Float32Array, half_width: Float32Array | FloatArray | float) -> Float32Array:
    """1 on a vein, falling to 1/e at half its width."""
    scaled = distance / np.asarray(half_width, dtype=np.float32)
    return np.asarray(np.exp(-scaled * scaled))


def _noise(grid: BladeGrid, tile: FieldTile, sigma_mm: float, rng: np.random.Generator) -> Float32Array:
    return tile.noise[sigma_mm].crop(rng, grid.shape)

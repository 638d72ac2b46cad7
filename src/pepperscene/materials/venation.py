"""Outline and veins of a flat blade: midrib, lateral veins that join in loops, and the network between.

The outline and the lateral veins follow formulas that the meshes of blades share
(`pepperscene.geometry.blade`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.materials.patterns import Float32Array, PeriodicField, random_cells, smooth_noise
from pepperscene.spectra.spectrum import FloatArray

# Chosen: the layout of the veins of a leaf.
VEIN_PAIRS: Final = 7
VEIN_COT_BASE: Final = 1.0 / np.tan(np.radians(60.0))  # of the angles of lateral veins to the midrib
VEIN_COT_TIP: Final = 1.0 / np.tan(np.radians(45.0))
VEIN_ASPECT: Final = 112.0 / 135.0
"""Width over length of the blade that the vein layout is defined for; other blades stretch it, as uv is."""
PALMATE_PAIRS: Final = 3
"""Chosen: the lowest pairs of lateral veins, which in a palmate blade are main veins as its midrib is."""
VEIN_ARC: Final = 0.7
"""Bend of a lateral vein towards the tip, at the margin of the widest part, as a slope."""

PIXELS: Final = 512
"""Of the longer side of a texture, chosen: .26 mm on a leaf of 135 mm, a third of a lateral vein's width."""

LOOP_START, LOOP_TOP = 0.80, 0.89
"""Chosen, fractions of the half-width: where a lateral vein leaves its course, and the outermost point of the
loop by which it joins the next one. In photographs of sweet pepper the loops are at 80 to 90 %."""

ISLET_MM, MESH_MM, VEINLET_MM = 10.0, 4.5, 1.8
"""Chosen: spacing of the cells that bulge, of the meshes of the tertiary veins (3 to 6 mm in photographs) and
of the finest veins."""

_FOOT: Final = 0.012  # chosen: fraction of the length below which the blade narrows down to the petiole
_FINEST_TIP: Final = 2.2  # chosen: greatest power of the outline at the tip


def outline_reach(along: FloatArray, widest: FloatArray | float, base: FloatArray | float) -> FloatArray:
    """Half-width of a blade without lobes, over the greatest: a beta curve, narrow at its foot.

    It is 0 at both ends and 1 at `widest`, less what the foot takes.

    Args:
        along: fraction of the length, 0 at the base and 1 at the tip. All arguments broadcast.
        widest: position where it is widest.
        base: power of the outline at the base; limited, because a great power makes the tip a thread.
    """
    base = np.minimum(base, _FINEST_TIP * widest / (1.0 - widest))
    tip = base * (1.0 - widest) / widest
    body = (along / widest) ** base * ((1.0 - along) / (1.0 - widest)) ** tip
    return np.asarray(body * -np.expm1(-along / _FOOT))


@dataclass(frozen=True, eq=False)
class BladeGrid:
    """Square pixels over the uv of a blade: row 0 is the base, column 0 the left edge."""

    size_mm: tuple[float, float]  # width and length of the blade
    pixel_mm: float
    x_mm: Float32Array  # `(1, w)` from the midrib, positive to the right
    y_mm: Float32Array  # `(h, 1)` from the base
    half_mm: Float32Array  # `(h, 1)` half-width of the blade
    edge_mm: Float32Array  # `(h, w)` distance from the margin, negative outside
    palmate: bool = False  # whether the lowest lateral veins are main veins

    @classmethod
    def build(
        cls,
        size_mm: tuple[float, float],
        widest: float = 0.37,
        base: float = 0.85,
        pixels: int = PIXELS,
        palmate: bool = False,
    ) -> BladeGrid:
        """Lay out the pixels of a blade of this width and length, and its mean outline (see `outline_reach`).

        `pixels` are those of the longer side; in a palmate blade the lowest lateral veins are main veins.
        """
        pixel_mm = max(size_mm) / pixels
        columns, rows = (max(round(extent / pixel_mm), 2) for extent in size_mm)
        x = ((np.arange(columns) + 0.5) / columns - 0.5)[None, :] * size_mm[0]
        along = (np.arange(rows) + 0.5) / rows
        half = 0.5 * size_mm[0] * outline_reach(along, widest, base)
        # To first order, the distance from the curve x = half(y).
        steepness = np.hypot(1.0, np.gradient(half, along * size_mm[1]))
        edge = (half[:, None] - np.abs(x)) / steepness[:, None]
        arrays = (x, along[:, None] * size_mm[1], half[:, None], edge)
        x_mm, y_mm, half_mm, edge_mm = (array.astype(np.float32) for array in arrays)
        return cls(size_mm, pixel_mm, x_mm, y_mm, half_mm, edge_mm, palmate)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.edge_mm.shape[0], self.edge_mm.shape[1]

    @property
    def height(self) -> Float32Array:
        """`(h, 1)` from base 0 to tip 1."""
        return self.y_mm / np.float32(self.size_mm[1])


@dataclass(frozen=True, eq=False)
class FieldTile:
    """Isotropic periodic fields in the pixels of a grid, of which every texture of a leaf takes crops.

    A field is made once: two crops of it are independent, up to chance overlaps that no one sees.
    """

    noise: dict[float, PeriodicField]  # by standard deviation of the filter, mm
    islets: PeriodicField  # of the cells that bulge, mm; two distances as from `random_cells`
    meshes: PeriodicField  # likewise of the meshes of the tertiary veins
    veinlets: PeriodicField  # likewise of the finest veins

    @classmethod
    def build(cls, grid: BladeGrid, sigmas_mm: tuple[float, ...], rng: np.random.Generator) -> FieldTile:
        """Make the fields on a square that is as large as the longer side of the grid."""
        pixels, pixel_mm = max(grid.shape), grid.pixel_mm

        def noise(sigma_mm: float) -> PeriodicField:
            field = smooth_noise(rng, (pixels, pixels), (sigma_mm / pixel_mm,) * 2)
            return PeriodicField(field.astype(np.float32))

        def cells(spacing_mm: float) -> PeriodicField:
            # Meshes of fewer than four pixels would alias.
            spacing = max(spacing_mm / pixel_mm, 4.0)
            return PeriodicField(np.float32(pixel_mm) * random_cells(rng, pixels, spacing))

        networks = [cells(spacing) for spacing in (ISLET_MM, MESH_MM, VEINLET_MM)]
        return cls({sigma: noise(sigma) for sigma in sigmas_mm}, *networks)


@dataclass(frozen=True, eq=False)
class Venation:
    """Veins of one texture; all arrays `(h, w)`, distances in millimetres."""

    midrib_mm: Float32Array  # distance from the midrib
    lateral_mm: Float32Array  # distance from the nearest lateral vein or loop
    main_mm: Float32Array | None  # distance from the main veins beside the midrib; None if there are none
    out: Float32Array  # distance from the midrib as a fraction of the half-width there, at most 1
    bulge_mm: Float32Array  # distance from the centre of the nearest bulging cell
    islet_mm: Float32Array  # distance from the walls of these cells
    mesh_mm: Float32Array  # distance from the tertiary veins
    veinlet_mm: Float32Array  # distance from the finest veins


RIPPLE_MM: Final = 8.0
"""Chosen: standard deviation of the filter of the displacements of veins."""


def grow_veins(grid: BladeGrid, tile: FieldTile, rng: np.random.Generator) -> Venation:
    """Draw the veins of one texture of a blade.

    A lateral vein that leaves the midrib at y = s L runs along y = s L + c(s) |x| + b(|x|), with the
    cotangent c of its angle to the midrib linear in s and b increasing with the cube of |x|. So every point
    has one s, in closed form, and is on a vein where s is the origin of one. Blades of other shapes stretch
    the same layout, so that meshes of any blade can compute from uv where its veins are. Beyond
    `LOOP_START` of the half-width each vein bends to the next one and joins it (brochidodromous venation).
    """
    width, length = grid.size_mm
    ripple = tile.noise[RIPPLE_MM]
    # Displace the veins by some tenths of a millimetre over a centimetre, and bend the midrib.
    x = grid.x_mm + _midrib_bend(grid, rng.spawn(1)[0]) + np.float32(0.35) * ripple.crop(rng, grid.shape)
    y = grid.y_mm + np.float32(0.7) * ripple.crop(rng, grid.shape)

    # Solve for the origin of the vein through each point, as a fraction of the length of the layout's blade.
    midrib_mm = np.abs(x)
    reach = midrib_mm * np.float32(2.0 / width)
    half, cot_change = np.float32(0.5 * VEIN_ASPECT) * reach, np.float32(VEIN_COT_TIP - VEIN_COT_BASE)
    stretch = 1 + cot_change * half
    arc = np.float32(VEIN_ARC * VEIN_ASPECT / 6.0) * (reach * reach * reach)
    origin = (y * np.float32(1.0 / length) - np.float32(VEIN_COT_BASE) * half - arc) / stretch
    # |grad| of `origin`, per millimetre of this blade.
    bend = np.float32(VEIN_COT_BASE) + cot_change * origin + np.float32(VEIN_ARC) * (reach * reach)
    slope = np.sqrt((bend * np.float32(VEIN_ASPECT / width)) ** 2 + np.float32(1.0 / length**2)) / stretch

    # Number of the vein through each point. Each side has its own veins: they are opposite only by chance.
    middle = grid.shape[1] // 2
    sides = [origin[:, :middle], origin[:, middle:]]
    number, spacing = (
        np.concatenate(parts, axis=1)
        for parts in zip(*(_number_veins(side, _draw_origins(rng)) for side in sides), strict=True)
    )
    part = number - np.floor(number)
    per_mm = slope / spacing  # veins per millimetre across them
    beside_mm = np.minimum(part, 1 - part) / per_mm
    beside_mm[(number < -0.5) | (number > VEIN_PAIRS - 0.5)] = length

    # Main veins run on to the margin.
    main_mm = np.where(np.round(number) < PALMATE_PAIRS, beside_mm, length) if grid.palmate else None

    # Distance from the loops, whose distance from the midrib is a function of the vein's number.
    half_mm = np.maximum(grid.half_mm, np.float32(1.0))
    out = midrib_mm / half_mm
    # A parabola of the root of the vein's fraction: steep where a vein bends, flat where it joins the next.
    rise, root = np.float32(LOOP_TOP - LOOP_START), np.sqrt(part)
    level = LOOP_START + 4 * rise * root * (1 - root)
    tilt = np.minimum(2 * rise * np.abs(1 / np.maximum(root, np.float32(0.05)) - 2), np.float32(0.5)) * per_mm
    loop_mm = np.abs(out - level) / np.sqrt(tilt * tilt + 1 / (half_mm * half_mm))
    loop_mm[number < 0.0] = length
    beyond_mm = np.maximum(out - np.float32(LOOP_START), 0) * half_mm
    lateral_mm = np.minimum(np.sqrt(beside_mm * beside_mm + beyond_mm * beyond_mm), loop_mm)

    bulge_mm, islet_mm = np.moveaxis(tile.islets.crop(rng, grid.shape), -1, 0)
    mesh_mm, veinlet_mm = (part.crop(rng, grid.shape)[..., 1] for part in (tile.meshes, tile.veinlets))
    return Venation(
        midrib_mm,
        lateral_mm,
        main_mm,
        np.minimum(out, 1),
        bulge_mm.copy(),
        islet_mm.copy(),
        mesh_mm,
        veinlet_mm,
    )


def _midrib_bend(grid: BladeGrid, rng: np.random.Generator) -> Float32Array:
    """Distance `(h, 1)` in mm of the midrib from the middle of the blade; 0 at base and tip.

    A bow and an S, each scaled to the width. Chosen: their amplitudes have standard deviations of 1.6 and
    1.1 mm on a blade of 112 mm, some widths of the midrib, yet unseen against the fold of the mesh.
    """
    amplitudes = rng.normal(0.0, (0.0143, 0.0098)) * grid.size_mm[0]
    bend = sum(a * np.sin((k + 1) * np.pi * grid.height) for k, a in enumerate(amplitudes))
    return np.asarray(bend, np.float32)


def _draw_origins(rng: np.random.Generator) -> FloatArray:
    """Origins of one side's lateral veins, as fractions of the midrib; closer to each other at the base."""
    even = (
        np.arange(VEIN_PAIRS) + rng.uniform(-0.12, 0.12, VEIN_PAIRS) + rng.uniform(0.15, 0.5)
    ) / VEIN_PAIRS
    return np.asarray(0.02 + 0.85 * even**1.15)


def _number_veins(origin: Float32Array, origins: FloatArray) -> tuple[Float32Array, Float32Array]:
    """Number of the vein through points, linear between veins, and the distance between their origins."""
    # Chosen: beyond the last vein distances go on, so that none starts at the tip; likewise below the first.
    ends = (2.0 * origins[0] - origins[1], 2.0 * origins[-1] - origins[-2])
    known = np.concatenate([ends[:1], origins, ends[1:]])
    number = np.interp(origin, known, np.arange(-1.0, len(origins) + 1.0)).astype(np.float32)
    index = np.clip(np.floor(number).astype(np.intp) + 1, 0, len(known) - 2)
    return number, np.diff(known).astype(np.float32)[index]

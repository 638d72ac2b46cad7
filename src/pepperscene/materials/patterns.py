"""Patterns of surfaces: smooth random fields, cell networks and the veins of leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.spectra.spectrum import FloatArray


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], sigma: tuple[float, float]) -> FloatArray:
    """White noise under a Gaussian filter, `(h, w)`, mean 0, variance 1, periodic in both directions.

    Args:
        rng: source of the white noise.
        shape: rows and columns.
        sigma: standard deviation of the filter, in rows and in columns.
    """
    # A Gaussian of width sigma has the transfer function exp(-2 (pi f sigma)^2).
    along_rows = np.exp(-2.0 * (np.pi * np.fft.fftfreq(shape[0]) * sigma[0]) ** 2)
    along_columns = np.exp(-2.0 * (np.pi * np.fft.rfftfreq(shape[1]) * sigma[1]) ** 2)
    transfer = along_rows[:, None] * along_columns[None, :]
    transfer[0, 0] = 0.0
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * transfer, s=shape)
    return np.asarray(field / field.std())


def noise_mm(
    rng: np.random.Generator,
    shape: tuple[int, int],
    size_mm: tuple[float, float],
    sigma_mm: tuple[float, float],
) -> FloatArray:
    """Smooth noise over uv with its grain in millimetres.

    Args:
        rng: source of the white noise.
        shape: rows (along v) and columns (along u).
        size_mm: extent of u and of v.
        sigma_mm: standard deviation of the filter along u and along v.
    """
    rows, columns = shape
    return smooth_noise(rng, shape, (sigma_mm[1] / size_mm[1] * rows, sigma_mm[0] / size_mm[0] * columns))


def cell_walls(rng: np.random.Generator, points: FloatArray, spacing: float) -> FloatArray:
    """Measure of distance from the walls of random cells: 0 on a wall, increasing inwards, `(...)`.

    The cells are Voronoi cells of a jittered triangular grid; the measure is the difference between the
    distances to the second nearest and the nearest centre (Worley 1996, SIGGRAPH: F2 - F1).

    Args:
        rng: jitters the centres.
        points: `(..., 2)` positions.
        spacing: mean distance between centres, in the unit of `points`.
    """
    from scipy.spatial import cKDTree

    low, high = points.reshape(-1, 2).min(axis=0) - spacing, points.reshape(-1, 2).max(axis=0) + spacing
    rows = np.arange(low[1], high[1] + spacing, spacing * np.sqrt(3) / 2)
    columns = np.arange(low[0], high[0] + spacing, spacing)
    x, y = np.meshgrid(columns, rows)
    x = x + (np.arange(rows.size) % 2)[:, None] * spacing / 2
    centres = np.stack([x.ravel(), y.ravel()], axis=-1)
    # A jitter of a quarter of the spacing hides the grid without making slivers: chosen.
    centres += rng.normal(0.0, 0.25 * spacing, centres.shape)
    distance, _ = cKDTree(centres).query(points, k=2, workers=-1)
    return np.asarray(distance[..., 1] - distance[..., 0])


# Chosen: the layout of the veins of a leaf, and the resolution at which it is drawn.
PIXELS: Final = 512
VEIN_PAIRS: Final = 7
VEIN_COT_BASE: Final = 1.0 / np.tan(np.radians(60.0))  # of the angles of secondary veins to the midrib
VEIN_COT_TIP: Final = 1.0 / np.tan(np.radians(45.0))
VEIN_ASPECT: Final = 112.0 / 135.0
"""Width over length of the blade that the vein layout is defined for; other blades stretch it, as uv is."""
VEIN_ARC: Final = 0.7
"""Bend of a secondary vein towards the tip, at the margin of the widest part, as a slope."""


@dataclass(frozen=True, eq=False)
class Venation:
    """Veins of a flat blade, on a grid over uv (row 0 is the base, column 0 the left edge)."""

    size_mm: tuple[float, float]  # width and length of the blade
    midrib_mm: FloatArray  # `(h, w)` distance from the midrib
    secondary_mm: FloatArray  # `(h, w)` distance from the nearest secondary vein
    reach: FloatArray  # `(h, w)` distance from the midrib as a fraction of half the width, at most 1
    height: FloatArray  # `(h, w)` from base 0 to tip 1
    tertiary_mm: FloatArray  # `(h, w)` measure of distance from the network between them, 0 on a vein
    veinlet_mm: FloatArray  # `(h, w)` likewise for the finest veins


def grow_veins(size_mm: tuple[float, float], rng: np.random.Generator, pixels: int = PIXELS) -> Venation:
    """Lay out the veins of a blade of this width and length.

    A secondary vein that leaves the midrib at y = s L runs along y = s L + c(s) |x| + b(|x|), with the
    cotangent c of its angle to the midrib linear in s and b increasing with the cube of |x|. So every point
    has one s, in closed form, and is on a vein where s is the origin of one. Blades of other shapes stretch
    the same layout, so that meshes of any blade can compute from uv where its veins are.
    """
    width, length = size_mm
    middle = (np.arange(pixels) + 0.5) / pixels
    x, y = np.meshgrid((middle - 0.5) * width, middle * length)

    # Displace the veins by some tenths of a millimetre over a centimetre.
    ripple = (10.0 / length * pixels, 10.0 / width * pixels)
    x = x + 0.35 * smooth_noise(rng, x.shape, ripple)
    y = y + 0.6 * smooth_noise(rng, x.shape, ripple)

    # Solve for the origin of the vein through each point, as a fraction of the length of the layout's blade.
    midrib_mm = np.abs(x)
    reach = 2.0 * midrib_mm / width
    half, cot_change = 0.5 * VEIN_ASPECT * reach, VEIN_COT_TIP - VEIN_COT_BASE
    stretch = 1.0 + cot_change * half
    origin = (y / length - VEIN_COT_BASE * half - VEIN_ARC * VEIN_ASPECT / 6.0 * reach**3) / stretch
    # |grad| of `origin`, times `stretch`, per millimetre of this blade.
    slope = np.hypot(
        1.0 / length, (VEIN_COT_BASE + cot_change * origin + VEIN_ARC * reach**2) * VEIN_ASPECT / width
    )

    # Each side has its own veins: they are opposite only by chance.
    secondary_mm = np.full(x.shape, np.inf)
    for side in (x < 0, x >= 0):
        nearest = np.abs(origin[side][:, None] - _draw_origins(rng)).min(axis=1)
        secondary_mm[side] = nearest * (stretch / slope)[side]

    # Cells of the network are elongated across, from one secondary vein to the next.
    points = np.stack([x, 0.8 * y], axis=-1)
    return Venation(
        size_mm, midrib_mm, secondary_mm, np.minimum(reach, 1.0), np.clip(y / length, 0.0, 1.0),
        cell_walls(rng, points, 5.5), cell_walls(rng, points, 2.0),
    )  # fmt: skip


def _draw_origins(rng: np.random.Generator) -> FloatArray:
    """Origins of one side's secondary veins, as fractions of the midrib; closer to each other at the base."""
    even = (
        np.arange(VEIN_PAIRS) + rng.uniform(-0.12, 0.12, VEIN_PAIRS) + rng.uniform(0.15, 0.5)
    ) / VEIN_PAIRS
    return 0.02 + 0.85 * even**1.15


def vein_pattern(veins: Venation, rng: np.random.Generator) -> NDArray[np.float32]:
    """State offset over uv: veins are paler (down to -0.75, on the midrib), the blade between is mottled.

    An offset to the state moves along the pigments' path, so a vein's colour has its own spectrum.
    """
    # Veins become thinner towards the margin, and those near the tip are thinner from their origin.
    taper = (1.0 - 0.75 * veins.reach) * (1.0 - 0.8 * veins.height**2)
    parts = (
        0.75 * _ridge(veins.midrib_mm, 0.4 + 1.0 * (1.0 - veins.height) ** 0.7),
        0.48 * taper * _ridge(veins.secondary_mm, 0.25 + 0.4 * taper),
        # Tissue near the larger veins is somewhat paler than that further away.
        0.14 * taper * _ridge(veins.secondary_mm, 2.2),
        0.12 * _ridge(veins.tertiary_mm, 0.5),
        0.06 * _ridge(veins.veinlet_mm, 0.35),
    )
    paler = np.maximum.reduce(parts)
    mottle = 0.035 * _isotropic_noise(veins, rng, 1.2) + 0.035 * _isotropic_noise(veins, rng, 8.0)
    return (mottle - paler).astype(np.float32)


def vein_relief(veins: Venation, rng: np.random.Generator) -> NDArray[np.float32]:
    """Height in mm over uv: veins are in furrows on the upper side, the blade bulges between them."""
    panels = 0.55 * _dome(veins.secondary_mm, 4.0) * _dome(veins.midrib_mm, 4.0)
    blisters = 0.10 * _dome(veins.tertiary_mm, 1.5)
    furrow = 0.30 * _ridge(veins.midrib_mm, 1.6)
    rough = 0.10 * _isotropic_noise(veins, rng, 4.0) + 0.008 * _isotropic_noise(veins, rng, 0.8)
    return (panels + blisters - furrow + rough).astype(np.float32)


def _ridge(distance: FloatArray, half_width: FloatArray | float) -> FloatArray:
    """1 on a vein, falling to 1/e at half its width."""
    return np.exp(-((distance / half_width) ** 2))


def _dome(distance: FloatArray, scale: float) -> FloatArray:
    """0 on a vein, rising to 1 over `scale`; rounded at 0, to avoid a sharp crease."""
    bottom = 0.15 * scale
    return 1.0 - np.exp(-(np.hypot(distance, bottom) - bottom) / scale)


def _isotropic_noise(veins: Venation, rng: np.random.Generator, sigma_mm: float) -> FloatArray:
    return noise_mm(rng, veins.midrib_mm.shape, veins.size_mm, (sigma_mm, sigma_mm))

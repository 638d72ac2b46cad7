"""Smooth random fields and cell networks, of which surface patterns are made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], sigma: tuple[float, float]) -> Field:
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
) -> Field:
    """Smooth noise over uv whose grain is told in millimetres.

    Args:
        rng: source of the white noise.
        shape: rows (along v) and columns (along u).
        size_mm: extent of u and of v.
        sigma_mm: standard deviation of the filter along u and along v.
    """
    rows, columns = shape
    return smooth_noise(rng, shape, (sigma_mm[1] / size_mm[1] * rows, sigma_mm[0] / size_mm[0] * columns))


def cell_walls(rng: np.random.Generator, points: Field, spacing: float) -> Field:
    """How far points lie from the walls of random cells: 0 on a wall, growing to the inside, `(...)`.

    The cells are those of Voronoi around a jittered triangular grid; the measure is the difference between
    the distances to the second nearest and the nearest centre (Worley 1996, SIGGRAPH: F2 - F1).

    Args:
        rng: jitters the centres.
        points: `(..., 2)` places.
        spacing: mean distance between centres, in the unit of `points`.
    """
    from scipy.spatial import cKDTree

    low, high = points.reshape(-1, 2).min(axis=0) - spacing, points.reshape(-1, 2).max(axis=0) + spacing
    rows = np.arange(low[1], high[1] + spacing, spacing * np.sqrt(3) / 2)
    columns = np.arange(low[0], high[0] + spacing, spacing)
    x, y = np.meshgrid(columns, rows)
    x = x + (np.arange(rows.size) % 2)[:, None] * spacing / 2
    centres = np.stack([x.ravel(), y.ravel()], axis=-1)
    # A jitter of a quarter of the spacing breaks the grid and leaves no slivers: chosen by eye.
    centres += rng.normal(0.0, 0.25 * spacing, centres.shape)
    distance, _ = cKDTree(centres).query(points, k=2, workers=-1)
    return np.asarray(distance[..., 1] - distance[..., 0])

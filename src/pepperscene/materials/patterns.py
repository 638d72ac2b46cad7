"""Random fields of surfaces: smooth noise, cell networks and scattered discs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.spectra.spectrum import FloatArray

Float32Array = NDArray[np.float32]

_JITTER: Final = 0.32
"""Chosen: largest displacement of a cell's centre, in spacings. It hides the grid, and keeps the two nearest
centres within the rows and columns that `random_cells` searches."""


def named_generator(seed: int, name: str) -> np.random.Generator:
    """Generator that depends on a seed and a name alone."""
    words = np.frombuffer(sha256(name.encode()).digest(), dtype="<u4").tolist()
    return np.random.default_rng([seed, *words])


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], sigma: tuple[float, float]) -> FloatArray:
    """White noise under a Gaussian filter, `(h, w)`, mean 0, variance 1, periodic in both directions.

    It is 0 everywhere if the filter is so wide that nothing is left. `sigma` is the standard deviation of the
    filter, in rows and in columns.
    """
    # A Gaussian of width sigma has the transfer function exp(-2 (pi f sigma)^2).
    along_rows = np.exp(-2.0 * (np.pi * np.fft.fftfreq(shape[0]) * sigma[0]) ** 2)
    along_columns = np.exp(-2.0 * (np.pi * np.fft.rfftfreq(shape[1]) * sigma[1]) ** 2)
    transfer = along_rows[:, None] * along_columns[None, :]
    transfer[0, 0] = 0.0
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * transfer, s=shape)
    spread = field.std()
    return np.asarray(field / spread if spread > 0.0 else field)


def noise_mm(
    rng: np.random.Generator,
    shape: tuple[int, int],
    size_mm: tuple[float, float],
    sigma_mm: tuple[float, float],
) -> FloatArray:
    """Smooth noise over uv, rows along v and columns along u, with its grain in millimetres.

    `size_mm` is the extent, `sigma_mm` the standard deviation of the filter, along u and along v.
    """
    rows, columns = shape
    return smooth_noise(rng, shape, (sigma_mm[1] / size_mm[1] * rows, sigma_mm[0] / size_mm[0] * columns))


def random_cells(rng: np.random.Generator, pixels: int, spacing: float) -> Float32Array:
    """Distances in random cells, `(n, n, 2)` in pixels, periodic: from the centre, and from the wall.

    The cells are Voronoi cells of a jittered triangular grid. The distance from the wall is approximated by
    half the difference between the distances to the second nearest and the nearest centre (Worley 1996,
    SIGGRAPH: F2 - F1), which is exact on the line between the two. `spacing` is the distance between centres
    before the jitter, in pixels; it is adjusted to fit the period.
    """
    columns = max(round(pixels / spacing), 3)
    rows = 2 * max(round(pixels / (spacing * np.sqrt(3.0))), 2)  # even, since odd rows are shifted
    step_x, step_y = pixels / columns, pixels / rows
    jitter = rng.uniform(-_JITTER, _JITTER, (2, rows, columns)) * min(step_x, step_y)
    # Centres with their images beyond the edges of the period.
    row, column = np.arange(-1, rows + 1)[:, None], np.arange(-2, columns + 2)
    x = step_x * (column + 0.5 * (row % 2)) + jitter[0, row % rows, column % columns]
    y = step_y * (row + 0.5) + jitter[1, row % rows, column % columns]
    x, y = x.astype(np.float32).ravel(), y.astype(np.float32).ravel()

    at = np.arange(pixels, dtype=np.float32) + np.float32(0.5)
    own_row = np.floor(at / step_y).astype(np.intp)[:, None]
    nearest = np.full((pixels, pixels), np.inf, np.float32)
    second = nearest.copy()
    for row_step in (-1, 0, 1):
        shift = 0.5 * ((own_row + row_step) % 2)
        first = (own_row + row_step + 1) * column.size + np.floor(at / step_x - shift).astype(np.intp) + 2
        for column_step in (-1, 0, 1, 2):
            centre = first + column_step
            squared = (at - x[centre]) ** 2 + (at[:, None] - y[centre]) ** 2
            second = np.minimum(second, np.maximum(nearest, squared))
            nearest = np.minimum(nearest, squared)
    nearest, second = np.sqrt(nearest), np.sqrt(second)
    return np.stack([nearest, 0.5 * (second - nearest)], axis=-1)


def scatter_discs(
    rng: np.random.Generator, pixels: int, pixel_mm: float, per_cm2: float, radius_mm: tuple[float, float]
) -> FloatArray:
    """`(k, 5)` discs for `stamp_discs` at random places of a square field, from least to greatest radius."""
    count = round(per_cm2 * (0.1 * pixels * pixel_mm) ** 2)
    low, high = (radius / pixel_mm for radius in radius_mm)
    # Small ones are more frequent: uniform in the logarithm.
    radii = low * (high / low) ** rng.random(count)
    return np.stack([*rng.uniform(0.0, pixels, (2, count)), radii, *rng.random((2, count))], axis=1)


def stamp_discs(
    field: Float32Array,
    discs: FloatArray,
    extent: float,
    profile: Callable[[FloatArray, float], FloatArray],
    combine: np.ufunc,
) -> None:
    """Write uneven discs into a periodic field `(n, n)`, in place.

    Args:
        field: changed where discs are.
        discs: `(k, 5)` column and row of the centre, mean radius in pixels, and two numbers from 0 to 1: one
            for `profile`, one for the shape.
        extent: of a disc's influence, in radii.
        profile: (distance from the centre in radii, the disc's first number) -> values.
        combine: of the field and the values, such as `np.minimum`.
    """
    n = len(field)
    for x, y, radius, number, shape in discs:
        reach = int(np.ceil(1.3 * extent * radius))
        rows, columns = (int(c) + np.arange(-reach, reach + 1) for c in (y, x))
        dx, dy = columns - x, (rows - y)[:, None]
        # Chosen: elliptic by up to a fifth, and with three uneven corners.
        angle = np.arctan2(dy, dx)
        turn = 2.0 * np.pi * shape
        uneven = 1.0 + 0.2 * np.cos(2.0 * angle + 5.0 * turn) * shape + 0.1 * np.cos(3.0 * angle + turn)
        part = np.ix_(rows % n, columns % n)
        values = profile(np.hypot(dx, dy) / (radius * uneven), float(number))
        field[part] = combine(field[part], values.astype(np.float32))


@dataclass(frozen=True, eq=False)
class PeriodicField:
    """An isotropic field on a periodic square, of which many crops are taken."""

    values: Float32Array  # `(n, n)`, or `(n, n, c)` for c fields that are cropped together

    def crop(self, rng: np.random.Generator, shape: tuple[int, int]) -> Float32Array:
        """Part `(h, w, ...)` at a random position and in one of eight orientations; h and w at most n."""
        turns, mirrored, top, left = (int(rng.integers(k)) for k in (4, 2, *self.values.shape[:2]))
        turned = np.rot90(self.values[:, ::-1] if mirrored else self.values, turns)
        rows = (top + np.arange(shape[0])) % turned.shape[0]
        columns = (left + np.arange(shape[1])) % turned.shape[1]
        return np.asarray(turned[rows[:, None], columns])

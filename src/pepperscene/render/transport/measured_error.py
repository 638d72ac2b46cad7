"""The error of an image whose indirect light is gathered and denoised, measured in some of its pixels.

What the denoiser leaves of noise, and what it loses of the light, depends on the image. So some pixels get
four or eight further means of samples, independent of the image and of each other, that no filter has
changed. They have no error but noise, so the product of two of their differences to the image has the mean
of the squared error. Stray light averages the errors of neighbours, which are alike: the differences are
taken in pixels near each other, drawn as the point spread brings their light to the pixel that is tested.
The light of these means is gathered from cells with half of the frame's paths. The noise of such a cell has
twice the variance, half of it in common with the image's cell; so their difference has the variance of the
noise of the image's cells, which counts like any other error. A bias that both have is not seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, electrons_per_light, near_point_spread
from pepperscene.camera.image.expected_image import expected_image

Image = NDArray[np.float32]

_GRID: Final = 48
"""Pixels along each side of the grid that is tested. Chosen: a few pixels have much of the squared error, so
that with 32 the result varies by 20 % with their choice."""
_LEAST_SAMPLES: Final = 16
_TESTS_PER_SOFT: Final = 2
"""Samples of each mean: the least number, and those for each sample of indirect light. Chosen: with two
means of twice as many, which take as long, a product has 1.5 times the variance by noise. Four take .4 s of
CPU time for a draft and .7 s for `standard`."""
_MEANS: Final = (4, 8)
_MOST_SPREAD: Final = 0.2
"""Standard error of the squared error over itself, from which on all means are taken. Chosen: of the error it
is half of that. Over five seeds the error of frame 110 of `randomised` varies by 7 to 8 %
instead of 32 to 38 % with two means, and that of frame 0 of `greenhouse` by 4 to 7 % (400x300 pixels)."""
_GOLDEN_RATIO: Final = 0.618034
_STEP: Final = 0.125
"""Of a difference. Chosen: small beside the light, large beside the steps of a table of tones."""
_REACH: Final = 8  # pixels; chosen: light that is scattered further is taken as even


def samples_of_mean(soft: int) -> int:
    """Samples of each mean for an image with so many samples of indirect light in each pixel."""
    return max(_LEAST_SAMPLES, _TESTS_PER_SOFT * soft)


def measured_error(
    camera: Camera, signal: Image, independent: Callable[[NDArray[np.int64], int], Image]
) -> float | None:
    """Root mean square error of an image's light, codes; None if the means are too noisy to tell it.

    Args:
        camera: that takes the image.
        signal: `(h, w, c)` its light, electrons s-1 m-2 sr-1.
        independent: from row-major indices of pixels and the number of a mean, 0 to 7, to `(n, c)` that mean.
    """
    rows, columns = _grid(camera)
    spread = near_point_spread(camera, _REACH)
    offsets, weights = np.indices(spread.shape).reshape(2, -1) - _REACH, spread.ravel()
    near = float(weights.sum())

    def around(offset: NDArray[np.int64]) -> NDArray[np.int64]:
        """Row-major indices of the pixels at offsets `(2, ...)` from those of the grid, within the image."""
        row = np.clip(rows + offset[0], 0, camera.height - 1)
        return np.asarray(row * camera.width + np.clip(columns + offset[1], 0, camera.width - 1))

    # The light of the grid's pixels with stray light.
    flat = signal.reshape(-1, signal.shape[-1])
    light = (1.0 - near) * flat.mean(axis=0, dtype=float)
    for weight, offset in zip(weights.tolist(), offsets.T, strict=True):
        if weight > 0.0:
            light = light + weight * flat[around(offset)]
    noiseless = replace(camera.developing, shot_noise=False, read_noise=False, quantise=False)
    of_light = replace(camera, developing=noiseless)
    electrons = _electrons_per_light(camera, rows, columns)[:, None]

    def in_codes(difference: Image) -> NDArray[np.floating]:
        """A difference of light, linear: the concave tone curve would make codes of noise too low."""
        above, below = (
            expected_image(((light + step * difference) * electrons)[None], of_light)
            for step in (_STEP, -_STEP)
        )
        return 255.0 / (2.0 * _STEP) * (above - below)

    rng = np.random.default_rng(0)
    differences: list[NDArray[np.floating]] = []
    for count in _MEANS:
        for number in range(len(differences), count):
            pixels = around(offsets[:, rng.choice(weights.size, rows.size, p=weights / near)])
            differences.append(in_codes(near * (independent(pixels, number) - flat[pixels])))
        # Mean of the products of all pairs, in each pixel and colour.
        products = np.square(sum(differences)) - sum(map(np.square, differences))
        squares = np.mean(products, axis=-1, dtype=float) / (count * (count - 1))
        square = float(squares.mean())
        if squares.std() <= _MOST_SPREAD * square * math.sqrt(squares.size):
            break
    return math.sqrt(square) if square > 0.0 else None


def _grid(camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the pixels that are tested."""
    line = np.arange(_GRID)
    rows = ((line + 0.5) * (camera.height / _GRID)).astype(np.int64)
    # Each row begins at another column.
    start = (line * _GOLDEN_RATIO) % 1.0
    columns = ((line + start[:, None]) * (camera.width / _GRID)).astype(np.int64)
    return np.repeat(rows, _GRID), columns.ravel()


def _electrons_per_light(
    camera: Camera, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Those of the pixels of `_grid`."""
    lines = (electrons_per_light(camera, slice(row, row + 1))[0] for row in rows[::_GRID].tolist())
    return np.concatenate([line[at] for line, at in zip(lines, columns.reshape(_GRID, -1), strict=True)])

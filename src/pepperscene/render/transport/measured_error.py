"""The error of an image whose indirect light is gathered and denoised, measured in some of its pixels.

What the denoiser leaves of noise, and what it loses of the light, depends on the image. So some pixels get
two further means of samples, independent of the image and of each other, that no filter has changed. They
have no error but noise, so the product of their differences to the image has the mean of the squared error.
The noise of the cells that the light is gathered from is in all three, and is not seen: some per cent.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, electrons_per_light, stray_light_factor
from pepperscene.camera.image.expected_image import expected_image

Image = NDArray[np.float32]

_GRID: Final = 32
_LEAST_SAMPLES: Final = 32
"""Pixels along each side of the grid that is tested, and the least number of samples of each mean. Chosen:
they take .3 s of CPU time. In three frames of `greenhouse`, 800x600, as drafts and in standard quality, the
result is .84 to 1.01 of the true error."""
_TESTS_PER_SOFT: Final = 4  # chosen: the noise of the result then falls as fast as the error
_GOLDEN_RATIO: Final = 0.618034


def samples_of_mean(soft: int) -> int:
    """Samples of each mean for an image with so many samples of indirect light in each pixel."""
    return max(_LEAST_SAMPLES, _TESTS_PER_SOFT * soft)


def measured_error(
    camera: Camera, signal: Image, independent: Callable[[NDArray[np.int64], int], Image]
) -> float | None:
    """Root mean square error of an image's light, codes; None if the means are too noisy to tell it.

    Stray light averages the errors of neighbours, which are taken to be independent.

    Args:
        camera: that takes the image.
        signal: `(h, w, c)` its light, electrons s-1 m-2 sr-1.
        independent: from row-major indices of pixels and the number of a mean, 0 or 1, to `(n, c)` that mean.
    """
    line = np.arange(_GRID)
    rows = ((line + 0.5) * (camera.height / _GRID)).astype(np.int64)
    # Each row begins at another column.
    start = (line * _GOLDEN_RATIO) % 1.0
    columns = ((line + start[:, None]) * (camera.width / _GRID)).astype(np.int64)
    per_light = [
        electrons_per_light(camera, slice(row, row + 1))[0, across]
        for row, across in zip(rows.tolist(), columns, strict=True)
    ]
    pixels = (rows[:, None] * camera.width + columns).ravel()
    lights = signal.reshape(-1, signal.shape[-1])[pixels], independent(pixels, 0), independent(pixels, 1)
    electrons = np.concatenate(per_light)[:, None]
    noiseless = replace(camera.developing, shot_noise=False, read_noise=False, quantise=False)
    of_light = replace(camera, developing=noiseless)
    codes, first, second = (255.0 * expected_image((light * electrons)[None], of_light) for light in lights)
    square = float(np.mean((codes - first) * (codes - second), dtype=float))
    return math.sqrt(square) * stray_light_factor(camera) if square > 0.0 else None

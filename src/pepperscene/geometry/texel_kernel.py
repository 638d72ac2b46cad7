"""Compiled interpolation of values at the corners of triangles to the texels of images."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.compiled import compiled

_TOLERANCE: Final = 1e-9  # chosen: of barycentric coordinates


@compiled
def fill_texels(
    texels: NDArray[np.float64],
    number: NDArray[np.intp],
    corners: NDArray[np.float64],
    values: NDArray[np.float64],
) -> None:
    """Write values to images `(n, h, w)`, in place, linear over triangles.

    Texels next to a triangle that no triangle covers get the value of the nearest place of one.

    Args:
        texels: values of texels that are not near a triangle are left.
        number: `(f,)` image of each triangle.
        corners: `(f, 3, 2)` column and row of its corners; texel centres are at whole numbers.
        values: `(f, 3)` at its corners.
    """
    # 1 for texels next to triangles, 2 for those inside.
    written = np.zeros(texels.shape, np.uint8)
    height, width = texels.shape[1:]
    for face in range(len(number)):
        image, corner, value = number[face], corners[face], values[face]
        ax, ay = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1]
        bx, by = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1]
        area = ax * by - ay * bx
        if area == 0.0:
            continue
        left, right = int(np.floor(corner[:, 0].min())), int(np.ceil(corner[:, 0].max()))
        top, bottom = int(np.floor(corner[:, 1].min())), int(np.ceil(corner[:, 1].max()))
        for y in range(max(top, 0), min(bottom, height - 1) + 1):
            for x in range(max(left, 0), min(right, width - 1) + 1):
                px, py = x - corner[0, 0], y - corner[0, 1]
                second, third = (px * by - py * bx) / area, (ax * py - ay * px) / area
                first = 1.0 - second - third
                level = 2 if min(first, second, third) >= -_TOLERANCE else 1
                if level < written[image, y, x]:
                    continue
                first, second, third = (max(first, 0.0), max(second, 0.0), max(third, 0.0))
                total = first * value[0] + second * value[1] + third * value[2]
                texels[image, y, x] = total / (first + second + third)
                written[image, y, x] = level

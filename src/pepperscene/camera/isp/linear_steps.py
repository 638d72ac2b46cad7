"""Steps on linear colours: black level, lens shading, lateral chromatic aberration, saturation."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.isp.processor import ImageProcessor

Floats = NDArray[np.float32]

_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB, IEC 61966-2-1


def correct_shading(
    rgb: Floats, rows: slice, shape: tuple[int, int], isp: ImageProcessor, falloff: NDArray[np.float64]
) -> Floats:
    """camera_rgb `(n, w, c)` of some rows with the errors of black level and shading correction.

    Args:
        rgb: camera_rgb of these rows.
        rows: of the image.
        shape: rows and columns of the image.
        isp: the processor. The residual of its correction is a factor of 1 + s r^2; r is 1 in the corners.
        falloff: `(n, w)` of the lens, 1 on its axis.
    """
    rgb = rgb + np.float32(isp.black_level_error or 0.0)
    if isp.shading_correction:
        rgb *= (falloff**-isp.shading_correction).astype(np.float32)[..., None]
    red, blue = isp.shading_cast or (0.0, 0.0)
    residual = np.array([red, 0.0, blue] if rgb.shape[2] == 3 else [0.0]) + (isp.shading or 0.0)
    height, width = shape
    corner = (height**2 + width**2) / 4
    down = np.square(np.arange(rows.start, rows.stop)[:, None] + 0.5 - height / 2) / corner
    right = np.square(np.arange(width) + 0.5 - width / 2) / corner
    for channel in np.flatnonzero(residual):
        added = residual[channel]
        rgb[..., channel] *= (1.0 + added * down).astype(np.float32) + (added * right).astype(np.float32)
    return rgb


def displace_red_and_blue(rgb: Floats, isp: ImageProcessor) -> None:
    """Scale red and blue of camera_rgb `(h, w, 3)` about the centre, in place, by what is not corrected.

    A lens of lateral chromatic aberration has another focal length for each colour. Interpolation is linear.
    """
    height, width = rgb.shape[:2]
    remains = (1.0 - (isp.chromatic_correction or 0.0)) / (np.hypot(height, width) / 2)
    for channel, pixels in zip((0, 2), isp.chromatic_aberration_px or (0.0, 0.0), strict=True):
        if pixels * remains:
            scale = 1.0 + pixels * remains
            at = [(np.arange(n) + 0.5 - n / 2) / scale + n / 2 - 0.5 for n in (height, width)]
            rgb[..., channel] = resample(rgb[..., channel], at[0], at[1])


def resample(plane: Floats, rows: NDArray[np.float64], columns: NDArray[np.float64]) -> Floats:
    """`(len(rows), len(columns))` linearly interpolated values of a plane `(h, w)`; its edges are held.

    Twice as fast as `Image.resize` of Pillow, and three times as fast as `scipy.ndimage.affine_transform`.
    """
    first, second, weight = _neighbours(rows, plane.shape[0])
    down = plane[first]
    down += (plane[second] - down) * weight[:, None]
    first, second, weight = _neighbours(columns, plane.shape[1])
    right = down.take(first, axis=1)
    right += (down.take(second, axis=1) - right) * weight
    return right


def _neighbours(at: NDArray[np.float64], count: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    at = np.clip(at, 0, count - 1)
    first = np.floor(at).astype(np.intp)
    return first, np.minimum(first + 1, count - 1), (at - first).astype(np.float32)


def saturate(linear: Floats, factor: float | None) -> Floats:
    """Linear sRGB `(n, w, 3)` whose differences from its luminance are multiplied; grey stays grey."""
    if factor is None or factor == 1.0:
        return linear
    matrix = factor * np.eye(3) + (1.0 - factor) * _LUMINANCE
    return linear @ matrix.T.astype(np.float32)

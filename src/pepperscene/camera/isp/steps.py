"""Steps of image signal processors: on linear colours, and on codes and their neighbours.

Linear: black level, lens shading, lateral chromatic aberration, saturation. On codes: noise reduction, local
tone mapping, sharpening.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.isp.processor import ImageProcessor

Floats = NDArray[np.float32]

_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB, IEC 61966-2-1
_LUMA: Final = np.array([0.299, 0.587, 0.114], np.float32)  # of JPEG (ITU-T T.871)
_NOISE_RADIUS: Final = 2  # pixels of a window; chosen: a bilateral filter of cameras has 5 x 5
_BASE_SCALE: Final = 4  # chosen: the base layer is computed from means of 4 x 4 pixels
_BASE_RADIUS: Final = 1 / 16  # of the image's shorter side; chosen: a fruit, not a whole plant
_BASE_EDGE: Final = 0.1  # chosen: the base follows edges of more than 25 codes, so that they have no halos
SHARPENING_RADIUS: Final = 1.0  # chosen: the scale of a pixel


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


def apply_local_steps(codes: Floats, isp: ImageProcessor) -> Floats:
    """Codes `(h, w, c)` in [0, 1] after all steps that see neighbours; values can leave [0, 1].

    All act on luma, or on the differences of red and blue from it; grey stays grey.
    """
    luma = codes @ _LUMA if codes.shape[2] == 3 else codes[..., 0]
    changed = reduce_noise(luma, isp.luma_noise_reduction or 0.0)
    changed = map_locally(changed, isp.local_tone_mapping or 0.0, isp.local_contrast or 0.0)
    radius = isp.sharpening_radius_px or SHARPENING_RADIUS
    changed = sharpen(changed, isp.sharpening or 0.0, radius, isp.sharpening_threshold or 0.0)
    if codes.shape[2] == 1:
        return changed[..., None]
    if not isp.chroma_noise_reduction:
        return codes if changed is luma else codes + (changed - luma)[..., None]
    red, blue = (_smooth_chroma(codes[..., c] - luma, isp.chroma_noise_reduction) for c in (0, 2))
    green = (red * _LUMA[0] + blue * _LUMA[2]) / -_LUMA[1]
    return np.stack([changed + red, changed + green, changed + blue], axis=-1)


def guided_filter(plane: Floats, radius: int, edge: float) -> Floats:
    """`(h, w)` smoothed where values within the radius vary by less than about `edge`, and kept elsewhere.

    The filter of He, Sun and Tang (2013, IEEE Trans. Pattern Anal. Mach. Intell. 35:1397), guided by the
    image itself: edge-preserving as a bilateral filter is, with the bilateral filter's parameter sigma_r as
    `edge`. It takes 10 ms for 800 x 600 pixels, at any radius. The bilateral filter of scikit-image takes 77;
    that of OpenCV takes 3, but OpenCV is no dependency, and its results depend on the processor.
    """
    slope, offset = _guided_coefficients(plane, radius, edge)
    slope *= plane
    slope += offset
    return slope


def _guided_coefficients(plane: Floats, radius: int, edge: float) -> tuple[Floats, Floats]:
    """The mean linear model of the windows that see each pixel."""
    from scipy.ndimage import uniform_filter

    size = 2 * radius + 1
    mean = uniform_filter(plane, size)
    variance = uniform_filter(plane * plane, size)
    variance -= mean * mean
    np.maximum(variance, np.float32(0), out=variance)  # rounding
    slope = variance / (variance + np.float32(max(edge, 1e-4) ** 2))
    mean -= slope * mean
    return uniform_filter(slope, size), uniform_filter(mean, size)


def reduce_noise(luma: Floats, strength: float) -> Floats:
    """`(h, w)` luma smoothed within 5 x 5 pixels where it varies by less than about `strength`; 0 for off."""
    return guided_filter(luma, _NOISE_RADIUS, strength) if strength else luma


def _smooth_chroma(difference: Floats, strength: float) -> Floats:
    """The same for the difference of a colour from luma, at half the resolution."""
    half = _reduced(difference, 2)
    return _enlarged(reduce_noise(half, strength), difference.shape, 2)


def map_locally(luma: Floats, mapping: float, contrast: float) -> Floats:
    """`(h, w)` luma whose base layer is moved towards its mean, and whose details are amplified.

    The base B is moved by 3 B (1 - B) `mapping` of the way, which keeps black, white and the order of tones.
    Base and detail are those of a guided filter (Durand and Dorsey 2002, ACM Trans. Graph. 21:257, with a
    bilateral one), computed at a lower resolution (He and Sun 2015, arXiv:1505.00996).
    """
    if not (mapping or contrast):
        return luma
    radius = max(1, round(_BASE_RADIUS * min(luma.shape) / _BASE_SCALE))
    coefficients = _guided_coefficients(_reduced(luma, _BASE_SCALE), radius, _BASE_EDGE)
    slope, base = (_enlarged(part, luma.shape, _BASE_SCALE) for part in coefficients)
    slope *= luma
    base += slope
    mapped = luma + np.float32(contrast) * (luma - base)
    if mapping:
        mean = np.float32(base.mean(dtype=np.float64))
        mapped += np.float32(3 * mapping) * np.clip(base - base * base, 0, None) * (mean - base)
    return mapped


def sharpen(luma: Floats, amount: float, radius_px: float, threshold: float) -> Floats:
    """`(h, w)` luma plus `amount` times its difference from a Gaussian blur, less the threshold."""
    if not amount:
        return luma
    from scipy.ndimage import gaussian_filter

    mask = luma - gaussian_filter(luma, radius_px)
    if threshold:
        mask -= np.clip(mask, np.float32(-threshold), np.float32(threshold))
    mask *= np.float32(amount)
    mask += luma
    return mask


def _reduced(plane: Floats, scale: int) -> Floats:
    """Means of blocks of `scale` pixels each way; those at the right and lower edge may be smaller."""
    from PIL import Image

    return np.array(Image.fromarray(plane).reduce(scale))


def _enlarged(plane: Floats, shape: tuple[int, ...], scale: int) -> Floats:
    """The inverse of `_reduced` for smooth planes."""
    rows, columns = ((np.arange(count) + 0.5) / scale - 0.5 for count in shape)
    return resample(plane, rows, columns)

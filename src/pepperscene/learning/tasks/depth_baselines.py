"""Classical methods that fill the holes of measured depth, without learning."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import SetupError

DepthMap = NDArray[np.floating[Any]]
Colour = NDArray[np.uint8]

DepthMethod = Callable[[Colour, NDArray[np.float32]], DepthMap]
"""A method: from the photograph `(h, w, 3)`, sRGB, and the measured depth `(h, w)`, metres, nan in holes, to
the depth of all pixels `(h, w)`, metres. At least one pixel has a measured depth."""

_INPAINT_RADIUS_PX: Final = 5.0  # chosen: OpenCV's examples use 3 to 5

_SMALL_KERNEL_PX, _FILL_KERNEL_PX, _LARGE_KERNEL_PX = 5, 7, 31  # section III of Ku et al. 2018
_NEAREST_INVERTED: Final = 1.25
"""Inverted depths are this times the largest depth, minus the depth: the paper's 100 m over its 80 m."""

_GUIDE_RADIUS_PX: Final = 8  # chosen: a petiole's width at arm's length; doubled until holes are filled
_GUIDE_EPSILON: Final = 1e-3
"""Variance of the photograph, 0 to 1, below which it is treated as flat. Chosen: between the .01 and .0001
(.1 and .01 squared) of He et al."""


def nearest(_colour: Colour, sensor: NDArray[np.float32]) -> DepthMap:
    """The depth of the nearest measured pixel."""
    from scipy import ndimage

    rows, columns = ndimage.distance_transform_edt(
        ~np.isfinite(sensor), return_distances=False, return_indices=True
    )
    return np.asarray(sensor[rows, columns])


def navier_stokes(_colour: Colour, sensor: NDArray[np.float32]) -> DepthMap:
    """OpenCV's inpainting by Navier-Stokes equations.

    Bertalmio, Bertozzi & Sapiro 2001, "Navier-Stokes, fluid dynamics, and image and video inpainting", CVPR.
    OpenCV's other method, that of Telea, overshoots in images of real numbers.
    """
    cv2 = opencv()
    hole = ~np.isfinite(sensor)
    start = np.where(hole, 0.0, sensor).astype(np.float32)
    return np.asarray(cv2.inpaint(start, hole.astype(np.uint8), _INPAINT_RADIUS_PX, cv2.INPAINT_NS))


def ip_basic(_colour: Colour, sensor: NDArray[np.float32]) -> DepthMap:
    """Morphology on inverted depth: near surfaces grow over holes.

    Ku, Harakeh & Waslander 2018, "In defense of classical image processing: fast depth completion on the
    CPU", CRV, section III, with its kernels. Its last step but one repeats here until no hole is left.
    """
    from skimage.morphology import diamond

    cv2 = opencv()
    top = _NEAREST_INVERTED * float(np.nanmax(sensor))
    inverted = np.where(np.isfinite(sensor), top - sensor, 0.0).astype(np.float32)

    # Dilate with a diamond, and close small holes.
    inverted = cv2.dilate(inverted, diamond(_SMALL_KERNEL_PX // 2))
    inverted = cv2.morphologyEx(inverted, cv2.MORPH_CLOSE, np.ones((_SMALL_KERNEL_PX,) * 2, np.uint8))
    inverted = _fill_by_dilation(inverted, _FILL_KERNEL_PX)

    # Extend each column's first depth to the top of the image, then fill large holes.
    filled = inverted > 0
    first = filled.argmax(axis=0)
    above = (np.arange(len(inverted))[:, None] < first) & filled.any(axis=0)
    inverted = np.where(above, inverted[first, np.arange(inverted.shape[1])], inverted)
    while not (inverted > 0).all():
        inverted = _fill_by_dilation(inverted, _LARGE_KERNEL_PX)

    # Remove outliers, and smooth.
    inverted = cv2.medianBlur(np.ascontiguousarray(inverted), _SMALL_KERNEL_PX)
    inverted = cv2.GaussianBlur(inverted, (_SMALL_KERNEL_PX,) * 2, 0)
    return np.asarray(top - inverted)


def guided_filter(colour: Colour, sensor: NDArray[np.float32]) -> DepthMap:
    """In each window, depth as a linear function of the colours, fitted to the measured pixels.

    The guided image filter (He, Sun & Tang 2013, IEEE TPAMI 35:1397) with weights of 1 for measured pixels
    and 0 for holes. It gives values to holes alone, between the least and the largest depth that is measured
    in the window; windows double in size until all holes have one.
    """
    cv2 = opencv()
    guide = colour.astype(np.float64) / 255.0
    known = np.isfinite(sensor)
    measured = np.where(known, sensor, 0.0).astype(np.float64)
    filled = measured.copy()
    radius, hole = _GUIDE_RADIUS_PX, ~known
    while hole.any():
        fitted = _linear_in_colour(cv2, guide, measured, known, radius)
        window = np.ones((2 * radius + 1,) * 2, np.uint8)
        high = cv2.dilate(np.where(known, measured, -np.inf), window)
        low = cv2.erode(np.where(known, measured, np.inf), window)
        new = hole & (cv2.dilate(known.astype(np.uint8), window) > 0)
        filled[new] = np.clip(fitted, low, high)[new]
        radius, hole = 2 * radius, hole & ~new
    return filled


BASELINES: Final[Mapping[str, DepthMethod]] = {
    "nearest": nearest,
    "navier_stokes": navier_stokes,
    "ip_basic": ip_basic,
    "guided_filter": guided_filter,
}
"""Methods by name."""


def opencv() -> Any:
    """The module; raises `SetupError` if OpenCV is not installed."""
    try:
        import cv2
    except ImportError:
        problem = "OpenCV is not installed, which this baseline needs"
        raise SetupError(f"{problem}; install it with `pip install 'pepperscene[depth]'`") from None
    return cv2


def _fill_by_dilation(inverted: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Empty pixels, which are 0, get the largest inverted depth around them."""
    dilated = opencv().dilate(inverted, np.ones((side, side), np.uint8))
    return np.where(inverted > 0, inverted, dilated)


def _linear_in_colour(
    cv2: Any, guide: NDArray[np.float64], depth: NDArray[np.float64], known: NDArray[np.bool_], radius: int
) -> NDArray[np.float64]:
    """The filtered depth `(h, w)`; of no meaning where no pixel within two radii is measured."""
    weight = known.astype(np.float64)

    def window_sum(image: NDArray[np.float64]) -> NDArray[np.float64]:
        side = 2 * radius + 1
        return np.asarray(
            cv2.boxFilter(image, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        )

    # Counts are whole; sums of decimals may leave 1e-17 where there is nothing.
    count = np.rint(window_sum(weight))
    some = np.maximum(count, 1.0)

    # Means and covariances of the measured pixels of each window.
    mean_depth = window_sum(weight * depth) / some
    mean_colour = window_sum(weight[..., None] * guide) / some[..., None]
    pairs = guide[..., :, None] * guide[..., None, :]
    weighted = (weight[..., None, None] * pairs).reshape(*weight.shape, 9)
    # OpenCV filters images of at most four channels at full speed, and of nine as well.
    second = window_sum(weighted).reshape(*weight.shape, 3, 3) / some[..., None, None]
    covariance = second - mean_colour[..., :, None] * mean_colour[..., None, :]
    with_depth = window_sum((weight * depth)[..., None] * guide) / some[..., None]
    with_depth -= mean_colour * mean_depth[..., None]

    # Slope and offset of each window, and their means over the windows of a pixel by measured pixels.
    slope = np.linalg.solve(covariance + _GUIDE_EPSILON * np.eye(3), with_depth[..., None])[..., 0]
    offset = mean_depth - (slope * mean_colour).sum(axis=-1)
    total = np.maximum(window_sum(count), 1.0)
    slopes = window_sum(count[..., None] * slope) / total[..., None]
    return np.asarray((slopes * guide).sum(axis=-1) + window_sum(count * offset) / total)

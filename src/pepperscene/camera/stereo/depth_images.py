"""Depth images: semi-global matching by OpenCV, a left-right check, holes, and the view of another camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.stereo.depth_camera import DepthCamera, StereoMatching
from pepperscene.errors import SetupError

_FRACTION: Final = 16.0
"""OpenCV's disparities are whole sixteenths of a pixel; as 16-bit integers, below 0 where there is none."""
_PENALTIES: Final = (8, 32)
"""Of a disparity that differs from that of the neighbour by one, and by more, for each pixel of a block
(OpenCV documentation of StereoSGBM)."""
_SPECKLE_RANGE_PX: Final = 2  # largest difference within a speckle; OpenCV: "normally, 1 or 2 is good enough"
_PREFILTER: Final = 63  # clipping of the horizontal gradients; as in OpenCV's example of stereo matching
_REFINEMENTS: Final = 3  # chosen: a fourth changes disparities of a projected pattern by less than 0.005 px
_LARGEST_CORRECTION_PX: Final = 1.0  # chosen: semi-global matching is right to a pixel
_LEAST_GRADIENT: Final = 0.5
"""Codes per pixel, root mean square over a window. Chosen: that of rounded values without detail."""
Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class MatchedDepth:
    """Result of matching a pair of images, in the pixels of the left one.

    Attributes:
        depth_m: `(h, w)` float32, metres along the optical axis; nan in holes.
        confidence: `(h, w)` float32: correlation of the two images around the pixel, at most 1; 0 in holes.
    """

    depth_m: Floats
    confidence: Floats


def match_depth(left: Bytes, right: Bytes, depth_camera: DepthCamera) -> MatchedDepth:
    """Match the images of a depth camera.

    A pixel is a hole where no disparity is unique, where the right image does not find the same one (it does
    not see the point, or sees another surface), where the point is outside the right image, where few
    pixels agree, where the images do not correlate (there is nothing but noise), and where the depth is out
    of range.

    Args:
        left: `(h, w)` or `(h, w, 3)` uint8, developed image of the left imager.
        right: likewise.
        depth_camera: its geometry and settings.

    Raises:
        SetupError: OpenCV is not installed.
        ValueError: the images have different sizes.
    """
    if left.shape[:2] != right.shape[:2]:
        raise ValueError(f"images have different sizes: {left.shape[:2]} and {right.shape[:2]}")
    first, second = _grey(left), _grey(right)
    settings = depth_camera.matching
    disparity = _disparities(first, second, settings)
    # The right image, matched from right to left, is the left image of the mirrored pair.
    mirrored = _disparities(second[:, ::-1], first[:, ::-1], settings)
    difference = _left_right_difference(disparity, mirrored[:, ::-1])
    disparity = _refined(disparity, first, second, settings.refined_px)
    correlation = _correlation(disparity, first, second, settings.refined_px or settings.block_px)

    valid = (difference <= settings.left_right_px) & (correlation >= settings.least_correlation)
    # Written so that the nan of an unknown disparity fails too.
    valid &= disparity * settings.farthest_m >= depth_camera.disparity_m
    depth = np.full(disparity.shape, np.nan, np.float32)
    depth[valid] = depth_camera.disparity_m / disparity[valid]
    return MatchedDepth(depth, np.where(valid, correlation, np.float32(0.0)))


def _disparities(left: Bytes, right: Bytes, settings: StereoMatching) -> Floats:
    """`(h, w)` disparities of the left image, pixels; nan where there is none."""
    cv2 = _opencv()
    small, large = (factor * settings.block_px**2 for factor in _PENALTIES)
    matcher = cv2.StereoSGBM_create(
        minDisparity=0,
        numDisparities=settings.disparities,
        blockSize=settings.block_px,
        P1=small,
        P2=large,
        disp12MaxDiff=-1,  # both images are matched instead
        preFilterCap=_PREFILTER,
        uniquenessRatio=settings.uniqueness_percent,
        speckleWindowSize=settings.speckle_px,
        speckleRange=_SPECKLE_RANGE_PX,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
    # OpenCV leaves out columns that have fewer disparities than others, so there are more columns.
    wide = [np.pad(image, ((0, 0), (settings.disparities, 0)), mode="edge") for image in (left, right)]
    found = matcher.compute(*wide)[:, settings.disparities :].astype(np.float32) / np.float32(_FRACTION)
    # Points outside the other image.
    found[(found < 0) | (np.arange(found.shape[1]) - found < -0.5)] = np.nan
    return np.asarray(found)


def _correlation(disparity: Floats, left: Bytes, right: Bytes, window_px: int) -> Floats:
    """`(h, w)` correlation of the slopes of both images along rows, in windows; -1 without a disparity.

    Of slopes, because smooth shading, which both images have anywhere, correlates without a right match.
    """
    cv2 = _opencv()
    known = np.isfinite(disparity)
    columns, rows = _pixel_grid(disparity)
    x = columns - np.where(known, disparity, np.float32(0.0))
    first, second = _slope(left.astype(np.float32)), _slope(right.astype(np.float32))
    second = cv2.remap(second, x, rows, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)

    def mean(image: Floats) -> Floats:
        return np.asarray(cv2.boxFilter(image, -1, (window_px, window_px)))

    # Weaker slopes than those of rounded values and noise count less.
    weakest = np.float32(_LEAST_GRADIENT**2)
    strength = np.sqrt((mean(first**2) + weakest) * (mean(second**2) + weakest))
    correlation = mean(first * second) / strength
    return np.where(known, np.clip(correlation, -1.0, 1.0), np.float32(-1.0)).astype(np.float32)


def _slope(image: Floats) -> Floats:
    """`(h, w)` central differences along rows, per pixel."""
    cv2 = _opencv()
    return np.asarray(cv2.Sobel(image, -1, 1, 0, ksize=1, scale=0.5, borderType=cv2.BORDER_REPLICATE))


def _refined(disparity: Floats, left: Bytes, right: Bytes, window_px: int) -> Floats:
    """Disparities by least squares over windows, in which the disparity is taken to be constant.

    Semi-global matching compares whole pixels, and interpolates costs between them, which draws disparities
    to whole numbers. So the right image is shifted by the disparities found, and what remains of the
    difference between the images, over the gradient, corrects them (Lucas & Kanade 1981). A correction of
    more than a pixel, as at the border of a surface, is left out.
    """
    cv2 = _opencv()
    if window_px == 0:
        return disparity
    columns, rows = _pixel_grid(disparity)
    known = np.isfinite(disparity)
    start = found = np.where(known, disparity, np.float32(0.0)).astype(np.float32)
    first, second = left.astype(np.float32), right.astype(np.float32)
    slope = _slope(second)
    window = (window_px, window_px)
    for _ in range(_REFINEMENTS):
        shifted, gradient = (
            cv2.remap(image, columns - found, rows, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
            for image in (second, slope)
        )
        # Normal equations of a shift that is constant in the window; holes have no weight.
        gradient *= known
        weights = cv2.boxFilter(gradient * gradient, -1, window)
        sums = cv2.boxFilter(gradient * (gradient * found - (first - shifted)), -1, window)
        better = sums / np.maximum(weights, np.float32(_LEAST_GRADIENT**2))
        accepted = (weights > _LEAST_GRADIENT**2) & (np.abs(better - start) <= _LARGEST_CORRECTION_PX)
        found = np.where(accepted, better, start)
    return np.where(known, found, np.float32(np.nan))


def _pixel_grid(image: Floats) -> tuple[Floats, Floats]:
    """`(h, w)` columns and rows of the pixels."""
    columns, rows = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in image.shape[::-1]))
    return columns, rows


def _left_right_difference(left: Floats, right: Floats) -> Floats:
    """`(h, w)` difference between a pixel's disparity and that of its point in the right image.

    Infinite where there is none.
    """
    rows, columns = np.ogrid[: left.shape[0], : left.shape[1]]
    known = np.isfinite(left)
    target = np.clip(np.rint(columns - np.where(known, left, 0.0)), 0, left.shape[1] - 1).astype(np.intp)
    difference = np.abs(right[rows, target] - left)
    return np.where(np.isfinite(difference), difference, np.float32(np.inf))


def _grey(image: Bytes) -> Bytes:
    """`(h, w)` grey values; of a colour image, its luma."""
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    return np.asarray(_opencv().cvtColor(np.ascontiguousarray(image), _opencv().COLOR_RGB2GRAY))


def _opencv() -> Any:
    try:
        import cv2
    except ImportError:
        problem = "a depth camera needs OpenCV, which is not installed"
        raise SetupError(f"{problem}; install it with `pip install 'pepperscene[depth]'`") from None
    return cv2


def align_depth(depth_m: Floats, confidence: Floats, source: Camera, target: Camera) -> tuple[Floats, Floats]:
    """Depth and confidence of one camera in the pixels of another.

    Each pixel with a depth is a square across the optical axis at that depth. It covers the pixels between
    the images of its corners in the other camera, where the nearest square counts: the method of the
    alignment in librealsense (`align.cpp`). So what only the other camera sees is a hole.

    Args:
        depth_m: `(h, w)` metres along the optical axis of the source, nan for none.
        confidence: `(h, w)`.
        source: the camera of the depth.
        target: the other camera, `(h', w')`.

    Returns:
        `(h', w')` depth along the optical axis of the target, nan for none, and confidence, 0 for none.
    """
    if _is_same_view(source, target):
        return depth_m, confidence
    row, column = np.nonzero(np.isfinite(depth_m))
    z, corner = depth_m[row, column].astype(float), np.column_stack([column, row]).astype(float)
    first, near = _project(corner, z, source, target)
    last, far = _project(corner + 1.0, z, source, target)
    # From the pixel that holds one corner to that of the other, so that neighbours leave no gap.
    begin, end = np.floor(np.minimum(first, last)), np.floor(np.maximum(first, last))
    known = np.isfinite(begin).all(-1) & np.isfinite(end).all(-1) & (np.minimum(near, far) > 0.0)
    known &= (end >= 0.0).all(-1) & (begin < (target.width, target.height)).all(-1)
    begin, end = (
        np.clip(x[known], 0, (target.width - 1, target.height - 1)).astype(int) for x in (begin, end)
    )
    depth = ((near + far) / 2.0)[known]

    # The farthest first, so that the nearest are written last.
    order = np.argsort(-depth, kind="stable")
    begin, end, depth = begin[order], end[order], depth[order]
    value = confidence[row, column][known][order]
    aligned = np.full((target.height, target.width), np.inf, np.float32)
    source_pixel = np.full(aligned.shape, -1)
    extent = (end - begin).max(axis=0, initial=0) + 1
    for down in range(extent[1]):
        for right in range(extent[0]):
            pixel = begin + np.array([right, down])
            inside = (pixel <= end).all(-1)
            u, v = pixel[inside].T
            nearer = depth[inside] < aligned[v, u]
            u, v, index = u[nearer], v[nearer], np.flatnonzero(inside)[nearer]
            aligned[v, u] = depth[index]
            source_pixel[v, u] = index
    hole = source_pixel < 0
    aligned[hole] = np.nan
    values = np.where(hole, 0.0, value[source_pixel]) if len(value) else np.zeros(aligned.shape)
    return aligned, values.astype(np.float32)


def _project(
    pixels: NDArray[np.float64], z: NDArray[np.float64], source: Camera, target: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixel coordinates `(n, 2)` and depth `(n,)` in the target of points at depths `(n,)` behind pixels."""
    matrix = source.intrinsics
    slopes = (pixels - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]
    points = np.column_stack([slopes * z[:, None], z])
    world = points @ source.pose[:3, :3].T + source.pose[:3, 3]
    depth = (world - target.pose[:3, 3]) @ target.pose[:3, 2]
    return target.project(world), depth


def _is_same_view(source: Camera, target: Camera) -> bool:
    """Whether both cameras see the same point in each pixel."""
    same_size = (source.width, source.height) == (target.width, target.height)
    same_lens = target.lens.distortion.is_zero and np.array_equal(source.intrinsics, target.intrinsics)
    return same_size and same_lens and np.allclose(source.pose, target.pose, rtol=0.0, atol=1e-9)

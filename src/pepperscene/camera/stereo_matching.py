"""Depth from a pair of images: semi-global matching by OpenCV, a left-right check, and holes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.depth_camera import DepthCamera, StereoMatching
from pepperscene.errors import SetupError

_FRACTION: Final = 16.0
"""OpenCV's disparities are whole sixteenths of a pixel; as 16-bit integers, below 0 where there is none."""
_PENALTIES: Final = (8, 32)
"""Of a disparity that differs from that of the neighbour by one, and by more, for each pixel of a block
(OpenCV documentation of StereoSGBM)."""
_SPECKLE_RANGE_PX: Final = 2  # largest difference within a speckle; OpenCV: "normally, 1 or 2 is good enough"
_PREFILTER: Final = 63  # clipping of the horizontal gradients; as in OpenCV's example of stereo matching

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class MatchedDepth:
    """Result of matching a pair of images, in the pixels of the left one.

    Attributes:
        depth_m: `(h, w)` float32, metres along the optical axis; nan in holes.
        confidence: `(h, w)` float32: 1 where the disparities of both images are equal, falling linearly to 0
            at the largest allowed difference; 0 in holes.
    """

    depth_m: Floats
    confidence: Floats


def match_depth(left: Bytes, right: Bytes, depth_camera: DepthCamera) -> MatchedDepth:
    """Match the images of a depth camera.

    A pixel is a hole where no disparity is unique, where the right image does not find the same one (it does
    not see the point, or sees another surface), where the point is outside the right image, where few
    pixels agree, and where the depth is out of range.

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

    depth = np.full(disparity.shape, np.nan, np.float32)
    valid = (difference <= settings.left_right_px) & (disparity > 0)
    depth[valid] = depth_camera.disparity_m / disparity[valid]
    depth[depth > settings.farthest_m] = np.nan
    margin = max(settings.left_right_px, 1.0 / _FRACTION)
    confidence = np.where(np.isfinite(depth), np.clip(1.0 - difference / margin, 0.0, 1.0), 0.0)
    return MatchedDepth(depth, confidence.astype(np.float32))


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

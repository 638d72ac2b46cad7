"""A depth image seen from another camera, as depth cameras align their depth with their colour image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.camera import Camera

Floats = NDArray[np.float32]


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

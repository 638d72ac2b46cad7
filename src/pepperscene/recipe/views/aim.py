"""Directions of cameras that show a target at a given place in the image, with a given roll."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera

FloatArray = NDArray[np.float64]

_ALONG_Z = 1e-9  # chosen: directions closer to the vertical than this, in radians, have no azimuth
_ROUNDING = 1e-12  # of the sine of an angle


def image_rays(camera: Camera, places: FloatArray) -> FloatArray:
    """`(n, 3)` unit directions in camera axes of the rays through `(n, 2)` places in the image.

    Places count from the image's centre, right and down, in halves of its width and height.
    """
    size = np.array([camera.width, camera.height])
    matrix = camera.intrinsics
    pixels = 0.5 * size * (1.0 + places)
    slopes = camera.lens.distortion.undistort((pixels - matrix[:2, 2]) / matrix[[0, 1], [0, 1]])
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def directions(elevation: FloatArray, azimuth: FloatArray) -> FloatArray:
    """`(n, 3)` unit vectors from a target to cameras: at azimuth 0 at its -y side, then towards +x."""
    cosine = np.cos(elevation)
    return np.stack([cosine * np.sin(azimuth), -cosine * np.cos(azimuth), np.sin(elevation)], axis=1)


def aimed_rotations(
    elevation: FloatArray, azimuth: FloatArray, rays: FloatArray, roll: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Rotations of cameras around a target that see it along given rays.

    A camera is turned about the vertical, then tilted up or down, and then rolled about its optical axis, so
    that with no roll the rows of its image are level.

    Args:
        elevation: `(n,)` of the camera seen from the target, radians, positive above it.
        azimuth: `(n,)` of the camera around the target, radians, as in `directions`.
        rays: `(n, 3)` unit vectors to the target in camera axes.
        roll: `(n,)` radians, clockwise seen from behind the camera.

    Returns:
        `(n, 3, 3)` camera to world, and `(n,)` whether there is such a camera that is tilted by at most 90
        degrees: from above, a level camera cannot have the target far to the left or right.
    """
    view = -directions(elevation, azimuth)
    # The ray in the axes of the camera before it was rolled.
    cos, sin = np.cos(roll), np.sin(roll)
    x, y, z = cos * rays[:, 0] - sin * rays[:, 1], sin * rays[:, 0] + cos * rays[:, 1], rays[:, 2]
    # Tilt: turns (y, z) so far that the ray rises as the view does.
    length = np.hypot(y, z)
    rise = view[:, 2] / length
    tilt = np.arctan2(y, z) + np.arcsin(np.clip(rise, -1.0, 1.0))
    is_possible = (np.abs(rise) <= 1.0 + _ROUNDING) & (np.abs(tilt) <= 0.5 * np.pi + _ALONG_Z)
    # Turn: brings the ray's horizontal part, x to the right and the rest ahead, to that of the view.
    ahead = length * np.sqrt(np.maximum(1.0 - rise**2, 0.0))
    turn = np.arctan2(view[:, 1], view[:, 0]) - np.arctan2(ahead, x)
    turn = np.where(np.hypot(ahead, x) < _ALONG_Z, azimuth, turn)

    level = np.zeros_like(turn)
    right = np.stack([np.cos(turn), np.sin(turn), level], axis=1)
    forward_level = np.stack([-np.sin(turn), np.cos(turn), level], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    forward = np.cos(tilt)[:, None] * forward_level + np.sin(tilt)[:, None] * up
    down = np.sin(tilt)[:, None] * forward_level - np.cos(tilt)[:, None] * up
    rolled_right = cos[:, None] * right + sin[:, None] * down
    rolled_down = -sin[:, None] * right + cos[:, None] * down
    return np.stack([rolled_right, rolled_down, forward], axis=2), is_possible

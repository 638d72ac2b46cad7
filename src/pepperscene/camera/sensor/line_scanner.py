"""The image of a line scanner (push broom): each row is the same line of photosites at another time.

A point is in the row in which the line sees it, so projection finds a time: that at which the point crosses
the line while the camera moves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.poses.motion import Motion

Array = NDArray[np.float64]

_MIDDLE: Final = 0.5  # of the line's only row
_ACCURACY: Final = 1e-9  # of the time of a row; chosen: rounding of image coordinates is a thousandth of it
_MOST_STEPS: Final = 32  # chosen: a camera that does not turn takes 2, and one that turns 4 or 5


def crossing_times(
    points: Array,
    pose: Array,
    motion: Motion,
    matrix: Array,
    image_points: Callable[[Array], Array],
    line_time_s: float,
) -> Array:
    """Times `(n,)`, seconds, at which world points `(n, 3)` cross the middle of the line; nan if they do not.

    Newton's method from time 0: first on the plane of a lens without distortion, which a camera that does not
    turn crosses linearly in time, then on the sensor.

    Args:
        points: metres.
        pose: `(4, 4)` camera to world at time 0.
        motion: of the camera.
        matrix: `(3, 3)` pinhole matrix of the line as a sensor of one row.
        image_points: pixel coordinates `(n, 2)` on that sensor of points `(3, n)` in camera axes.
        line_time_s: from row to row.
    """

    def in_plane(times: Array) -> Array:
        _, y, z = motion.to_camera(pose, points, times).T
        return np.asarray(matrix[1, 1] * y + (matrix[1, 2] - _MIDDLE) * z)

    def on_sensor(times: Array) -> Array:
        return image_points(motion.to_camera(pose, points, times).T)[:, 1] - _MIDDLE

    times = _roots(in_plane, np.zeros(len(points)), line_time_s)
    return _roots(on_sensor, times, line_time_s)


def _roots(residual: Callable[[Array], Array], start_s: Array, step_s: float) -> Array:
    """Times `(n,)` at which n residuals are 0, by Newton's method with differences over a step."""
    times, is_found = start_s.copy(), np.zeros(len(start_s), bool)
    for _ in range(_MOST_STEPS):
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value = residual(times)
            change = value * step_s / (residual(times + step_s) - value)
            times = np.where(np.isfinite(change), times - change, np.nan)
            is_found |= np.abs(change) <= _ACCURACY * step_s
        if (is_found | np.isnan(times)).all():
            break
    return np.where(is_found, times, np.nan)

"""Camera-to-world poses.

World: z up, x along the row to the right as seen from the aisle, y into the crop. Camera: x right, y down, z
forward. The columns of a pose are the camera's axes and its position, in world coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> NDArray[np.float64]:
    """`(4, 4)` pose of a camera at `position` that looks at `target` with `up` upwards in its image.

    Raises:
        ValueError: the target is the position, or the view is along `up`.
    """
    origin = np.asarray(position, dtype=float)
    return _pose(origin, np.asarray(target, dtype=float) - origin, np.asarray(up, dtype=float))


def arc_path(
    count: int,
    distance_m: float,
    azimuth_rad: tuple[float, float],
    height_m: tuple[float, float],
    pitch_rad: float,
    centre: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.float64]:
    """`(count, 4, 4)` poses on an arc around a vertical axis, evenly spaced in azimuth and height.

    At azimuth 0 the camera is in the aisle (at -y of the axis); positive azimuth moves it towards +x. It
    faces the axis horizontally and is then tilted up by the pitch. Both ends are included; a single pose is
    the first end. After section 2.5 of Barth et al. 2018 (40 cm from the plant, 20 degrees up, 250 frames).

    Args:
        count: number of poses.
        distance_m: horizontal distance to the axis.
        azimuth_rad: first and last.
        height_m: first and last, above the ground.
        pitch_rad: elevation of the optical axis, positive upwards.
        centre: x and y of the axis.

    Raises:
        ValueError: the count is less than 1, the distance is not positive, or the view is vertical.
    """
    if count < 1 or not distance_m > 0:
        raise ValueError("at least one pose and a positive distance are needed")
    azimuth = np.linspace(*azimuth_rad, count)
    height = np.linspace(*height_m, count)
    inward = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(count)], axis=-1)
    axis = np.column_stack([np.full(count, centre[0]), np.full(count, centre[1]), height])
    up = np.array([0.0, 0.0, 1.0])
    forward = np.cos(pitch_rad) * inward + np.sin(pitch_rad) * up
    positions = axis - distance_m * inward
    return np.stack([_pose(position, view, up) for position, view in zip(positions, forward, strict=True)])


def _pose(
    position: NDArray[np.float64], view: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    length = np.linalg.norm(view)
    right = np.cross(view, up)
    if not np.linalg.norm(right) > 1e-9 * length * np.linalg.norm(up):
        raise ValueError("the view must have a direction other than upwards or downwards")
    forward = view / length
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, position
    return pose

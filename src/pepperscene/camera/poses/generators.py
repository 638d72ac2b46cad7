"""Camera-to-world poses: one that looks at a point, an arc, and a grid; checks of poses.

World: z up, x along the row to the right as seen from the aisle, y into the crop. Camera: x right, y down, z
forward. The columns of a pose are the camera's axes and its position, in world coordinates.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.errors import ArgumentError

Array = NDArray[np.float64]
MAX_POSES: Final = 100_000
"""In a list, a grid or a path. Chosen: more than an hour at 25 frames per second, in 13 MB."""
LEAST_INTERVAL_S: Final = 1e-6
"""Between the times of two poses. Chosen: no camera takes a million images a second, and velocities computed
from shorter intervals have no digits."""
LATEST_S: Final = 1e12
"""Of times, before and after 0. Chosen: 30,000 years, far beyond any clock."""
_TOLERANCE: Final = 1e-6  # of a rotation's entries, as in `Camera`


def as_points(values: ArrayLike, name: str = "points") -> Array:
    """`(n, 3)` points from `(..., 3)`, one `(3,)` or an empty list; else raises `ArgumentError`."""
    array = _numbers(values, name, "(n, 3)")
    if array.shape == (0,):
        return array.reshape(0, 3)
    if not array.ndim or array.shape[-1] != 3:
        raise ArgumentError(name, f"must have the shape (n, 3), not {array.shape}")
    return array.reshape(-1, 3)


def as_poses(values: ArrayLike, name: str = "poses") -> Array:
    """`(n, 4, 4)` poses from `(n, 4, 4)`, one `(4, 4)` or an empty list; else raises `ArgumentError`."""
    array = _numbers(values, name, "(n, 4, 4)")
    if array.shape == (0,):
        return array.reshape(0, 4, 4)
    if array.ndim not in (2, 3) or array.shape[-2:] != (4, 4):
        raise ArgumentError(name, f"must have the shape (n, 4, 4), not {array.shape}")
    return array.reshape(-1, 4, 4)


def as_positions(values: ArrayLike, name: str = "points") -> Array:
    """`(n, 3)` positions: points as `as_points` takes them, or those of poses, as `as_poses` takes them."""
    array = _numbers(values, name, "(n, 3) or (n, 4, 4)")
    if array.ndim in (2, 3) and array.shape[-2:] == (4, 4):
        return array.reshape(-1, 4, 4)[:, :3, 3]
    if array.ndim not in (1, 2) or array.shape[-1] not in (0, 3):
        raise ArgumentError(name, f"must have the shape (n, 3) or (n, 4, 4), not {array.shape}")
    return as_points(array, name)


def _numbers(values: ArrayLike, name: str, shape: str) -> Array:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ArgumentError(name, f"must be numbers of the shape {shape}") from None


def check_poses(poses: NDArray[np.float64]) -> None:
    """Raise ValueError unless matrices `(n, 4, 4)` are rotations and translations, and finite."""
    rotation = poses[:, :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        error = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
        valid = (error <= _TOLERANCE) & (np.linalg.det(rotation) > 0) & np.isfinite(poses).all(axis=(1, 2))
        valid &= np.all(poses[:, 3] == [0, 0, 0, 1], axis=1)
    if not valid.all():
        number = int(np.argmin(valid))
        raise ValueError(f"pose {number} must be a rotation and a translation, without scale or reflection")


def check_intervals(times_s: NDArray[np.float64]) -> None:
    """Raise ValueError unless times `(n,)` ascend, within `LATEST_S`, by `LEAST_INTERVAL_S` or more."""
    if not np.all(np.abs(times_s) <= LATEST_S) or too_close(times_s).any():
        allowed = f"at least {LEAST_INTERVAL_S:g} s apart, from {-LATEST_S:g} to {LATEST_S:g} s"
        raise ValueError(f"times must be ascending, {allowed}")


def too_close(times_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """`(n - 1,)` whether a time is not at least `LEAST_INTERVAL_S` after the time before it.

    Differences of large times are rounded, which does not count.
    """
    rounding = np.spacing(np.abs(times_s).max(initial=0.0))
    return np.asarray(~(np.diff(times_s) >= LEAST_INTERVAL_S - rounding) | ~(np.diff(times_s) > 0))


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> NDArray[np.float64]:
    """`(4, 4)` pose of a camera at `position` that looks at `target` with `up` upwards in its image.

    Raises:
        ValueError: an argument has not three coordinates, the target is the position, or the view is along
            `up`.
    """
    origin, goal, upwards = (np.asarray(point, dtype=float) for point in (position, target, up))
    for name, point in (("position", origin), ("target", goal), ("up", upwards)):
        if point.shape != (3,):
            raise ValueError(f"{name} must have three coordinates, not the shape {point.shape}")
    return pose_along(origin, goal - origin, upwards)


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
    axis = np.column_stack([np.tile(centre, (count, 1)), np.linspace(*height_m, count)])
    return _facing(axis, distance_m, np.linspace(*azimuth_rad, count), pitch_rad)


def grid_poses(
    x_m: ArrayLike,
    distance_m: ArrayLike,
    height_m: ArrayLike,
    azimuth_rad: ArrayLike,
    pitch_rad: ArrayLike,
    centre: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.float64]:
    """`(n, 4, 4)` poses at every combination of five lists; the last list varies fastest, the first slowest.

    Each pose faces a vertical axis as in `arc_path`. Each argument is a list `(m,)` or one number.

    Args:
        x_m: positions of the axis along the row, relative to the centre.
        distance_m: horizontal distances to the axis.
        height_m: heights above the ground.
        azimuth_rad: directions from the axis to the camera: 0 in the aisle, positive towards +x.
        pitch_rad: elevations of the optical axis, positive upwards.
        centre: x and y of the axis at `x_m` = 0.

    Raises:
        ValueError: a list is empty, has more than one dimension or is not finite, a distance is not positive,
            a view is vertical, or there are more than 100,000 poses.
    """
    lists = [np.atleast_1d(np.asarray(v, float)) for v in (x_m, distance_m, height_m, azimuth_rad, pitch_rad)]
    if any(values.ndim != 1 or not values.size or not np.isfinite(values).all() for values in lists):
        raise ValueError("each list of a grid must have at least one number, and finite ones only")
    if not np.all(lists[1] > 0):
        raise ValueError("distances must be positive")
    if (count := math.prod(values.size for values in lists)) > MAX_POSES:
        raise ValueError(f"a grid of {count:,} poses is too large; at most {MAX_POSES:,} are allowed")
    x, distance, height, azimuth, pitch = (part.ravel() for part in np.meshgrid(*lists, indexing="ij"))
    axis = np.column_stack([centre[0] + x, np.full(count, centre[1]), height])
    return _facing(axis, distance[:, None], azimuth, pitch[:, None])


def protocol_poses(
    distances_m: ArrayLike,
    azimuths_rad: ArrayLike,
    height_m: float,
    pitch_rad: float,
    centre: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.float64]:
    """`(n, 4, 4)` poses of a robot: at each distance, each azimuth, at one height, facing the axis.

    The azimuth varies fastest. Arguments, units and errors are those of `grid_poses`.
    """
    return grid_poses(0.0, distances_m, height_m, azimuths_rad, pitch_rad, centre)


def pose_along(
    position: NDArray[np.float64], view: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`(4, 4)` pose at a position `(3,)` that looks along `view` `(3,)` of any length, with `up` upwards.

    Raises:
        ValueError: the view is zero or along `up`.
    """
    length = np.linalg.norm(view)
    right = np.cross(view, up)
    if not np.linalg.norm(right) > 1e-9 * length * np.linalg.norm(up):
        raise ValueError("the view must have a direction other than upwards or downwards")
    forward = view / length
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, position
    return pose


def _facing(
    axis: NDArray[np.float64],
    distance_m: float | NDArray[np.float64],
    azimuth_rad: NDArray[np.float64],
    pitch_rad: float | NDArray[np.float64],
) -> NDArray[np.float64]:
    """`(n, 4, 4)` poses that face points of a vertical axis `(n, 3)`, and are then tilted up by the pitch.

    Distance and pitch are numbers or `(n, 1)`; the azimuth is `(n,)`.
    """
    inward = np.stack([-np.sin(azimuth_rad), np.cos(azimuth_rad), np.zeros(len(axis))], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    forward = np.cos(pitch_rad) * inward + np.sin(pitch_rad) * up
    views = zip(axis - distance_m * inward, forward, strict=True)
    return np.stack([pose_along(position, view, up) for position, view in views])

"""Shapes of points and poses that a caller gives, and checks of poses and times."""

from __future__ import annotations

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
    """`(n, 3)` points from `(..., 3)`, one `(3,)` or an empty list.

    Raises:
        ArgumentError: `name` has another shape, or is not made of numbers.
    """
    array = _numbers(values, name, "(n, 3)")
    if array.shape == (0,):
        return array.reshape(0, 3)
    if not array.ndim or array.shape[-1] != 3:
        raise ArgumentError(name, f"must have the shape (n, 3), not {array.shape}")
    return array.reshape(-1, 3)


def as_poses(values: ArrayLike, name: str = "poses") -> Array:
    """`(n, 4, 4)` poses from `(n, 4, 4)`, one `(4, 4)` or an empty list.

    Raises:
        ArgumentError: `name` has another shape, or is not made of numbers.
    """
    array = _numbers(values, name, "(n, 4, 4)")
    if array.shape == (0,):
        return array.reshape(0, 4, 4)
    if array.ndim not in (2, 3) or array.shape[-2:] != (4, 4):
        raise ArgumentError(name, f"must have the shape (n, 4, 4), not {array.shape}")
    return array.reshape(-1, 4, 4)


def as_positions(values: ArrayLike, name: str = "points") -> Array:
    """`(n, 3)` positions: points as `as_points` takes them, or those of poses, as `as_poses` takes them.

    Raises:
        ArgumentError: `name` has neither shape, or is not made of numbers.
    """
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
    """Check that matrices `(n, 4, 4)` are rotations and translations.

    Raises:
        ValueError: one of them is not, or is not finite.
    """
    rotation = poses[:, :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        error = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
        valid = (error <= _TOLERANCE) & (np.linalg.det(rotation) > 0) & np.isfinite(poses).all(axis=(1, 2))
        valid &= np.all(poses[:, 3] == [0, 0, 0, 1], axis=1)
    if not valid.all():
        number = int(np.argmin(valid))
        raise ValueError(f"pose {number} must be a rotation and a translation, without scale or reflection")


def check_times(times_s: NDArray[np.float64]) -> None:
    """Check that times `(n,)` are finite and ascending.

    Raises:
        ValueError: they are not, or two are equal.
    """
    if not np.isfinite(times_s).all() or not np.all(np.diff(times_s) > 0):
        raise ValueError("times must be finite and ascending, without duplicates")


def check_intervals(times_s: NDArray[np.float64]) -> None:
    """Check that velocities can be computed from times `(n,)`.

    Raises:
        ValueError: they are not ascending, within `LATEST_S` and at least `LEAST_INTERVAL_S` apart.
    """
    if not np.all(np.abs(times_s) <= LATEST_S) or too_close(times_s).any():
        allowed = f"at least {LEAST_INTERVAL_S:g} s apart, from {-LATEST_S:g} to {LATEST_S:g} s"
        raise ValueError(f"times must be ascending, {allowed}")


def too_close(times_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """`(n - 1,)` whether a time is not at least `LEAST_INTERVAL_S` after the time before it.

    Differences of large times are rounded, which does not count.
    """
    rounding = np.spacing(np.abs(times_s).max(initial=0.0))
    return np.asarray(~(np.diff(times_s) >= LEAST_INTERVAL_S - rounding) | ~(np.diff(times_s) > 0))

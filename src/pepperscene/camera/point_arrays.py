"""Shapes of points and poses that a caller gives, one or many.

Reshaping alone would take the numbers of 4 x 4 poses for points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.errors import ArgumentError

Array = NDArray[np.float64]


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

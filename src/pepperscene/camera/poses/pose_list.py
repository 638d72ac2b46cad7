"""A list of camera poses with times and names, and the checks of numbers that files share."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.poses.generators import (
    LATEST_S,
    LEAST_INTERVAL_S,
    MAX_POSES,
    check_intervals,
    check_poses,
    too_close,
)
from pepperscene.errors import InputError

Array = NDArray[np.float64]
Label = Callable[[int], str]
"""The place of a pose in its file, from its position in the list: "line 7"."""

_TOLERANCE: Final = 1e-3
"""Of a quaternion's length, and of the entries of a rotation matrix times its transpose. Chosen: files with
four digits pass; larger deviations are mistakes."""

_FARTHEST_M: Final = 1e6
"""Chosen: coordinates of national grids are some thousand kilometres at most, and doubles resolve 0.1 nm."""


@dataclass(frozen=True, eq=False)
class PoseList:
    """Camera poses in order; arrays are read-only.

    Attributes:
        poses: `(n, 4, 4)` camera to world, metres. Camera axes: x right, y down, z forward; world: z up.
        times_s: `(n,)` ascending, or None.
        names: one for each pose (a file name of an image), or None.
    """

    poses: Array
    times_s: Array | None = None
    names: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        poses = np.array(self.poses, dtype=float)
        if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not 1 <= len(poses) <= MAX_POSES:
            raise ValueError(f"poses must have the shape (n, 4, 4) with n from 1 to {MAX_POSES:,}")
        check_poses(poses)
        if self.times_s is not None:
            times = np.array(self.times_s, dtype=float)
            if times.shape != (len(poses),):
                raise ValueError("there must be one time for each pose")
            check_intervals(times)
            times.setflags(write=False)
            object.__setattr__(self, "times_s", times)
        if self.names is not None:
            names = tuple(self.names)
            if len(names) != len(poses) or not all(map(is_name, names)):
                raise ValueError(
                    "there must be one name for each pose, on one line and without spaces around it"
                )
            object.__setattr__(self, "names", names)
        poses.setflags(write=False)
        object.__setattr__(self, "poses", poses)

    def __len__(self) -> int:
        return len(self.poses)


def is_name(name: str) -> bool:
    """Whether every format can hold a name: not empty, one line, no spaces around it."""
    return bool(name) and name.isprintable() and name == name.strip()


def check_name(name: object, path: Path, key: str) -> None:
    """Raise `InputError` unless a pose's name in a file is text as of `is_name`."""
    if not isinstance(name, str) or not is_name(name):
        raise InputError(path, "must be a name of printable characters", key=key, value=name)


def rigid_poses(rotation: Array, position: Array) -> Array:
    """`(n, 4, 4)` poses of rotations `(n, 3, 3)` and positions `(n, 3)`."""
    poses = np.tile(np.eye(4), (len(position), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotation, position
    return poses


def finite_number(value: object, path: Path, key: str) -> float:
    """A number of a file, from text or JSON; raises `InputError` if it is not finite."""
    number = math.nan
    # Python would also convert true, an int, and text with underscores, "1_000".
    is_excluded = isinstance(value, bool) or (isinstance(value, str) and "_" in value)
    if isinstance(value, str | int | float) and not is_excluded:
        with contextlib.suppress(ValueError, OverflowError):
            number = float(value)
    if not math.isfinite(number):
        raise InputError(path, "must be a finite number", key=key, value=value)
    return number


def rotations_of_quaternions(quaternions: Array, path: Path, label: Label) -> Array:
    """`(n, 3, 3)` of quaternions `(n, 4)` in the order x, y, z, w, normalised.

    Raises `InputError` if a length is not within 0.001 of 1.
    """
    from scipy.spatial.transform import Rotation

    with np.errstate(over="ignore"):
        length = np.linalg.norm(quaternions, axis=1)
    if (number := _first(~(np.abs(length - 1) <= _TOLERANCE))) is not None:
        problem = (
            f"must be a quaternion of length 1 within {_TOLERANCE:g}; its length is {length[number]:.6g}"
        )
        raise InputError(path, problem, key=label(number), value=quaternions[number].tolist())
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def nearest_rotations(matrices: Array, path: Path, label: Label) -> Array:
    """`(n, 3, 3)` rotations nearest to matrices `(n, 3, 3)`; raises `InputError` if one is no rotation."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(matrices @ np.swapaxes(matrices, 1, 2) - np.eye(3)).max(axis=(1, 2))
        wrong = ~(error <= _TOLERANCE) | ~(np.linalg.det(matrices) > 0)
    if (number := _first(wrong)) is not None:
        raise InputError(path, "must contain a rotation, without scale or reflection", key=label(number))
    # The orthogonal factor of the polar decomposition.
    left, _, right = np.linalg.svd(matrices)
    return np.asarray(left @ right)


def quaternions_of(rotation: Array) -> Array:
    """`(n, 4)` quaternions x, y, z, w with w >= 0 of rotations `(n, 3, 3)`."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True))


def ascending_times(times: list[float], path: Path, label: Label) -> Array:
    """Times `(n,)` of a file; raises `InputError` unless they are within `LATEST_S` and far enough apart."""
    values = np.array(times)
    if (number := _first(~(np.abs(values) <= LATEST_S))) is not None:
        problem = f"must be from {-LATEST_S:g} to {LATEST_S:g} s"
        raise InputError(path, problem, key=f"{label(number)}, time", value=times[number])
    if (number := _first(too_close(values))) is not None:
        problem = f"must be after the time before it, {times[number]!r}, by {LEAST_INTERVAL_S:g} s"
        raise InputError(path, problem, key=f"{label(number + 1)}, time", value=times[number + 1])
    return values


def check_positions(position: Array, path: Path, label: Label) -> None:
    """Raise `InputError` if a coordinate of positions `(n, 3)` is beyond 1000 km."""
    if (number := _first(~(np.abs(position) <= _FARTHEST_M).all(axis=1))) is not None:
        problem = f"must have a position within {_FARTHEST_M:,.0f} m of the origin"
        raise InputError(path, problem, key=label(number))


def _first(wrong: ArrayLike) -> int | None:
    """The number of the first entry that is wrong."""
    return int(np.argmax(wrong)) if np.any(wrong) else None


def check_count(count: int, path: Path) -> None:
    """Raise `InputError` if a file has no poses, or more than 100,000."""
    if not 1 <= count <= MAX_POSES:
        problem = "contains no poses" if count < 1 else f"contains more than {MAX_POSES:,} poses"
        raise InputError(path, f"{problem}; 1 to {MAX_POSES:,} are allowed")


def text_of(values: Array) -> list[str]:
    """Numbers with all the digits that are needed to read the same values back."""
    return [repr(float(value)) for value in values]

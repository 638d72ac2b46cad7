"""Views that do not depend on the plants: on an arc, a protocol, a grid, a path, or from a file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.recipe.views_tables import ArcViews, GridViews, PathViews, PoseViews, ProtocolViews, Views

if TYPE_CHECKING:
    from pepperscene.camera import Motion
    from pepperscene.camera.poses.trajectory import Trajectory
    from pepperscene.scene import Greenhouse

Array = NDArray[np.float64]
_Content = tuple[int, int] | None


@dataclass(frozen=True, eq=False)
class View:
    """A camera's `(4, 4)` pose, camera to world in metres, and its motion; None if it does not move."""

    pose: Array
    motion: Motion | None = None

    def turned(self, angle_rad: float) -> View:
        """The view turned about the world's vertical axis, counter-clockwise seen from above."""
        if not angle_rad:
            return self
        from pepperscene.camera import Motion
        from pepperscene.scene import rotation_about_z

        turn = np.eye(4)
        turn[:3, :3] = rotation = rotation_about_z(angle_rad)
        motion = self.motion
        if motion is not None:
            motion = Motion(rotation @ motion.velocity_m_s, rotation @ motion.angular_velocity_rad_s)
        return View(turn @ self.pose, motion)


def view_count(table: Views, where: str = "views") -> int | None:
    """Number of views that a table determines; None if `plan.frames` does.

    Raises:
        InputError: a file of poses cannot be read.
    """
    if isinstance(table, PathViews) and table.frame_rate_hz is not None:
        return len(_path(table, None, where))
    if isinstance(table, PoseViews):
        try:
            return len(_read_poses(table.file, _content(table))[0])
        except InputError as error:
            if error.key or error.where != table.file:
                raise
            raise InputError(where, error.problem, key="views.file", value=table.file) from None
    return table.count


def fixed_view(table: Views, step: int, frames: int, greenhouse: Greenhouse, where: str = "views") -> View:
    """The view of a step; `frames` is the number of steps.

    Poses of an arc, a protocol and a grid keep their distance from the row wherever it leans at the camera's
    height; those of paths and files are in world coordinates.
    """
    poses, velocities = _views(table, _content(table), frames, greenhouse, where)
    if step >= len(poses):
        raise InputError(where, f"gives {len(poses)} views, but plan.frames is {frames}", key="views")
    if velocities is None:
        return View(poses[step])
    from pepperscene.camera import Motion

    return View(poses[step], Motion(*velocities[:, step]))


def view_times(table: Views, frames: int, greenhouse: Greenhouse, where: str = "views") -> Array | None:
    """Times `(n,)` in seconds of the views of a path, or of an arc with a speed; None for other views.

    Arguments and errors are those of `fixed_view`.
    """
    if isinstance(table, PathViews):
        return _path(table, frames, where).times_s
    if isinstance(table, ArcViews) and table.speed_m_s is not None:
        return _arc_times(_views(table, None, frames, greenhouse, where)[0], table.speed_m_s)
    return None


@lru_cache(maxsize=64)
def _views(
    table: Views, content: _Content, frames: int, greenhouse: Greenhouse, where: str
) -> tuple[Array, Array | None]:
    """Poses `(n, 4, 4)`; velocities and angular velocities `(2, n, 3)`, or None without motion."""
    from pepperscene.camera import arc_path, grid_poses, protocol_poses
    from pepperscene.camera.poses.generators import too_close
    from pepperscene.camera.poses.trajectory import trajectory_from_poses

    match table:
        case ArcViews():
            poses = arc_path(frames, table.distance_m, table.azimuth_rad, table.height_m, table.pitch_rad)
        case ProtocolViews():
            distances, azimuths = np.array(table.distance_m), np.array(table.azimuth_rad)
            poses = protocol_poses(distances, azimuths, table.height_m, table.pitch_rad)
        case GridViews():
            poses = grid_poses(
                np.array(table.x_m),
                np.array(table.distance_m),
                np.array(table.height_m),
                np.array(table.azimuth_rad),
                np.array(table.pitch_rad),
            )
        case PathViews():
            trajectory = _path(table, frames, where)
            return trajectory.poses, _velocities(trajectory) if table.motion else None
        case PoseViews():
            poses, times = _read_poses(table.file, content)
            if times is None or not table.motion:
                return poses, None
            return poses, _velocities(trajectory_from_poses(poses, times))
        case _:
            raise TypeError(f"{type(table).__name__} depends on the scene")
    # Keep the distance from the row, wherever the row leans at the camera's height.
    poses[:, 1, 3] -= [greenhouse.lean_offset_m(float(height)) for height in poses[:, 2, 3]]
    if isinstance(table, ArcViews) and table.speed_m_s is not None and len(poses) > 1:
        times = _arc_times(poses, table.speed_m_s)
        # A camera that does not move along its arc takes sharp photographs.
        if not too_close(times).any():
            return poses, _velocities(trajectory_from_poses(poses, times))
    return poses, None


def _arc_times(poses: Array, speed_m_s: float) -> Array:
    """Times `(n,)` at which a camera with a speed is at poses `(n, 4, 4)`."""
    lengths = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(lengths)]) / speed_m_s


def _path(table: PathViews, frames: int | None, where: str) -> Trajectory:
    from pepperscene.camera.poses.trajectory import spline_trajectory

    rate = table.frame_rate_hz
    look_at = None if table.look_at_m is None else np.array(table.look_at_m)
    try:
        return spline_trajectory(
            np.array(table.points_m),
            table.speed_m_s,
            count=frames if rate is None else None,
            frame_interval_s=None if rate is None else 1.0 / rate,
            look_at_m=look_at,
            azimuth_rad=None if look_at is not None else table.azimuth_rad,
            pitch_rad=None if look_at is not None else table.pitch_rad,
        )
    except ValueError as error:
        raise InputError(where, f"gives no path: {error}", key="views.points_mm") from None


def _velocities(trajectory: Trajectory) -> Array:
    return np.stack([trajectory.velocity_m_s, trajectory.angular_velocity_rad_s])


def _content(table: Views) -> _Content:
    """Size and time of the last change of a file of poses, which can change while a notebook runs."""
    if not isinstance(table, PoseViews):
        return None
    try:
        status = Path(table.file).stat()
    except (OSError, ValueError):
        return None  # reported where the file is read
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=8)
def _read_poses(file: str, _content: _Content) -> tuple[Array, Array | None]:
    from pepperscene.camera.pose_files.formats import read_poses

    found = read_poses(Path(file))
    return found.poses, found.times_s

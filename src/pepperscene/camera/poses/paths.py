"""Paths of a moving camera: poses with times, velocities and angular velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.poses.curves import SmoothCurve, curve_through
from pepperscene.camera.poses.poses import MOST_POSES, check_intervals, check_poses, check_times, pose_along

Array = NDArray[np.float64]

_UP: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of a camera along time, and how it moves at each; all arrays are read-only.

    Attributes:
        poses: `(n, 4, 4)` camera to world, metres.
        times_s: `(n,)` ascending.
        velocity_m_s: `(n, 3)` of the camera's position, in world axes.
        angular_velocity_rad_s: `(n, 3)` in world axes: the camera turns about this axis by its length.
    """

    poses: Array
    times_s: Array
    velocity_m_s: Array
    angular_velocity_rad_s: Array

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.times_s))
        shapes = {
            "poses": (count, 4, 4),
            "times_s": (count,),
            "velocity_m_s": (count, 3),
            "angular_velocity_rad_s": (count, 3),
        }
        for name, shape in shapes.items():
            values = np.array(getattr(self, name), dtype=float)
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite, with the shape {shape}, not {values.shape}")
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        check_times(self.times_s)

    def __len__(self) -> int:
        return len(self.times_s)


def spline_trajectory(
    points_m: ArrayLike,
    speed_m_s: float,
    count: int | None = None,
    frame_interval_s: float | None = None,
    *,
    look_at_m: ArrayLike | None = None,
    azimuth_rad: ArrayLike | None = None,
    pitch_rad: ArrayLike | None = None,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Trajectory:
    """A camera on a smooth curve through points at constant speed, with a level horizon.

    The curve is a cubic spline; if the last point is the first, it is closed. Poses are either `count`,
    evenly over the whole length with both ends (one pose is the start), or one every `frame_interval_s` from
    the start. The camera looks at a fixed point, or in a direction whose azimuth and pitch are given for the
    whole path or per point; in between they change monotonically and smoothly. An azimuth is not wrapped:
    from 350 to 370 degrees the camera turns by 20, from 350 to 10 by -340. Velocities are exact derivatives.

    Args:
        points_m: `(k, 3)` positions, at least two.
        speed_m_s: along the curve.
        count: number of poses, or None.
        frame_interval_s: time between poses, or None; exactly one of the two is needed.
        look_at_m: `(3,)` the point on the optical axis; None if there is an azimuth.
        azimuth_rad: of the optical axis, one number or `(k,)`: 0 looks along +y, into the crop, and positive
            is counter-clockwise as seen from above, as in `arc_path`.
        pitch_rad: elevation of the optical axis, one number or `(k,)`, positive upwards; by default 0.
        centre: x and y that are added to the points and to `look_at_m`.

    Raises:
        ValueError: an argument is not as above, two neighbouring points are equal, the curve turns back on
            itself, a view is vertical, or there are more than 100,000 poses.
    """
    offset = np.array([*centre, 0.0])
    curve = curve_through(np.asarray(points_m, dtype=float) + offset)
    times = _frame_times(curve.length_m / _positive(speed_m_s, "speed"), count, frame_interval_s)
    parameter = curve.parameter_at(times * speed_m_s)
    # Position and velocity: the derivative along the arc has the length 1.
    position, derivative = curve.spline(parameter), curve.spline(parameter, 1)
    rate = speed_m_s / np.linalg.norm(derivative, axis=-1)
    velocity = derivative * rate[:, None]
    # Direction of view and its rates in azimuth and pitch.
    if look_at_m is not None:
        if azimuth_rad is not None or pitch_rad is not None:
            raise ValueError("a path has a point to look at, or an azimuth and a pitch, not both")
        target = np.asarray(look_at_m, dtype=float)
        if target.shape != (3,):
            raise ValueError("the point to look at must have three coordinates")
        view = target + offset - position
        azimuth_rate, pitch_rate = _rates_of_view(view, -velocity)
    elif azimuth_rad is not None:
        azimuth, azimuth_rate = _interpolated(curve, azimuth_rad, parameter, rate)
        pitch, pitch_rate = _interpolated(curve, 0.0 if pitch_rad is None else pitch_rad, parameter, rate)
        flat = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(len(azimuth))], axis=-1)
        view = np.cos(pitch)[:, None] * flat + np.sin(pitch)[:, None] * _UP
    else:
        raise ValueError("a path needs a point to look at, or an azimuth")
    poses = np.stack([pose_along(*row, _UP) for row in zip(position, view, strict=True)])
    # A level camera turns about the vertical by the azimuth and about its own x axis by the pitch.
    turn = azimuth_rate[:, None] * _UP + pitch_rate[:, None] * poses[:, :3, 0]
    return Trajectory(poses, times, velocity, turn)


def trajectory_from_poses(
    poses: ArrayLike, times_s: ArrayLike, centre: tuple[float, float] = (0.0, 0.0)
) -> Trajectory:
    """A camera that moves smoothly through poses `(n, 4, 4)` at times `(n,)`.

    The velocity at a pose is that of the parabola through it and its two neighbours (central differences for
    any spacing; exact for constant acceleration), one-sided at the ends. The angular velocity is that of
    SciPy's `RotationSpline`; at the ends it is the mean of the first and the last interval. A single pose
    does not move.

    Args:
        poses: camera to world, with any roll.
        times_s: ascending, at least a microsecond apart.
        centre: x and y that are added to the positions.

    Raises:
        ValueError: shapes or values are not as above, or there are more than 100,000 poses.
    """
    from scipy.spatial.transform import Rotation, RotationSpline

    matrices, times = np.array(poses, dtype=float), np.asarray(times_s, dtype=float)
    if times.ndim != 1 or not times.size or matrices.shape != (len(times), 4, 4):
        raise ValueError("a trajectory needs as many poses (n, 4, 4) as times (n,), and at least one")
    if len(times) > MOST_POSES:
        raise ValueError(f"{len(times):,} poses are too many; at most {MOST_POSES:,} are allowed")
    check_intervals(times)
    check_poses(matrices)
    matrices[:, :2, 3] += centre
    if len(times) == 1:
        return Trajectory(matrices, times, np.zeros((1, 3)), np.zeros((1, 3)))
    position = matrices[:, :3, 3]
    # A parabola needs three poses.
    velocity = np.gradient(position, times, axis=0, edge_order=2 if len(times) > 2 else 1)
    rotations = Rotation.from_matrix(matrices[:, :3, :3])
    # The spline's rates are in camera axes.
    turn = rotations.apply(RotationSpline(times, rotations)(times, 1))
    return Trajectory(matrices, times, velocity, turn)


def _positive(value: float, name: str) -> float:
    if not 0 < value < np.inf:
        raise ValueError(f"the {name} must be positive and finite")
    return value


def _frame_times(duration_s: float, count: int | None, frame_interval_s: float | None) -> Array:
    """Times `(n,)` of the frames of a path that takes `duration_s`."""
    if (count is None) == (frame_interval_s is None):
        raise ValueError("a path needs either a number of poses or an interval between frames")
    if frame_interval_s is not None:
        intervals = duration_s / _positive(frame_interval_s, "interval between frames")
        # An end that is missed by rounding alone counts.
        number = np.floor(intervals + 1e-9) + 1
        allowed = number <= MOST_POSES
        times = np.arange(number if allowed else 0) * frame_interval_s
    else:
        number, allowed = count, 1 <= (count or 0) <= MOST_POSES
        times = np.linspace(0.0, duration_s, count or 0) if allowed else np.zeros(0)
    if not allowed:
        raise ValueError(f"a path has 1 to {MOST_POSES:,} poses, not {number:,.0f}")
    return np.minimum(times, duration_s)


def _interpolated(
    curve: SmoothCurve, angle_rad: ArrayLike, parameter: Array, rate: Array
) -> tuple[Array, Array]:
    """An angle `(n,)` and its rate `(n,)` in rad/s, from one number or one per point of the curve."""
    from scipy.interpolate import PchipInterpolator

    angle = np.asarray(angle_rad, dtype=float)
    if angle.shape not in ((), curve.knots.shape) or not np.isfinite(angle).all():
        raise ValueError("an azimuth or pitch must be one finite number, or one for each point of the path")
    if angle.ndim == 0:
        return np.full(len(parameter), float(angle)), np.zeros(len(parameter))
    # Monotone between two points, so that it never exceeds the angles that were given.
    spline = PchipInterpolator(curve.knots, angle)
    return spline(parameter), spline(parameter, 1) * rate


def _rates_of_view(view: Array, view_rate: Array) -> tuple[Array, Array]:
    """Rates `(n,)` in rad/s of the azimuth and pitch of a view `(n, 3)` with the derivative `view_rate`."""
    x, y, z = view.T
    x_rate, y_rate, z_rate = view_rate.T
    flat = np.hypot(x, y)
    with np.errstate(divide="ignore", invalid="ignore"):  # `pose_along` refuses a vertical view
        azimuth_rate = (x * y_rate - y * x_rate) / flat**2
        flat_rate = (x * x_rate + y * y_rate) / flat
        pitch_rate = (flat * z_rate - z * flat_rate) / (flat**2 + z**2)
    return azimuth_rate, pitch_rate

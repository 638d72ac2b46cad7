"""Paths of a moving camera: poses with times, velocities and angular velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.poses.generators import MAX_POSES, check_intervals, check_poses, pose_along

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]
_UP: Final = np.array([0.0, 0.0, 1.0])
_PARTS: Final = 32
"""Parts of a span between two points for the arc length. Chosen: with 8 Gauss points in each, the length of
curves that are not refused is exact to 1e-8, also in hairpin bends."""
_GAUSS_POINTS: Final = 8
_NEWTON_STEPS: Final = 60  # chosen: about 4 are needed; as many halvings of the interval reach rounding
_LEAST_CHORD: Final = 1e-9
"""Least distance of two neighbouring points over the length of the path. Chosen: parts of shorter spans
vanish in the rounding of the arc length."""
_LEAST_RATE: Final = 1e-3
"""Least |dr/du|, which is near 1 for a parameter u of chord lengths. Chosen: a curve that is slower there
turns within a thousandth of a span, which no camera follows at constant speed."""


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
        if not np.all(np.diff(self.times_s) > 0):
            raise ValueError("times must be finite and ascending, without duplicates")

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
    if len(times) > MAX_POSES:
        raise ValueError(f"{len(times):,} poses are too many; at most {MAX_POSES:,} are allowed")
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
        allowed = number <= MAX_POSES
        times = np.arange(number if allowed else 0) * frame_interval_s
    else:
        number, allowed = count, 1 <= (count or 0) <= MAX_POSES
        times = np.linspace(0.0, duration_s, count or 0) if allowed else np.zeros(0)
    if not allowed:
        raise ValueError(f"a path has 1 to {MAX_POSES:,} poses, not {number:,.0f}")
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


@dataclass(frozen=True, eq=False)
class SmoothCurve:
    """A cubic spline through points, with a constant rate along its arc length.

    Attributes:
        knots: `(k,)` parameter of the points: the sum of chord lengths, metres.
        spline: position `(..., 3)` against the parameter.
        nodes: `(m,)` ends of the parts whose length is tabulated.
        lengths: `(m,)` arc length up to each node, metres.
    """

    knots: Array
    spline: CubicSpline
    nodes: Array
    lengths: Array

    @property
    def length_m(self) -> float:
        """Arc length of the whole curve."""
        return float(self.lengths[-1])

    def parameter_at(self, arc_length_m: Array) -> Array:
        """Parameter `(n,)` at arc lengths `(n,)` from the start; Newton's method, kept inside a bracket."""
        # Start from the part of the table that holds the length, linearly between its ends.
        goal = np.clip(arc_length_m, 0.0, self.length_m)
        part = np.clip(np.searchsorted(self.lengths, goal, side="right") - 1, 0, len(self.nodes) - 2)
        start, low, high = self.nodes[part], self.nodes[part], self.nodes[part + 1]
        rest = goal - self.lengths[part]
        fraction = rest / (self.lengths[part + 1] - self.lengths[part])
        parameter = low + fraction * (high - low)
        for _ in range(_NEWTON_STEPS):
            error = _arc_length(self.spline, start, parameter) - rest
            if np.abs(error).max() <= 1e-13 * self.length_m:
                break
            # Narrow the bracket by the sign of the error; halve it where Newton's step would leave it.
            low, high = np.where(error < 0, parameter, low), np.where(error > 0, parameter, high)
            step = parameter - error / np.linalg.norm(self.spline(parameter, 1), axis=-1)
            parameter = np.where((step >= low) & (step <= high), step, (low + high) / 2)
        return parameter


def curve_through(points_m: Array) -> SmoothCurve:
    """A curve through points `(k, 3)`; if the last is the first, it is closed and smooth there too.

    A cubic spline with continuous second derivatives over the chord length. Its ends are free of curvature:
    otherwise it swings out by several spans where points are unevenly spaced.

    Raises:
        ValueError: fewer than two points, two neighbours are (nearly) equal, or the curve turns back on
            itself.
    """
    from scipy.interpolate import CubicSpline

    if points_m.ndim != 2 or points_m.shape[1] != 3 or len(points_m) < 2 or not np.isfinite(points_m).all():
        raise ValueError("the points of a path must be at least two, with three finite coordinates each")
    chords = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    if not chords.min() > _LEAST_CHORD * chords.sum():
        number = int(np.argmin(chords)) + 1
        raise ValueError(f"points {number} and {number + 1} are equal, or nearly so")
    knots = np.concatenate([[0.0], np.cumsum(chords)])
    is_closed = len(points_m) > 2 and np.array_equal(points_m[0], points_m[-1])
    spline = CubicSpline(knots, points_m, bc_type="periodic" if is_closed else "natural")
    _check_no_reversal(spline)
    # Tabulate the arc length over parts of each span.
    fractions = np.arange(_PARTS) / _PARTS
    nodes = np.append((knots[:-1, None] + chords[:, None] * fractions).ravel(), knots[-1])
    lengths = np.concatenate([[0.0], np.cumsum(_arc_length(spline, nodes[:-1], nodes[1:]))])
    return SmoothCurve(knots, spline, nodes, lengths)


def _check_no_reversal(spline: CubicSpline) -> None:
    """Check that the rate |dr/du| is nowhere near zero, at the ends of spans and at its extrema."""
    from scipy.interpolate import PPoly

    first, second = spline.derivative(1).c, spline.derivative(2).c
    # r' . r'' of each span, of degree 3, whose roots are the extrema of |r'|.
    product = np.zeros((first.shape[0] + second.shape[0] - 1, first.shape[1]))
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            product[i + j] += (a * b).sum(axis=-1)
    extrema = PPoly(product, spline.x).roots(discontinuity=False, extrapolate=False)
    # A straight span has the extremum "everywhere", marked by nan; its ends are enough.
    candidates = np.concatenate([spline.x, extrema[np.isfinite(extrema)]])
    rate = np.linalg.norm(spline(candidates, 1), axis=-1)
    if rate.min() < _LEAST_RATE:
        x, y, z = spline(candidates[np.argmin(rate)])
        raise ValueError(
            f"the path turns back on itself at ({x:.3f}, {y:.3f}, {z:.3f}) m, where a constant speed is "
            "impossible; move the points apart, or use two paths"
        )


def _arc_length(spline: CubicSpline, start: Array, end: Array) -> Array:
    """Arc length `(n,)` between parameters `(n,)` of the same part."""
    places, weights = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
    half = (end - start) / 2
    rates = np.linalg.norm(spline(start[:, None] + half[:, None] * (1 + places), 1), axis=-1)
    return np.asarray(half * (rates @ weights))

"""Poses and paths of a camera against closed forms and numerical derivatives of their own poses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from pepperscene.camera import (
    Trajectory,
    arc_path,
    grid_poses,
    look_at,
    protocol_poses,
    spline_trajectory,
    trajectory_from_poses,
)

RADIUS = 0.6
POINTS = np.array([[0, -1.5, 1.0], [0.4, -1.3, 1.1], [0.9, -1.45, 1.3], [1.0, -1.2, 1.7], [1.8, -1.6, 1.2]])
SPEED = 0.35
HAIRPIN = np.array([[0, 0, 1], [1, 0, 1], [1.05, 0.02, 1], [1, 0.04, 1], [0, 0.05, 1]])


def circle():
    angle = np.linspace(0, 2 * np.pi, 65)
    points = np.stack([RADIUS * np.sin(angle), -RADIUS * np.cos(angle), np.full_like(angle, 1.2)], axis=-1)
    points[-1] = points[0]
    return points


def test_circle_around_a_plant_has_its_radius_speed_curvature_and_angular_velocity():
    path = spline_trajectory(circle(), SPEED, count=101, look_at_m=(0, 0, 1.2))
    position = path.poses[:, :3, 3]
    radius = np.linalg.norm(position[:, :2], axis=1)
    np.testing.assert_allclose(radius, RADIUS, rtol=1e-6)
    np.testing.assert_allclose(path.times_s[-1], 2 * np.pi * RADIUS / SPEED, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(path.velocity_m_s, axis=1), SPEED, rtol=1e-12)
    # The velocity is along the tangent, and turns with the curvature 1 / radius.
    tangent = np.stack([-position[:, 1], position[:, 0], 0 * radius], axis=-1) / RADIUS
    np.testing.assert_allclose(path.velocity_m_s, SPEED * tangent, atol=1e-5 * SPEED)
    turned = np.linalg.norm(np.diff(path.velocity_m_s, axis=0), axis=1) / SPEED
    step = SPEED * np.diff(path.times_s)
    np.testing.assert_allclose(2 * np.arcsin(turned / 2) / step, 1 / RADIUS, rtol=1e-3)
    # Facing the axis, the camera turns counter-clockwise as it moves to +x in front of the plant.
    expected = np.tile([0, 0, SPEED / RADIUS], (101, 1))
    np.testing.assert_allclose(path.angular_velocity_rad_s, expected, atol=1e-5)
    # Smooth where it closes.
    np.testing.assert_allclose(path.poses[-1], path.poses[0], atol=1e-12)
    np.testing.assert_allclose(path.velocity_m_s[-1], path.velocity_m_s[0], atol=1e-12)


def test_straight_line_is_even_and_does_not_turn():
    path = spline_trajectory([(0, -2, 1), (3, -2, 1)], 0.5, frame_interval_s=0.25, azimuth_rad=0.0)
    assert len(path) == 25
    np.testing.assert_allclose(path.times_s, np.arange(25) * 0.25)
    np.testing.assert_allclose(path.poses[:, 0, 3], np.arange(25) * 0.125, atol=1e-12)
    np.testing.assert_allclose(path.velocity_m_s, np.tile([0.5, 0, 0], (25, 1)), atol=1e-12)
    np.testing.assert_array_equal(path.angular_velocity_rad_s, 0)
    np.testing.assert_allclose(path.poses[:, :3, 2], np.tile([0, 1, 0], (25, 1)), atol=1e-15)


@pytest.mark.parametrize("points", [POINTS, HAIRPIN], ids=["smooth", "hairpin"])
def test_arc_length_agrees_with_adaptive_integration(points):
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    spline = CubicSpline(knots, points, bc_type="natural")
    length = sum(
        quad(lambda u: np.linalg.norm(spline(u, 1)), *ends, epsabs=1e-12, limit=500)[0]
        for ends in itertools.pairwise(np.linspace(0, knots[-1], 101))
    )
    path = spline_trajectory(points, SPEED, count=2, azimuth_rad=0.0)
    np.testing.assert_allclose(path.times_s[-1] * SPEED, length, rtol=1e-6)


@pytest.mark.parametrize("points", [POINTS, HAIRPIN], ids=["smooth", "hairpin"])
def test_curve_hits_all_points_at_constant_speed_without_swinging_out(points):
    path = spline_trajectory(points, SPEED, count=5001, azimuth_rad=0.0)
    position, step = path.poses[:, :3, 3], SPEED * path.times_s[1]
    nearest = np.linalg.norm(position[:, None] - points, axis=-1).min(axis=0)
    assert nearest.max() <= step / 2 + 1e-9
    np.testing.assert_allclose(position[[0, -1]], points[[0, -1]], atol=1e-12)
    chords = np.linalg.norm(np.diff(position, axis=0), axis=1)
    assert np.all(chords <= step * (1 + 1e-9))  # in a bend, a chord is shorter than its arc
    np.testing.assert_allclose(np.median(chords), step, rtol=1e-6)
    assert np.all((position > points.min(axis=0) - 0.1) & (position < points.max(axis=0) + 0.1))


@pytest.mark.parametrize(
    "view",
    [
        {"look_at_m": (0.9, 0.1, 1.0)},
        {"azimuth_rad": [0.0, 0.3, -0.2, 1.0, 2.0], "pitch_rad": [0.1, 0.5, 0.2, -0.6, 0.0]},
    ],
    ids=["look_at", "per_point"],
)
def test_velocities_are_the_derivatives_of_the_poses(view):
    path = spline_trajectory(POINTS, SPEED, count=5001, **view)
    interval = path.times_s[2] - path.times_s[0]
    velocity = (path.poses[2:, :3, 3] - path.poses[:-2, :3, 3]) / interval
    np.testing.assert_allclose(path.velocity_m_s[1:-1], velocity, atol=5e-5)
    rotation = path.poses[:, :3, :3]
    turn = Rotation.from_matrix(rotation[2:] @ np.swapaxes(rotation[:-2], -1, -2)).as_rotvec() / interval
    # Second derivatives of the angles jump at the points.
    np.testing.assert_allclose(path.angular_velocity_rad_s[1:-1], turn, atol=1e-2)
    assert np.median(np.abs(path.angular_velocity_rad_s[1:-1] - turn)) < 1e-5


def test_direction_at_the_points_is_as_given_and_an_azimuth_is_not_wrapped():
    azimuth = np.radians([350.0, 370.0])
    path = spline_trajectory(
        [(0, -1, 1), (1, -1, 1)], 1.0, count=3, azimuth_rad=azimuth, pitch_rad=[0.2, 0.4]
    )
    forward = path.poses[:, :3, 2]
    np.testing.assert_allclose(np.arcsin(forward[:, 2]), [0.2, 0.3, 0.4], atol=1e-12)
    heading = np.degrees(np.arctan2(-forward[:, 0], forward[:, 1]))
    np.testing.assert_allclose(heading, [-10, 0, 10], atol=1e-9)


def test_centre_moves_points_and_target():
    moved = spline_trajectory(POINTS, SPEED, count=5, look_at_m=(1, 0, 1), centre=(0.3, -0.2))
    still = spline_trajectory(POINTS, SPEED, count=5, look_at_m=(1, 0, 1))
    shift = moved.poses[:, :3, 3] - still.poses[:, :3, 3]
    np.testing.assert_allclose(shift, [(0.3, -0.2, 0)] * 5, atol=1e-12)
    np.testing.assert_allclose(moved.poses[:, :3, :3], still.poses[:, :3, :3], atol=1e-12)


def test_interval_that_divides_the_duration_includes_the_end():
    line = [(0, 0, 1), (0.3, 0, 1)]
    assert len(spline_trajectory(line, 0.1, frame_interval_s=0.1, azimuth_rad=0.0)) == 31
    assert len(spline_trajectory(line, 0.1, frame_interval_s=0.11, azimuth_rad=0.0)) == 28
    assert len(spline_trajectory(line, 0.1, frame_interval_s=100.0, azimuth_rad=0.0)) == 1
    assert len(spline_trajectory(line, 0.1, count=1, azimuth_rad=0.0)) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points_m": POINTS[:1]}, "at least two"),
        ({"points_m": [[0, 0, np.nan], [1, 0, 0]]}, "finite"),
        ({"points_m": [[0, 0, 1], [1, 0, 1], [1, 0, 1]]}, "points 2 and 3 are equal"),
        ({"points_m": [[0, 0, 1], [1, 0, 1], [1, 1e-14, 1]]}, "points 2 and 3 are equal, or nearly so"),
        ({"points_m": [[0, 0, 1], [1, 0, 1], [0, 0, 1]]}, "turns back on itself"),
        ({"speed_m_s": 0.0}, "speed must be positive"),
        ({"count": None}, "either a number of poses or an interval"),
        ({"frame_interval_s": 1.0}, "either a number of poses or an interval"),
        ({"count": 0}, "1 to 100,000 poses, not 0"),
        ({"count": None, "frame_interval_s": 1e-12}, "1 to 100,000 poses"),
        ({"azimuth_rad": None}, "needs a point to look at, or an azimuth"),
        ({"look_at_m": (0, 0, 1)}, "not both"),
        ({"azimuth_rad": None, "look_at_m": np.ones((10, 3))}, "three coordinates"),
        ({"azimuth_rad": [0.0, 1.0]}, "one for each point"),
        ({"pitch_rad": np.pi / 2}, "other than upwards or downwards"),
        ({"azimuth_rad": None, "look_at_m": POINTS[0] + [0, 0, 1]}, "other than upwards or downwards"),
    ],
)
def test_arguments_that_are_not_allowed(changes, message):
    arguments = {"points_m": POINTS, "speed_m_s": SPEED, "count": 10, "azimuth_rad": 0.0, **changes}
    with pytest.raises(ValueError, match=message):
        spline_trajectory(**arguments)


def helix(times, rate=0.8):
    """Poses on a helix around z that face its axis, and their exact velocities."""
    angle = rate * times
    poses = grid_poses(0.0, RADIUS, 1.0, angle, 0.3)
    poses[:, 2, 3] += 0.1 * times
    velocity = np.stack([RADIUS * rate * np.cos(angle), RADIUS * rate * np.sin(angle), 0.1 + 0 * times], -1)
    return poses, velocity, np.tile([0, 0, rate], (len(times), 1))


def test_timed_poses_of_a_helix_give_its_velocities():
    times = 100 + np.cumsum(np.random.default_rng(1).uniform(0.005, 0.015, 400))
    poses, velocity, turn = helix(times)
    path = trajectory_from_poses(poses, times)
    np.testing.assert_allclose(path.velocity_m_s, velocity, atol=1e-4)
    np.testing.assert_allclose(path.angular_velocity_rad_s, turn, atol=1e-9)
    np.testing.assert_array_equal(path.poses, poses)


def test_constant_acceleration_is_exact_and_two_poses_move_evenly():
    times = np.array([0.0, 0.1, 0.4, 0.5])
    poses = np.tile(look_at((0, -1, 1), (0, 0, 1)), (4, 1, 1))
    poses[:, 0, 3] = 0.2 * times + 3 * times**2
    path = trajectory_from_poses(poses, times)
    np.testing.assert_allclose(path.velocity_m_s[:, 0], 0.2 + 6 * times, atol=1e-12)
    np.testing.assert_allclose(path.angular_velocity_rad_s, 0, atol=1e-12)
    pair = trajectory_from_poses(poses[:2], times[:2])
    np.testing.assert_allclose(pair.velocity_m_s[:, 0], 0.5, atol=1e-12)
    one = trajectory_from_poses(poses[:1], [5.0], centre=(1.0, 2.0))
    np.testing.assert_array_equal(one.velocity_m_s, np.zeros((1, 3)))
    np.testing.assert_array_equal(one.angular_velocity_rad_s, np.zeros((1, 3)))
    np.testing.assert_allclose(one.poses[0, :3, 3], [1, 1, 1])


def test_angular_velocity_is_in_world_axes_for_a_camera_with_roll():
    axis, rate = np.array([2.0, -1.0, 2.0]) / 3, 0.7
    times = np.linspace(0, 2, 41)
    start = look_at((0, -1, 1), (0.2, 0.1, 1.4))[:3, :3] @ Rotation.from_rotvec([0, 0, 0.4]).as_matrix()
    poses = np.tile(np.eye(4), (41, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(times * rate, axis)).as_matrix() @ start
    path = trajectory_from_poses(poses, times)
    np.testing.assert_allclose(path.angular_velocity_rad_s, np.tile(rate * axis, (41, 1)), atol=1e-9)
    np.testing.assert_array_equal(path.velocity_m_s, 0)


def test_timed_poses_that_are_not_allowed():
    poses, _, _ = helix(np.arange(3.0))
    for changed, times, message in (
        (poses, [0.0, 1.0], "as many poses"),
        (poses[:0], [], "at least one"),
        (poses, [0.0, 2.0, 2.0], "ascending"),
        (poses, [0.0, np.nan, 2.0], "ascending"),
        (2 * poses, [0.0, 1.0, 2.0], "pose 0 must be a rotation"),
        (poses * [[[1], [1], [-1], [1]]], [0.0, 1.0, 2.0], "without scale or reflection"),
    ):
        with pytest.raises(ValueError, match=message):
            trajectory_from_poses(changed, times)


def test_trajectory_is_read_only_and_checks_its_shapes():
    path = spline_trajectory(POINTS, SPEED, count=4, azimuth_rad=0.0)
    with pytest.raises(ValueError, match="read-only"):
        path.velocity_m_s[0] = 0
    with pytest.raises(ValueError, match="velocity_m_s must be finite"):
        Trajectory(path.poses, path.times_s, path.velocity_m_s[:2], path.angular_velocity_rad_s)


def test_grid_is_the_product_of_its_lists_with_the_last_fastest():
    # The robot of Barth et al. 2018: five distances and three angles.
    distances, azimuths = [0.2, 0.3, 0.4, 0.5, 0.6], np.radians([-45, 0, 45])
    protocol = protocol_poses(distances, azimuths, 1.5, 0.3, centre=(0.3, 0.05))
    expected = grid_poses(0.0, distances, 1.5, azimuths, 0.3, centre=(0.3, 0.05))
    np.testing.assert_allclose(protocol, expected, atol=1e-15)
    lists = ([0.0, 0.5], [0.4, 0.6], [1.0, 1.5, 2.0], [-0.5, 0.5], [0.0, 0.2])
    poses = grid_poses(*lists, centre=(0.2, 0.1))
    assert poses.shape == (48, 4, 4)
    for pose, (x, distance, height, azimuth, pitch) in zip(poses, itertools.product(*lists), strict=True):
        expected = arc_path(1, distance, (azimuth, azimuth), (height, height), pitch, centre=(0.2 + x, 0.1))
        np.testing.assert_allclose(pose, expected[0], atol=1e-15)


def test_grids_that_are_not_allowed():
    for changes, message in (
        ({"distance_m": [0.4, 0.0]}, "positive"),
        ({"height_m": []}, "at least one number"),
        ({"height_m": [[1.0]]}, "at least one number"),
        ({"azimuth_rad": np.nan}, "finite"),
        ({"pitch_rad": -np.pi / 2}, "upwards or downwards"),
        ({"x_m": np.zeros(400), "height_m": np.ones(400)}, "160,000 poses is too large"),
    ):
        arguments = {"x_m": 0, "distance_m": 0.4, "height_m": 1, "azimuth_rad": 0, "pitch_rad": 0, **changes}
        with pytest.raises(ValueError, match=message):
            grid_poses(**arguments)


PITCH = np.deg2rad(20)
VECTORS = st.tuples(*3 * [st.floats(-3, 3)])


def arc(**changes):
    arguments = {
        "count": 250, "distance_m": 0.4, "azimuth_rad": (-np.pi / 4, np.pi / 4), "height_m": (0.3, 3.2),
        "pitch_rad": PITCH, "centre": (0.6, 0.05), **changes,
    }  # fmt: skip
    return arc_path(**arguments)


def assert_valid(poses):
    """Orthonormal, right-handed, with the world's up upwards in the image and a level horizon."""
    rotation = poses[..., :3, :3]
    identity = np.broadcast_to(np.eye(3), rotation.shape)
    np.testing.assert_allclose(np.swapaxes(rotation, -1, -2) @ rotation, identity, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-12)
    assert np.all(rotation[..., 2, 1] < 0)  # y down
    np.testing.assert_allclose(rotation[..., 2, 0], 0, atol=1e-12)  # x level
    np.testing.assert_array_equal(poses[..., 3, :], np.broadcast_to([0, 0, 0, 1.0], (*poses.shape[:-2], 4)))


def test_arc_keeps_its_distance_and_looks_at_the_axis():
    poses = arc()
    assert poses.shape == (250, 4, 4)
    assert_valid(poses)
    to_axis = np.array([0.6, 0.05]) - poses[:, :2, 3]
    np.testing.assert_allclose(np.linalg.norm(to_axis, axis=-1), 0.4, atol=1e-12)
    forward = poses[:, :3, 2]
    np.testing.assert_allclose(np.arcsin(forward[:, 2]), PITCH, atol=1e-12)
    np.testing.assert_allclose(forward[:, :2] / np.cos(PITCH), to_axis / 0.4, atol=1e-12)


def test_arc_is_even_in_height_and_azimuth_and_a_single_pose_is_its_first_end():
    poses = arc(count=5)
    np.testing.assert_allclose(poses[:, 2, 3], np.linspace(0.3, 3.2, 5))
    azimuth = np.arctan2(poses[:, 0, 3] - 0.6, -(poses[:, 1, 3] - 0.05))
    np.testing.assert_allclose(azimuth, np.linspace(-np.pi / 4, np.pi / 4, 5), atol=1e-12)
    np.testing.assert_array_equal(arc(count=1)[0], poses[0])


def test_azimuth_zero_is_in_the_aisle_and_positive_is_right():
    front, right = arc(count=2, azimuth_rad=(0, np.pi / 2), pitch_rad=0.0, centre=(0, 0))
    np.testing.assert_allclose(front[:3, 3], [0, -0.4, 0.3], atol=1e-15)
    np.testing.assert_allclose(front[:3, 2], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(front[:3, 0], [1, 0, 0], atol=1e-15)  # along the row, to the right
    np.testing.assert_allclose(right[:3, 3], [0.4, 0, 3.2], atol=1e-15)


@given(position=VECTORS, target=VECTORS)
def test_look_at_puts_the_target_on_the_optical_axis(position, target):
    view = np.subtract(target, position)
    assume(np.hypot(view[0], view[1]) >= 1e-3 * max(np.linalg.norm(view), 1e-3))  # not vertical
    pose = look_at(position, target)
    assert_valid(pose)
    np.testing.assert_allclose(pose[:3, :3].T @ view, [0, 0, np.linalg.norm(view)], atol=1e-9)


def test_raises_on_vertical_or_empty_views():
    for position, target in (((0, 0, 0), (0, 0, 1)), ((1, 1, 1), (1, 1, 1))):
        with pytest.raises(ValueError, match="direction"):
            look_at(position, target)
    with pytest.raises(ValueError, match="positive"):
        arc(distance_m=0.0)

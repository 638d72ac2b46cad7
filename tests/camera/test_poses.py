"""Poses are rotations that look in the right direction."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pepperscene.camera import arc_path, look_at

PITCH = np.deg2rad(20)
POINTS = st.tuples(*3 * [st.floats(-3, 3)])


def path(**changes):
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
    poses = path()
    assert poses.shape == (250, 4, 4)
    assert_valid(poses)
    to_axis = np.array([0.6, 0.05]) - poses[:, :2, 3]
    np.testing.assert_allclose(np.linalg.norm(to_axis, axis=-1), 0.4, atol=1e-12)
    forward = poses[:, :3, 2]
    np.testing.assert_allclose(np.arcsin(forward[:, 2]), PITCH, atol=1e-12)
    np.testing.assert_allclose(forward[:, :2] / np.cos(PITCH), to_axis / 0.4, atol=1e-12)


def test_arc_is_even_in_height_and_azimuth_and_a_single_pose_is_its_first_end():
    poses = path(count=5)
    np.testing.assert_allclose(poses[:, 2, 3], np.linspace(0.3, 3.2, 5))
    azimuth = np.arctan2(poses[:, 0, 3] - 0.6, -(poses[:, 1, 3] - 0.05))
    np.testing.assert_allclose(azimuth, np.linspace(-np.pi / 4, np.pi / 4, 5), atol=1e-12)
    np.testing.assert_array_equal(path(count=1)[0], poses[0])


def test_azimuth_zero_is_in_the_aisle_and_positive_is_right():
    front, right = path(count=2, azimuth_rad=(0, np.pi / 2), pitch_rad=0.0, centre=(0, 0))
    np.testing.assert_allclose(front[:3, 3], [0, -0.4, 0.3], atol=1e-15)
    np.testing.assert_allclose(front[:3, 2], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(front[:3, 0], [1, 0, 0], atol=1e-15)  # along the row, to the right
    np.testing.assert_allclose(right[:3, 3], [0.4, 0, 3.2], atol=1e-15)


@given(position=POINTS, target=POINTS)
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
        path(distance_m=0.0)

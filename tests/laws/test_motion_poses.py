"""Poses of a moving camera, times of its rows, and projection through a rolling shutter."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from bodies import axis_camera
from scipy.spatial.transform import Rotation

from pepperscene.camera import Camera, Distortion, Motion, arc_path
from pepperscene.camera.sensor.rows import Shutter

VELOCITY, SPIN = (0.4, -0.2, 0.1), (0.3, 0.5, -0.7)


def moving_camera(line_time_s: float = 2e-5, *, labels_per_row: bool = True) -> Camera:
    camera = axis_camera(320, 240, flash=False)
    lens = replace(camera.lens, distortion=Distortion(-0.08, 0.02, p1=0.001))
    return replace(
        camera,
        lens=lens,
        sensor=replace(camera.sensor, line_time_s=line_time_s),
        pose=arc_path(3, 0.4, (0.0, 0.3), (0.2, 0.5), 0.3)[1],
        exposure_s=1e-3,
        motion=Motion(VELOCITY, SPIN),
        labels_per_row=labels_per_row,
    )


def points_in_view(camera: Camera, count: int = 80) -> np.ndarray:
    """World points whose images are spread over all of the camera's image, and a little beyond."""
    rng = np.random.default_rng(2)
    depth = rng.uniform(0.2, 2.0, (count, 1))
    across = rng.uniform(-0.6, 0.6, (count, 2)) * (camera.width, camera.height) / camera.intrinsics[0, 0]
    local = np.hstack([across * depth, depth])
    return local @ camera.pose[:3, :3].T + camera.pose[:3, 3]


@pytest.mark.parametrize("t", [-0.5, 1e-9, 0.02, 3.0])
def test_poses_turn_as_scipy_and_opencv_say(t):
    pose = moving_camera().pose
    moved = Motion(VELOCITY, SPIN).pose_at(pose, t)
    np.testing.assert_allclose(moved[:3, 3], pose[:3, 3] + np.multiply(VELOCITY, t), atol=1e-15)
    rotation_vector = np.multiply(SPIN, t)
    for rotation in (Rotation.from_rotvec(rotation_vector).as_matrix(), cv2.Rodrigues(rotation_vector)[0]):
        np.testing.assert_allclose(moved[:3, :3], rotation @ pose[:3, :3], atol=1e-14)


def test_projection_through_a_rolling_shutter_is_that_of_the_pose_of_its_row():
    camera = moving_camera()
    points = points_in_view(camera)
    pixels = camera.project(points)
    assert np.isfinite(pixels).all()
    for point, (u, v) in zip(points, pixels, strict=True):
        # An ordinary camera at the pose of that row, and OpenCV.
        t = (np.clip(v, 0, 240) - 120) * 2e-5
        pose = Motion(VELOCITY, SPIN).pose_at(camera.pose, t)
        still = replace(camera, motion=None, pose=pose).project(point)[0]
        world_to_camera = np.linalg.inv(pose)
        d = camera.lens.distortion
        coefficients = np.array([d.k1, d.k2, d.p1, d.p2, d.k3])
        rotation, shift = cv2.Rodrigues(world_to_camera[:3, :3])[0], world_to_camera[:3, 3]
        by_opencv = cv2.projectPoints(point[None], rotation, shift, camera.intrinsics, coefficients)[
            0
        ].ravel()
        assert still == pytest.approx([u, v], abs=1e-6)
        assert by_opencv == pytest.approx([u, v], abs=1e-5)
    moved = np.linalg.norm(pixels - replace(camera, motion=None).project(points), axis=1)
    assert moved.max() > 1.0


def test_labels_of_one_pose_ignore_the_rows():
    camera = moving_camera(labels_per_row=False)
    points = points_in_view(camera)
    np.testing.assert_array_equal(camera.project(points), replace(camera, motion=None).project(points))


@pytest.mark.parametrize("fraction", [0.3, 0.5])
def test_fast_images_are_projected_to_a_millionth_of_a_pixel(fraction):
    # The image moves by this fraction of a row, up or down, while the shutter advances by one.
    for sign in (1.0, -1.0):
        camera = replace(moving_camera(), pose=np.eye(4), lens=axis_camera(320, 240).lens)
        speed = sign * fraction / 2e-5 / camera.intrinsics[0, 0] * 0.5
        camera = replace(camera, motion=Motion((0.0, speed, 0.0)))
        y = np.linspace(-0.01, 0.01, 21)
        found = camera.project(np.stack([0 * y, y, np.full(21, 0.5)], axis=1))[:, 1]
        # v = c + f (y - s t) / z with t = (v - h/2) line_time, solved for v.
        focal, centre, line = camera.intrinsics[1, 1] / 0.5, camera.intrinsics[1, 2], 2e-5
        expected = (centre + focal * (y + speed * 120 * line)) / (1 + focal * speed * line)
        inside = (expected > 0) & (expected < 240)
        assert inside.sum() > 5
        np.testing.assert_allclose(found[inside], expected[inside], atol=1e-6)


# --- the rows and the flash ---------------------------------------------------------------------------------


def brute_force_share(shutter: Shutter, pulse_s: float) -> np.ndarray:
    """The share of the flash's light by counting instants."""
    step = shutter.exposure_s / 2000
    begin = shutter.pulse_begin(pulse_s)
    share = []
    for middle in (np.arange(shutter.rows) + 0.5 - shutter.rows / 2) * shutter.line_time_s:
        t = middle - shutter.exposure_s / 2 + (np.arange(2000) + 0.5) * step
        share.append(((t >= begin) & (t < begin + pulse_s)).sum() * step / min(pulse_s, shutter.exposure_s))
    return np.array(share)


@pytest.mark.parametrize(
    ("exposure_s", "line_time_s", "pulse_s", "evenly"),
    [
        (3e-3, 0.0, 50e-6, True),
        (50e-6, 0.0, 50e-6, True),
        (50e-6, 0.0, 1.0, True),
        (3e-3, 1e-5, 50e-6, True),  # all rows are exposed while the flash is on
        (3e-3, 1e-5, 2.5e-3, False),  # the first rows close before the flash ends
        (5e-4, 1e-5, 5e-5, False),  # only the first rows see it
        (5e-4, 1e-5, 6e-4, False),
        (5e-4, 1e-5, 1.0, True),  # a lamp that stays on
        (3e-3, 1e-5, 1.0, True),
    ],
)
def test_rows_see_the_overlap_of_pulse_and_exposure(exposure_s, line_time_s, pulse_s, evenly):
    shutter = Shutter(exposure_s, line_time_s, 100)
    share = shutter.flash_fraction(pulse_s)
    np.testing.assert_allclose(share, brute_force_share(shutter, pulse_s), atol=0.02)
    windows, exposures = shutter.flash_windows(pulse_s), shutter.exposures()
    assert (windows.begin_s >= exposures.begin_s - 1e-12).all()
    assert (windows.end_s <= exposures.end_s + 1e-12).all()
    assert (share == 1.0).all() == evenly

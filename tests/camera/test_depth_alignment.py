"""A depth image in the pixels of another camera, against the geometry of planes."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.camera import Camera, align_depth, load_lens, load_sensor


def camera(name="infrared", size=(212, 120), place=(0.0, 0.0, 0.0)):
    pose = np.eye(4)
    pose[:3, 3] = place
    sensor = load_sensor(f"realsense_d435_{name}").with_size(*size)
    return Camera(load_lens(f"realsense_d435_{name}"), sensor, pose)


def plane(of, z):
    return np.full((of.height, of.width), z, np.float32), np.ones((of.height, of.width), np.float32)


def test_the_same_camera_keeps_the_image():
    depth, confidence = plane(camera(), 0.7)
    aligned = align_depth(depth, confidence, camera(), camera())
    assert aligned[0] is depth
    assert aligned[1] is confidence


@pytest.mark.parametrize(("size", "forward"), [((320, 180), 0.05), ((106, 60), 0.0)])
def test_a_plane_fills_the_other_image_at_its_own_depth(size, forward):
    source, target = camera(), camera("colour", size, (-0.015, 0.0, forward))
    depth, confidence = align_depth(*plane(source, 0.7), source, target)
    assert depth.shape == (size[1], size[0])
    np.testing.assert_allclose(depth, 0.7 - forward, rtol=1e-6)
    np.testing.assert_array_equal(confidence, 1.0)


def test_points_are_found_where_the_other_camera_sees_them():
    source, target = camera(), camera("colour", (320, 180), (-0.015, 0.002, 0.01))
    depth = np.full((120, 212), np.nan, np.float32)
    depth[60, 100] = 0.5
    aligned, confidence = align_depth(depth, np.where(np.isfinite(depth), 0.25, 0.0), source, target)
    # The middle of the pixel, by hand.
    fx, fy, cx, cy = source.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]]
    point = np.array([(100.5 - cx) / fx * 0.5, (60.5 - cy) / fy * 0.5, 0.5])
    u, v = target.project(point)[0]
    rows, columns = np.nonzero(np.isfinite(aligned))
    assert (np.abs(columns + 0.5 - u) < 2.5).all()
    assert (np.abs(rows + 0.5 - v) < 2.5).all()
    assert aligned[int(v), int(u)] == pytest.approx(0.49, abs=1e-6)
    np.testing.assert_array_equal(confidence[rows, columns], np.float32(0.25))


def test_the_nearest_surface_counts_and_what_is_hidden_is_a_hole():
    source, target = camera(), camera(place=(-0.1, 0.0, 0.0))
    depth, confidence = plane(source, 1.0)
    depth[30:90, 80:130] = 0.4
    aligned, _ = align_depth(depth, confidence, source, target)
    f = source.intrinsics[0, 0]
    near, far = f * 0.1 / 0.4, f * 0.1 / 1.0  # shifts to the right, pixels
    left, right = 80 + near, 130 + near
    np.testing.assert_allclose(aligned[40:80, int(left) + 2 : int(right) - 2], 0.4)
    # The target sees more of the far plane on the left of the near one than the source does.
    hole = aligned[40:80, int(80 + far) + 2 : int(left) - 2]
    assert hole.shape[1] > 3
    assert np.isnan(hole).all()
    np.testing.assert_allclose(aligned[40:80, int(right) + 2 :], 1.0)
    aligned, confidence = align_depth(*plane(source, np.nan), source, target)
    assert np.isnan(aligned).all()
    assert not confidence.any()

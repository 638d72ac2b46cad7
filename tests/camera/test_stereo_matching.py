"""Stereo images of noise shifted by known disparities, and depth in the pixels of another camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pepperscene.camera import (
    Camera,
    DepthCamera,
    StereoMatching,
    align_depth,
    load_lens,
    load_sensor,
    match_depth,
)

WIDTH, HEIGHT = 240, 120
BASELINE_M = 0.05
RNG = np.random.default_rng(3)


@pytest.fixture(scope="module")
def depth_camera():
    sensor = load_sensor("realsense_d435_infrared").with_size(WIDTH, HEIGHT)
    left = Camera(load_lens("realsense_d435_infrared"), sensor)
    return DepthCamera(left, BASELINE_M, matching=StereoMatching(disparities=64))


def texture():
    """`(h, 2 w)` noise without frequencies that pixels cannot hold; it repeats along rows."""
    noise = gaussian_filter(RNG.standard_normal((HEIGHT, 2 * WIDTH)), 1.2, mode="wrap")
    return 128.0 + 40.0 * noise / noise.std()


def shifted(image, pixels):
    """An image moved to the left by any number of pixels, exactly, by its Fourier transform."""
    frequency = np.fft.fftfreq(image.shape[1])
    return np.fft.ifft(np.fft.fft(image, axis=1) * np.exp(2j * np.pi * frequency * pixels), axis=1).real


def picture(image):
    noise = RNG.normal(0.0, 1.0, (HEIGHT, WIDTH))
    return np.clip(np.rint(image[:, :WIDTH] + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("disparity", [6.0, 20.5, 33.8])
def test_a_plane_has_its_disparity_without_bias_to_whole_pixels(depth_camera, disparity):
    image = texture()
    matched = match_depth(picture(image), picture(shifted(image, disparity)), depth_camera)
    # Points outside the right image are holes, others are found.
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[5:-5, int(disparity) + 6 : -6] = True
    assert np.isnan(matched.depth_m[:, : int(disparity) - 1]).all()
    assert np.isfinite(matched.depth_m[inside]).mean() > 0.99
    found = depth_camera.disparity_m / matched.depth_m[inside]
    assert np.nanmean(found) == pytest.approx(disparity, abs=0.005)
    assert np.nanstd(found) < 0.02
    assert matched.confidence[inside].mean() > 0.95
    np.testing.assert_array_equal(matched.confidence == 0, np.isnan(matched.depth_m))


def test_without_refinement_disparities_are_drawn_to_whole_pixels(depth_camera):
    image, raw = texture(), replace(depth_camera, matching=StereoMatching(disparities=64, refined_px=0))
    pair = picture(image), picture(shifted(image, 10.25))
    deviations = [
        np.nanstd(camera.disparity_m / match_depth(*pair, camera).depth_m[5:-5, 20:-6])
        for camera in (depth_camera, raw)
    ]
    assert deviations[1] > 1.5 * deviations[0]


def test_noise_alone_gives_holes(depth_camera):
    left, right = (picture(np.full((HEIGHT, WIDTH), 60.0)) for _ in range(2))
    assert np.isnan(match_depth(left, right, depth_camera).depth_m).mean() > 0.97


def test_a_near_square_hides_a_band_on_its_left(depth_camera):
    near, far = texture(), texture()
    left, right = far[:, :WIDTH].copy(), shifted(far, 8.0)[:, :WIDTH]
    left[30:90, 100:160] = near[30:90, 100:160]
    right[30:90, 76:136] = near[30:90, 100:160]  # disparity 24
    matched = match_depth(picture(left), picture(right), depth_camera)
    disparity = depth_camera.disparity_m / matched.depth_m
    # The right camera sees the square where the band of 16 pixels beside it would be.
    band = disparity[40:80, 86:98]
    assert (np.isnan(band) | (np.abs(band - 8) > 1)).mean() > 0.9
    assert np.isnan(band).mean() > 0.5
    assert np.nanmedian(disparity[40:80, 110:150]) == pytest.approx(24, abs=0.1)
    assert np.nanmedian(disparity[40:80, 180:220]) == pytest.approx(8, abs=0.1)


def test_colour_images_and_a_limit_of_depth(depth_camera):
    image = texture()
    pair = [np.repeat(picture(x)[..., None], 3, axis=-1) for x in (image, shifted(image, 20.0))]
    depth = match_depth(*pair, depth_camera).depth_m
    true = depth_camera.disparity_m / 20.0
    assert np.nanmedian(depth) == pytest.approx(true, rel=1e-2)
    for farthest, share in ((1.1 * true, 0.8), (0.9 * true, 0.0)):
        limited = replace(depth_camera, matching=replace(depth_camera.matching, farthest_m=farthest))
        assert np.isfinite(match_depth(*pair, limited).depth_m).mean() == pytest.approx(share, abs=0.2)


def test_images_of_different_sizes_are_rejected(depth_camera):
    with pytest.raises(ValueError, match="different sizes"):
        match_depth(np.zeros((4, 4), np.uint8), np.zeros((4, 5), np.uint8), depth_camera)


def looking(name="infrared", size=(212, 120), place=(0.0, 0.0, 0.0)):
    pose = np.eye(4)
    pose[:3, 3] = place
    sensor = load_sensor(f"realsense_d435_{name}").with_size(*size)
    return Camera(load_lens(f"realsense_d435_{name}"), sensor, pose)


def plane(of, z):
    return np.full((of.height, of.width), z, np.float32), np.ones((of.height, of.width), np.float32)


def test_the_same_camera_keeps_the_image():
    depth, confidence = plane(looking(), 0.7)
    aligned = align_depth(depth, confidence, looking(), looking())
    assert aligned[0] is depth
    assert aligned[1] is confidence


@pytest.mark.parametrize(("size", "forward"), [((320, 180), 0.05), ((106, 60), 0.0)])
def test_a_plane_fills_the_other_image_at_its_own_depth(size, forward):
    source, target = looking(), looking("colour", size, (-0.015, 0.0, forward))
    depth, confidence = align_depth(*plane(source, 0.7), source, target)
    assert depth.shape == (size[1], size[0])
    np.testing.assert_allclose(depth, 0.7 - forward, rtol=1e-6)
    np.testing.assert_array_equal(confidence, 1.0)


def test_points_are_found_where_the_other_camera_sees_them():
    source, target = looking(), looking("colour", (320, 180), (-0.015, 0.002, 0.01))
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
    source, target = looking(), looking(place=(-0.1, 0.0, 0.0))
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

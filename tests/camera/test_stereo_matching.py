"""Matching of stereo images that are made without the program: noise shifted by known disparities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pepperscene.camera import Camera, DepthCamera, StereoMatching, load_lens, load_sensor, match_depth

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

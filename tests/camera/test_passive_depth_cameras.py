"""The RealSense D405 and the ZED 2i: geometry as in their makers' documents, and the depth of planes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pepperscene.camera import load_lens, match_depth
from pepperscene.recipe.resolve.load import resolve_recipe


@pytest.fixture(scope="module")
def d405():
    return resolve_recipe("realsense_close").depth_camera


@pytest.fixture(scope="module")
def zed():
    return resolve_recipe("zed").depth_camera


def field_deg(pixels: float, focal_px: float) -> float:
    return 2.0 * np.degrees(np.arctan(0.5 * pixels / focal_px))


def test_geometry_of_the_d405(d405):
    # D400 series data sheet: 87 x 58 degrees, 18 mm; librealsense: 0.1 mm.
    assert d405.baseline_m == 0.018
    assert d405.depth_unit_m == pytest.approx(1e-4)
    assert d405.projector is None
    assert d405.left.sensor.line_time_s == 0.0
    mode = d405.left.sensor.with_size(1280, 720)
    focal_px = d405.left.lens.focal_length_m / mode.pixel_pitch_m
    assert field_deg(720, focal_px) == pytest.approx(58.0, abs=0.5)
    # The data sheet's formula for the field of view of a depth image, here at 25 cm.
    half = np.radians(field_deg(1280, focal_px) / 2)
    assert np.degrees(np.arctan(np.tan(half) - 0.018 / 0.25) + half) == pytest.approx(87.0, abs=0.5)
    # Nearest depths of the data sheet: 100 mm at 1280 columns and 70 mm at 848, here for 128 disparities.
    for columns, nearest_m in ((1280, 0.1), (848, 0.07)):
        focal_px = d405.left.intrinsics[0, 0] * columns / 848
        assert focal_px * 0.018 / d405.matching.disparities == pytest.approx(nearest_m, rel=0.15)


def test_geometry_of_the_zed(zed):
    assert zed.baseline_m == pytest.approx(0.12)
    assert zed.depth_unit_m == pytest.approx(1e-3)
    assert zed.left.sensor.pixel_pitch_m == pytest.approx(4e-6)
    assert zed.left.sensor.line_time_s == pytest.approx(25.6e-6)
    # Stereolabs' forum: rectified images of 2208 columns of 2 um show 92.8 degrees.
    assert field_deg(2208, load_lens("zed_2i_2mm").focal_length_m / 2e-6) == pytest.approx(92.8, abs=0.5)
    # From 0.3 to 20 m.
    assert zed.disparity_m / zed.matching.disparities == pytest.approx(0.3, rel=0.02)
    assert zed.matching.farthest_m == 20.0


@pytest.mark.parametrize(("name", "distance_m", "most"), [("d405", 0.2, 0.014), ("zed", 1.0, 0.01)])
def test_a_textured_plane_is_measured_within_the_published_error(name, distance_m, most, request):
    # D405: 1.4 % at 20 cm; ZED 2i: 1 % up to 3 m. Texture of one deviation of 3 codes, noise of one code.
    camera = request.getfixturevalue(name)
    rng, height = np.random.default_rng(4), 96
    width, disparity = camera.left.width, camera.disparity_m / distance_m
    noise = gaussian_filter(rng.standard_normal((height, 2 * width)), 0.8, mode="wrap")
    texture = 110.0 + 3.0 * noise / noise.std()
    frequency = np.fft.fftfreq(2 * width)
    moved = np.fft.ifft(np.fft.fft(texture, axis=1) * np.exp(2j * np.pi * frequency * disparity), axis=1).real
    left, right = (
        np.clip(np.rint(image[:, :width] + rng.normal(0.0, 1.0, (height, width))), 0, 255).astype(np.uint8)
        for image in (texture, moved)
    )
    depth = match_depth(left, right, camera).depth_m[8:-8, int(disparity) + 8 : -8]
    assert np.isfinite(depth).mean() > 0.95
    error = depth[np.isfinite(depth)] / distance_m - 1.0
    assert np.sqrt((error**2).mean()) < most
    assert abs(np.median(error)) < 0.1 * most

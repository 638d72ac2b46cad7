"""Camera geometry: pixels to rays and back, and metadata."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pepperscene.camera import (
    Camera,
    Distortion,
    FisheyeDistortion,
    Motion,
    load_flash,
    load_lens,
    load_sensor,
    look_at,
)
from pepperscene.camera.metadata import CameraMetadata
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder

SENSOR = load_sensor("ueye_ui5250re")
PINHOLE = load_lens("lensagon_cmfa0420nd")
BARREL = replace(PINHOLE, distortion=Distortion(-0.107, 0.043, 0.001, -0.0005))
POSE = look_at((0.3, -0.4, 1.1), (0.0, 0.1, 1.3))
LENSES = [path.stem for path in sorted((shipped_folder("materials") / "lenses").glob("*.toml"))]
FLASH = load_flash("led_matrix_200klx")
# The same field in fewer, larger pixels.
COARSE = replace(SENSOR, columns=80, rows=60, pitch_m=10 * SENSOR.pitch_m)


def test_intrinsics_field_of_view_and_aperture_of_the_papers_camera():
    # 4.16 mm over pixels of 2 x 4.5 um; the optical axis meets the middle of 800 x 600.
    camera = Camera(PINHOLE, SENSOR)
    expected = [[4160 / 9, 0, 400], [0, 4160 / 9, 300], [0, 0, 1]]
    np.testing.assert_allclose(camera.intrinsics, expected, rtol=1e-12)
    slopes = camera.ray_slopes()
    assert slopes.shape == (601, 801, 2)
    # 7.2 x 5.4 mm behind 4.16 mm: 81.7 x 66.0 degrees.
    width, height = np.rad2deg(np.arctan(slopes[-1, -1]) - np.arctan(slopes[0, 0]))
    assert width == pytest.approx(81.7, abs=0.1)
    assert height == pytest.approx(66.0, abs=0.1)
    # 4.16 mm at f/2: 2.08 mm across.
    assert camera.aperture_radius_m == pytest.approx(1.04e-3)
    # The pulse over the exposure.
    for exposure_s, flash, duty in ((200e-6, FLASH, 0.25), (20e-6, FLASH, 1), (50e-6, None, 0)):
        assert Camera(PINHOLE, SENSOR, exposure_s=exposure_s, flash=flash).flash_duty == pytest.approx(duty)


def test_projection_of_a_known_point():
    # 40 cm ahead, 10 cm to the right and 5 cm up of a camera at the origin that looks along +y.
    camera = Camera(PINHOLE, SENSOR, look_at((0, 0, 0), (0, 1, 0)))
    expected = [[400 + 4160 / 9 * 0.25, 300 - 4160 / 9 * 0.125]]
    np.testing.assert_allclose(camera.project([[0.1, 0.4, 0.05]]), expected, rtol=1e-12)


def test_principal_offset_shifts_the_image():
    # 90 um to the right and 45 um up on the sensor are 10 and 5 pixels of 9 um.
    camera = Camera(replace(BARREL, principal_offset_m=(90e-6, -45e-6)), SENSOR)
    np.testing.assert_allclose(camera.intrinsics[:2, 2], [410, 295])
    np.testing.assert_allclose(camera.project([[0, 0, 1.0]]), [[410, 295]])
    np.testing.assert_allclose(camera.ray_slopes()[295, 410], 0, atol=1e-12)
    # The whole image moves, distortion included.
    points = np.array([[0.3, -0.2, 1.0], [-0.4, 0.1, 0.7]])
    moved = camera.project(points) - Camera(BARREL, SENSOR).project(points)
    np.testing.assert_allclose(moved, [[10, -5], [10, -5]], atol=1e-9)


def test_pixel_centres_are_between_the_corners():
    camera = Camera(BARREL, replace(SENSOR, columns=200, rows=150))
    corners, directions = camera.ray_slopes(), camera.pixel_directions()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-12)
    centres = directions[..., :2] / directions[..., 2:]
    middle = (corners[1:, 1:] + corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:]) / 4
    np.testing.assert_allclose(middle, centres, rtol=0, atol=2e-6)  # 1e-3 of a pixel


@pytest.mark.parametrize("name", LENSES)
def test_points_on_the_rays_of_pixel_corners_are_projected_to_them(name):
    # Required of every shipped lens: 0.01 px over the whole frame. Newton's iteration leaves rounding.
    camera = Camera(load_lens(name), COARSE, POSE)
    slopes = camera.ray_slopes().reshape(-1, 2)
    depth_z = np.linspace(0.05, 20.0, len(slopes))[:, None]
    points = np.column_stack([slopes, np.ones(len(slopes))]) * depth_z
    pixels = camera.project(points @ camera.pose[:3, :3].T + camera.pose[:3, 3])
    v, u = np.mgrid[0 : camera.height + 1, 0 : camera.width + 1]
    np.testing.assert_allclose(pixels, np.column_stack([u.ravel(), v.ravel()]), rtol=0, atol=1e-8)


def test_invisible_points_project_to_nan_without_warnings():
    camera = Camera(replace(PINHOLE, distortion=Distortion(k1=-0.1)), SENSOR)
    points = [[0, 0, -1.0], [0, 0, 0.0], [5, 0, 1.0], [0, 0, 1.0]]  # r = 5 is beyond the fold at r = 1.83
    pixels = camera.project(points)
    assert np.isnan(pixels[:3]).all()
    np.testing.assert_allclose(pixels[3], [400, 300])


def test_at_pose_changes_only_the_pose():
    camera = Camera(BARREL, SENSOR, flash=FLASH)
    moved = camera.at_pose(POSE)
    np.testing.assert_array_equal(moved.pose, POSE)
    assert (moved.lens, moved.sensor, moved.flash) == (camera.lens, camera.sensor, camera.flash)
    assert moved.ray_slopes() is camera.ray_slopes()
    with pytest.raises(ValueError, match="read-only"):
        moved.pose[0, 0] = 2


def test_metadata_describe_the_camera():
    lens = load_lens("lensagon_cmfa0420nd_typical_distortion")
    metadata = Camera(lens, SENSOR, POSE, flash=FLASH, focus_m=0.4).to_metadata()
    assert (metadata["width"], metadata["height"], metadata["exposure_s"]) == (800, 600, 50e-6)
    np.testing.assert_array_equal(metadata["pose"], POSE)
    assert (metadata["focus_m"], metadata["vignetting"]) == (0.4, True)
    assert (metadata["bits"], metadata["gain"]) == (10, 1.0)
    assert {metadata["lens"], metadata["sensor"]} == {lens.name, SENSOR.name}
    plain = Camera(PINHOLE, SENSOR).to_metadata()
    assert (plain["focus_m"], plain["vignetting"]) == (None, False)


@pytest.mark.parametrize(
    ("sensor", "distortion"),
    [
        (replace(COARSE, line_time_s=2e-5), Distortion(-0.107, 0.043, 0.001, -0.0005, k4=0.01)),
        (COARSE, FisheyeDistortion(k1=0.01)),
        (load_sensor("generic_line_scanner_vnir").with_size(64, 20), Distortion()),
    ],
    ids=["rolling shutter", "fisheye", "line scanner"],
)
def test_metadata_give_the_geometry_back(sensor, distortion):
    lens = replace(PINHOLE, distortion=distortion, principal_offset_m=(9e-6, -18e-6), fy_over_fx=1.01)
    motion = Motion(np.array([0.2, 0.05, 0.0]), np.array([0.1, -0.3, 0.2]))
    camera = Camera(lens, sensor, POSE, motion=motion)
    content = json.loads(json.dumps(camera.to_metadata()))
    recorded = Camera.from_metadata(content)
    assert CameraMetadata.model_validate(content).width == camera.width == recorded.width
    assert recorded.to_metadata()["motion"] == content["motion"]
    ahead = np.random.default_rng(5).uniform((-0.3, -0.3, 0.7), (0.3, 0.3, 1.3), (50, 3))
    points = POSE[:3, 3] + ahead @ POSE[:3, :3].T
    np.testing.assert_allclose(recorded.project(points), camera.project(points), rtol=0, atol=1e-7)
    np.testing.assert_allclose(recorded.pixel_directions(), camera.pixel_directions(), atol=1e-12)
    np.testing.assert_array_equal(recorded.label_poses([0.0, 7.5]), camera.label_poses([0.0, 7.5]))


def test_raises_on_an_invalid_pose_and_on_a_focus_within_the_focal_length():
    for pose in (np.eye(3), np.diag([2.0, 1, 1, 1]), np.diag([-1.0, 1, 1, 1]), np.full((4, 4), np.nan)):
        with pytest.raises(ValueError, match="pose"):
            Camera(PINHOLE, SENSOR, pose)
    for focus_m in (-0.4, 4.16e-3, np.inf, np.nan):
        with pytest.raises(InputError, match=r"focus_m.*beyond the focal length"):
            Camera(PINHOLE, SENSOR, focus_m=focus_m)

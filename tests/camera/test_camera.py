"""Camera geometry: pixels to rays and back, and metadata."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
# The same field in fewer, larger pixels, so that many lenses can be tried.
COARSE = replace(SENSOR, columns=80, rows=60, pitch_m=10 * SENSOR.pitch_m)
both_lenses = pytest.mark.parametrize("lens", [PINHOLE, BARREL], ids=["pinhole", "barrel"])


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


def test_flash_duty_is_the_pulse_over_the_exposure():
    assert Camera(PINHOLE, SENSOR, exposure_s=200e-6, flash=FLASH).flash_duty == pytest.approx(0.25)
    assert Camera(PINHOLE, SENSOR, exposure_s=20e-6, flash=FLASH).flash_duty == 1
    assert Camera(PINHOLE, SENSOR).flash_duty == 0


@both_lenses
def test_points_along_pixel_rays_project_to_pixel_centres(lens):
    camera = Camera(lens, SENSOR, POSE)
    directions = camera.pixel_directions()
    assert directions.shape == (600, 800, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-12)
    rows, columns = np.mgrid[0:600:37, 0:800:41]
    distance = np.random.default_rng(1).uniform(0.1, 5, rows.shape)[..., None]
    points = directions[rows, columns] * distance @ camera.pose[:3, :3].T + camera.pose[:3, 3]
    expected = np.stack([columns + 0.5, rows + 0.5], axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(camera.project(points.reshape(-1, 3)), expected, rtol=0, atol=1e-8)


@both_lenses
def test_pixel_centres_are_between_the_corners(lens):
    camera = Camera(lens, SENSOR)
    corners, directions = camera.ray_slopes(), camera.pixel_directions()
    centres = directions[..., :2] / directions[..., 2:]
    middle = (corners[1:, 1:] + corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:]) / 4
    np.testing.assert_allclose(middle, centres, rtol=0, atol=2e-6)  # 1e-3 of a pixel


def round_trip_error_px(camera):
    """Largest distance between pixel corners and the projections of points on their rays."""
    slopes = camera.ray_slopes().reshape(-1, 2)
    depth_z = np.linspace(0.05, 20.0, len(slopes))[:, None]
    points = np.column_stack([slopes, np.ones(len(slopes))]) * depth_z
    pixels = camera.project(points @ camera.pose[:3, :3].T + camera.pose[:3, 3])
    v, u = np.mgrid[0 : camera.height + 1, 0 : camera.width + 1]
    return np.abs(pixels - np.column_stack([u.ravel(), v.ravel()])).max()


@pytest.mark.parametrize("name", LENSES)
def test_shipped_lens_round_trip_is_exact_up_to_the_border(name):
    # Required: 0.01 px over the whole frame. Newton's iteration leaves rounding.
    assert round_trip_error_px(Camera(load_lens(name), SENSOR, POSE)) < 1e-8


@st.composite
def lenses(draw):
    """Brown-Conrady lenses that can be inverted over the sensor, their axis up to 0.5 mm off its middle."""
    distortion = Distortion(
        k1=draw(st.floats(-0.07, 0.2)), k2=draw(st.floats(0, 0.1)), k3=draw(st.floats(0, 0.02)),
        p1=draw(st.floats(-0.005, 0.005)), p2=draw(st.floats(-0.005, 0.005)),
    )  # fmt: skip
    offset = (draw(st.floats(-5e-4, 5e-4)), draw(st.floats(-5e-4, 5e-4)))
    return replace(PINHOLE, distortion=distortion, principal_offset_m=offset)


@given(lens=lenses())
@settings(max_examples=60, deadline=None)
def test_any_lens_round_trip_is_exact(lens):
    assert round_trip_error_px(Camera(lens, COARSE, POSE)) < 1e-8


@given(lens=lenses())
@settings(max_examples=40, deadline=None)
def test_projection_matches_opencv(lens):
    camera = Camera(lens, SENSOR, POSE)
    d = lens.distortion
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 19), np.linspace(-0.7, 0.7, 15))
    points = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) * 0.4
    world = points @ POSE[:3, :3].T + POSE[:3, 3]
    to_camera = np.linalg.inv(POSE)
    rotation, _ = cv2.Rodrigues(to_camera[:3, :3])
    coefficients = np.array([d.k1, d.k2, d.p1, d.p2, d.k3])
    expected, _ = cv2.projectPoints(world, rotation, to_camera[:3, 3], camera.intrinsics, coefficients)
    # With the same matrix, both count from the outer edge of the first pixel.
    np.testing.assert_allclose(camera.project(world), expected[:, 0], rtol=0, atol=1e-6)


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


def test_metadata_is_json_and_describes_the_geometry():
    lens = load_lens("lensagon_cmfa0420nd_typical_distortion")
    lens = replace(lens, principal_offset_m=(9e-6, -18e-6))
    metadata = json.loads(json.dumps(Camera(lens, SENSOR, POSE, flash=FLASH, focus_m=0.4).to_metadata()))
    assert (metadata["width"], metadata["height"], metadata["exposure_s"]) == (800, 600, 50e-6)
    np.testing.assert_array_equal(metadata["pose"], POSE)
    assert Distortion(**metadata["distortion"]) == lens.distortion
    assert (metadata["cx"], metadata["cy"]) == pytest.approx((401, 298))
    assert metadata["principal_offset_m"] == [9e-6, -18e-6]
    assert (metadata["focus_m"], metadata["vignetting"]) == (0.4, True)
    assert (metadata["bits"], metadata["gain"]) == (10, 1.0)
    assert {metadata["lens"], metadata["sensor"]} == {lens.name, SENSOR.name}
    plain = Camera(PINHOLE, SENSOR).to_metadata()
    assert plain["focus_m"] is None
    assert plain["vignetting"] is False


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
    points = (
        POSE[:3, 3]
        + (np.random.default_rng(5).uniform((-0.3, -0.3, 0.7), (0.3, 0.3, 1.3), (50, 3))) @ POSE[:3, :3].T
    )
    np.testing.assert_allclose(recorded.project(points), camera.project(points), rtol=0, atol=1e-7)
    np.testing.assert_allclose(recorded.pixel_directions(), camera.pixel_directions(), atol=1e-12)
    np.testing.assert_array_equal(recorded.label_poses([0.0, 7.5]), camera.label_poses([0.0, 7.5]))


@pytest.mark.parametrize(
    "pose", [np.eye(3), np.diag([2.0, 1, 1, 1]), np.diag([-1.0, 1, 1, 1]), np.full((4, 4), np.nan)]
)
def test_raises_on_invalid_pose(pose):
    with pytest.raises(ValueError, match="pose"):
        Camera(PINHOLE, SENSOR, pose)


@pytest.mark.parametrize("focus", [0.0, -0.4, 4.16e-3, np.inf, np.nan])
def test_raises_on_focus_within_the_focal_length(focus):
    with pytest.raises(InputError, match=r"focus_m.*beyond the focal length"):
        Camera(PINHOLE, SENSOR, focus_m=focus)


def test_raises_on_distortion_that_cannot_be_inverted_over_the_image():
    with pytest.raises(InputError, match=r"distortion.*invertible over the whole image"):
        Camera(replace(PINHOLE, distortion=Distortion(k1=-0.3)), SENSOR)

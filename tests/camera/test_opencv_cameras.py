"""Projection and distortion against OpenCV, which counts the centre of the first pixel as (0, 0)."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.camera import (
    Camera,
    Distortion,
    FisheyeDistortion,
    load_sensor,
    look_at,
    relative_illumination,
)
from pepperscene.camera.optics.calibration import CameraCalibration
from pepperscene.camera.optics.distortion import MODELS, make_distortion
from pepperscene.errors import InputError

# Typical calibrations: a machine-vision lens, a depth camera's factory calibration and a fisheye lens.
COEFFICIENTS = {
    "plumb_bob": (-0.28, 0.09, 0.0012, -0.0008, -0.012),
    "rational_polynomial": (0.52, -0.08, 0.0003, -0.0004, 0.003, 0.86, -0.03, 0.004),
    "equidistant": (0.035, -0.012, 0.006, -0.0015),
}
SENSOR = load_sensor("generic_rgb")
each_model = pytest.mark.parametrize("model", MODELS)


def camera_of(model, coefficients=None, fx=900.0, fy=912.0, cx=655.3, cy=471.8):
    coefficients = COEFFICIENTS[model] if coefficients is None else coefficients
    calibration = CameraCalibration(SENSOR.columns, SENSOR.rows, fx, fy, cx, cy, model, coefficients)
    lens = calibration.lens("test", SENSOR.pixel_pitch_m, 2.0, 0.9)
    return Camera(lens, SENSOR, pose=look_at([0.3, -0.8, 1.2], [0.1, 0.4, 1.0]))


def project_with_opencv(camera, model, coefficients, points, fx=900.0, fy=912.0, cx=655.3, cy=471.8):
    """Pixel coordinates `(n, 2)` in this package's convention."""
    rotation = camera.pose[:3, :3].T
    vector, shift = cv2.Rodrigues(rotation)[0], -rotation @ camera.pose[:3, 3]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    pixels, _ = project(points[:, None], vector, shift, matrix, np.array(coefficients))
    return pixels.reshape(-1, 2) + 0.5


def points_in_view(camera, count=1000):
    """World points `(n, 3)` along rays through random places of the image."""
    rng = np.random.default_rng(7)
    rows, columns = rng.integers(0, camera.height, count), rng.integers(0, camera.width, count)
    rays = camera.pixel_directions()[rows, columns] * rng.uniform(0.2, 5.0, (count, 1))
    return rays @ camera.pose[:3, :3].T + camera.pose[:3, 3]


@each_model
def test_1000_points_are_projected_as_by_opencv(model):
    camera = camera_of(model)
    points = points_in_view(camera)
    expected = project_with_opencv(camera, model, COEFFICIENTS[model], points)
    np.testing.assert_allclose(camera.project(points), expected, rtol=0, atol=1e-6)


@each_model
def test_rays_of_pixel_centres_are_projected_back_to_them(model):
    camera = camera_of(model)
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    points = (camera.pixel_directions() @ camera.pose[:3, :3].T + camera.pose[:3, 3])[::37, ::41]
    centres = np.stack([u, v], axis=-1)[::37, ::41]
    np.testing.assert_allclose(camera.project(points), centres.reshape(-1, 2), rtol=0, atol=1e-6)


@given(coefficients=st.tuples(*4 * [st.floats(-0.02, 0.05)]), half_angle=st.floats(5, 80))
def test_undistort_inverts_the_fisheye_model(coefficients, half_angle):
    distortion = FisheyeDistortion(*coefficients)
    radius = min(np.tan(np.radians(half_angle)), 0.95 * distortion.fold_radius)
    ideal = np.random.default_rng(1).uniform(-1, 1, (200, 2)) * radius / np.sqrt(2)
    back = distortion.undistort(distortion.distort(ideal))
    np.testing.assert_allclose(back, ideal, rtol=1e-8, atol=1e-9)


@each_model
def test_area_scale_is_the_jacobian_of_the_model(model):
    distortion = make_distortion(model, COEFFICIENTS[model])
    ideal, step = np.random.default_rng(2).uniform(-0.8, 0.8, (500, 2)), 1e-5
    ideal[0] = 0
    ends = np.array([[distortion.distort(ideal + sign * d) for d in step * np.eye(2)] for sign in (-1, 1)])
    jacobian = np.moveaxis((ends[1] - ends[0]) / (2 * step), 1, 0)
    np.testing.assert_allclose(distortion.area_scale(ideal), np.linalg.det(jacobian), rtol=0, atol=1e-8)


def test_fold_radii_of_closed_forms():
    # theta (1 + k1 theta^2) turns where 1 + 3 k1 theta^2 = 0.
    assert FisheyeDistortion(k1=-1 / 3).fold_radius == pytest.approx(np.tan(1.0), rel=1e-12)
    assert FisheyeDistortion(k1=-1 / 9).fold_radius == np.inf  # 1.73 rad: beyond a right angle
    assert FisheyeDistortion().fold_radius == np.inf
    # r / (1 + k4 r^2) turns at r = 1 / sqrt(k4), and 1 / (1 + k4 r^2) has a pole where k4 r^2 = -1.
    assert Distortion(k4=0.25).fold_radius == pytest.approx(2.0, rel=1e-9)
    assert Distortion(k4=-0.25).fold_radius == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("model", ["rational_polynomial", "equidistant"])
def test_fold_radius_is_the_first_maximum_of_the_image_radius(model):
    folding = {
        "rational_polynomial": (-0.3, 0.02, 0, 0, 0.01, 0.2, 0.1, 0.01),
        "equidistant": (-0.3, 0.01, 0, 0),
    }
    distortion = make_distortion(model, folding[model])
    radius = np.linspace(1e-4, 6, 60_001)
    image = distortion.distort(np.stack([radius, 0 * radius], axis=-1))[:, 0]
    assert distortion.fold_radius == pytest.approx(radius[np.argmax(np.diff(image) < 0)], abs=3e-4)
    beyond = 1.01 * distortion.distort([distortion.fold_radius, 0.0])
    with pytest.raises(ValueError, match="cannot be inverted"):
        distortion.undistort([[0.1, 0.0], beyond])


def test_equidistant_pixels_get_the_light_of_their_solid_angle():
    # theta_d = theta has the area scale theta cos^3(theta) / sin(theta), so cos^4 over it is this.
    camera = camera_of("equidistant", (0, 0, 0, 0), fx=700.0, fy=700.0)
    cosine = camera.pixel_directions()[..., 2]
    theta = np.arccos(cosine)
    expected = cosine * np.sin(theta) / theta
    np.testing.assert_allclose(relative_illumination(camera), expected, rtol=1e-7, atol=1e-7)


def test_a_fisheye_image_beyond_a_right_angle_is_refused_with_its_angle():
    with pytest.raises(InputError, match=r"slope \(-1\.312, -0\.945\) is at 92\.6 degrees from the axis"):
        camera_of("equidistant", (0, 0, 0, 0), fx=500.0, fy=500.0)
    with pytest.raises(InputError, match=r"a corner at 8[5-9]\.. degrees .* at most 85 are allowed"):
        camera_of("equidistant", (0, 0, 0, 0), fx=530.0, fy=530.0)


@each_model
def test_json_holds_the_model_and_its_coefficients(model):
    content = make_distortion(model, COEFFICIENTS[model]).to_json()
    name = content.pop("model", "plumb_bob")
    assert (name, tuple(content), tuple(content.values())) == (model, MODELS[model], COEFFICIENTS[model])
    plain = Distortion(-0.1, 0.02, 0.001, -0.002, 0.003).to_json()
    assert plain == {"k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002, "k3": 0.003}

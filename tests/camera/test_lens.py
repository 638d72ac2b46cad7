"""Lenses: distortion and projection against formulas and OpenCV, their inverse, and vignetting."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.camera import (
    AngularProfile,
    Camera,
    Distortion,
    FisheyeDistortion,
    Lens,
    load_lens,
    load_sensor,
    look_at,
    relative_illumination,
)
from pepperscene.camera.optics.calibration import CameraCalibration
from pepperscene.camera.optics.distortion import MODELS, make_distortion
from pepperscene.errors import InputError

TYPICAL = load_lens("lensagon_cmfa0420nd_typical_distortion")


def disc(radius):
    """`(40 x 15, 2)` slopes over a disc."""
    angle, length = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(0, radius, 15))
    return np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1).reshape(-1, 2)


# Computed by hand from the formula in OpenCV's documentation of calib3d (plumb bob):
# x'' = x' (1 + k1 r2 + k2 r4 + k3 r6) + 2 p1 x' y' + p2 (r2 + 2 x'2)
# y'' = y' (1 + k1 r2 + k2 r4 + k3 r6) + p1 (r2 + 2 y'2) + 2 p2 x' y'
@pytest.mark.parametrize(
    ("distortion", "ideal", "distorted"),
    [
        (Distortion(k1=0.1), (1.0, 0.0), (1.1, 0.0)),
        (Distortion(k1=-0.2, k2=0.1), (0.0, 0.5), (0.0, 0.478125)),
        (Distortion(k3=0.001), (1.0, 1.0), (1.008, 1.008)),
        (Distortion(p1=0.01), (1.0, 2.0), (1.04, 2.13)),
        (Distortion(p2=0.01), (1.0, 2.0), (1.07, 2.04)),
        (Distortion(-0.1, 0.02, 0.001, -0.002, -0.001), (0.6, -0.8), (0.547, -0.731)),
    ],
)
def test_distortion_of_known_points(distortion, ideal, distorted):
    np.testing.assert_allclose(distortion.distort(ideal), distorted, rtol=0, atol=1e-15)


@given(
    k1=st.floats(-0.2, 0.3), k2=st.floats(0.0, 0.1), k3=st.floats(0.0, 0.02),
    p1=st.floats(-0.005, 0.005), p2=st.floats(-0.005, 0.005),
)  # fmt: skip
def test_undistort_inverts_distort(k1, k2, k3, p1, p2):
    distortion = Distortion(k1, k2, p1, p2, k3)
    ideal = disc(min(1.0, 0.9 * distortion.fold_radius))
    np.testing.assert_allclose(distortion.undistort(distortion.distort(ideal)), ideal, rtol=0, atol=1e-9)


def test_fold_radius_is_where_the_distorted_radius_is_largest():
    assert Distortion().fold_radius == math.inf
    assert Distortion(k1=0.1, k2=0.1).fold_radius == math.inf
    # 1 + 3 k1 r^2 = 0 at r = 1, where x = 2/3 is the outermost point of the image.
    assert Distortion(k1=-1 / 3).fold_radius == pytest.approx(1.0, rel=1e-12)
    assert Distortion(k2=-1 / 80).fold_radius == pytest.approx(2.0, rel=1e-9)
    assert Distortion(k3=-1 / 7).fold_radius == pytest.approx(1.0, rel=1e-9)
    # Two extrema, s = 1 and s = 2: (1 - s)(1 - s/2) = 1 - 1.5 s + 0.5 s^2; the first counts.
    assert Distortion(k1=-0.5, k2=0.1).fold_radius == pytest.approx(1.0, rel=1e-9)


def test_undistort_raises_beyond_the_fold():
    folding = Distortion(k1=-1 / 3)
    inner = folding.undistort([0.66, 0.0])[0]
    assert inner * (1 - inner**2 / 3) == pytest.approx(0.66)
    with pytest.raises(ValueError, match="cannot be inverted"):
        folding.undistort([[0.1, 0.0], [0.67, 0.0]])


def test_vignetting_decreases_outwards_and_is_held():
    ideal = load_lens("lensagon_cmfa0420nd")
    assert (ideal.vignetting, ideal.principal_offset_m) == (None, (0.0, 0.0))
    relative = TYPICAL.vignetting.at(np.deg2rad(np.arange(0.0, 90.0)))
    assert relative[:15].min() == 1
    assert np.all(np.diff(relative) <= 0)
    assert relative[-1] == relative[50] == pytest.approx(0.7)


def test_raises_on_invalid_lens():
    with pytest.raises(ValueError, match="focal length"):
        Lens("invalid", 0.0, 2.0)
    with pytest.raises(ValueError, match="finite"):
        Distortion(k1=math.nan)
    with pytest.raises(ValueError, match="principal point"):
        Lens("invalid", 4e-3, 2.0, principal_offset_m=(0.0, math.inf))


def test_profile_is_zero_or_held_beyond_its_last_angle():
    angle, relative = np.array([0.0, 0.5, 1.0]), np.array([1.0, 0.8, 0.4])
    at = [0.25, 1.0, 1.01, 1.5]
    np.testing.assert_allclose(AngularProfile(angle, relative).at(at), [0.9, 0.4, 0, 0])
    np.testing.assert_allclose(AngularProfile(angle, relative, "hold").at(at), [0.9, 0.4, 0.4, 0.4])
    for angle, relative in (
        ([0.1, 1], [1, 0]), ([0, 1, 1], [1, 1, 0]), ([0, np.nan], [1, 0]), ([0, 2], [1, 0]), ([0], [1]),
        ([0, 1], [0.5, 0]), ([0, 1], [1, -1]), ([0, 1], [1, np.inf]), ([0, 1], [1, 1, 1]),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"angles|intensities"):
            AngularProfile(np.array(angle, float), np.array(relative, float))


# Typical calibrations: a machine-vision lens, a depth camera's factory calibration and a fisheye lens.
COEFFICIENTS = {
    "plumb_bob": (-0.28, 0.09, 0.0012, -0.0008, -0.012),
    "rational_polynomial": (0.52, -0.08, 0.0003, -0.0004, 0.003, 0.86, -0.03, 0.004),
    "equidistant": (0.035, -0.012, 0.006, -0.0015),
}
SENSOR = load_sensor("generic_rgb")
QUARTER = replace(SENSOR, columns=320, rows=240)
each_model = pytest.mark.parametrize("model", MODELS)


def camera_of(model, coefficients=None, fx=225.0, fy=228.0, cx=163.8, cy=117.9, sensor=QUARTER):
    coefficients = COEFFICIENTS[model] if coefficients is None else coefficients
    calibration = CameraCalibration(sensor.columns, sensor.rows, fx, fy, cx, cy, model, coefficients)
    lens = calibration.lens("test", sensor.pixel_pitch_m, 2.0, 0.9)
    return Camera(lens, sensor, pose=look_at([0.3, -0.8, 1.2], [0.1, 0.4, 1.0]))


def project_with_opencv(camera, model, coefficients, points, fx=225.0, fy=228.0, cx=163.8, cy=117.9):
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
    camera = camera_of("equidistant", (0, 0, 0, 0), fx=175.0, fy=175.0)
    cosine = camera.pixel_directions()[..., 2]
    theta = np.arccos(cosine)
    expected = cosine * np.sin(theta) / theta
    np.testing.assert_allclose(relative_illumination(camera), expected, rtol=1e-7, atol=1e-7)


def test_a_fisheye_image_beyond_a_right_angle_is_refused_with_its_angle():
    with pytest.raises(InputError, match=r"slope \(-1\.312, -0\.945\) is at 92\.6 degrees from the axis"):
        camera_of("equidistant", (0, 0, 0, 0), 500.0, 500.0, 655.3, 471.8, SENSOR)
    with pytest.raises(InputError, match=r"a corner at 8[5-9]\.. degrees .* at most 85 are allowed"):
        camera_of("equidistant", (0, 0, 0, 0), 530.0, 530.0, 655.3, 471.8, SENSOR)


@each_model
def test_json_holds_the_model_and_its_coefficients(model):
    content = make_distortion(model, COEFFICIENTS[model]).to_json()
    name = content.pop("model", "plumb_bob")
    assert (name, tuple(content), tuple(content.values())) == (model, MODELS[model], COEFFICIENTS[model])
    plain = Distortion(-0.1, 0.02, 0.001, -0.002, 0.003).to_json()
    assert plain == {"k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002, "k3": 0.003}

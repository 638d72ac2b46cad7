"""The camera's geometry: pixels to rays and back."""

from __future__ import annotations

import dataclasses
import json
import warnings

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.camera import Camera, Distortion, load_flash, load_lens, load_sensor, look_at
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder

SENSOR = load_sensor("ueye_ui5250re")
PINHOLE = load_lens("lensagon_cmfa0420nd")
BARREL = dataclasses.replace(PINHOLE, distortion=Distortion(-0.107, 0.043, 0.001, -0.0005))
POSE = look_at((0.3, -0.4, 1.1), (0.0, 0.1, 1.3))
LENSES = [path.stem for path in sorted((shipped_folder("materials") / "lenses").glob("*.toml"))]
# The same field in fewer, larger pixels, so that many lenses can be tried.
COARSE = dataclasses.replace(SENSOR, columns=80, rows=60, pitch_m=10 * SENSOR.pitch_m)


def test_intrinsics_by_hand():
    # 4.16 mm over pixels of 2 x 4.5 um; the optical axis meets the middle of 800 x 600.
    np.testing.assert_allclose(
        Camera(PINHOLE, SENSOR).intrinsics, [[4160 / 9, 0, 400], [0, 4160 / 9, 300], [0, 0, 1]], rtol=1e-12
    )


def test_field_of_view_by_hand():
    slopes = Camera(PINHOLE, SENSOR).ray_slopes()
    assert slopes.shape == (601, 801, 2)
    # 7.2 x 5.4 mm behind 4.16 mm: 81.7 x 66.0 degrees.
    wide, high = np.rad2deg(np.arctan(slopes[-1, -1]) - np.arctan(slopes[0, 0]))
    assert wide == pytest.approx(81.7, abs=0.1)
    assert high == pytest.approx(66.0, abs=0.1)


@pytest.mark.parametrize("lens", [PINHOLE, BARREL], ids=["pinhole", "barrel"])
def test_points_along_a_pixel_s_ray_project_to_its_centre(lens):
    camera = Camera(lens, SENSOR, POSE)
    directions = camera.pixel_directions()
    assert directions.shape == (600, 800, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-12)
    rows, columns = np.mgrid[0:600:37, 0:800:41]
    distance = np.random.default_rng(1).uniform(0.1, 5, rows.shape)[..., None]
    points = directions[rows, columns] * distance @ camera.pose[:3, :3].T + camera.pose[:3, 3]
    pixels = camera.project(points.reshape(-1, 3))
    expected = np.stack([columns + 0.5, rows + 0.5], axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(pixels, expected, rtol=0, atol=1e-8)


def round_trip_px(camera):
    """The largest way, in pixels, between pixels' corners and where points on their rays are projected to."""
    slopes = camera.ray_slopes().reshape(-1, 2)
    distance = np.linspace(0.05, 20.0, len(slopes))[:, None]  # along the optical axis
    points = np.column_stack([slopes, np.ones(len(slopes))]) * distance
    pixels = camera.project(points @ camera.pose[:3, :3].T + camera.pose[:3, 3])
    v, u = np.mgrid[0 : camera.height + 1, 0 : camera.width + 1]
    return np.abs(pixels - np.column_stack([u.ravel(), v.ravel()])).max()


@pytest.mark.parametrize("name", LENSES)
def test_unprojected_pixels_project_to_themselves_up_to_the_border(name):
    # Required: 0.01 px over the whole frame. Newton's iteration leaves rounding.
    assert round_trip_px(Camera(load_lens(name), SENSOR, POSE)) < 1e-8


@st.composite
def lenses(draw):
    """Brown-Conrady lenses that can be inverted over the sensor, their axis up to 0.5 mm off its middle."""
    distortion = Distortion(
        k1=draw(st.floats(-0.07, 0.2)), k2=draw(st.floats(0, 0.1)), k3=draw(st.floats(0, 0.02)),
        p1=draw(st.floats(-0.005, 0.005)), p2=draw(st.floats(-0.005, 0.005)),
    )  # fmt: skip
    offset = (draw(st.floats(-5e-4, 5e-4)), draw(st.floats(-5e-4, 5e-4)))
    return dataclasses.replace(PINHOLE, distortion=distortion, principal_offset_m=offset)


@given(lens=lenses())
@settings(max_examples=60, deadline=None)
def test_any_lens_unprojects_and_projects(lens):
    assert round_trip_px(Camera(lens, COARSE, POSE)) < 1e-8


@given(lens=lenses())
@settings(max_examples=40, deadline=None)
def test_opencv_puts_points_onto_the_same_pixels(lens):
    camera = Camera(lens, SENSOR, POSE)
    d = lens.distortion
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 19), np.linspace(-0.7, 0.7, 15))
    points = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) * 0.4
    world = points @ POSE[:3, :3].T + POSE[:3, 3]
    to_camera = np.linalg.inv(POSE)
    turn, _ = cv2.Rodrigues(to_camera[:3, :3])
    expected, _ = cv2.projectPoints(
        world, turn, to_camera[:3, 3], camera.intrinsics, np.array([d.k1, d.k2, d.p1, d.p2, d.k3])
    )
    # Neither rounds pixels: both count from the outer edge of the first one when given the same matrix.
    np.testing.assert_allclose(camera.project(world), expected[:, 0], rtol=0, atol=1e-6)


def test_the_principal_point_by_hand():
    # 90 um to the right and 45 um up on the sensor are 10 and 5 pixels of 9 um.
    lens = dataclasses.replace(BARREL, principal_offset_m=(90e-6, -45e-6))
    camera = Camera(lens, SENSOR)
    np.testing.assert_allclose(camera.intrinsics[:2, 2], [410, 295])
    np.testing.assert_allclose(camera.project([[0, 0, 1.0]]), [[410, 295]])
    np.testing.assert_allclose(camera.ray_slopes()[295, 410], 0, atol=1e-12)
    # The whole picture moves along, distortion included.
    points = np.array([[0.3, -0.2, 1.0], [-0.4, 0.1, 0.7]])
    moved = camera.project(points) - Camera(BARREL, SENSOR).project(points)
    np.testing.assert_allclose(moved, [[10, -5], [10, -5]], atol=1e-9)


def test_the_aperture_by_hand():
    # 4.16 mm at f/2: 2.08 mm across.
    assert Camera(PINHOLE, SENSOR).aperture_radius_m == pytest.approx(1.04e-3)


@pytest.mark.parametrize("focus", [0.0, -0.4, 4.16e-3, np.inf, np.nan])
def test_a_lens_cannot_be_focused_within_its_focal_length(focus):
    with pytest.raises(InputError, match=r"focus_m.*beyond the focal length"):
        Camera(PINHOLE, SENSOR, focus_m=focus)


@pytest.mark.parametrize("lens", [PINHOLE, BARREL], ids=["pinhole", "barrel"])
def test_corner_slopes_surround_the_centre_s(lens):
    camera = Camera(lens, SENSOR)
    corners, directions = camera.ray_slopes(), camera.pixel_directions()
    centres = directions[..., :2] / directions[..., 2:]
    middle = (corners[1:, 1:] + corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:]) / 4
    np.testing.assert_allclose(middle, centres, rtol=0, atol=2e-6)  # 1e-3 of a pixel


def test_a_point_by_hand():
    # 40 cm ahead, 10 cm to the right and 5 cm up of a camera at the origin that looks along +y.
    camera = Camera(PINHOLE, SENSOR, look_at((0, 0, 0), (0, 1, 0)))
    focal = 4160 / 9
    np.testing.assert_allclose(
        camera.project([[0.1, 0.4, 0.05]]), [[400 + focal * 0.25, 300 - focal * 0.125]], rtol=1e-12
    )


def test_points_that_cannot_be_seen_are_nan():
    folding = dataclasses.replace(PINHOLE, distortion=Distortion(k1=-0.1))
    camera = Camera(folding, SENSOR)
    points = [[0, 0, -1.0], [0, 0, 0.0], [5, 0, 1.0], [0, 0, 1.0]]  # r = 5 is past the turn at r = 1.83
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pixels = camera.project(points)
    assert np.isnan(pixels[:3]).all()
    np.testing.assert_allclose(pixels[3], [400, 300])


def test_a_lens_that_cannot_be_undone_over_the_picture_is_the_user_s_to_mend():
    lens = dataclasses.replace(PINHOLE, distortion=Distortion(k1=-0.3))
    with pytest.raises(InputError, match=r"distortion.*invertible over the whole picture"):
        Camera(lens, SENSOR)


def test_another_pose_changes_nothing_else():
    camera = Camera(BARREL, SENSOR, flash=load_flash("led_matrix_200klx"))
    moved = camera.at_pose(POSE)
    np.testing.assert_array_equal(moved.pose, POSE)
    assert (moved.lens, moved.sensor, moved.flash) == (camera.lens, camera.sensor, camera.flash)
    assert moved.ray_slopes() is camera.ray_slopes()
    with pytest.raises(ValueError, match="read-only"):
        moved.pose[0, 0] = 2


def test_the_flash_shines_during_its_pulse_alone():
    flash = load_flash("led_matrix_200klx")
    assert Camera(PINHOLE, SENSOR, exposure_s=200e-6, flash=flash).flash_duty == pytest.approx(0.25)
    assert Camera(PINHOLE, SENSOR, exposure_s=20e-6, flash=flash).flash_duty == 1
    assert Camera(PINHOLE, SENSOR).flash_duty == 0


def test_facts_are_json_and_rebuild_the_geometry():
    lens = dataclasses.replace(
        load_lens("lensagon_cmfa0420nd_typical_distortion"), principal_offset_m=(9e-6, -18e-6)
    )
    camera = Camera(lens, SENSOR, POSE, flash=load_flash("led_matrix_200klx"), focus_m=0.4)
    facts = json.loads(json.dumps(camera.metadata()))
    assert (facts["width"], facts["height"], facts["exposure_s"]) == (800, 600, 50e-6)
    np.testing.assert_array_equal(facts["pose"], POSE)
    assert Distortion(**facts["distortion"]) == lens.distortion
    assert (facts["cx"], facts["cy"]) == pytest.approx((401, 298))
    assert facts["principal_offset_m"] == [9e-6, -18e-6]
    assert (facts["focus_m"], facts["vignetting"]) == (0.4, True)
    assert (facts["bits"], facts["gain"]) == (10, 1.0)
    assert {facts["lens"], facts["sensor"]} == {lens.name, SENSOR.name}
    assert Camera(PINHOLE, SENSOR).metadata()["focus_m"] is None
    assert Camera(PINHOLE, SENSOR).metadata()["vignetting"] is False


@pytest.mark.parametrize(
    "pose", [np.eye(3), np.diag([2.0, 1, 1, 1]), np.diag([-1.0, 1, 1, 1]), np.full((4, 4), np.nan)]
)
def test_poses_that_are_none_are_refused(pose):
    with pytest.raises(ValueError, match="pose"):
        Camera(PINHOLE, SENSOR, pose)

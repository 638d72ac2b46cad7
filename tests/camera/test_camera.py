"""The camera's geometry: pixels to rays and back."""

from __future__ import annotations

import dataclasses
import json
import warnings

import numpy as np
import pytest

from pepperscene.camera import Camera, Distortion, load_flash, load_lens, load_sensor, look_at
from pepperscene.errors import InputError

SENSOR = load_sensor("ueye_ui5250re")
PINHOLE = load_lens("lensagon_cmfa0420nd")
BARREL = dataclasses.replace(PINHOLE, distortion=Distortion(-0.107, 0.043, 0.001, -0.0005))
POSE = look_at((0.3, -0.4, 1.1), (0.0, 0.1, 1.3))


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
    facts = json.loads(json.dumps(Camera(BARREL, SENSOR, POSE, flash=load_flash("led_matrix_200klx")).facts()))
    assert (facts["width"], facts["height"], facts["exposure_s"]) == (800, 600, 50e-6)
    np.testing.assert_array_equal(facts["pose"], POSE)
    assert Distortion(**facts["distortion"]) == BARREL.distortion
    assert {facts["lens"], facts["sensor"]} == {BARREL.name, SENSOR.name}


@pytest.mark.parametrize(
    "pose", [np.eye(3), np.diag([2.0, 1, 1, 1]), np.diag([-1.0, 1, 1, 1]), np.full((4, 4), np.nan)]
)
def test_poses_that_are_none_are_refused(pose):
    with pytest.raises(ValueError, match="pose"):
        Camera(PINHOLE, SENSOR, pose)

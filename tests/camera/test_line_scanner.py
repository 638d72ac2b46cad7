"""The geometry of a line scanner, against closed forms: each row is the same line at its own time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.camera import Camera, Distortion, Motion, load_lens, load_sensor
from pepperscene.errors import InputError

LINES, COLUMNS = 48, 64
SPEED_M_S = 0.12


def scanner(motion=None, pose=None, **distortion):
    sensor = load_sensor("generic_line_scanner_vnir").with_size(COLUMNS, LINES)
    lens = load_lens("generic_line_scanner_38deg")
    lens = replace(lens, distortion=Distortion(**distortion)) if distortion else lens
    motion = motion or Motion((0.0, SPEED_M_S, 0.0))
    return Camera(lens, sensor, np.eye(4) if pose is None else pose, exposure_s=5e-3, motion=motion)


def points_of_pixels(camera, distance_m=1.3):
    """`(h, w, 3)` points on the rays through the pixels' centres, from the pose of each row."""
    poses = camera.pose_at((np.arange(LINES) + 0.5 - LINES / 2) * camera.sensor.line_time_s)
    directions = np.einsum("rij,rcj->rci", poses[:, :3, :3], camera.pixel_directions())
    return poses[:, None, :3, 3] + distance_m * directions


def test_all_rows_look_in_the_same_directions():
    directions = scanner().pixel_directions()
    assert directions.shape == (LINES, COLUMNS, 3)
    np.testing.assert_array_equal(directions, np.broadcast_to(directions[:1], directions.shape))
    np.testing.assert_allclose(directions[..., 1], 0.0, atol=1e-12)
    # 38 degrees across, from edge to edge.
    slopes = scanner().ray_slopes()
    assert slopes.shape == (2, COLUMNS + 1, 2)
    assert 2 * np.degrees(np.arctan(slopes[0, -1, 0])) == pytest.approx(38.0, abs=0.1)


def test_a_point_is_in_the_row_at_whose_time_the_line_passes_it():
    # Moving along y at s, the line is at s t: it passes y at t = y / s.
    camera = scanner()
    points = np.random.default_rng(1).uniform([-0.2, -0.1, 0.5], [0.2, 0.1, 2.0], (50, 3))
    (x, y, z), (u, v) = points.T, camera.project(points).T
    line_time_s, matrix = camera.sensor.line_time_s, camera.intrinsics
    np.testing.assert_allclose(v, y / SPEED_M_S / line_time_s + LINES / 2, atol=1e-9)
    np.testing.assert_allclose(u, matrix[0, 0] * x / z + COLUMNS / 2, atol=1e-9)


@pytest.mark.parametrize(
    ("motion", "distortion"),
    [
        (Motion((0.0, 0.0, 0.0), (-0.3, 0.0, 0.0)), {}),
        (Motion((0.02, 0.1, 0.0), (-0.1, 0.05, 0.2)), {"k1": -0.15, "p1": 0.002}),
    ],
)
def test_points_on_the_rays_of_pixels_project_to_their_centres(motion, distortion):
    camera = scanner(motion, **distortion)
    found = camera.project(points_of_pixels(camera).reshape(-1, 3)).reshape(LINES, COLUMNS, 2)
    row, column = np.mgrid[:LINES, :COLUMNS] + 0.5
    np.testing.assert_allclose(found, np.stack([column, row], axis=-1), atol=1e-6)


def test_a_still_scanner_and_points_behind_it_have_no_row():
    still = scanner(Motion())
    assert np.isnan(still.project([[0.0, 0.0, 1.0]])).all()
    assert np.isnan(scanner().project([[0.0, 0.0, -1.0]])).all()


def test_modes_keep_the_time_of_a_line():
    sensor = load_sensor("generic_line_scanner_vnir")
    mode = sensor.with_size(128, 2000)
    assert (mode.binning, mode.rows, mode.line_time_s) == (8, 2000, sensor.line_time_s)
    assert mode.columns * mode.pixel_pitch_m == pytest.approx(sensor.columns * sensor.pitch_m)
    with pytest.raises(ValueError, match="1 to 1024 columns"):
        sensor.with_size(2048, 10)


def test_metadata_say_what_it_is_and_lines_are_exposed_one_after_the_other():
    described = scanner().to_metadata()
    assert (described["line_scan"], described["line_time_s"], len(described["bands"])) == (True, 0.01, 224)
    with pytest.raises(ValueError, match="one after the other"):
        replace(scanner(), exposure_s=0.011)


@pytest.mark.parametrize(
    ("changes", "key", "problem"),
    [
        ({"camera.exposure_us": 20_000}, "camera.exposure_us", "must be at most 10000"),
        ({"camera.exposure_us": "auto"}, "camera.exposure_us", "does not know the lines"),
        ({"camera.labels_per_row": False}, "camera.labels_per_row", "is a line scanner"),
        ({"views.speed_mm_s": None}, "views.kind", "must move the camera"),
    ],
)
def test_recipes_use_it_as_a_line_scanner(changes, key, problem):
    from pepperscene.recipe.resolve.load import load_recipe

    camera = {"sensor": "generic_line_scanner_vnir", "lens": "generic_line_scanner_38deg", "flash": "none"}
    base = {**{f"camera.{name}": value for name, value in camera.items()}, "camera.exposure_us": 5000}
    base["views.speed_mm_s"] = 100
    changes = {key: value for key, value in {**base, **changes}.items() if value is not None}
    with pytest.raises(InputError) as caught:
        load_recipe("greenhouse", changes)
    assert caught.value.key == key
    assert problem in caught.value.problem

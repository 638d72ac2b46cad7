"""Distortion: the documented formula, its inverse, and where it has none."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.camera import AngularProfile, Distortion, Lens, load_lens, load_sensor

# Barrel, pincushion and decentred, invertible up to a slope of 1.5 at least.
DISTORTIONS = st.builds(
    Distortion,
    k1=st.floats(-0.07, 0.3), k2=st.floats(0.0, 0.1), k3=st.floats(0.0, 0.02),
    p1=st.floats(-0.005, 0.005), p2=st.floats(-0.005, 0.005),
)  # fmt: skip


def places(radius):
    """`(40 x 15, 2)` slopes over a disc."""
    angle, length = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(0, radius, 15))
    return np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1).reshape(-1, 2)


# Worked by hand from the formula in OpenCV's documentation of calib3d (plumb bob):
# x'' = x' (1 + k1 r2 + k2 r4 + k3 r6) + 2 p1 x' y' + p2 (r2 + 2 x'2)
# y'' = y' (1 + k1 r2 + k2 r4 + k3 r6) + p1 (r2 + 2 y'2) + 2 p2 x' y'
BY_HAND = [
    (Distortion(k1=0.1), (1.0, 0.0), (1.1, 0.0)),
    (Distortion(k1=-0.2, k2=0.1), (0.0, 0.5), (0.0, 0.478125)),
    (Distortion(k3=0.001), (1.0, 1.0), (1.008, 1.008)),
    (Distortion(p1=0.01), (1.0, 2.0), (1.04, 2.13)),
    (Distortion(p2=0.01), (1.0, 2.0), (1.07, 2.04)),
    (
        Distortion(-0.1, 0.02, 0.001, -0.002, -0.001),
        (0.6, -0.8),
        (0.6 * 0.919 - 0.00096 - 0.00344, -0.8 * 0.919 + 0.00228 + 0.00192),
    ),
]


@pytest.mark.parametrize(("distortion", "ideal", "seen"), BY_HAND)
def test_the_formula_at_points_worked_by_hand(distortion, ideal, seen):
    np.testing.assert_allclose(distortion.distorted(ideal), seen, rtol=0, atol=1e-15)


@given(
    k1=st.floats(-0.2, 0.3), k2=st.floats(0.0, 0.1), k3=st.floats(0.0, 0.02),
    p1=st.floats(-0.005, 0.005), p2=st.floats(-0.005, 0.005),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_undistorting_undoes_distorting(k1, k2, k3, p1, p2):
    distortion = Distortion(k1, k2, p1, p2, k3)
    ideal = places(min(1.0, 0.9 * distortion.limit))
    np.testing.assert_allclose(distortion.undistorted(distortion.distorted(ideal)), ideal, rtol=0, atol=1e-9)


@given(distortion=DISTORTIONS)
@settings(max_examples=60, deadline=None)
def test_opencv_agrees(distortion):
    ideal = places(1.2)
    points = np.column_stack([ideal, np.ones(len(ideal))])
    coefficients = np.array([distortion.k1, distortion.k2, distortion.p1, distortion.p2, distortion.k3])
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), coefficients)
    np.testing.assert_allclose(distortion.distorted(ideal), seen[:, 0], rtol=0, atol=1e-12)
    # OpenCV's own inverse, by fixed-point iteration, where that converges: in the inner part.
    inner = np.linalg.norm(ideal, axis=-1) < 0.6
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12)
    undone = cv2.undistortPoints(seen[inner], np.eye(3), coefficients, criteria=stop)[:, 0]
    np.testing.assert_allclose(distortion.undistorted(seen[inner, 0]), undone, rtol=0, atol=1e-7)


@given(distortion=DISTORTIONS)
@settings(max_examples=30, deadline=None)
def test_areas_scale_with_the_jacobian(distortion):
    ideal, step = places(1.2), 1e-5
    right, down = np.array([step, 0.0]), np.array([0.0, step])
    along_x = (distortion.distorted(ideal + right) - distortion.distorted(ideal - right)) / (2 * step)
    along_y = (distortion.distorted(ideal + down) - distortion.distorted(ideal - down)) / (2 * step)
    expected = along_x[:, 0] * along_y[:, 1] - along_x[:, 1] * along_y[:, 0]
    np.testing.assert_allclose(distortion.area_scale(ideal), expected, rtol=0, atol=1e-8)


def test_round_trip_over_the_whole_picture_of_the_shipped_lens():
    lens, sensor = load_lens("lensagon_cmfa0420nd_typical_distortion"), load_sensor("ueye_ui5250re")
    focal_px = lens.focal_length_m / sensor.pixel_pitch_m
    u, v = np.meshgrid(np.arange(sensor.columns + 1.0), np.arange(sensor.rows + 1.0))
    seen = np.stack([u - sensor.columns / 2, v - sensor.rows / 2], axis=-1) / focal_px
    ideal = lens.distortion.undistorted(seen)
    assert np.abs(lens.distortion.distorted(ideal) - seen).max() < 1e-12
    # Barrel distortion pulls inwards: every ray comes from further out than it seems.
    assert np.all(np.linalg.norm(ideal, axis=-1) >= np.linalg.norm(seen, axis=-1) - 1e-12)


def test_the_limit_is_where_the_radius_turns_back():
    assert Distortion().limit == math.inf
    assert Distortion(k1=0.1, k2=0.1).limit == math.inf
    # 1 + 3 k1 r^2 = 0 at r = 1, where x = 2/3 is the outermost place of the picture.
    assert Distortion(k1=-1 / 3).limit == pytest.approx(1.0, rel=1e-12)
    assert Distortion(k2=-1 / 80).limit == pytest.approx(2.0, rel=1e-9)
    assert Distortion(k3=-1 / 7).limit == pytest.approx(1.0, rel=1e-9)
    # Two turns, s = 1 and s = 2: (1 - s)(1 - s/2) = 1 - 1.5 s + 0.5 s^2; the first counts.
    assert Distortion(k1=-0.5, k2=0.1).limit == pytest.approx(1.0, rel=1e-9)


def test_what_cannot_be_undone_is_refused():
    folding = Distortion(k1=-1 / 3)
    np.testing.assert_allclose(
        folding.undistorted([0.66, 0.0])[0] * (1 - folding.undistorted([0.66, 0.0])[0] ** 2 / 3), 0.66
    )
    with pytest.raises(ValueError, match="cannot be inverted"):
        folding.undistorted([[0.1, 0.0], [0.67, 0.0]])


def test_what_a_lens_file_tells():
    typical, ideal = load_lens("lensagon_cmfa0420nd_typical_distortion"), load_lens("lensagon_cmfa0420nd")
    assert (ideal.vignetting, ideal.principal_offset_m) == (None, (0.0, 0.0))
    # Nothing is lost in the middle, more and more outwards, and the last angle's value beyond.
    share = typical.vignetting.at(np.deg2rad(np.arange(0.0, 90.0)))
    assert share[:15].min() == 1
    assert np.all(np.diff(share) <= 0)
    assert share[-1] == share[50] == pytest.approx(0.7)


def test_impossible_lenses_are_refused():
    with pytest.raises(ValueError, match="focal length"):
        Lens("none", 0.0, 2.0)
    with pytest.raises(ValueError, match="finite"):
        Distortion(k1=math.nan)
    with pytest.raises(ValueError, match="principal point"):
        Lens("none", 4e-3, 2.0, principal_offset_m=(0.0, math.inf))


def test_lenses_are_keys():
    # The camera keeps the rays of a lens and a sensor, found by both.
    table = AngularProfile(np.array([0.0, 1.0]), np.array([1.0, 0.5]), "hold")
    lens = Lens("one", 4e-3, 2.0, principal_offset_m=np.array([1e-4, -1e-4]), vignetting=table)
    assert {lens: 1}[lens] == 1
    assert lens.principal_offset_m == (1e-4, -1e-4)

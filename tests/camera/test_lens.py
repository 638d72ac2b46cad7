"""Distortion: the documented formula, its inverse, and where it has none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.camera import Distortion, Lens, load_lens, load_sensor

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
    radius = min(1.0, 0.9 * distortion.limit)
    angle, length = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(0, radius, 15))
    ideal = np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1)
    np.testing.assert_allclose(distortion.undistorted(distortion.distorted(ideal)), ideal, rtol=0, atol=1e-9)


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


def test_impossible_lenses_are_refused():
    with pytest.raises(ValueError, match="focal length"):
        Lens("none", 0.0, 2.0)
    with pytest.raises(ValueError, match="finite"):
        Distortion(k1=math.nan)

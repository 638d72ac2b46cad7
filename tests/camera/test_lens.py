"""Lenses: distortion against its documented formula, its inverse, and vignetting."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.camera import AngularProfile, Distortion, Lens, load_lens

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


def test_lens_is_hashable():
    # The camera caches the rays of a lens and a sensor.
    table = AngularProfile(np.array([0.0, 1.0]), np.array([1.0, 0.5]), "hold")
    lens = Lens("test", 4e-3, 2.0, principal_offset_m=np.array([1e-4, -1e-4]), vignetting=table)
    assert {lens: 1}[lens] == 1
    assert lens.principal_offset_m == (1e-4, -1e-4)


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

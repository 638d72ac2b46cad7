"""Electrons of the camera against calculations that share no code with it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.camera import (
    AngularProfile,
    Camera,
    Developing,
    Distortion,
    expected_electrons,
    load_lens,
    load_sensor,
    relative_illumination,
)
from pepperscene.spectra import Spectrum

LENS, SENSOR = load_lens("lensagon_cmfa0420nd"), load_sensor("ueye_ui5250re")
COARSE = dataclasses.replace(SENSOR, columns=80, rows=60, pitch_m=10 * SENSOR.pitch_m)


def squared_slopes(camera):
    """`(h, w)` squared slopes of the image's pixels, from the intrinsics in a frame's metadata."""
    data = camera.to_metadata()
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    return ((u - data["cx"]) / data["fx"]) ** 2 + ((v - data["cy"]) / data["fy"]) ** 2


@given(right=st.floats(-1e-3, 1e-3), down=st.floats(-1e-3, 1e-3))
@settings(max_examples=25, deadline=None)
def test_light_falls_with_the_fourth_power_of_the_cosine(right, down):
    camera = Camera(dataclasses.replace(LENS, principal_offset_m=(right, down)), COARSE)
    np.testing.assert_allclose(relative_illumination(camera), (1 + squared_slopes(camera)) ** -2, rtol=1e-12)


def test_vignetting_multiplies_the_cosine_falloff():
    table = AngularProfile(np.deg2rad([0, 20, 30]), np.array([1.0, 0.9, 0.5]), "hold")
    camera = Camera(dataclasses.replace(LENS, vignetting=table), COARSE)
    angle = np.rad2deg(np.arctan(np.sqrt(squared_slopes(camera))))
    expected = np.interp(angle, [0, 20, 30], [1.0, 0.9, 0.5]) * np.cos(np.deg2rad(angle)) ** 4
    np.testing.assert_allclose(relative_illumination(camera), expected, rtol=1e-9)
    assert angle.max() > 45  # held beyond the table's end


def test_falloff_can_be_disabled():
    lens = load_lens("lensagon_cmfa0420nd_typical_distortion")
    camera = Camera(lens, COARSE, developing=Developing(falloff=False))
    np.testing.assert_array_equal(relative_illumination(camera), np.ones((60, 80)))
    electrons = expected_electrons(np.full((60, 80, 3), 1e20), camera)
    expected = 1e20 * math.pi / 16 * 0.9 * (45e-6) ** 2 * 50e-6
    assert electrons.min() == electrons.max() == pytest.approx(expected, rel=1e-12)


@given(
    k1=st.floats(-0.07, 0.2), k2=st.floats(0, 0.1), k3=st.floats(0, 0.02),
    p1=st.floats(-0.004, 0.004), p2=st.floats(-0.004, 0.004),
    offset=st.tuples(st.floats(-5e-4, 5e-4), st.floats(-5e-4, 5e-4)),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_all_light_that_enters_the_pupil_reaches_the_sensor(k1, k2, k3, p1, p2, offset):
    # Under the radiance L the pupil of area A receives L A times the integral of cos(theta) over the solid
    # angle that the image shows. In the plane z = 1 that is the integral of cos^4(theta) dx dy inside the
    # image's outline, which is known without the fall-off: the rays through the image's border.
    lens = dataclasses.replace(LENS, distortion=Distortion(k1, k2, p1, p2, k3), principal_offset_m=offset)
    camera = Camera(lens, COARSE)
    slopes = camera.ray_slopes()
    border = np.concatenate([slopes[0, :-1], slopes[:-1, -1], slopes[-1, :0:-1], slopes[:0:-1, 0]])
    # With r^2 = x^2 + y^2: the divergence of (x, y) / (2 (1 + r^2)) is (1 + r^2)^-2, so the flux is a contour
    # integral (Green), here by Simpson's rule on each edge.
    a, b = border, np.roll(border, -1, axis=0)
    edge = b - a

    def flux(p):
        return (p[:, 0] * edge[:, 1] - p[:, 1] * edge[:, 0]) / (2 * (1 + (p**2).sum(axis=-1)))

    into_pupil = (flux(a) + 4 * flux((a + b) / 2) + flux(b)).sum() / 6
    pixel = (COARSE.pixel_pitch_m / lens.focal_length_m) ** 2  # L pi / (4 N^2) = L A / f^2
    on_sensor = relative_illumination(camera).sum() * pixel
    # Pixels are summed at their centres and the border is a polygon: with 80 x 60 pixels, the error is 1e-3.
    assert on_sensor == pytest.approx(into_pupil, rel=1e-3)


@pytest.mark.parametrize("channels", [1, 3])
def test_electrons_of_one_and_three_channels(channels):
    efficiency = Spectrum(np.array([400.0, 900.0]), np.full((channels, 2), 0.5))
    mono = {"pattern": "mono"} if channels == 1 else {}
    camera = Camera(LENS, dataclasses.replace(COARSE, quantum_efficiency=efficiency, **mono))
    signal = np.random.default_rng(3).uniform(0, 1e20, (60, 80, channels))
    electrons = expected_electrons(signal, camera)
    falloff = (1 + squared_slopes(camera)[..., None]) ** -2
    expected = signal * falloff * math.pi / 16 * 0.9 * (45e-6) ** 2 * 50e-6
    np.testing.assert_allclose(electrons, expected, rtol=1e-9)
    with pytest.raises(ValueError, match="must have the shape"):
        expected_electrons(np.zeros((60, 80, 4 - channels)), camera)


def test_light_scales_with_pupil_area_and_exposure():
    signal = np.ones((60, 80, 3))

    def middle(lens=LENS, **changes):
        return expected_electrons(signal, Camera(lens, COARSE, **changes))[30, 40, 0]

    reference = middle()
    assert middle(dataclasses.replace(LENS, f_number=4.0)) == pytest.approx(reference / 4)
    assert middle(exposure_s=200e-6) == pytest.approx(4 * reference)
    # Focusing does not change it.
    assert middle(focus_m=0.3) == pytest.approx(reference)

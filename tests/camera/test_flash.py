"""The flash: its calibration against closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pepperscene.camera import AngularProfile, load_flash
from pepperscene.spectra import illuminance, photopic_efficiency

FLASH = load_flash("led_matrix_200klx")
RIGHT_ANGLE = np.pi / 2


def with_profile(relative, radius_m, angles=4001):
    angle = np.linspace(0, RIGHT_ANGLE, angles)
    profile = AngularProfile(angle, relative(angle))
    return dataclasses.replace(FLASH, profile=profile, radius_m=radius_m)


def test_a_point_obeys_the_inverse_square_law():
    assert dataclasses.replace(FLASH, radius_m=0.0).axial_area_m2 == pytest.approx(0.25, rel=1e-15)


@pytest.mark.parametrize("radius", [1e-6, 0.03, 0.4])
def test_a_lambertian_disc_in_closed_form(radius):
    # E = pi L a^2 / (a^2 + d^2) and I = pi a^2 L, so I / E = a^2 + d^2.
    assert with_profile(np.cos, radius).axial_area_m2 == pytest.approx(radius**2 + 0.25, rel=1e-6)


def test_an_isotropic_disc_in_closed_form():
    # E = I 2 / a^2 (1 - cos of the disc's half-angle).
    expected = 0.3**2 / 2 / (1 - 0.5 / np.hypot(0.3, 0.5))
    assert with_profile(np.ones_like, 0.3).axial_area_m2 == pytest.approx(expected, rel=1e-12)


def test_the_shipped_disc_against_a_sum_over_its_points():
    # 400 rings of equal area, seen from the point straight ahead.
    ring = FLASH.radius_m * np.sqrt((np.arange(400) + 0.5) / 400)
    distance = np.hypot(ring, FLASH.at_m)
    per_point = FLASH.profile.at(np.arccos(FLASH.at_m / distance)) * (FLASH.at_m / distance) / distance**2
    assert 1 / FLASH.axial_area_m2 == pytest.approx(per_point.mean(), rel=1e-5)


def test_the_intensity_gives_the_illuminance():
    nm = photopic_efficiency().wavelength_nm
    irradiance = FLASH.radiant_intensity(nm) / FLASH.axial_area_m2
    lux = 683.002 * np.trapezoid(irradiance * photopic_efficiency().values, nm)
    assert lux == pytest.approx(200_000, rel=1e-3)  # a 5 nm spectrum sampled each nanometre
    assert illuminance(FLASH.spectrum) > 0


def test_the_profile_lights_half_of_the_picture_and_leaves_its_corners_dark():
    angle = np.deg2rad([0, 18, 41, 47])
    relative = FLASH.profile.at(angle)
    assert relative[0] == 1
    assert relative[1] == pytest.approx(0.5)
    assert relative[2] < 0.05
    assert relative[3] < 0.02
    assert FLASH.profile.at(np.deg2rad(66)) == 0


@pytest.mark.parametrize(
    ("angle", "relative"),
    [([0.1, 1], [1, 0]), ([0, 1, 1], [1, 1, 0]), ([0, 1], [0.5, 0]), ([0, 1], [1, -1]), ([0, 2], [1, 0])],
)
def test_profiles_that_are_none_are_refused(angle, relative):
    with pytest.raises(ValueError, match=r"angles|intensities"):
        AngularProfile(np.array(angle, float), np.array(relative, float))


def test_a_flash_without_visible_light_is_refused():
    dark = dataclasses.replace(FLASH.spectrum, values=np.zeros_like(FLASH.spectrum.values))
    with pytest.raises(ValueError, match="spectrum"):
        dataclasses.replace(FLASH, spectrum=dark)

"""The flash: its calibration against closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.camera import AngularProfile, Flash, load_flash
from pepperscene.spectra import illuminance

MATRIX = load_flash("led_matrix_200klx")
# One disc in the middle, whose irradiance straight ahead has a closed form.
DISC = dataclasses.replace(MATRIX, emitters_m=np.zeros((1, 2)), radius_m=0.03)
RIGHT_ANGLE = np.pi / 2


def closed_form(profile: AngularProfile, radius_m: float, at_m: float) -> float:
    """I / E of one centred disc: E = I 2 / a^2 * integral of p(theta) sin(theta) from 0 to atan(a / d).

    An element dA emits I p(theta) dA / (pi a^2) towards the plane's centre, at the distance d / cos(theta)
    and the incidence theta. Between the nodes of the profile p(theta) sin(theta) = (m + n theta) sin(theta)
    has the antiderivative n sin(theta) - (m + n theta) cos(theta).
    """
    edge = np.arctan2(radius_m, at_m)
    knots = np.append(profile.angle_rad[profile.angle_rad < edge], edge)
    p = profile.at(knots)
    slope = np.diff(p) / np.diff(knots)
    pieces = slope * np.diff(np.sin(knots)) - np.diff(p * np.cos(knots))
    return radius_m**2 / (2 * pieces.sum())


def disc_of(relative, radius_m, angles=4001):
    angle = np.linspace(0, RIGHT_ANGLE, angles)
    return dataclasses.replace(DISC, profile=AngularProfile(angle, relative(angle)), radius_m=radius_m)


def test_a_point_obeys_the_inverse_square_law():
    point = dataclasses.replace(DISC, radius_m=0.0)
    assert point.axial_area_m2 == pytest.approx(0.25, rel=1e-14)
    assert dataclasses.replace(point, at_m=2.0).axial_area_m2 == pytest.approx(4.0, rel=1e-14)


@pytest.mark.parametrize("radius", [1e-6, 0.03, 0.4])
def test_a_lambertian_disc_in_closed_form(radius):
    # E = pi L a^2 / (a^2 + d^2) and I = pi a^2 L, so I / E = a^2 + d^2.
    assert disc_of(np.cos, radius).axial_area_m2 == pytest.approx(radius**2 + 0.25, rel=1e-6)


def test_an_isotropic_disc_in_closed_form():
    # E = I 2 / a^2 (1 - cos of the disc's half-angle).
    expected = 0.3**2 / 2 / (1 - 0.5 / np.hypot(0.3, 0.5))
    assert disc_of(np.ones_like, 0.3).axial_area_m2 == pytest.approx(expected, rel=1e-12)


def test_a_disc_whose_beam_ends_at_once_in_closed_form():
    # As the isotropic disc, but only its inner part shines straight ahead: that within 20 degrees.
    beam = AngularProfile(np.deg2rad([0.0, 20.0]), np.ones(2))
    flash = dataclasses.replace(DISC, profile=beam, radius_m=0.3)
    assert flash.axial_area_m2 == pytest.approx(0.3**2 / 2 / (1 - np.cos(np.deg2rad(20))), rel=1e-9)


@pytest.mark.parametrize("aside", [(0.1, 0.0), (-0.2, 0.3)])
def test_a_lambertian_disc_beside_the_axis_in_closed_form(aside):
    # The configuration factor of a disc for a small parallel plane beside its axis, E = pi L F (J. R. Howell,
    # "A catalog of radiation heat transfer configuration factors", B-12).
    radius, height, offset = 0.15, 0.5, np.hypot(*aside)
    h, r = height / offset, radius / offset
    z = 1 + h**2 + r**2
    factor = (1 - (z - 2 * r**2) / np.sqrt(z**2 - 4 * r**2)) / 2
    flash = dataclasses.replace(disc_of(np.cos, radius), emitters_m=np.array([aside]))
    assert flash.axial_area_m2 == pytest.approx(radius**2 / factor, rel=1e-6)


@given(
    radius=st.floats(1e-3, 0.3),
    at=st.floats(0.05, 2.0),
    steps=st.lists(st.tuples(st.floats(0.02, 0.5), st.floats(0.05, 1.0)), min_size=1, max_size=6),
)
@settings(max_examples=150, deadline=None)
def test_any_profile_s_disc_as_its_closed_form(radius, at, steps):
    angle = np.concatenate([[0.0], np.cumsum([step for step, _ in steps]), [1.55]])
    relative = np.concatenate([[1.0], [value for _, value in steps], [0.0]])
    keep = np.append(angle[:-1] < 1.5, True)
    profile = AngularProfile(angle[keep], relative[keep])
    flash = dataclasses.replace(DISC, profile=profile, radius_m=radius, at_m=at)
    assert flash.axial_area_m2 == pytest.approx(closed_form(profile, radius, at), rel=1e-6)


def test_emitters_share_the_intensity():
    # Irradiance per intensity is linear: the mean of what each emitter would give alone.
    alone = [dataclasses.replace(MATRIX, emitters_m=one[None]).axial_area_m2 for one in MATRIX.emitters_m]
    assert 1 / MATRIX.axial_area_m2 == pytest.approx(np.mean(1 / np.array(alone)), rel=1e-12)
    # One that is beside the axis gives less: a profile below 1 over a longer way.
    assert 1 / max(alone) < 1 / MATRIX.axial_area_m2 < 1 / 0.25


def test_the_shipped_matrix():
    emitters = MATRIX.emitters_m
    assert emitters.shape == (64, 2)
    np.testing.assert_allclose(emitters.mean(axis=0), 0, atol=1e-15)
    apart = np.linalg.norm(emitters[:, None] - emitters, axis=-1)[~np.eye(64, dtype=bool)]
    assert apart.min() == pytest.approx(0.008)
    assert apart.min() > 2 * MATRIX.radius_m
    # No LED hides behind an M12 barrel around the optical axis.
    from_axis = np.hypot(*(emitters + MATRIX.offset_m[:2]).T) - MATRIX.radius_m
    assert from_axis.min() > 0.007
    with pytest.raises(ValueError, match="read-only"):
        emitters[0, 0] = 1.0


def test_the_strength_is_the_stated_one_in_lux_or_in_watts():
    assert illuminance(MATRIX.irradiance()) == pytest.approx(200_000, rel=1e-9)
    infrared = load_flash("led_nir_850nm")
    assert infrared.irradiance().integral() == pytest.approx(100, rel=1e-9)
    assert illuminance(infrared.irradiance()) < 1
    nm = np.arange(700.0, 1000.0)
    assert np.trapezoid(infrared.radiant_intensity(nm), nm) == pytest.approx(
        100 * infrared.axial_area_m2, rel=1e-6
    )
    # The same lamp told in watts.
    watts = float(MATRIX.irradiance().integral())
    same = dataclasses.replace(MATRIX, illuminance_lx=None, irradiance_W_m2=watts)
    np.testing.assert_allclose(same.radiant_intensity(nm), MATRIX.radiant_intensity(nm), rtol=1e-12)


def test_the_profile_lights_half_of_the_picture_and_leaves_its_corners_dark():
    angle = np.deg2rad([0, 18, 41, 47])
    relative = MATRIX.profile.at(angle)
    assert relative[0] == 1
    assert relative[1] == pytest.approx(0.5)
    assert relative[2] < 0.05
    assert relative[3] < 0.02
    assert MATRIX.profile.at(np.deg2rad(66)) == 0


def test_a_profile_ends_or_is_held():
    angle, relative = np.array([0.0, 0.5, 1.0]), np.array([1.0, 0.8, 0.4])
    asked = [0.25, 1.0, 1.01, 1.5]
    np.testing.assert_allclose(AngularProfile(angle, relative).at(asked), [0.9, 0.4, 0, 0])
    np.testing.assert_allclose(AngularProfile(angle, relative, "hold").at(asked), [0.9, 0.4, 0.4, 0.4])


@pytest.mark.parametrize(
    ("angle", "relative"),
    [
        ([0.1, 1], [1, 0]),
        ([0, 1, 1], [1, 1, 0]),
        ([0, np.nan], [1, 0]),
        ([0, 2], [1, 0]),
        ([0], [1]),
        ([0, 1], [0.5, 0]),
        ([0, 1], [1, -1]),
        ([0, 1], [1, np.inf]),
        ([0, 1], [1, 1, 1]),
    ],
)
def test_profiles_that_are_none_are_refused(angle, relative):
    with pytest.raises(ValueError, match=r"angles|intensities"):
        AngularProfile(np.array(angle, float), np.array(relative, float))


DARK = dataclasses.replace(MATRIX.spectrum, values=np.zeros_like(MATRIX.spectrum.values))
INFRARED = load_flash("led_nir_850nm").spectrum
NARROW = AngularProfile(np.array([0, 0.01]), np.array([1.0, 0.0]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spectrum": DARK}, "spectrum"),
        ({"spectrum": INFRARED}, "no lux"),
        ({"spectrum": DARK, "illuminance_lx": None, "irradiance_W_m2": 1.0}, "spectrum"),
        ({"irradiance_W_m2": 5.0}, "exactly one"),
        ({"illuminance_lx": None}, "exactly one"),
        ({"illuminance_lx": 0.0}, "positive"),
        ({"illuminance_lx": np.nan}, "positive"),
        ({"at_m": 0.0}, "positive"),
        ({"radius_m": -1e-3}, "radius"),
        ({"emitters_m": np.zeros((0, 2))}, "emitters"),
        ({"emitters_m": np.zeros(2)}, "emitters"),
        ({"emitters_m": np.full((1, 2), np.nan)}, "emitters"),
        ({"emitters_m": np.ones((3, 2)), "profile": NARROW}, "no light of the profile"),
    ],
)
def test_flashes_that_are_none_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(MATRIX, **changes)


def test_a_flash_of_its_own_is_a_point():
    flash = Flash("mine", MATRIX.spectrum, 1.0, MATRIX.profile, illuminance_lx=100.0)
    np.testing.assert_array_equal(flash.emitters_m, [[0, 0]])
    assert flash.axial_area_m2 == pytest.approx(1.0)

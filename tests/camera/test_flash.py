"""Flash: calibration against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.camera import AngularProfile, Flash, load_flash
from pepperscene.spectra import illuminance

MATRIX, INFRARED = load_flash("led_matrix_200klx"), load_flash("led_nir_850nm")
# One disc in the middle, whose irradiance straight ahead has a closed form.
DISC = replace(MATRIX, emitters_m=np.zeros((1, 2)), radius_m=0.03)


def closed_form(profile, radius_m, at_m):
    """I / E of one centred disc: E = I 2 / a^2 * integral of p(theta) sin(theta) from 0 to atan(a / d).

    An element dA emits I p(theta) dA / (pi a^2) towards the plane's centre, at the distance d / cos(theta)
    and the incidence theta. Between the nodes of the profile, p(theta) sin(theta) = (m + n theta) sin(theta)
    has the antiderivative n sin(theta) - (m + n theta) cos(theta).
    """
    edge = np.arctan2(radius_m, at_m)
    nodes = np.append(profile.angle_rad[profile.angle_rad < edge], edge)
    p = profile.at(nodes)
    slope = np.diff(p) / np.diff(nodes)
    pieces = slope * np.diff(np.sin(nodes)) - np.diff(p * np.cos(nodes))
    return radius_m**2 / (2 * pieces.sum())


def test_point_follows_the_inverse_square_law():
    # A flash is a point unless stated otherwise.
    point = Flash("mine", MATRIX.spectrum, 0.5, MATRIX.profile, illuminance_lx=100.0)
    assert point.axial_area_m2 == pytest.approx(0.25, rel=1e-14)
    assert replace(point, at_m=2.0).axial_area_m2 == pytest.approx(4.0, rel=1e-14)


def test_disc_with_a_sharp_beam():
    # As the isotropic disc, but only its part within 20 degrees shines straight ahead.
    beam = AngularProfile(np.deg2rad([0.0, 20.0]), np.ones(2))
    flash = replace(DISC, profile=beam, radius_m=0.3)
    assert flash.axial_area_m2 == pytest.approx(0.3**2 / 2 / (1 - np.cos(np.deg2rad(20))), rel=1e-9)


@pytest.mark.parametrize("offset", [(0.1, 0.0), (-0.2, 0.3)])
def test_lambertian_disc_beside_the_axis(offset):
    # The configuration factor of a disc for a small parallel plane beside its axis, E = pi L F (J. R. Howell,
    # "A catalog of radiation heat transfer configuration factors", B-12).
    radius, height, distance = 0.15, 0.5, np.hypot(*offset)
    h, r = height / distance, radius / distance
    z = 1 + h**2 + r**2
    factor = (1 - (z - 2 * r**2) / np.sqrt(z**2 - 4 * r**2)) / 2
    angle = np.linspace(0, np.pi / 2, 4001)
    profile = AngularProfile(angle, np.cos(angle))
    flash = replace(DISC, profile=profile, radius_m=radius, emitters_m=np.array([offset]))
    assert flash.axial_area_m2 == pytest.approx(radius**2 / factor, rel=1e-6)


@given(
    radius=st.floats(1e-3, 0.3),
    at=st.floats(0.05, 2.0),
    steps=st.lists(st.tuples(st.floats(0.02, 0.5), st.floats(0.05, 1.0)), min_size=1, max_size=6),
)
def test_disc_of_any_profile(radius, at, steps):
    angle = np.concatenate([[0.0], np.cumsum([step for step, _ in steps]), [1.55]])
    relative = np.concatenate([[1.0], [value for _, value in steps], [0.0]])
    keep = np.append(angle[:-1] < 1.5, True)
    profile = AngularProfile(angle[keep], relative[keep])
    flash = replace(DISC, profile=profile, radius_m=radius, at_m=at)
    assert flash.axial_area_m2 == pytest.approx(closed_form(profile, radius, at), rel=1e-6)


def test_emitters_share_the_intensity():
    # Irradiance per intensity is linear: the mean of what each emitter would give alone.
    alone = [replace(MATRIX, emitters_m=one[None]).axial_area_m2 for one in MATRIX.emitters_m]
    assert 1 / MATRIX.axial_area_m2 == pytest.approx(np.mean(1 / np.array(alone)), rel=1e-12)
    # An emitter beside the axis contributes less: a profile below 1 over a longer distance.
    assert 1 / max(alone) < 1 / MATRIX.axial_area_m2 < 1 / 0.25


def test_strength_in_lux_or_watts_is_reproduced():
    assert illuminance(MATRIX.irradiance()) == pytest.approx(200_000, rel=1e-9)
    assert INFRARED.irradiance().integral() == pytest.approx(100, rel=1e-9)
    assert illuminance(INFRARED.irradiance()) < 1
    nm = np.arange(700.0, 1000.0)
    intensity = np.trapezoid(INFRARED.radiant_intensity(nm), nm)
    assert intensity == pytest.approx(100 * INFRARED.axial_area_m2, rel=1e-6)
    # The same lamp specified in watts.
    watts = float(MATRIX.irradiance().integral())
    same = replace(MATRIX, illuminance_lx=None, irradiance_W_m2=watts)
    np.testing.assert_allclose(same.radiant_intensity(nm), MATRIX.radiant_intensity(nm), rtol=1e-12)


DARK = replace(MATRIX.spectrum, values=np.zeros_like(MATRIX.spectrum.values))
NARROW = AngularProfile(np.array([0, 0.01]), np.array([1.0, 0.0]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spectrum": DARK}, "spectrum"),
        ({"spectrum": INFRARED.spectrum}, "no lux"),
        ({"irradiance_W_m2": 5.0}, "exactly one"),
        ({"illuminance_lx": None}, "exactly one"),
        ({"illuminance_lx": 0.0}, "positive"),
        ({"at_m": 0.0}, "positive"),
        ({"radius_m": -1e-3}, "radius"),
        ({"emitters_m": np.zeros((0, 2))}, "emitters"),
        ({"emitters_m": np.ones((3, 2)), "profile": NARROW}, "no light of the profile"),
        ({"rotation": 2 * np.eye(3)}, "rotation, without reflection"),
        ({"rotation": np.diag([1, 1, -1])}, "rotation, without reflection"),
    ],
)
def test_raises_on_invalid_flash(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(MATRIX, **changes)

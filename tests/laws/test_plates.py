"""Laws that light in plates must obey: Fresnel, the exponential integral, adding layers, energy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from pepperscene.spectra.plates import cone_transmissivity, pile, plate, slab_transmission


def fresnel_transmittance(angle: float, ior: float) -> float:
    """Textbook form, unpolarised, from air."""
    inside = np.arcsin(np.sin(angle) / ior)
    a, b = np.cos(angle), np.cos(inside)
    across = ((a - ior * b) / (a + ior * b)) ** 2
    within = ((ior * a - b) / (ior * a + b)) ** 2
    return 1.0 - 0.5 * (across + within)


@pytest.mark.parametrize("ior", [1.2, 1.34, 1.45, 1.52, 2.0])
@pytest.mark.parametrize("degrees", [10, 40, 59, 90])
def test_cone_transmissivity_is_the_mean_of_fresnel_over_projected_solid_angle(ior, degrees):
    top = np.radians(degrees)
    flux, _ = quad(lambda a: fresnel_transmittance(a, ior) * np.sin(2 * a), 0.0, top)
    assert cone_transmissivity(top, ior) == pytest.approx(flux / np.sin(top) ** 2, abs=1e-7)


@pytest.mark.parametrize("absorbance", [0.0, 1e-6, 0.03, 0.5, 2.0, 12.0])
def test_slab_transmits_beer_lambert_averaged_over_diffuse_directions(absorbance):
    mean, _ = quad(lambda mu: 2 * mu * np.exp(-absorbance / mu), 0.0, 1.0, epsabs=1e-12)
    assert slab_transmission(absorbance) == pytest.approx(mean, abs=1e-9)


@given(st.floats(0.0, 30.0), st.floats(1.1, 2.0))
def test_a_plate_never_gives_more_than_it_gets(absorbance, ior):
    r, t = plate(absorbance, ior)
    assert r > 0
    assert t >= 0
    assert r + t <= 1 + 1e-12
    if absorbance == 0:
        assert r + t == pytest.approx(1.0, abs=1e-12)


def add_layers(upper, lower):
    """Both layers symmetric; closed form of the light that goes to and fro between them."""
    (r1, t1), (r2, t2) = upper, lower
    between = 1.0 - r1 * r2
    return r1 + t1 * r2 * t1 / between, t1 * t2 / between


@given(st.floats(0.0, 8.0), st.integers(1, 6))
def test_a_pile_of_whole_plates_is_the_plates_added_one_by_one(absorbance, count):
    one = plate(absorbance, 1.45)
    built = one
    for _ in range(count - 1):
        built = add_layers(one, built)
    assert np.stack(pile(*one, count)) == pytest.approx(np.stack(built), abs=1e-9)


@given(st.floats(1e-9, 8.0), st.floats(0.3, 3.0), st.floats(0.3, 3.0))
def test_piles_of_any_height_add_up(absorbance, first, second):
    one = plate(absorbance, 1.45)
    whole = pile(*one, first + second)
    r1, t1 = pile(*one, first)
    r2, t2 = pile(*one, second)
    assert t1 * t2 / (1 - r1 * r2) == pytest.approx(float(whole[1]), abs=1e-8)
    assert r1 + t1 * t1 * r2 / (1 - r1 * r2) == pytest.approx(float(whole[0]), abs=1e-8)


def test_the_pile_has_no_step_where_absorption_vanishes():
    faint = pile(*plate(1e-7, 1.45), 1.6)
    none = pile(*plate(0.0, 1.45), 1.6)
    assert np.stack(faint) == pytest.approx(np.stack(none), abs=1e-5)
    assert sum(none) == pytest.approx(1.0, abs=1e-12)


def test_an_opaque_plate_is_finite():
    r, t = pile(0.1, 0.0, 2.5)
    assert r == pytest.approx(0.1)
    assert t == pytest.approx(0.0, abs=1e-30)

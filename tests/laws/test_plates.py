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


def test_an_interface_between_like_media_is_not_there():
    """Where Stern's closed form has lost all its digits."""
    faint = np.array([1.0, np.nextafter(1.0, 2.0), 1.0 + 1e-12, 1.0 + 1e-9, 1.0 + 1e-6])
    for degrees in (10, 40, 90):
        through = cone_transmissivity(np.radians(degrees), faint)
        assert through[0] == 1.0
        # Reflection goes with the square of the index' step, but for grazing light.
        assert through == pytest.approx(np.ones(5), abs=1e-12 if degrees < 90 else 1e-5)
        assert through.max() <= 1.0
    # Nearly normal light: 1 - ((n - 1) / (n + 1))^2.
    n = np.linspace(1.0, 2.5, 50)
    normal = 1.0 - ((n - 1.0) / (n + 1.0)) ** 2
    assert cone_transmissivity(1e-3, n) == pytest.approx(normal, abs=1e-12)


@given(st.one_of(st.floats(0.0, 30.0), st.floats(0.0, 1e308)), st.floats(1.1, 2.0))
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


@given(st.one_of(st.floats(0.0, 8.0), st.floats(-18.0, 0.0).map(lambda x: 10.0**x)), st.integers(1, 6))
def test_a_pile_of_whole_plates_is_the_plates_added_one_by_one(absorbance, count):
    one = plate(absorbance, 1.45)
    built = one
    for _ in range(count - 1):
        built = add_layers(one, built)
    assert np.stack(pile(*one, count)) == pytest.approx(np.stack(built), abs=1e-13)


@given(st.floats(0.0, 8.0), st.floats(0.3, 3.0), st.floats(0.3, 3.0))
def test_piles_of_any_height_add_up(absorbance, first, second):
    one = plate(absorbance, 1.45)
    whole = pile(*one, first + second)
    r1, t1 = pile(*one, first)
    r2, t2 = pile(*one, second)
    assert t1 * t2 / (1 - r1 * r2) == pytest.approx(float(whole[1]), abs=1e-13)
    assert r1 + t1 * t1 * r2 / (1 - r1 * r2) == pytest.approx(float(whole[0]), abs=1e-13)


def test_the_pile_has_no_step_where_absorption_vanishes():
    """What is absorbed goes to zero with the absorbance, by the same share of it: 2 k per plate and pass."""
    faint = np.geomspace(1e-12, 1e-5, 200)
    absorbed = 1.0 - sum(pile(*plate(faint, 1.45), 1.6))
    share = absorbed / faint
    # Rounding of 1 - R - T, and the slope's own change, which goes with k log k.
    assert np.all(np.abs(share - share[-1]) < 2e-15 / faint + 1e-3)
    none = pile(*plate(0.0, 1.45), 1.6)
    assert sum(none) == pytest.approx(1.0, abs=1e-14)


@given(
    st.one_of(st.floats(0.0, 1e308), st.floats(-320.0, 3.0).map(lambda x: 10.0**x)),
    st.floats(0.0, 12.0).map(lambda x: 10.0**x),
    st.floats(1.1, 2.5),
)
def test_piles_of_any_height_and_absorption_are_possible(absorbance, count, ior):
    """Piles of up to 1e12 plates, from denormal to enormous absorbance; many multiply the rounding of one."""
    r, t = pile(*plate(absorbance, ior), count)
    assert 0.0 < r <= 1.0 + 1e-9
    assert 0.0 <= t <= 1.0
    assert r + t <= 1.0 + 1e-9


def test_an_opaque_plate_is_finite():
    r, t = pile(0.1, 0.0, 2.5)
    assert r == pytest.approx(0.1)
    assert t == pytest.approx(0.0, abs=1e-30)

"""Physics of light in plates: Fresnel, the exponential integral, adding layers, energy conservation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from pepperscene.spectra.prospect import (
    SERIES_BELOW,
    _arcsinh_ratio,
    _log_sinh_ratio,
    cone_transmissivity,
    pile,
    plate,
    slab_transmission,
)


def fresnel_transmittance(angle: float, ior: float) -> float:
    """Textbook form, unpolarised, from air."""
    inside = np.arcsin(np.sin(angle) / ior)
    a, b = np.cos(angle), np.cos(inside)
    s_polarised = ((a - ior * b) / (a + ior * b)) ** 2
    p_polarised = ((ior * a - b) / (ior * a + b)) ** 2
    return 1.0 - 0.5 * (s_polarised + p_polarised)


@pytest.mark.parametrize("ior", [1.2, 1.34, 1.45, 1.52, 2.0])
@pytest.mark.parametrize("degrees", [10, 40, 59, 90])
def test_cone_transmissivity_is_the_mean_of_fresnel(ior, degrees):
    top = np.radians(degrees)
    flux, _ = quad(lambda a: fresnel_transmittance(a, ior) * np.sin(2 * a), 0.0, top)
    assert cone_transmissivity(top, ior) == pytest.approx(flux / np.sin(top) ** 2, abs=1e-7)


@pytest.mark.parametrize("absorbance", [0.0, 1e-6, 0.03, 0.5, 2.0, 12.0])
def test_slab_transmits_beer_lambert_averaged_over_diffuse_directions(absorbance):
    mean, _ = quad(lambda mu: 2 * mu * np.exp(-absorbance / mu), 0.0, 1.0, epsabs=1e-12)
    assert slab_transmission(absorbance) == pytest.approx(mean, abs=1e-9)


def test_interface_of_index_near_1_transmits_everything():
    """Where Stern's closed form has lost all its digits."""
    ior = np.array([1.0, np.nextafter(1.0, 2.0), 1.0 + 1e-12, 1.0 + 1e-9, 1.0 + 1e-6])
    for degrees in (10, 40, 90):
        transmissivity = cone_transmissivity(np.radians(degrees), ior)
        assert transmissivity[0] == 1.0
        # Reflectance is quadratic in the index step, except at grazing incidence.
        assert transmissivity == pytest.approx(np.ones(5), abs=1e-12 if degrees < 90 else 1e-5)
        assert transmissivity.max() <= 1.0
    # Nearly normal incidence: 1 - ((n - 1) / (n + 1))^2.
    n = np.linspace(1.0, 2.5, 50)
    normal = 1.0 - ((n - 1.0) / (n + 1.0)) ** 2
    assert cone_transmissivity(1e-3, n) == pytest.approx(normal, abs=1e-12)


def add_layers(upper, lower):
    """Closed form of the light that bounces between two symmetric layers."""
    (r1, t1), (r2, t2) = upper, lower
    between = 1.0 - r1 * r2
    return r1 + t1 * r2 * t1 / between, t1 * t2 / between


@given(st.one_of(st.floats(0.0, 8.0), st.floats(-18.0, 0.0).map(lambda x: 10.0**x)), st.integers(1, 6))
def test_pile_of_n_plates_equals_n_added_layers(absorbance, count):
    single = plate(absorbance, 1.45)
    expected = single
    for _ in range(count - 1):
        expected = add_layers(single, expected)
    assert np.stack(pile(*single, count)) == pytest.approx(np.stack(expected), abs=1e-13)


@given(st.floats(0.0, 8.0), st.floats(0.3, 3.0), st.floats(0.3, 3.0))
def test_fractional_piles_add_up(absorbance, first, second):
    single = plate(absorbance, 1.45)
    r, t = pile(*single, first + second)
    r1, t1 = pile(*single, first)
    r2, t2 = pile(*single, second)
    assert t1 * t2 / (1 - r1 * r2) == pytest.approx(float(t), abs=1e-13)
    assert r1 + t1 * t1 * r2 / (1 - r1 * r2) == pytest.approx(float(r), abs=1e-13)


def test_pile_is_continuous_where_absorption_vanishes():
    """Absorptance is proportional to small absorbances: 2 k per plate and pass."""
    absorbance = np.geomspace(1e-12, 1e-5, 200)
    absorptance = 1.0 - sum(pile(*plate(absorbance, 1.45), 1.6))
    ratio = absorptance / absorbance
    # Rounding of 1 - R - T, and the change of the slope, of order k log k.
    assert np.all(np.abs(ratio - ratio[-1]) < 2e-15 / absorbance + 1e-3)
    assert sum(pile(*plate(0.0, 1.45), 1.6)) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("ratio", [_arcsinh_ratio, _log_sinh_ratio])
def test_series_continue_the_closed_forms(ratio):
    """Values meet at the switch, and so do slopes over steps of a thousandth to either side."""
    y = SERIES_BELOW * np.array([0.998, 0.999, np.nextafter(1.0, 0.0), 1.0, 1.001, 1.002])
    values = ratio(y)
    assert values[2] == pytest.approx(values[3], rel=0, abs=3e-16)
    slopes = np.diff(values) / np.diff(y)
    # The slope changes by less than a millionth per step; rounding of values over steps of 1e-6 is 2e-10.
    assert slopes[[0, 1, 3]] == pytest.approx(slopes[4], rel=1e-5)


@given(
    st.one_of(st.floats(0.0, 1e308), st.floats(-320.0, 3.0).map(lambda x: 10.0**x)),
    st.floats(0.0, 12.0).map(lambda x: 10.0**x),
    st.floats(1.1, 2.5),
)
def test_pile_conserves_energy(absorbance, count, ior):
    """Up to 1e12 plates, from denormal to enormous absorbance; many plates multiply the rounding of one."""
    r, t = pile(*plate(absorbance, ior), count)
    assert 0.0 < r <= 1.0 + 1e-9
    assert 0.0 <= t <= 1.0
    assert r + t <= 1.0 + 1e-9


def test_pile_of_opaque_plates_is_finite():
    r, t = pile(0.1, 0.0, 2.5)
    assert r == pytest.approx(0.1)
    assert t == pytest.approx(0.0, abs=1e-30)

"""Interpolation, integrals and products of spectra are exact on every grid."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad

from pepperscene.spectra import Spectrum

OUTSIDE = ("hold", "zero", "error")


def grids():
    """Uneven grids of wavelengths between 300 and 1100 nm, with steps down to a thousandth of a nanometre."""
    steps = st.lists(st.integers(300_000, 1_100_000), min_size=2, max_size=12, unique=True)
    return steps.map(lambda nm: np.array(sorted(nm)) / 1000.0)


@st.composite
def spectra(draw, outside=None, rows=()):
    nm = draw(grids())
    values = draw(arrays(float, (*rows, nm.size), elements=st.floats(0.0, 100.0)))
    return Spectrum(nm, values, outside or draw(st.sampled_from(OUTSIDE)))


def close(expected):
    return pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_behaviour_outside_the_range():
    nm, values = np.array([400.0, 500.0, 700.0]), np.array([2.0, 4.0, 6.0])
    hold, zero, error = (Spectrum(nm, values, outside) for outside in OUTSIDE)
    assert hold.at([300, 400, 700, 800]) == pytest.approx([2, 2, 6, 6])
    assert zero.at([300, 400, 700, 800]) == pytest.approx([0, 2, 6, 0])
    assert error.at([400, 700]) == pytest.approx([2, 6])
    with pytest.raises(ValueError, match=r"399\.9 nm is outside the spectrum's 400 to 700 nm"):
        error.at([399.9])
    # As weights of a constant: integrals from 200 to 800 nm.
    constant = Spectrum([200.0, 800.0], [1.0, 1.0])
    assert constant.integral(hold) == pytest.approx(400.0 + 1300.0 + 600.0)
    assert constant.integral(zero) == pytest.approx(1300.0)
    with pytest.raises(ValueError, match="200 to 800 nm is partly outside the spectrum's 400 to 700 nm"):
        constant.integral(error)


@given(spectra(), spectra(outside="hold"))
def test_integral_of_a_product_matches_adaptive_quadrature(spectrum, weight):
    low, high = spectrum.range_nm
    nodes = np.union1d(spectrum.wavelength_nm, weight.wavelength_nm)
    pieces = nodes[(nodes >= low) & (nodes <= high)]
    expected = sum(
        quad(lambda nm: (spectrum.at(nm) * weight.at(nm)).item(), a, b)[0] for a, b in pairwise(pieces)
    )
    assert spectrum.integral(weight) == pytest.approx(expected, rel=1e-8, abs=1e-6)


@given(spectra(outside="zero", rows=(3, 1)), spectra(outside="zero", rows=(2,)))
def test_integrals_broadcast(many, others):
    result = many.integral(others)
    assert result.shape == (3, 2)
    one = Spectrum(many.wavelength_nm, many.values[2, 0])
    other = Spectrum(others.wavelength_nm, others.values[1])
    assert one.integral(other) == close(result[2, 1])


def test_a_box_filter_has_sharp_edges():
    light = Spectrum([400.0, 700.0], [1.0, 4.0])
    box = Spectrum([500.0, 600.0], [1.0, 1.0], "zero")
    assert light.integral(box) == pytest.approx(250.0)
    assert light.integral(Spectrum([500.0, 600.0], [1.0, 1.0], "hold")) == pytest.approx(light.integral())
    assert light.times(box).integral() == pytest.approx(250.0)


@given(spectra(), spectra(), st.lists(st.floats(200, 1200), min_size=1))
def test_products_are_exact_at_the_nodes_of_both_and_outside(a, b, wavelengths):
    (low_a, high_a), (low_b, high_b) = a.range_nm, b.range_nm
    if "hold" not in (a.outside, b.outside) and (low_a >= high_b or low_b >= high_a):
        with pytest.raises(ValueError, match="do not overlap"):
            a.times(b)
        return
    product = a.times(b)
    nodes = product.wavelength_nm
    assert product.values == close(a.at(nodes) * b.at(nodes))
    if product.outside != "error":
        beyond = np.array([nm for nm in wavelengths if nm < nodes[0] or nm > nodes[-1]])
        assert product.at(beyond) == close(a.at(beyond) * b.at(beyond))


def test_multiplies_by_a_number():
    spectrum = Spectrum([400.0, 700.0], [[1.0, 3.0], [2.0, 2.0]], "hold")
    assert spectrum.times(2.5).values == pytest.approx(2.5 * spectrum.values)
    assert spectrum.times(2.5).outside == "hold"


@pytest.mark.parametrize(
    ("nm", "values", "message"),
    [
        ([400.0], [1.0], "increasing"),
        ([500.0, 400.0], [1.0, 1.0], "increasing"),
        ([400.0, np.nan], [1.0, 1.0], "increasing"),
        ([400.0, 500.0], [1.0, 1.0, 1.0], "values for"),
        ([400.0, 500.0], [1.0, np.inf], "finite"),
    ],
)
def test_raises_on_invalid_arrays(nm, values, message):
    with pytest.raises(ValueError, match=message):
        Spectrum(np.array(nm), np.array(values))

"""Spectra conserve energy on every grid."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad

from pepperscene.spectra import Spectrum

OUTSIDES = ("hold", "zero", "error")


def grids():
    """Uneven grids of wavelengths between 300 and 1100 nm, with steps down to a thousandth of a nanometre."""
    steps = st.lists(st.integers(300_000, 1_100_000), min_size=2, max_size=12, unique=True)
    return steps.map(lambda nm: np.array(sorted(nm)) / 1000.0)


@st.composite
def spectra(draw, outside=None, rows=()):
    nm = draw(grids())
    values = draw(arrays(float, (*rows, nm.size), elements=st.floats(0.0, 100.0)))
    return Spectrum(nm, values, outside or draw(st.sampled_from(OUTSIDES)))


def close(expected):
    return pytest.approx(expected, rel=1e-9, abs=1e-6)


@given(spectra(rows=(2,)), grids(), st.data())
def test_means_over_bins_keep_the_integral(spectrum, edges, data):
    """Within the range the means times the widths add up to the integral, however the bins lie."""
    low, high = spectrum.range_nm
    edges = np.union1d(edges[(edges > low) & (edges < high)], [low, high])
    means = spectrum.averaged(edges)
    assert means.shape == (2, edges.size - 1)
    assert (means * np.diff(edges)).sum(-1) == close(spectrum.integral())
    # Each bin by itself as well: it is the integral of the part that lies in it.
    k = data.draw(st.integers(0, edges.size - 2))
    nodes = spectrum.wavelength_nm
    part = np.union1d(nodes[(nodes > edges[k]) & (nodes < edges[k + 1])], edges[k : k + 2])
    own = Spectrum(part, spectrum.at(part)).integral()
    assert means[:, k] * (edges[k + 1] - edges[k]) == close(own)


@given(spectra(outside="hold"), grids(), grids())
def test_finer_bins_average_to_the_coarse_ones(spectrum, edges, finer):
    fine = np.union1d(edges, finer[(finer > edges[0]) & (finer < edges[-1])])
    areas = spectrum.averaged(fine) * np.diff(fine)
    coarse = np.add.reduceat(areas, np.searchsorted(fine, edges[:-1])) / np.diff(edges)
    assert spectrum.averaged(edges) == close(coarse)


@given(spectra(), grids())
def test_more_nodes_change_nothing(spectrum, extra):
    """A spectrum resampled at its own nodes and any others is the same function."""
    low, high = spectrum.range_nm
    nm = np.union1d(spectrum.wavelength_nm, extra[(extra > low) & (extra < high)])
    finer = Spectrum(nm, spectrum.at(nm), spectrum.outside)
    assert finer.integral() == close(spectrum.integral())
    middle = [low, (low + high) / 2, high]
    assert finer.averaged(middle) == close(spectrum.averaged(middle))
    ramp = Spectrum([200.0, 1200.0], [0.0, 1.0])
    assert finer.integral(ramp) == close(spectrum.integral(ramp))
    assert finer.at(np.linspace(low, high, 50)) == close(spectrum.at(np.linspace(low, high, 50)))


def test_beyond_the_range_is_what_the_spectrum_says():
    nm, values = np.array([400.0, 500.0, 700.0]), np.array([2.0, 4.0, 6.0])
    held, zero, error = (Spectrum(nm, values, outside) for outside in OUTSIDES)
    assert held.at([300, 400, 700, 800]) == pytest.approx([2, 2, 6, 6])
    assert zero.at([300, 400, 700, 800]) == pytest.approx([0, 2, 6, 0])
    assert error.at([400, 700]) == pytest.approx([2, 6])
    # Bins: wholly beyond, half beyond, within.
    edges = [200, 300, 500, 600, 800]
    assert held.averaged(edges) == pytest.approx([2.0, 2.5, 4.5, 5.75])
    assert zero.averaged(edges) == pytest.approx([0.0, 1.5, 4.5, 2.75])
    assert error.averaged([400, 500, 700]) == pytest.approx([3.0, 5.0])
    with pytest.raises(ValueError, match=r"399\.9 nm lies beyond the spectrum's 400 to 700 nm"):
        error.at([399.9])
    with pytest.raises(ValueError, match="200 to 800 nm lie partly beyond the spectrum's 400 to 700 nm"):
        error.averaged(edges)


@given(spectra(outside="zero"), grids())
def test_light_beyond_the_range_is_dark(spectrum, edges):
    """Any bins that cover the range of a light hold all of its energy."""
    low, high = spectrum.range_nm
    edges = np.union1d(edges, [low - 1.0, high + 1.0])
    assert spectrum.averaged(edges) @ np.diff(edges) == close(spectrum.integral())


@given(spectra(), spectra(outside="hold"))
def test_the_integral_of_a_product_is_exact(spectrum, weight):
    """Against adaptive quadrature, which is told the bends."""
    low, high = spectrum.range_nm
    nodes = np.union1d(spectrum.wavelength_nm, weight.wavelength_nm)
    bends = nodes[(nodes >= low) & (nodes <= high)]
    expected = sum(
        quad(lambda nm: (spectrum.at(nm) * weight.at(nm)).item(), a, b)[0] for a, b in pairwise(bends)
    )
    assert spectrum.integral(weight) == pytest.approx(expected, rel=1e-8, abs=1e-6)


@given(spectra(outside="zero"), spectra(outside="zero"))
def test_the_integral_of_a_product_does_not_ask_who_is_first(a, b):
    assert a.integral(b) == close(b.integral(a))


@given(spectra(outside="zero", rows=(3, 1)), spectra(outside="zero", rows=(2,)))
def test_many_spectra_at_once_are_the_spectra_one_by_one(many, others):
    whole = many.integral(others)
    assert whole.shape == (3, 2)
    one, other = (
        Spectrum(many.wavelength_nm, many.values[2, 0]),
        Spectrum(others.wavelength_nm, others.values[1]),
    )
    assert one.integral(other) == close(whole[2, 1])


def test_a_weight_that_steps_inside_the_range():
    """A box-shaped filter passes exactly the light within it: no slope is invented at its ends."""
    light = Spectrum([400.0, 700.0], [1.0, 4.0])
    box = Spectrum([500.0, 600.0], [1.0, 1.0], "zero")
    assert light.integral(box) == pytest.approx(250.0)
    assert light.integral(Spectrum([500.0, 600.0], [1.0, 1.0], "hold")) == pytest.approx(light.integral())
    assert light.times(box).integral() == pytest.approx(250.0)
    with pytest.raises(ValueError, match="400 to 700 nm lie partly beyond the spectrum's 500 to 600 nm"):
        light.integral(Spectrum([500.0, 600.0], [1.0, 1.0], "error"))


@given(spectra(), spectra(), st.lists(st.floats(200, 1200), min_size=1))
def test_a_product_is_exact_at_the_nodes_of_both_and_beyond(a, b, asked):
    (low_a, high_a), (low_b, high_b) = a.range_nm, b.range_nm
    if "hold" not in (a.outside, b.outside) and (low_a >= high_b or low_b >= high_a):
        with pytest.raises(ValueError, match="do not overlap"):
            a.times(b)
        return
    product = a.times(b)
    nodes = product.wavelength_nm
    assert product.values == close(a.at(nodes) * b.at(nodes))
    if product.outside != "error":
        beyond = np.array([nm for nm in asked if nm < nodes[0] or nm > nodes[-1]])
        assert product.at(beyond) == close(a.at(beyond) * b.at(beyond))


def test_scaling_scales():
    spectrum = Spectrum([400.0, 700.0], [[1.0, 3.0], [2.0, 2.0]], "hold")
    assert spectrum.times(2.5).values == pytest.approx(2.5 * spectrum.values)
    assert spectrum.times(2.5).outside == "hold"


@pytest.mark.parametrize(
    ("nm", "values", "told"),
    [
        ([400.0], [1.0], "increasing"),
        ([500.0, 400.0], [1.0, 1.0], "increasing"),
        ([400.0, np.nan], [1.0, 1.0], "increasing"),
        ([400.0, 500.0], [1.0, 1.0, 1.0], "values for"),
        ([400.0, 500.0], [1.0, np.inf], "finite"),
    ],
)
def test_what_is_no_spectrum(nm, values, told):
    with pytest.raises(ValueError, match=told):
        Spectrum(np.array(nm), np.array(values))


@pytest.mark.parametrize("edges", [[500.0], [500.0, 500.0], [600.0, 500.0], [[400.0, 500.0]]])
def test_edges_must_increase(edges):
    with pytest.raises(ValueError, match="edges must be one increasing list"):
        Spectrum([400.0, 700.0], [1.0, 1.0]).averaged(edges)

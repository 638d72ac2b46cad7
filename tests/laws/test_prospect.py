"""PROSPECT against prosail 2.0.5 (J. Gomez-Dans, an independent implementation), and its own physics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from prosail import run_prospect, spectral_lib
from scipy.integrate import quad

from pepperscene.spectra import absorption_coefficients, layer_over_body, leaf_spectra
from pepperscene.spectra.prospect import (
    INCIDENCE_CONE_RAD,
    cone_transmissivity,
    pile,
    plate,
    slab_transmission,
)

# --- leaves and layers --------------------------------------------------------------------------------------


NM = np.arange(400, 801, 5)
LEAF = {"structure_n": 1.5, "chlorophyll_ug_cm2": 40, "carotenoid_ug_cm2": 8, "water_cm": 0.01}


def smooth_gloss(ior):
    """Reflectance of a smooth cuticle for light in PROSPECT's cone of incidence."""
    return 1.0 - cone_transmissivity(INCIDENCE_CONE_RAD, ior)


def content(usual: float) -> st.SearchStrategy[float]:
    """Cultivar files allow any finite content of at least 0: from denormal to enormous."""
    return st.one_of(st.just(0.0), st.floats(0.0, usual), st.floats(0.0, 1.7e308), st.floats(0.0, 1e-300))


@settings(max_examples=150)
@given(
    n=st.one_of(st.floats(1.0, 4.0), st.floats(4.0, 1e9)), chl=content(120), car=content(40), ant=content(20),
    cap=content(40), brown=content(4), water=content(0.1), dry=content(0.04),
    ior=st.one_of(st.floats(1.0, 2.5), st.floats(1.0, 1.000001)), flesh=st.floats(0.0, 1.0, exclude_max=True),
)  # fmt: skip
def test_conserves_energy(n, chl, car, ant, cap, brown, water, dry, ior, flesh):
    """Nothing is negative, NaN or more than the incident light, for any contents that files allow."""
    leaf = leaf_spectra(
        NM, structure_n=n, chlorophyll_ug_cm2=chl, carotenoid_ug_cm2=car, anthocyanin_ug_cm2=ant,
        capsanthin_ug_cm2=cap, brown=brown, water_cm=water, dry_matter_g_cm2=dry,
    )  # fmt: skip
    # Thousands of clear plates multiply the rounding of one.
    rounding = 1e-12 if n <= 4 else 1e-9
    assert leaf.reflectance.min() > 0
    assert leaf.transmittance.min() >= 0
    assert (leaf.reflectance + leaf.transmittance).max() <= 1 + rounding
    assert (leaf.diffuse_reflectance + leaf.diffuse_transmittance).max() <= 1 + rounding
    gloss = smooth_gloss(ior)
    body_r, body_t = leaf.under_gloss(gloss)
    assert min(body_r.min(), body_t.min()) >= 0
    assert (body_r + body_t).max() <= 1 + rounding
    # Gloss and body together give the leaf, wherever the gloss alone is not brighter than the leaf.
    valid = leaf.reflectance >= gloss
    assert (gloss + (1 - gloss) * body_r)[valid] == pytest.approx(leaf.reflectance[valid], abs=rounding)
    assert ((1 - gloss) * body_t)[valid] == pytest.approx(leaf.transmittance[valid], abs=rounding)
    fruit, transmittance = layer_over_body(leaf, flesh).under_gloss(gloss)
    assert fruit.min() >= 0
    assert fruit.max() <= 1
    assert not transmittance.any()


def test_below_400_nm_the_coefficients_of_400_nm_apply():
    below, at_400 = leaf_spectra([380.0], **LEAF), leaf_spectra([400.0], **LEAF)
    assert below.reflectance == at_400.reflectance
    with pytest.raises(ValueError, match="greater than"):
        leaf_spectra([2501.0], **LEAF)


@pytest.mark.parametrize(
    "contents",
    [
        {"structure_n": 0.9},
        {"structure_n": np.nan},
        {"structure_n": np.inf},
        {"chlorophyll_ug_cm2": -1},
        {"chlorophyll_ug_cm2": np.inf},
        {"water_cm": [0.01, np.nan]},
    ],
)
def test_raises_on_impossible_contents(contents):
    with pytest.raises(ValueError, match="plate"):
        leaf_spectra(NM, **(LEAF | contents))


def test_layer_on_a_body_equals_a_series_of_reflections():
    skin = leaf_spectra(NM, structure_n=1.0, chlorophyll_ug_cm2=5)
    rho, light, total = 0.7, skin.transmittance, skin.reflectance.copy()
    for _ in range(200):
        total += light * rho * skin.diffuse_transmittance
        light = light * rho * skin.diffuse_reflectance
    assert layer_over_body(skin, rho).reflectance == pytest.approx(total, abs=1e-12)
    assert layer_over_body(skin, 0.0).reflectance == pytest.approx(skin.reflectance, abs=1e-15)


# --- plates -------------------------------------------------------------------------------------------------


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


def test_pile_is_continuous_where_absorption_vanishes():
    """Absorptance is proportional to small absorbances: 2 k per plate and pass."""
    absorbance = np.geomspace(1e-12, 1e-5, 200)
    absorptance = 1.0 - sum(pile(*plate(absorbance, 1.45), 1.6))
    ratio = absorptance / absorbance
    # Rounding of 1 - R - T, and the change of the slope, of order k log k.
    assert np.all(np.abs(ratio - ratio[-1]) < 2e-15 / absorbance + 1e-3)
    assert sum(pile(*plate(0.0, 1.45), 1.6)) == pytest.approx(1.0, abs=1e-14)


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


# --- random leaves against prosail --------------------------------------------------------------------------


PROSAIL_NM = np.arange(400, 2501)
TOLERANCE = 1e-6
RANGES = {
    "structure_n": (1.0, 3.5),
    "chlorophyll_ug_cm2": (0.0, 120.0),
    "carotenoid_ug_cm2": (0.0, 40.0),
    "anthocyanin_ug_cm2": (0.0, 20.0),
    "brown": (0.0, 2.0),
    "water_cm": (0.0, 0.06),
    "dry_matter_g_cm2": (0.0, 0.04),
}


def draw(count: int, seed: int, **ranges: tuple[float, float]) -> dict[str, np.ndarray]:
    """Uniform over the ranges; each content except structure is absent in a fifth of the leaves."""
    rng = np.random.default_rng(seed)
    drawn = {name: rng.uniform(low, high, count) for name, (low, high) in ranges.items()}
    present = {name: rng.random(count) > 0.2 for name in ranges if name != "structure_n"}
    return {name: values * present.get(name, 1.0) for name, values in drawn.items()}


def prosail(*contents: float, **options) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and transmittance by prosail, which multiplies infinity by zero internally."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return run_prospect(*contents, **options)[1:]


def max_difference(leaf, index: int, reflectance: np.ndarray, transmittance: np.ndarray) -> float:
    differences = leaf.reflectance[index] - reflectance, leaf.transmittance[index] - transmittance
    return float(np.abs(differences).max())


@pytest.mark.parametrize("part", range(3))
def test_random_leaves_match_prosail(part):
    contents = draw(100, part, **RANGES)
    leaf = leaf_spectra(PROSAIL_NM, **contents)
    assert leaf.reflectance.shape == (100, PROSAIL_NM.size)
    for i in range(100):
        n, cab, car, ant, brown, cw, cm = (contents[name][i] for name in RANGES)
        spectra = prosail(n, cab, car, brown, cw, cm, ant=ant)
        assert max_difference(leaf, i, *spectra) < TOLERANCE, {k: v[i] for k, v in contents.items()}


def test_leaf_without_pigments_matches_prosail():
    """prosail has a special case for it, too."""
    for n in (1.0, 1.5, 3.5):
        leaf = leaf_spectra(PROSAIL_NM, structure_n=[n])
        assert max_difference(leaf, 0, *prosail(n, 0.0, 0.0, 0.0, 0.0, 0.0)) < TOLERANCE


def test_protein_and_carbon_match_prosail():
    """prosail has no PROSPECT-PRO, but accepts coefficients: protein and carbon are passed as dry matter."""
    specific = absorption_coefficients(PROSAIL_NM)
    ranges = {k: v for k, v in RANGES.items() if k != "dry_matter_g_cm2"}
    contents = draw(100, 11, **ranges, protein_g_cm2=(0.0, 0.003), carbon_g_cm2=(0.0, 0.03))
    leaf = leaf_spectra(PROSAIL_NM, **contents)
    for i in range(100):
        n, cab, car, ant, brown, cw, protein, carbon = (values[i] for values in contents.values())
        dry = protein * specific["protein"] + carbon * specific["carbon"]
        spectra = prosail(n, cab, car, brown, cw, 1.0, ant=ant, km=dry)
        assert max_difference(leaf, i, *spectra) < TOLERANCE


def test_coefficients_match_prosail():
    specific, table = absorption_coefficients(PROSAIL_NM), spectral_lib.prospectd
    names = ("refractive_index", "chlorophyll", "carotenoid", "anthocyanin", "brown", "water", "dry_matter")
    shipped = (table.nr, table.kab, table.kcar, table.kant, table.kbrown, table.kw, table.km)
    for name, values in zip(names, shipped, strict=True):
        assert specific[name] == pytest.approx(values, rel=1e-12), name

"""PROSPECT against published values, measured tissue, and its own physics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.spectra import absorption_coefficients, layer_over_body, leaf_spectra
from pepperscene.spectra.prospect import INCIDENCE_CONE_RAD, cone_transmissivity

NM = np.arange(400, 801, 5)
LEAF = {"structure_n": 1.5, "chlorophyll_ug_cm2": 40, "carotenoid_ug_cm2": 8, "water_cm": 0.01}


def smooth_gloss(ior):
    """Reflectance of a smooth cuticle for light in PROSPECT's cone of incidence."""
    return 1.0 - cone_transmissivity(INCIDENCE_CONE_RAD, ior)


def test_protein_and_carbon_replace_dry_matter():
    """Their coefficients were calibrated so that LMA = protein + carbon: the near infrared hardly changes."""
    nm = np.arange(750, 2401, 50)
    total = leaf_spectra(nm, **LEAF, dry_matter_g_cm2=0.008)
    parts = leaf_spectra(nm, **LEAF, protein_g_cm2=0.001, carbon_g_cm2=0.007)
    assert parts.reflectance == pytest.approx(total.reflectance, abs=0.02)
    with pytest.raises(ValueError, match="not both"):
        leaf_spectra(nm, **LEAF, dry_matter_g_cm2=0.008, protein_g_cm2=0.001)


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


def test_clear_tissue_absorbs_nothing():
    leaf = leaf_spectra(NM, structure_n=2.2)
    assert leaf.reflectance + leaf.transmittance == pytest.approx(np.ones(NM.size), abs=1e-12)


def test_opaque_tissue_reflects_from_its_surface_alone():
    leaf = leaf_spectra([450.0], structure_n=1.5, chlorophyll_ug_cm2=2000)
    ior = absorption_coefficients([450.0])["refractive_index"]
    assert leaf.reflectance == pytest.approx(smooth_gloss(ior), abs=1e-6)


def test_below_400_nm_the_coefficients_of_400_nm_apply():
    below, at_400 = leaf_spectra([380.0], **LEAF), leaf_spectra([400.0], **LEAF)
    assert below.reflectance == at_400.reflectance
    with pytest.raises(ValueError, match="greater than"):
        leaf_spectra([2501.0], **LEAF)


def test_gloss_broadcasts_over_leaves():
    leaf = leaf_spectra(NM, **LEAF)
    gloss = smooth_gloss(np.array([1.3, 1.0]))
    assert gloss[1] == 0.0
    many = leaf_spectra(NM, **LEAF | {"brown": [0.0, 0.5]}).under_gloss(gloss)
    assert many[0][0] == pytest.approx(leaf.under_gloss(gloss[0])[0], abs=1e-15)
    assert many[1][1] == pytest.approx(leaf_spectra(NM, **LEAF, brown=0.5).transmittance, abs=1e-15)


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

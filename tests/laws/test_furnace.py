"""White furnace: in uniform light no surface sends out more than it receives, and a lossless one as much.

The directional albedo is measured twice, by the BSDF's own sampling and by a quadrature of its values that
does not use that sampling, and compared with E + (1 - E) (R + T) from NumPy. Views are from both sides, from
1 degree above the surface to the normal.

Power: 8 independent lattices of 4,096 samples per case; the standard error of a case is .0003 on average and
at most .0025, that of the mean over a group of cases below 2e-5. The error of the quadrature is below .0012
for the synthetic surfaces (with mirrors of alpha .001) and .0003 for the shipped ones.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scatterers import TEST_NM, Cases, grey_surface, integrate_cases, lossless, plain, sample_cases, shipped

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import flesh_reflectance
from pepperscene.materials.gloss import cone_gloss
from pepperscene.spectra import layer_over_body, leaf_spectra

COSINES = tuple(side * cosine for side in (1, -1) for cosine in (1.0, 0.8, 0.5, 0.2, 0.1, 0.05, 0.02))
STATES = (0.0, 0.5, 1.0)
GROUPS = ("synthetic", "shipped", "shipped with relief")


@cache
def measured(group: str):
    """Cases; albedos and rejected fractions by sampling; albedos and integrated densities by quadrature."""
    if group == "synthetic":
        cases = Cases.over(lossless(), (0.0,), COSINES, seed=1)
    else:
        surfaces = shipped() if group == "shipped with relief" else [plain(s) for s in shipped()]
        cases = Cases.over(surfaces, STATES, COSINES, seed=2)
    return cases, *sample_cases(cases, 8, 4096, seed=3), *integrate_cases(cases)


def worst(cases: Cases, excess: np.ndarray) -> str:
    case = int(np.unravel_index(np.argmax(excess), excess.shape)[0])
    return f"{cases.label(case)}: {excess.max():.5f}"


@pytest.mark.parametrize("group", GROUPS)
def test_no_surface_sends_out_more_than_it_receives(group):
    cases, by_samples, _, by_quadrature, _ = measured(group)
    assert np.isfinite(by_samples).all()
    assert by_samples.min() >= 0.0
    assert (by_samples.mean(axis=1) <= 1.005).all(), worst(cases, by_samples.mean(axis=1))
    assert (by_quadrature <= 1.0015).all(), worst(cases, by_quadrature)


def test_lossless_surfaces_send_out_as_much_as_they_receive():
    _, by_samples, _, by_quadrature, _ = measured("synthetic")
    assert by_samples.mean(axis=1) == pytest.approx(1.0, abs=0.005)
    assert by_quadrature == pytest.approx(1.0, abs=0.0015)
    assert by_samples.mean() == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize("group", ["synthetic", "shipped"])
def test_albedo_equals_that_of_gloss_and_body(group):
    cases, by_samples, _, by_quadrature, _ = measured(group)
    expected = cases.expected()
    error = by_samples.std(axis=1, ddof=1) / np.sqrt(8)
    assert error.max() < 0.0025
    deviation = by_samples.mean(axis=1) - expected
    assert (np.abs(deviation) < 0.005).all(), worst(cases, np.abs(deviation))
    # No bias is hidden in the noise: deviations over the standard error are Student's t with 7 degrees of
    # freedom, of root mean square 1.18, unless the error is below the tables' 4e-4.
    noisy = error > 2e-4
    assert np.sqrt(np.mean((deviation / np.maximum(error, 1e-9))[noisy] ** 2)) < 1.5
    assert abs(deviation.mean()) < 1e-4
    assert (np.abs(by_quadrature - expected) < 0.0015).all(), worst(cases, np.abs(by_quadrature - expected))


@pytest.mark.parametrize("group", GROUPS)
def test_samples_and_quadrature_agree(group):
    cases, by_samples, rejected, by_quadrature, density = measured(group)
    difference = np.abs(by_samples.mean(axis=1) - by_quadrature)
    assert (difference < 0.005).all(), worst(cases, difference)
    # The density integrates to the fraction that is not rejected, below the horizon or beyond a relief's.
    missing = np.abs(1.0 - rejected.mean(axis=1) - density)
    assert (missing < 0.004).all(), worst(cases, missing[:, None])
    assert (density < 1.002).all(), worst(cases, density[:, None])


def test_relief_loses_only_light_below_the_smooth_surface():
    # A matt body on a slope of angle t, seen from the normal: (1 + cos t) / 2 of the hemisphere's light is
    # above the smooth surface, on both sides of the sheet. Slopes up to 40 degrees and more.
    x = np.linspace(0.0, 1.0, 64)
    height = (5.0 * np.sin(2 * np.pi * x)[None] * np.ones((64, 1))).astype(np.float32)
    surface = replace(grey_surface("sheet", 0.6, 0.6, 0.4, 1.0, (0.3, 0.3)), relief_mm=height)
    u = np.linspace(0.02, 0.98, 49)
    uv = np.stack([u, np.full(49, 0.5)], axis=1).astype(np.float32)
    for side in (1.0, -1.0):
        wi = np.tile(np.array([0.0, 0.0, side], np.float32), (49, 1))
        cases = Cases((surface,), np.zeros(49, int), np.zeros(49), wi, uv)
        cosine = np.abs(cases.frames(cases.optics())[:, 2, 2])
        assert cosine.min() < 0.75
        albedo, rejected = sample_cases(cases, 8, 4096, seed=4)
        visible = (1.0 + cosine) / 2.0
        assert albedo.mean(axis=1) == pytest.approx(np.tile(visible[:, None], (1, 4)), abs=0.003)
        assert rejected.mean(axis=1) == pytest.approx(1.0 - visible, abs=0.003)


def test_gloss_and_body_together_reproduce_the_leaf_model():
    # PROSPECT gives R and T of the whole leaf, gloss included, for light in a cone of incidence of 40
    # degrees. The quadrature of the kernel's values over that cone must give the same sum for the upper side,
    # and the reflectance of the skin on its flesh for opaque organs, but at least the gloss alone. Bound: the
    # errors of quadrature and tables, .0015.
    cultivar = load_cultivar("kaite")
    cone = np.sqrt(1.0 - (np.arange(8) + 0.5) / 8 * np.sin(np.radians(40.0)) ** 2)
    surfaces = {surface.name: plain(surface) for surface in shipped()}
    for name in ("leaf", "fruit", "stem", "petiole", "peduncle", "calyx"):
        cases = Cases.over([surfaces[name]], STATES, cone, seed=4)
        by_quadrature, _ = integrate_cases(cases)
        albedo = by_quadrature.reshape(len(STATES), cone.size, -1).mean(axis=1)
        path = cultivar.pigments[name]
        leaf = leaf_spectra(TEST_NM, **path.at(STATES))
        expected = leaf.reflectance + leaf.transmittance
        if name != "leaf":
            expected = layer_over_body(leaf, flesh_reflectance(path.flesh_reflectance, TEST_NM)).reflectance
        assert albedo == pytest.approx(
            np.maximum(expected, cone_gloss(path.ior, path.roughness[0])), abs=0.0015
        )

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
from scatterers import (
    TEST_NM,
    Cases,
    grey_surface,
    integrate_cases,
    lossless,
    plain,
    sample_cases,
    shipped,
    two_lobes,
    waves,
)

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import Surface, flesh_reflectance
from pepperscene.materials.gloss import cone_gloss
from pepperscene.spectra import layer_over_body, leaf_spectra

COSINES = tuple(side * cosine for side in (1, -1) for cosine in (1.0, 0.8, 0.5, 0.2, 0.1, 0.05, 0.02))
STATES = (0.0, 0.5, 1.0)
GROUPS = ("synthetic", "two lobes", "residue", "shipped", "shipped with relief")
ALL_GROUPS = [
    pytest.param(group, marks=() if group in ("two lobes", "residue") else pytest.mark.long)
    for group in GROUPS
]
LOSSLESS = ALL_GROUPS[:3]


@cache
def measured(group: str):
    """Cases; albedos and rejected fractions by sampling; albedos and integrated densities by quadrature."""
    if group == "synthetic":
        cases = Cases.over(lossless(), (0.0,), COSINES, seed=1)
    elif group in ("two lobes", "residue"):
        cases = Cases.over(two_lobes(), (0.0,), COSINES, seed=5)
        if group == "residue":
            # White residue on a part, on nearly all, and on what a pattern would make more than all.
            cases = replace(cases, residue=np.array([0.1, 0.5, 2.0])[np.arange(len(cases)) % 3])
    else:
        surfaces = shipped() if group == "shipped with relief" else [plain(s) for s in shipped()]
        cases = Cases.over(surfaces, STATES, COSINES, seed=2)
    return cases, *sample_cases(cases, 8, 16384, seed=3), *integrate_cases(cases)


def worst(cases: Cases, excess: np.ndarray) -> str:
    case = int(np.unravel_index(np.argmax(excess), excess.shape)[0])
    return f"{cases.label(case)}: {excess.max():.5f}"


@pytest.mark.parametrize("group", ALL_GROUPS)
def test_no_surface_sends_out_more_than_it_receives(group):
    cases, by_samples, _, by_quadrature, _ = measured(group)
    assert np.isfinite(by_samples).all()
    assert by_samples.min() >= 0.0
    assert (by_samples.mean(axis=1) <= 1.005).all(), worst(cases, by_samples.mean(axis=1))
    assert (by_quadrature <= 1.0015).all(), worst(cases, by_quadrature)


@pytest.mark.parametrize("group", LOSSLESS)
def test_lossless_surfaces_send_out_as_much_as_they_receive(group):
    _, by_samples, _, by_quadrature, _ = measured(group)
    assert by_samples.mean(axis=1) == pytest.approx(1.0, abs=0.005)
    assert by_quadrature == pytest.approx(1.0, abs=0.0015)
    assert by_samples.mean() == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize("group", ["synthetic", "two lobes", "shipped"])
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


@pytest.mark.parametrize("group", ALL_GROUPS)
def test_samples_and_quadrature_agree(group):
    cases, by_samples, rejected, by_quadrature, density = measured(group)
    difference = np.abs(by_samples.mean(axis=1) - by_quadrature)
    assert (difference < 0.005).all(), worst(cases, difference)
    # The density integrates to the fraction that is not rejected, below the horizon or beyond a relief's.
    missing = np.abs(1.0 - rejected.mean(axis=1) - density)
    assert (missing < 0.004).all(), worst(cases, missing[:, None])
    assert (density < 1.002).all(), worst(cases, density[:, None])


def test_residue_and_sheet_reflect_as_layers():
    # A grey sheet of reflectance .5 and .3 and transmittance .2 without gloss, covered to .4 with residue of
    # reflectance .45: from the front the mean of both; from behind what comes through the sheet is reflected
    # between the two. By hand.
    sheet = replace(grey_surface("sheet", 0.5, 0.3, 0.2, 1.0, (0.3, 0.3)), residue_reflectance=0.45)
    cases = replace(Cases.over([sheet], (0.0,), (1.0, 0.3, -1.0, -0.3), seed=8), residue=0.4)
    albedo, _ = integrate_cases(cases)
    front = 0.6 * (0.5 + 0.2) + 0.4 * 0.45
    back = 0.3 + 0.6 * 0.2 + 0.4 * 0.45 * 0.2**2 / (1.0 - 0.45 * 0.5)
    assert albedo[:2] == pytest.approx(front, abs=0.0005)
    assert albedo[2:] == pytest.approx(back, abs=0.0005)


def test_residue_on_both_sides():
    # As above, with residue on .4 of the front and, independently, on .2 of the back. By hand.
    sheet = replace(
        grey_surface("sheet", 0.5, 0.3, 0.2, 1.0, (0.3, 0.3)), residue_reflectance=0.45, residue_behind=0.5
    )
    cases = replace(Cases.over([sheet], (0.0,), (1.0, 0.3, -1.0, -0.3), seed=8), residue=0.4)
    albedo, _ = integrate_cases(cases)
    through = 0.6 * 0.8 * 0.2
    front = 0.4 * 0.45 + 0.6 * (0.5 + 0.2 * 0.45 * 0.2**2 / (1.0 - 0.45 * 0.3)) + through
    back = 0.2 * 0.45 + 0.8 * (0.3 + 0.4 * 0.45 * 0.2**2 / (1.0 - 0.45 * 0.5)) + through
    assert albedo[:2] == pytest.approx(front, abs=0.0005)
    assert albedo[2:] == pytest.approx(back, abs=0.0005)


def test_residue_is_matt():
    # Cover f leaves (1 - f) of the gloss: a black body under gloss, and black residue.
    black = [
        replace(grey_surface("black", 0.0, 0.0, 0.0, 1.5, (0.1, 0.3)), residue_reflectance=0.0),
        replace(
            grey_surface("wide", 0.0, 0.0, 0.0, 1.5, (0.1, 0.3)),
            residue_reflectance=0.0,
            wide_roughness=(0.5, 0.5),
            wide_share=0.3,
        ),
    ]
    cases = replace(Cases.over(black, (0.0,), COSINES, seed=9), residue=0.7)
    albedo, _ = integrate_cases(cases)
    cover = np.where(cases.side == 0, 0.7, 0.0)
    expected = (1.0 - cover) * [cases.gloss(case) for case in range(len(cases))]
    assert albedo == pytest.approx(np.tile(expected[:, None], (1, 4)), abs=0.0015)


def test_ageing_moves_the_state_towards_dry_tissue():
    # Reflectance linear in the state from .9 (dry, -1) over .1 (0) to .5 (1); tissue that begins to age at
    # .2, .4 or never. By hand from the definition of `Surface.ageing_order`.
    rows = np.array([0.9, 0.5, 0.1, 0.3, 0.5])[:, None, None] * np.ones((1, 2, 2))
    order = np.array([[[0.2, 0.4, 1.5]]], np.float32)
    ordered = Surface(
        "s", np.array([380.0, 960.0]), rows, np.zeros((5, 2)), first_state=-1.0, ageing_order=order
    )
    plain_one = replace(ordered, name="t", ageing_order=None)
    begins, u = np.array([0.2, 0.4, 1.5]), (np.arange(3) + 0.5) / 3
    for ageing in (0.0, 0.3, 0.55, 1.0):
        uv = np.concatenate([np.stack([u, np.full(3, 0.5)], axis=1)] * 2).astype(np.float32)
        wi = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (6, 1))
        cases = Cases((ordered, plain_one), np.repeat([0, 1], 3), np.full(6, 0.8), wi, uv, ageing=ageing)
        aged = np.concatenate([np.clip((ageing - begins) / 0.25, 0.0, 1.0), np.full(3, ageing)])
        state = 0.8 - aged * 1.8
        expected = np.interp(state, np.linspace(-1.0, 1.0, 5), [0.9, 0.5, 0.1, 0.3, 0.5])
        albedo, _ = integrate_cases(cases)
        assert albedo == pytest.approx(np.tile(expected[:, None], (1, 4)), abs=0.0005), ageing


def relief_cases(reflectance: float, transmittance: float) -> Cases:
    """A matt sheet with slopes up to 40 degrees and more, seen from the normal at many places."""
    x = np.linspace(0.0, 1.0, 64)
    height = (5.0 * np.sin(2 * np.pi * x)[None] * np.ones((64, 1))).astype(np.float32)
    sheet = grey_surface("sheet", reflectance, reflectance, transmittance, 1.0, (0.3, 0.3))
    u = np.linspace(0.02, 0.98, 49)
    uv = np.tile(np.stack([u, np.full(49, 0.5)], axis=1), (2, 1)).astype(np.float32)
    wi = np.repeat(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], np.float32), 49, axis=0)
    surfaces = (replace(sheet, relief_mm=height[None]),)
    return Cases(surfaces, np.zeros(98, int), np.zeros(98), wi, uv)


@pytest.mark.parametrize(("reflectance", "transmittance"), [(0.6, 0.4), (1.0, 0.0), (0.3, 0.2)])
def test_light_beyond_the_horizon_of_a_relief_meets_the_surface_again(reflectance, transmittance):
    # On a slope of angle t the fraction (1 - cos t) / 2 of a matt body's light is below the smooth surface,
    # on both sides of the sheet, where it is scattered with the same albedo p again: p (1 - l) / (1 - l p)
    # leaves in the end, and all of it if p = 1.
    cases = relief_cases(reflectance, transmittance)
    cosine = np.abs(cases.frames(cases.optics())[:, 2, 2])
    assert cosine.min() < 0.75
    albedo, rejected = sample_cases(cases, 8, 4096, seed=4)
    lost, p = (1.0 - cosine) / 2.0, reflectance + transmittance
    expected = p * (1.0 - lost) / (1.0 - lost * p)
    assert albedo.mean(axis=1) == pytest.approx(np.tile(expected[:, None], (1, 4)), abs=0.003)
    assert rejected.mean(axis=1) == pytest.approx(lost, abs=0.003)
    if p == 1.0:
        assert albedo.mean(axis=1) == pytest.approx(1.0, abs=0.003)


FILTERED_SLOPES = [0.1, *(pytest.param(slope, marks=pytest.mark.long) for slope in (0.03, 0.2, 0.3))]


@cache
def filtered(slope: float):
    """Lossless surfaces with two lobes and a relief that a pixel covers; albedos as in `measured`."""
    surfaces = [replace(s, relief_mm=waves(slope)) for s in two_lobes()]
    cases = replace(Cases.over(surfaces, (0.0,), COSINES, seed=6), footprint_m2=1.0)
    blur = 2.0 * slope**2
    return cases, *sample_cases(cases, 8, 4096, seed=7), *integrate_cases(cases, blur), blur


@pytest.mark.parametrize("slope", FILTERED_SLOPES)
def test_a_filtered_relief_conserves_energy(slope):
    # Between the slope variances of the tables E is interpolated, with a larger error if the tables have to
    # begin with a mirror.
    cases, by_samples, _, by_quadrature, density, _ = filtered(slope)
    has_mirror = np.array([min(surface.roughness) < 0.05 for surface in cases.surfaces])[cases.surface]
    for chosen, bound in ((~has_mirror, 0.0015), (has_mirror, 0.01)):
        assert by_samples.mean(axis=1)[chosen] == pytest.approx(1.0, abs=bound + 0.0035)
        assert by_quadrature[chosen] == pytest.approx(1.0, abs=bound)
    assert (density < 1.002).all()


@pytest.mark.parametrize("slope", FILTERED_SLOPES)
def test_a_filtered_relief_widens_the_gloss(slope):
    # A black body: the gloss is that of sqrt(alpha^2 + 2 s^2), whatever the tables are.
    surfaces = [
        replace(
            s, relief_mm=waves(slope), reflectance=s.reflectance * 0.0, transmittance=s.transmittance * 0.0
        )
        for s in two_lobes()[:6:3]
    ]
    blur = 2.0 * slope**2
    for footprint in (1.0, None):
        cases = replace(Cases.over(surfaces, (0.0,), COSINES, seed=6), footprint_m2=footprint)
        by_quadrature, _ = integrate_cases(cases, blur)
        expected = np.array([cases.gloss(case, blur) for case in range(len(cases))])
        assert by_quadrature == pytest.approx(np.tile(expected[:, None], (1, 4)), abs=0.002)


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

"""Directional albedo of gloss against Fresnel, closed forms, finer quadrature and Mitsuba's surfaces."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pepperscene.materials.gloss import cuticle_transmittance, fresnel, gloss_albedo, interpolate_table
from pepperscene.render.variant import mitsuba_modules
from pepperscene.spectra.prospect import cone_transmissivity

COSINES = np.concatenate([[0.0], np.geomspace(1e-6, 1e-2, 60), np.linspace(0.01, 1.0, 100)])


@given(ior=st.floats(1.0, 2.5), roughness=st.floats(-3.0, 0.0))
@example(ior=1.0, roughness=-3.0)
@example(ior=1.001, roughness=-3.0)
@example(ior=2.5, roughness=-3.0)
@example(ior=2.5, roughness=0.0)
def test_table_interpolation_error_is_below_a_thousandth(ior, roughness):
    # Against direct evaluation with twice the steps in both directions, from exactly grazing to the normal.
    table, _ = cuticle_transmittance(ior, 10.0**roughness)
    direct = 1.0 - gloss_albedo(COSINES, ior, 10.0**roughness, (96, 64))
    assert interpolate_table(table, COSINES) == pytest.approx(direct, abs=1e-3)
    assert 0.0 <= table.min() <= table.max() <= 1.0


@pytest.mark.parametrize("ior", [1.0, 1.1, 1.45, 2.5])
def test_smooth_albedo_is_fresnel_reflectance(ior):
    assert gloss_albedo(COSINES, ior, 0.0) == pytest.approx(fresnel(COSINES, ior), abs=1e-12)
    table, mean = cuticle_transmittance(ior, 0.0)
    if ior == 1.0:
        assert (table == 1.0).all()
        assert mean == pytest.approx(1.0, abs=1e-12)
    else:
        # The mean transmissivity for diffuse light; the table's interpolant has a small error.
        assert mean == pytest.approx(float(cone_transmissivity(np.pi / 2, ior)), abs=2e-4)


def test_fresnel_matches_mitsuba():
    mi, _ = mitsuba_modules()
    for ior in (1.05, 1.45, 2.5):
        expected = np.asarray(mi.fresnel(mi.Float(COSINES), mi.Float(ior))[0])
        assert fresnel(COSINES, ior) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("ior", "alpha"), [(1.28, 0.45), (2.5, 0.02)])
def test_albedo_matches_mitsubas_rough_dielectric(ior, alpha):
    # Only the reflection lobe of roughdielectric: 2^20 samples, standard error below 3e-4.
    mi, dr = mitsuba_modules()
    glass = mi.load_dict(
        {"type": "roughdielectric", "distribution": "ggx", "alpha": alpha, "int_ior": ior, "ext_ior": 1.0}
    )
    n = 1 << 20
    rng = np.random.default_rng(5)
    u = rng.random((3, n)).astype(np.float32)
    context = mi.BSDFContext()
    context.component = 0
    for cosine in (1.0, 0.5, 0.02):
        si = dr.zeros(mi.SurfaceInteraction3f, n)
        si.wi = mi.Vector3f(float(np.sqrt(1.0 - cosine**2)), 0.0, cosine)
        _, weight = glass.sample(context, si, mi.Float(u[0]), mi.Point2f(u[1], u[2]))
        weights = np.asarray(weight)[0].astype(float)
        error = weights.std() / np.sqrt(n)
        assert error < 3e-4
        albedo = float(gloss_albedo(cosine, ior, alpha)[0])
        assert albedo == pytest.approx(weights.mean(), abs=4.5 * error + 1e-4)


def test_mean_is_that_of_the_interpolant():
    # Midpoint rule in the squared cosine, a million steps.
    table, mean = cuticle_transmittance(1.45, 0.1)
    mu = np.sqrt((np.arange(1 << 20) + 0.5) / (1 << 20))
    assert mean == pytest.approx(interpolate_table(table, mu).mean(), abs=1e-7)

"""Energy, reciprocity and sampling of the organs' BSDF, by its own definition and by numbers alone."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import bench_camera

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import Surface, organ_surfaces, twine_surface
from pepperscene.render.optics import Optics
from pepperscene.render.tables import pack
from pepperscene.render.variant import kernel

NM = np.array([400.0, 700.0])
CASES = {
    "matt": (0.7, 0.0, 1.0, (0.3, 0.3)),
    "sheet without gloss": (0.3, 0.5, 1.0, (0.3, 0.3)),
    "leaf": (0.08, 0.12, 1.45, (0.35, 0.5)),
    "white leaf": (0.5, 0.5, 1.45, (0.35, 0.5)),
    "fruit": (0.4, 0.0, 1.45, (0.1, 0.1)),
    "black gloss": (0.0, 0.0, 1.5, (0.2, 0.4)),
}
COSINES = (1.0, 0.8, 0.5, 0.2, 0.05, -0.05, -0.5, -1.0)


def optics_of(case: str, relief: bool = False) -> Optics:
    reflectance, transmittance, ior, roughness = CASES[case]
    both = np.stack([np.full(2, reflectance), np.full(2, reflectance)])[None]
    height = None
    if relief:
        y, x = np.mgrid[0:64, 0:64] / 64.0 * 2 * np.pi
        height = (0.3 * np.sin(3 * x) * np.sin(2 * y)).astype(np.float32)
    surface = Surface(case, NM, both, np.full((1, 2), transmittance), ior, roughness, None, height)
    return Optics(pack([surface], 400.0, 700.0))


def interaction(wi, n: int, uv=(0.5, 0.5)):
    """`n` interactions on the plane z = 0 seen from `wi`, 10 cm across the unit of uv."""
    mi, dr = kernel()
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(*wi)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0.0, 0.0, 1.0))
    si.dp_du, si.dp_dv = mi.Vector3f(0.1, 0.0, 0.0), mi.Vector3f(0.0, 0.1, 0.0)
    si.uv = mi.Point2f(*uv)
    si.wavelengths = mi.Spectrum(450.0, 500.0, 550.0, 600.0)
    return si


def towards(cosine: float):
    return (float(np.sqrt(1.0 - cosine**2)), 0.0, cosine)


def point_at(optics: Optics, cosine: float, n: int, uv=(0.5, 0.5)):
    mi, _ = kernel()
    si = interaction(towards(cosine), n, uv)
    return optics.at(si, mi.UInt32(0), mi.Float(0.5), mi.Bool(True))


@pytest.mark.parametrize("case", CASES)
def test_no_surface_sends_out_more_than_it_receives(case):
    # White furnace: the mean sampling weight is the directional albedo; 2^18 samples, error below 0.3 %.
    mi, _ = kernel()
    reflectance, transmittance, ior, _ = CASES[case]
    optics = optics_of(case)
    rng = np.random.default_rng(1)
    u = rng.random((3, 1 << 18)).astype(np.float32)
    for cosine in COSINES:
        _, density, weight, _ = point_at(optics, cosine, 1 << 18).sample(
            mi.Float(u[0]), mi.Point2f(u[1], u[2])
        )
        weights = np.asarray(weight)
        albedo = float(np.where(np.asarray(density) > 0, weights, 0.0).mean())
        assert np.isfinite(weights).all()
        assert weights.min() >= 0.0
        assert albedo <= 1.003
        if ior == 1.0:
            assert albedo == pytest.approx(reflectance + transmittance, abs=0.003)


@pytest.mark.parametrize("case", CASES)
def test_body_sends_out_what_the_cuticle_let_in(case):
    # Quadrature over the hemispheres of the diffuse lobes alone: (1 - F(i)) (R + T), for any roughness.
    mi, _ = kernel()
    reflectance, transmittance, ior, _ = CASES[case]
    both = np.full((1, 2, 2), reflectance)
    smooth = Surface(case, NM, both, np.full((1, 2), transmittance), ior, (1e-3, 1e-3))
    optics = Optics(pack([smooth], 400.0, 700.0))
    cos_o, phi = (np.arange(128) + 0.5) / 128, (np.arange(64) + 0.5) / 64 * 2 * np.pi
    c, p = np.meshgrid(cos_o, phi, indexing="ij")
    s = np.sqrt(1 - c**2)
    for cosine in (1.0, 0.6, 0.25, -0.6):
        total = 0.0
        for side in (1.0, -1.0):
            wo = np.stack([s * np.cos(p), s * np.sin(p), side * c]).reshape(3, -1).astype(np.float32)
            value, _ = point_at(optics, cosine, wo.shape[1]).eval_pdf(mi.Vector3f(*wo))
            # The mirror's spike is narrower than the grid: leave its cells out by their size.
            values = np.asarray(value)[0]
            total += np.minimum(values, 1.0).sum() * (2 * np.pi / values.size)
        fresnel = 0.0
        if ior > 1.0:
            ci, ct = abs(cosine), np.sqrt(1 - (1 - cosine**2) / ior**2)
            fresnel = (
                ((ior * ci - ct) / (ior * ci + ct)) ** 2 + ((ci - ior * ct) / (ci + ior * ct)) ** 2
            ) / 2
        assert total == pytest.approx((1 - fresnel) * (reflectance + transmittance), rel=0.01, abs=0.002)


@pytest.mark.parametrize("relief", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_scattering_is_reciprocal(case, relief):
    # f(i, o) = f(o, i) for 4,096 random pairs: on one side, and through the sheet.
    # On a relief: for directions that are on the same side of it and of the smooth surface, for beyond those
    # no shading normal is reciprocal (Veach 1997, section 5.3).
    mi, _ = kernel()
    optics = optics_of(case, relief)
    rng = np.random.default_rng(2)
    pairs = rng.normal(size=(2, 3, 4096))
    a, b = (pairs / np.linalg.norm(pairs, axis=1, keepdims=True)).astype(np.float32)

    def value(wi, wo):
        point = optics.at(interaction(wi, 4096, (0.3, 0.4)), mi.UInt32(0), mi.Float(0.5), mi.Bool(True))
        found, _ = point.eval_pdf(mi.Vector3f(*wo))
        cosine = np.asarray(point.frame.to_local(mi.Vector3f(*wo)).z)
        return np.asarray(found)[0] / np.maximum(np.abs(cosine), 1e-6), cosine * wo[2] > 0.01 * np.abs(wo[2])

    there, b_agrees = value(a, b)
    back, a_agrees = value(b, a)
    fair = a_agrees & b_agrees & (np.minimum(np.abs(a[2]), np.abs(b[2])) > 0.01)
    assert fair.sum() > 3500
    for pairs_of in (fair & (a[2] > 0) & (b[2] > 0), fair & (a[2] * b[2] < 0)):
        assert there[pairs_of] == pytest.approx(back[pairs_of], rel=1e-2, abs=1e-4)


@pytest.mark.parametrize("relief", [False, True])
@pytest.mark.parametrize("case", ["sheet without gloss", "leaf", "fruit"])
def test_samples_follow_their_density(case, relief):
    # Mitsuba's chi-squared test per direction of view; significance 0.01 corrected for all cases (Sidak).
    mi, dr = kernel()
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    optics = optics_of(case, relief)
    cosines = (0.9, 0.4, -0.6)
    for cosine in cosines:

        def sample(u, cosine=cosine):
            n = len(u[0])
            wo, density, _, _ = point_at(optics, cosine, n, (0.3, 0.4)).sample(
                mi.Float(u[0]), mi.Point2f(u[1], u[2])
            )
            return wo, mi.Float(dr.select(density > 0.0, 1.0, 0.0))

        def pdf(wo, cosine=cosine):
            return point_at(optics, cosine, len(wo.x), (0.3, 0.4)).eval_pdf(wo)[1]

        test = ChiSquareTest(
            domain=SphericalDomain(),
            sample_func=sample,
            pdf_func=pdf,
            sample_dim=3,
            sample_count=1 << 18,
            res=51,
            ires=16,
        )
        assert test.run(significance_level=0.01, test_count=18), test.messages


def test_packed_spectra_equal_the_surfaces():
    # The kernel's nearest 1 nm entry against the surface's own linear interpolation.
    nm = np.arange(380.0, 781.0, 5.0)
    curve = 0.3 + 0.2 * np.sin(nm / 40.0)
    states = np.linspace(0.5, 1.0, 5)[:, None]
    surface = Surface("s", nm, np.stack([states * curve, states * curve * 0.9], 1), states * curve * 0.5)
    mi, _ = kernel()
    optics = Optics(pack([surface], 380.0, 780.0))
    si = interaction((0.0, 0.0, 1.0), 1)
    si.wavelengths = mi.Spectrum(412.0, 530.0, 655.0, 700.0)
    point = optics.at(si, mi.UInt32(0), mi.Float(0.3), mi.Bool(True))
    wanted = np.interp([412, 530, 655, 700], nm, curve) * (0.5 + 0.3 * 0.5)
    assert np.asarray(point.reflectance).ravel() == pytest.approx(wanted, rel=1e-5)
    assert np.asarray(point.transmittance).ravel() == pytest.approx(wanted * 0.5, rel=1e-5)


def test_nearest_wavelengths_stand_for_the_shipped_surfaces():
    # What the packing promises: taking the nearest 1 nm changes no channel of any surface by more than 2e-4.
    camera = bench_camera()
    nm, fine = np.arange(380.0, 781.0, 5.0), np.arange(380.0, 690.0, 0.02)
    weight = camera.sensor.electrons_per_joule(fine) * camera.flash.radiant_intensity(fine)
    for surface in (*organ_surfaces(load_cultivar("kaite"), nm).values(), twine_surface(nm)):
        rows = np.concatenate([surface.reflectance.reshape(-1, nm.size), surface.transmittance])
        for row in rows[rows.any(axis=1)]:
            exact = weight @ np.interp(fine, nm, row)
            nearest = weight @ np.interp(np.floor(fine + 0.5), nm, row)
            assert nearest == pytest.approx(exact, rel=2e-4)


def test_patterns_close_on_themselves_around_a_tube():
    # A pattern that is periodic in u has no seam: the state at u = 0 is that at u = 1, midway between texels.
    nm = np.array([400.0, 700.0])
    states = np.linspace(0.0, 1.0, 33)[:, None]
    pattern = np.tile(0.4 * np.sin(2 * np.pi * (np.arange(16) + 0.5) / 16), (4, 1)).astype(np.float32)
    body = np.stack([states * np.ones(2)] * 2, axis=1)
    surface = Surface("tube", nm, body, np.zeros((33, 2)), pattern=pattern)
    mi, _ = kernel()
    optics = Optics(pack([surface], 400.0, 700.0))

    def state(u: float) -> float:
        point = optics.at(
            interaction((0.0, 0.0, 1.0), 1, (u, 0.5)), mi.UInt32(0), mi.Float(0.5), mi.Bool(True)
        )
        return float(np.asarray(point.reflectance).ravel()[0])

    assert state(0.0) == pytest.approx(state(1.0), abs=1e-5)
    assert state(0.0) == pytest.approx(0.5, abs=1e-3)  # halfway between the texels at -half and +half
    assert state(0.25) == pytest.approx(0.9, abs=0.02)

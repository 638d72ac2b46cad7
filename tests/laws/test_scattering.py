"""Scattering by surfaces: reciprocity, sound samples, packed tables, and the model of a spectrophotometer."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera
from hypothesis import example, given
from hypothesis import strategies as st
from scatterers import GRID_NM, TEST_NM, Cases, grey_surface, interaction, lossless, plain, shipped, two_lobes

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import Surface, organ_surfaces
from pepperscene.materials.gloss import gloss_albedo
from pepperscene.render.surface.optics import STEP_NM, Optics
from pepperscene.render.variant import mitsuba_modules
from pepperscene.tuning.reflectance import instrument_reflectance

PAIRS = 1 << 15


def pairs_of_directions(surfaces: tuple[Surface, ...], seed: int) -> tuple[Cases, np.ndarray]:
    """Surfaces seen from random directions, and `(n, 3)` second directions.

    Half of them are random, half near the mirrored direction, in the gloss.
    """
    rng = np.random.default_rng(seed)
    surface = rng.integers(0, len(surfaces), PAIRS)
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, PAIRS, 3)))
    alpha = np.array([surfaces[k].roughness for k in surface])[np.arange(PAIRS), (a[:, 2] < 0).astype(int)]
    slope = alpha[:, None] * rng.normal(size=(PAIRS, 2))
    half = np.column_stack([slope, np.ones(PAIRS)])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    mirrored = 2.0 * (a * half).sum(axis=1, keepdims=True) * half - a
    b = np.where(np.arange(PAIRS)[:, None] % 2 == 0, b, mirrored)
    uv = rng.uniform(0.05, 0.95, (PAIRS, 2)).astype(np.float32)
    return Cases(surfaces, surface, rng.random(PAIRS), a.astype(np.float32), uv), b.astype(np.float32)


@pytest.mark.parametrize(
    ("relief", "footprint_m2"),
    [
        (False, 0.0),
        (True, 0.0),
        pytest.param(True, 1e-7, marks=pytest.mark.long),
        pytest.param(True, None, marks=pytest.mark.long),
    ],
)
def test_scattering_is_reciprocal(relief, footprint_m2):
    # f(i, o) = f(o, i) for 32,768 pairs over all shipped surfaces, in all states, and all synthetic ones: on
    # one side, and through sheets with different sides, with and without residue and ageing. On a relief: for
    # directions on the same side of it and of the smooth surface, because shading normals are not reciprocal
    # for others (Veach 1997, section 5.3). A relief is read at full resolution, filtered to a third of a
    # millimetre (of 30), or as a whole.
    mi, dr = mitsuba_modules()
    surfaces = (*(shipped() if relief else map(plain, shipped())), *lossless(), *two_lobes())
    cases, b = pairs_of_directions(surfaces, seed=2)
    rng = np.random.default_rng(3)
    residue, ageing = rng.random((2, PAIRS)) * (rng.random((2, PAIRS)) < 0.5)
    cases = replace(cases, residue=residue, ageing=ageing, footprint_m2=footprint_m2)
    reversed_cases = replace(cases, wi=b)
    optics = cases.optics()

    def scattered(cases: Cases, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        point = cases.points(optics, dr.arange(mi.UInt32, PAIRS))
        value, _ = point.eval_pdf(mi.Vector3f(*wo.T))
        cosine = np.asarray(point.frame.to_local(mi.Vector3f(*wo.T)).z)
        f = np.asarray(value) / np.maximum(np.abs(cosine), 1e-6)
        tilt = np.broadcast_to(np.asarray(point.frame.n.z), (PAIRS,))
        return f, cosine * wo[:, 2] > 0.01 * np.abs(wo[:, 2]), tilt

    forward, b_agrees, tilt = scattered(cases, b)
    backward, a_agrees, _ = scattered(reversed_cases, cases.wi)
    valid = a_agrees & b_agrees & (np.minimum(np.abs(cases.wi[:, 2]), np.abs(b[:, 2])) > 0.01)
    assert (tilt.min() < 0.9) == (relief and footprint_m2 is not None)
    same = cases.wi[:, 2] * b[:, 2] > 0
    for chosen in (valid & same, valid & ~same):
        assert chosen.sum() > 5_000
        assert np.count_nonzero(forward[:, chosen] > 0) > 5_000
        # In single precision the half vector of a mirror of alpha .001 has a relative error of about 1e-3.
        assert forward[:, chosen] == pytest.approx(backward[:, chosen], rel=5e-3, abs=1e-6)
    # Nearly all agree far better.
    difference = np.abs(forward - backward)[:, valid]
    assert np.quantile(difference / np.maximum(forward[:, valid], 1e-3), 0.99) < 2e-4


def test_packed_spectra_equal_the_surfaces():
    # The kernel's nearest entry against linear interpolation of the surface.
    nm = np.arange(380.0, 781.0, 5.0)
    curve = 0.3 + 0.2 * np.sin(nm / 40.0)
    states = np.linspace(0.5, 1.0, 5)[:, None]
    surface = Surface("s", nm, np.stack([states * curve, states * curve * 0.9], 1), states * curve * 0.5)
    mi, _ = mitsuba_modules()
    optics = Optics.pack([surface], 380.0, 780.0)
    si = interaction((0.0, 0.0, 1.0), 1)
    si.wavelengths = mi.Spectrum(412.0, 530.0, 655.0, 700.0)
    point = optics.point(si, mi.UInt32(0), mi.Float(0.3), mi.Bool(True))
    expected = np.interp([412, 530, 655, 700], nm, curve) * (0.5 + 0.3 * 0.5)
    assert np.asarray(point.reflectance).ravel() == pytest.approx(expected, rel=1e-5)
    assert np.asarray(point.transmittance).ravel() == pytest.approx(expected * 0.5, rel=1e-5)


def test_nearest_wavelengths_are_accurate_for_shipped_surfaces():
    # Taking the nearest entry changes no channel of any surface by more than 2e-5. With entries 1 nm apart it
    # is 2.6e-4: the flash's blue light changes by 6 % of its peak per nm at 440 nm.
    camera = axis_camera()
    fine = np.arange(380.0, 690.0, 0.02)
    weight = camera.sensor.electrons_per_joule(fine) * camera.flash.radiant_intensity(fine)
    for surface in shipped():
        nm = surface.wavelength_nm
        rows = np.concatenate([surface.reflectance.reshape(-1, nm.size), surface.transmittance])
        for row in rows[rows.any(axis=1)]:
            exact = weight @ np.interp(fine, nm, row)
            nearest = weight @ np.interp(STEP_NM * np.floor(fine / STEP_NM + 0.5), nm, row)
            assert nearest == pytest.approx(exact, rel=2e-5)


def test_patterns_are_periodic_around_a_tube():
    # A pattern that is periodic in u has no seam: u = 0 and u = 1 have the same state, midway between texels.
    nm = np.array([400.0, 700.0])
    states = np.linspace(0.0, 1.0, 33)[:, None]
    pattern = np.tile(0.4 * np.sin(2 * np.pi * (np.arange(16) + 0.5) / 16), (1, 4, 1)).astype(np.float32)
    body = np.stack([states * np.ones(2)] * 2, axis=1)
    surface = Surface("tube", nm, body, np.zeros((33, 2)), pattern=pattern)
    mi, _ = mitsuba_modules()
    optics = Optics.pack([surface], 400.0, 700.0)

    def state(u: float) -> float:
        point = optics.point(
            interaction((0.0, 0.0, 1.0), 1, (u, 0.5)), mi.UInt32(0), mi.Float(0.5), mi.Bool(True)
        )
        return float(np.asarray(point.reflectance).ravel()[0])

    assert state(0.0) == pytest.approx(state(1.0), abs=1e-5)
    assert state(0.0) == pytest.approx(0.5, abs=1e-3)  # midway between the last and the first texel
    assert state(0.25) == pytest.approx(0.9, abs=0.02)


# --- any surface --------------------------------------------------------------------------------------------


EXAMPLES = 4096
HEIGHTS = (1.0, -1.0, 0.0, -0.0, 1e-45, -1e-45, 1e-38, -1e-38, 1e-20, 1e-7, -1e-7, 1e-5, 1.1e-5, -1e-4, 1e-3)

unit = st.floats(0.0, 1.0)
alphas = st.one_of(unit, st.floats(-4.0, 0.0).map(lambda x: 10.0**x))
iors = st.one_of(st.floats(1.0, 2.5), st.sampled_from([1.0, 1.0 + 1e-7, 1.0001, 2.5]))


@st.composite
def surfaces(draw) -> Surface:
    through = draw(unit)
    front, back = (draw(unit) * (1.0 - through) for _ in range(2))
    relief = draw(st.sampled_from([None, 0.01, 3.0]))
    surface = grey_surface("any", front, back, through, draw(iors), (draw(alphas), draw(alphas)))
    if draw(st.booleans()):
        wide = draw(alphas), draw(alphas)
        residue = {"residue_reflectance": draw(unit), "residue_behind": draw(unit)}
        surface = replace(surface, wide_roughness=wide, wide_share=draw(unit), **residue)
    if relief is None:
        return surface
    y, x = np.mgrid[0:16, 0:16] / 16.0 * 2.0 * np.pi
    height = (relief * np.sin(x) * np.sin(2.0 * y)).astype(np.float32)
    return replace(surface, relief_mm=height[None])


def directions(rng: np.random.Generator) -> np.ndarray:
    """`(EXAMPLES, 3)` float32 unit vectors, half of them extreme."""
    v = rng.normal(size=(EXAMPLES, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    height = rng.choice(np.array(HEIGHTS, np.float32), EXAMPLES)
    azimuth = rng.choice(np.array([0.0, 0.5 * np.pi, 1.0]), EXAMPLES) + rng.choice([0.0, np.pi], EXAMPLES)
    sine = np.sqrt(1.0 - height.astype(float) ** 2)
    extreme = np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), height])
    return np.where(rng.random((EXAMPLES, 1)) < 0.5, extreme, v).astype(np.float32)


@given(
    mixture=st.lists(surfaces(), min_size=3, max_size=3), nm=st.floats(200.0, 2600.0), seed=st.integers(0, 99)
)
@example([grey_surface("mirror", 0.0, 0.0, 0.0, 2.5, (0.0, 1e-3))] * 3, 500.0, 0)
@example(
    [
        grey_surface("hole", 0.0, 0.0, 1.0, 1.0, (0.0, 1.0)),
        grey_surface("black", 0.0, 0.0, 0.0, 1.0, (0.5, 0.5)),
    ],
    500.0,
    1,
)
def test_scattering_is_finite_positive_and_on_the_right_side(mixture, nm, seed):
    mi, dr = mitsuba_modules()
    rng = np.random.default_rng(seed)
    wi, other = directions(rng), directions(rng)
    # A third of the pairs are exactly mirrored: the peak of the gloss.
    mirrored = rng.random(EXAMPLES) < 0.33
    wo = np.where(mirrored[:, None], wi * np.array([-1, -1, 1], np.float32), other)
    u = rng.random((3, EXAMPLES)).astype(np.float32)
    u[:, :8] = np.array([0.0, 1.0 - 2.0**-24] * 4)

    # The first organs of the surfaces are clean; the others have residue and age.
    count = len(mixture)
    organs = np.ones((2 * count, 4))
    organs[:, 0] = np.arange(2 * count) % count
    organs[:, 2:] = rng.random((2 * count, 2)) * (np.arange(2 * count) >= count)[:, None]
    optics = Optics.pack(mixture, float(GRID_NM[0]), float(GRID_NM[-1]), organs=organs)
    si = interaction(mi.Vector3f(*wi.T), EXAMPLES, mi.Point2f(*rng.random((2, EXAMPLES)).astype(np.float32)))
    si.wavelengths = mi.Spectrum(*(mi.Float(nm) + mi.Float(30.0 * k) for k in range(4)))
    organ = rng.integers(0, 2 * count, EXAMPLES)
    surface = organ % count
    footprint = [0.0, 1e-6, 1.0, None][seed % 4]
    footprint = None if footprint is None else mi.Float(footprint)
    point = optics.point(si, mi.UInt32(organ), mi.Float(rng.random(EXAMPLES)), mi.Bool(True), footprint)
    value, density = point.eval_pdf(mi.Vector3f(*wo.T))
    out, sample_density, weight, lobe = point.sample(mi.Float(u[0]), mi.Point2f(u[1], u[2]))
    dr.eval(value, density, out, sample_density, weight, lobe)

    for array in map(np.asarray, (value, density, sample_density, weight)):
        assert np.isfinite(array).all()
        assert array.min() >= 0.0
    # Valid samples are unit vectors on their lobe's side.
    valid = np.asarray(sample_density) > 0.0
    out, lobe = np.asarray(out), np.asarray(lobe)
    assert np.abs(np.linalg.norm(out[:, valid], axis=0) - 1.0).max(initial=0.0) < 1e-5
    side = np.sign(out[2]) * np.sign(wi[:, 2])
    assert (side[valid & (lobe < 2)] > 0).all()
    assert (side[valid & (lobe == 2)] < 0).all()
    assert set(lobe) <= {0, 1, 2}
    # Weights are bounded: no lobe is sampled much more rarely than it is bright.
    assert np.asarray(weight)[:, valid].max(initial=0.0) < 30.0
    # No lobe is sampled that the surface does not have.
    gloss = np.array([s.ior > 1.0 for s in mixture])[surface]
    through = np.array([s.transmittance.max() > 0.0 for s in mixture])[surface]
    assert gloss[valid & (lobe == 0)].all()
    assert through[valid & (lobe == 2)].all()


# --- a spectrophotometer ------------------------------------------------------------------------------------


THIN = {"leaf": True, "fruit": False, "stem": False, "peduncle": False}
STATES = (0.0, 0.5, 1.0)  # rows of every surface's table
COSINE = float(np.cos(np.radians(8.0)))


def scattered(cases: Cases, directions: np.ndarray) -> np.ndarray:
    """BRDF times cosine `(cases, directions, 4)` by the renderer's code, for directions `(n, 3)`."""
    mi, dr = mitsuba_modules()
    lane = dr.arange(mi.UInt32, len(cases) * len(directions))
    wo = np.tile(directions, (len(cases), 1)).astype(np.float32)
    value, _ = cases.points(cases.optics(), lane // len(directions)).eval_pdf(mi.Vector3f(*wo.T))
    return np.asarray(value).reshape(4, len(cases), len(directions)).transpose(1, 2, 0)


def test_integrating_sphere_measures_the_reflected_light_without_gloss():
    # Light incident at 8 degrees, integrated over the hemisphere by quadrature, minus the narrow lobe.
    cultivar = load_cultivar("kaite")
    organs = organ_surfaces(cultivar, GRID_NM)
    cases = Cases.over([plain(organs[name]) for name in THIN], STATES, [COSINE], seed=1)
    node, weight = np.polynomial.legendre.leggauss(200)
    polar, azimuth = (node + 1.0) * np.pi / 4.0, (np.arange(400) + 0.5) / 400 * 2.0 * np.pi
    polar, azimuth = (axis.ravel() for axis in np.meshgrid(polar, azimuth, indexing="ij"))
    x, y, z = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)
    solid_angle = np.repeat(weight * np.pi / 4.0, 400) * np.sin(polar) * 2.0 * np.pi / 400
    reflected = np.einsum("cnk,n->ck", scattered(cases, np.stack([x, y, z], axis=1)), solid_angle)
    surfaces = [cases.surfaces[k] for k in cases.surface]
    for case, (surface, alpha, state) in enumerate(zip(surfaces, cases.alpha(), cases.state, strict=True)):
        pigments = cultivar.pigments[surface.name]
        modelled = instrument_reflectance(pigments, TEST_NM, state, thin=THIN[surface.name])
        # The trap takes the narrow lobe alone, on its share of the surface.
        share = 1.0 if surface.wide_roughness is None else 1.0 - surface.wide_share
        trapped = share * gloss_albedo(COSINE, surface.ior, alpha)[0]
        assert modelled == pytest.approx(reflected[case] - trapped, abs=1e-3), cases.label(case)

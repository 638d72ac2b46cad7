"""Reciprocity of the BSDF, and the packed tables of the surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera
from scatterers import Cases, interaction, lossless, plain, shipped, two_lobes

from pepperscene.materials import Surface
from pepperscene.render.surface.optics import STEP_NM, Optics
from pepperscene.render.variant import mitsuba_modules

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


@pytest.mark.parametrize(("relief", "footprint_m2"), [(False, 0.0), (True, 0.0), (True, 1e-7), (True, None)])
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
    fine = np.arange(380.0, 690.0, 0.04)
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

"""For any surface and directions, values are finite and not negative, and samples on the right side.

An example has three surfaces and 4,096 pairs of directions, half of them extreme: exactly normal, exactly
grazing, and denormal heights above or below the surface.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from scatterers import GRID_NM, grey_surface, interaction

from pepperscene.materials import Surface
from pepperscene.render.surface.optics import Optics
from pepperscene.render.variant import mitsuba_modules

PAIRS = 4096
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
    """`(PAIRS, 3)` float32 unit vectors, half of them extreme."""
    v = rng.normal(size=(PAIRS, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    height = rng.choice(np.array(HEIGHTS, np.float32), PAIRS)
    azimuth = rng.choice(np.array([0.0, 0.5 * np.pi, 1.0]), PAIRS) + rng.choice([0.0, np.pi], PAIRS)
    sine = np.sqrt(1.0 - height.astype(float) ** 2)
    extreme = np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), height])
    return np.where(rng.random((PAIRS, 1)) < 0.5, extreme, v).astype(np.float32)


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
    mirrored = rng.random(PAIRS) < 0.33
    wo = np.where(mirrored[:, None], wi * np.array([-1, -1, 1], np.float32), other)
    u = rng.random((3, PAIRS)).astype(np.float32)
    u[:, :8] = np.array([0.0, 1.0 - 2.0**-24] * 4)

    # The first organs of the surfaces are clean; the others have residue and age.
    count = len(mixture)
    organs = np.ones((2 * count, 4))
    organs[:, 0] = np.arange(2 * count) % count
    organs[:, 2:] = rng.random((2 * count, 2)) * (np.arange(2 * count) >= count)[:, None]
    optics = Optics.pack(mixture, float(GRID_NM[0]), float(GRID_NM[-1]), organs=organs)
    si = interaction(mi.Vector3f(*wi.T), PAIRS, mi.Point2f(*rng.random((2, PAIRS)).astype(np.float32)))
    si.wavelengths = mi.Spectrum(*(mi.Float(nm) + mi.Float(30.0 * k) for k in range(4)))
    organ = rng.integers(0, 2 * count, PAIRS)
    surface = organ % count
    footprint = [0.0, 1e-6, 1.0, None][seed % 4]
    footprint = None if footprint is None else mi.Float(footprint)
    point = optics.point(si, mi.UInt32(organ), mi.Float(rng.random(PAIRS)), mi.Bool(True), footprint)
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

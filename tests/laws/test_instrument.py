"""The direct model of a spectrophotometer agrees with the renderer's surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from scatterers import GRID_NM, TEST_NM, Cases, plain

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import organ_surfaces
from pepperscene.materials.gloss import gloss_albedo
from pepperscene.render.variant import mitsuba_modules
from pepperscene.tuning.reflectance import instrument_reflectance

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

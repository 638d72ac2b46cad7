"""The direct model of a spectrophotometer agrees with the renderer's surfaces."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scatterers import GRID_NM, SEEN_NM, Cases, plain

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import organ_surfaces
from pepperscene.materials.gloss import gloss_albedo
from pepperscene.render.variant import mitsuba_modules
from pepperscene.tuning.model.reflectance import instrument_reflectance

THIN = {"leaf": True, "fruit": False, "stem": False, "peduncle": False}
STATES = (0.0, 0.5, 1.0)  # rows of every surface's table


@cache
def cases(cosine: float) -> Cases:
    """Surfaces of the shipped cultivar without patterns, in three states, lit at a cosine."""
    organs = organ_surfaces(load_cultivar("kaite"), GRID_NM)
    return Cases.over([plain(organs[name]) for name in THIN], STATES, [cosine], seed=1)


def scattered(of: Cases, towards: np.ndarray) -> np.ndarray:
    """BRDF times cosine `(cases, directions, 4)` by the renderer's code, for directions `(n, 3)`."""
    mi, dr = mitsuba_modules()
    lane = dr.arange(mi.UInt32, len(of) * len(towards))
    wo = np.tile(towards, (len(of), 1)).astype(np.float32)
    value, _ = of.points(of.optics(), lane // len(towards)).eval_pdf(mi.Vector3f(*wo.T))
    return np.asarray(value).reshape(4, len(of), len(towards)).transpose(1, 2, 0)


def modelled(of: Cases) -> np.ndarray:
    """`(cases, 4)` reflectance by the direct model."""
    pigments = load_cultivar("kaite").pigments
    names = [of.surfaces[k].name for k in of.surface]
    values = [
        instrument_reflectance(pigments[name], SEEN_NM, state, thin=THIN[name])
        for name, state in zip(names, of.state, strict=True)
    ]
    return np.array(values)


def test_integrating_sphere_measures_the_reflected_light_without_gloss():
    # Light reflected from 8 degrees, by quadrature over the hemisphere, less the gloss' albedo.
    of = cases(float(np.cos(np.radians(8.0))))
    place, weight = np.polynomial.legendre.leggauss(200)
    polar, azimuth = (place + 1.0) * np.pi / 4.0, (np.arange(400) + 0.5) / 400 * 2.0 * np.pi
    polar, azimuth = (axis.ravel() for axis in np.meshgrid(polar, azimuth, indexing="ij"))
    towards = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1
    )
    solid_angle = np.repeat(weight * np.pi / 4.0, 400) * np.sin(polar) * 2.0 * np.pi / 400
    reflected = np.einsum("cnk,n->ck", scattered(of, towards), solid_angle)
    gloss = [gloss_albedo(np.cos(np.radians(8.0)), of.surfaces[k].ior, a)[0] for k, a in
             zip(of.surface, of.alpha(), strict=True)]  # fmt: skip
    assert modelled(of) == pytest.approx(reflected - np.array(gloss)[:, None], abs=1e-3)

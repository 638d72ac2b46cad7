"""Sensors with bands measure the reflectance of cards and leaves.

Rationale: users divide the signal of a band by that of a white card, and compute indices from the quotients.

Set-up: a wall in front of a camera, by its flash alone or under an even sky, and the same wall in white. The
expected reflectance is the mean of the wall's over the wavelengths that a band detects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from banded import gaussian_bands, small_camera, wall
from bodies import EVEN_SKY, matt
from prosail import run_prospect
from scatterers import plain
from scipy import stats
from test_convergence import sphere_and_leaf

from pepperscene.camera import Camera
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.materials.leaf import leaf_surface
from pepperscene.render import Quality, Renderer
from pepperscene.scene import Sky, assemble_scene
from pepperscene.spectra import leaf_spectra

RAMP_NM = np.array([300.0, 1100.0])
RAMP = np.array([0.5, 0.9])
"""At least a half, so that no path is lost to Russian roulette, and there is no noise."""


def electrons(camera: Camera, surface: Surface, sky: Sky | None, samples: int = 4) -> np.ndarray:
    """`(c,)` mean of an image of a wall of this surface, with a black one behind it."""
    walls = concatenate_meshes([wall(0.5, surface.name), wall(0.501, "black")])
    scene = assemble_scene(walls, {surface.name: surface, "black": lambertian_surface("black", 0.0)}, sky)
    quality = Quality(samples, samples, samples, 1, target=None, denoise=False)
    return Renderer(scene).render(camera, ["electrons"], quality)["electrons"].astype(float).mean(axis=(0, 1))


def reflectances(camera: Camera, surface: Surface, sky: Sky | None, samples: int = 4) -> np.ndarray:
    white = lambertian_surface("white", 1.0)
    return electrons(camera, surface, sky, samples) / electrons(camera, white, sky)


def seen(camera: Camera, nm: np.ndarray, spectrum: np.ndarray, sky: Sky | None) -> np.ndarray:
    """`(c,)` mean of a spectrum over the electrons of each band."""
    fine = np.arange(350.0, 1000.0, 0.25)
    light = camera.flash.spectrum.at(fine) if sky is None else sky.radiance.at(fine)[0]
    weights = camera.sensor.quantum_efficiency.at(fine) * fine * light
    return weights @ np.interp(fine, nm, spectrum) / weights.sum(axis=1)


@pytest.mark.parametrize(("count", "sky"), [(5, None), (200, EVEN_SKY)], ids=["flash", "sky"])
def test_cards_have_their_reflectance_in_all_bands(count, sky):
    bands = gaussian_bands(np.linspace(440.0, 700.0, count), 260.0 / count + 1.0)
    camera = small_camera(bands, flash=sky is None)
    measured = reflectances(camera, matt("ramp", RAMP_NM, RAMP), sky)
    assert measured.shape == (count,)
    assert measured == pytest.approx(seen(camera, RAMP_NM, RAMP, sky), rel=0.005)


def test_ndvi_of_a_leaf_is_that_of_prospect():
    # The gloss of the cuticle is part of PROSPECT's reflectance: cuticle and body add up to it, for light in
    # its cone of incidence. What the camera sees of a leaf that faces it under an even sky has nearly the
    # same part of gloss: 3.4 % from the front and 3.5 % in the cone.
    nm, state = np.arange(400.0, 1001.0, 1.0), 0.5
    path = load_cultivar("kaite").pigments["leaf"]
    camera = small_camera(gaussian_bands(np.array([668.0, 840.0]), 14.0), flash=False)
    leaf = plain(leaf_surface("leaf", path, nm))
    red, infrared = reflectances(camera, leaf, EVEN_SKY, samples=2048)
    measured = (infrared - red) / (infrared + red)

    contents = path.at(np.array([state]))
    own = leaf_spectra(nm, **contents).reflectance[0]
    assert measured == pytest.approx(ndvi(*seen(camera, nm, own, EVEN_SKY)), rel=0.01)
    # And that of prosail 2.0.5, which has all pigments of a leaf.
    names = (
        "structure_n",
        "chlorophyll_ug_cm2",
        "carotenoid_ug_cm2",
        "brown",
        "water_cm",
        "dry_matter_g_cm2",
    )
    values = [float(np.atleast_1d(contents[name])[0]) if name in contents else 0.0 for name in names]
    with np.errstate(invalid="ignore", divide="ignore"):
        other = run_prospect(*values, ant=0.0)[1][: nm.size]
    assert measured == pytest.approx(ndvi(*seen(camera, nm, other, EVEN_SKY)), rel=0.01)


def ndvi(red: float, infrared: float) -> float:
    return (infrared - red) / (infrared + red)


def test_bands_have_the_light_of_mitsubas_path_tracer():
    # Which carries random wavelengths to all bands. Edges, light through a leaf, gloss, sky, sun and flash.
    bands = gaussian_bands(np.linspace(450.0, 700.0, 5), 30.0)
    camera = small_camera(bands, columns=32, rows=24)
    camera = replace(camera, sensor=replace(camera.sensor, binning=32))
    renderer, runs = Renderer(sphere_and_leaf()), 6

    def means(samples: int, **method: str) -> np.ndarray:
        """`(runs, c)` means of images."""
        quality = Quality(samples, samples, samples, 2, target=None, denoise=False, **method)
        frames = [renderer.render(camera, ["electrons"], quality, seed) for seed in range(runs)]
        return np.array([frame["electrons"].astype(float).mean(axis=(0, 1)) for frame in frames])

    ours, reference = means(16), means(64, integrator="path")
    p = stats.ttest_ind(ours, reference, axis=0, equal_var=False).pvalue
    assert p.min() * 5 > 1e-3, (p, ours.mean(axis=0) / reference.mean(axis=0))
    assert ours.mean(axis=0) == pytest.approx(reference.mean(axis=0), rel=0.01)

"""Light on the floor below a crop: closed forms, and light traced through a canopy of random leaves."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import EVEN_SKY, axis_camera, body, lux, sheet
from random_leaves import leaf_corners
from scipy import integrate

from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.render import Quality, Renderer
from pepperscene.scene import DoubleRow, Greenhouse, assemble_scene, leaf_area_index, partly_cloudy_sky
from pepperscene.scene.floor import _leaf_scattering as leaf_scattering
from pepperscene.scene.floor import film_reflectance, reflected_radiance, transmitted_daylight

LEAF_AREA_INDEX = 2.0
HALF_WIDTH_M, HEIGHT_M, LEAF_M = 6.0, 0.65, 0.06
QUALITY = Quality(256, 256, 256, 2, target=None, denoise=False, most_bounces=64)


def closed_form(scattering, leaves: float, cosine: float | None = None) -> float:
    """Goudriaan 1977: extinction by the square root, and reflection at both sides of the crop."""
    root = np.sqrt(1.0 - scattering)
    diffuse, _ = integrate.quad(lambda c: 2.0 * c * np.exp(-0.5 * root * leaves / c), 0.0, 1.0)
    passing = diffuse if cosine is None else np.exp(-0.5 * root * leaves / cosine)
    deep = ((1.0 - root) / (1.0 + root)) ** 2
    return float(passing * (1.0 - deep) / (1.0 - deep * diffuse**2))


@pytest.mark.parametrize("leaves", [0.0, 0.5, 3.0, 7.0])
def test_transmitted_daylight_is_the_closed_form(leaves):
    skylight, sunlight = transmitted_daylight(leaves, np.radians(30.0))
    for i in (20, 50, 110):
        scattering = leaf_scattering()[i]
        assert skylight.values[i] == pytest.approx(closed_form(scattering, leaves), rel=1e-6)
        assert sunlight.values[i] == pytest.approx(closed_form(scattering, leaves, 0.5), rel=1e-6)
    # Near infrared light passes leaves that stop red light.
    assert leaves == 0.0 or skylight.at(850.0)[0] > 1.2 * skylight.at(670.0)[0]


def test_bare_floor_reflects_all_daylight():
    nm = np.arange(400.0, 701.0, 10.0)
    radiance = reflected_radiance(nm, 0.0, np.radians(20.0), np.full(nm.size, 3.0), 2.0)
    assert radiance == pytest.approx(5.0 * film_reflectance().at(nm) / np.pi)


@pytest.mark.parametrize("leaves", [0.0, 2.0])
def test_floor_of_the_environment_is_the_closed_form(leaves):
    # Overcast, so that all light is skylight of one spectrum.
    sky = partly_cloudy_sky(
        np.random.default_rng(3), illuminance_lx=1e4, sun_azimuth_rad=0.0, sun_elevation_rad=0.7,
        sun_fraction=0.0, cloud_cover=1.0, leaf_area_index=leaves,
    )  # fmt: skip
    nm = np.arange(380.0, 781.0, 5.0)
    above = sky.weights[:3].astype(float).sum(axis=(1, 2)) @ sky.radiance.at(nm)[:3]
    above *= 1e4 / lux(nm, above)
    expected = above * film_reflectance().at(nm) * transmitted_daylight(leaves, 0.7)[0].at(nm) / np.pi
    floor = sky.weights[3, -1, 0] * sky.radiance.at(nm)[3]
    np.testing.assert_allclose(floor, expected, rtol=0.01)


def canopy(scattering: float | None):
    """A floor at z = 0.3 below random leaves on the camera's side; None for no leaves."""
    floor = sheet(60.0, 60.0, 0.3, "floor")
    surfaces = {"floor": lambertian_surface("floor", 0.05)}
    if scattering is None:
        return assemble_scene(floor, surfaces, EVEN_SKY)
    rng = np.random.default_rng(8)
    count = int(LEAF_AREA_INDEX * (2.0 * HALF_WIDTH_M) ** 2 / LEAF_M**2)
    centres = rng.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, (count, 3))
    centres[:, 2] = rng.uniform(-0.05 - HEIGHT_M, -0.05, count)
    vertices = leaf_corners(centres, LEAF_M, rng)
    faces = (4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    leaves = body(trimesh.Trimesh(vertices.reshape(-1, 3), faces, process=False), "leaf")
    nm, half = np.array([300.0, 1100.0]), scattering / 2.0
    surfaces["leaf"] = Surface("leaf", nm, np.full((1, 2, 2), half), np.full((1, 2), half))
    return assemble_scene(concatenate_meshes([floor, leaves]), surfaces, EVEN_SKY)


@pytest.mark.parametrize("scattering", [pytest.param(0.0, marks=pytest.mark.long), 0.9])
def test_light_traced_through_random_leaves(scattering):
    # Black leaves follow the exponential exactly; for others Goudriaan's square root is an approximation.
    view = axis_camera(24, 16, flash=None)
    view = replace(view, sensor=replace(view.sensor, binning=20))
    lit = [
        Renderer(canopy(s)).render(view, ["electrons"], QUALITY)["electrons"].mean()
        for s in (scattering, None)
    ]
    expected = closed_form(scattering, LEAF_AREA_INDEX)
    assert lit[0] / lit[1] == pytest.approx(expected, rel=0.05)


def test_leaf_area_index_is_leaf_area_over_floor_area():
    leaf = sheet(0.2, 0.3, 0.0, "leaf")  # of 0.06 m2
    double = DoubleRow(3, 2, 0.2, 0.4, 0.1)
    assert leaf_area_index([leaf] * 5, double, Greenhouse(aisle_m=1.2)) == pytest.approx(
        0.06 / (0.2 * 1.6 / 2)
    )
    single = DoubleRow(3, 0, 0.2, 0.4, 0.1)
    assert leaf_area_index([leaf] * 3, single, Greenhouse(aisle_m=1.2)) == pytest.approx(0.06 / (0.2 * 1.2))

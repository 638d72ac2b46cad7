"""Sensors with bands measure the reflectance of cards and leaves, by hand and by the white reference."""

from __future__ import annotations

import colorsys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from bodies import EVEN_SKY, RANGE_NM, axis_camera, body, card, matt
from own_spectra import NM, leaf_curve, write_leaf
from prosail import run_prospect
from scatterers import plain
from scipy import stats
from test_convergence import sphere_and_leaf

from pepperscene.camera import (
    Camera,
    Developing,
    Partners,
    WhiteReference,
    load_flash,
    load_lens,
    load_sensor,
)
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface, organ_surfaces
from pepperscene.materials.leaf import leaf_surface
from pepperscene.render import Quality, Renderer
from pepperscene.scene import Scene, Sky, assemble_scene, partly_cloudy_sky
from pepperscene.spectra import Spectrum, leaf_spectra


def gaussian_bands(centres_nm: np.ndarray, width_nm: float, peak: float = 0.6) -> Spectrum:
    """Bands of a full width at half maximum."""
    centres = np.asarray(centres_nm, float)
    nm = np.arange(centres.min() - 3 * width_nm, centres.max() + 3 * width_nm, 0.5)
    curves = peak * np.exp(-4.0 * np.log(2.0) * ((nm - centres[:, None]) / width_nm) ** 2)
    return Spectrum(nm, np.where(curves < 1e-4 * peak, 0.0, curves))


def with_bands(camera: Camera, efficiency: Spectrum | None = None) -> Camera:
    """The camera with a sensor of these bands; with those of its colours by default."""
    efficiency = efficiency or camera.sensor.quantum_efficiency
    sensor = replace(camera.sensor, pattern="bands", quantum_efficiency=efficiency)
    return replace(camera, sensor=sensor)


def small_camera(efficiency: Spectrum | None = None, columns: int = 16, rows: int = 12, **changes) -> Camera:
    """`axis_camera` with bands; its few pixels cover the middle of the image."""
    return with_bands(axis_camera(columns, rows, **changes), efficiency)


def wall(z: float, surface: str) -> Mesh:
    """A plane of 8 m across the z axis, facing -z."""
    corners = np.array([[x, y, z] for x, y in ((-4, -4), (-4, 4), (4, 4), (4, -4))], float)
    return body(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False), surface)


# --- quotients of signals -----------------------------------------------------------------------------------


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
    renderer, runs = Renderer(sphere_and_leaf()), 12

    def means(samples: int, **method: str) -> np.ndarray:
        """`(runs, c)` means of images."""
        quality = Quality(samples, samples, samples, 2, target=None, denoise=False, **method)
        frames = [renderer.render(camera, ["electrons"], quality, seed) for seed in range(runs)]
        return np.array([frame["electrons"].astype(float).mean(axis=(0, 1)) for frame in frames])

    ours, reference = means(16), means(64, integrator="path")
    p = stats.ttest_ind(ours, reference, axis=0, equal_var=False).pvalue
    assert p.min() * 5 > 1e-3, (p, ours.mean(axis=0) / reference.mean(axis=0))
    assert ours.mean(axis=0) == pytest.approx(reference.mean(axis=0), rel=0.01)


# --- a leaf's own spectrum ----------------------------------------------------------------------------------


OWN_NM = np.arange(400.0, 1001.0, 1.0)
FIVE_BANDS = gaussian_bands(np.array([475.0, 560.0, 668.0, 717.0, 842.0]), 14.0)


def own_leaf(folder: Path, **table) -> Surface:
    """The leaf surface of a cultivar with the curve of `leaf_curve`, from a file in a folder."""
    curve = {"file": str(write_leaf(folder)), **table}
    return plain(organ_surfaces(load_cultivar("kaite_clean", {"spectra": {"leaf": curve}}), OWN_NM)["leaf"])


def over_white(camera: Camera, scene: Scene, samples: int = 1024) -> np.ndarray:
    """`(c,)` mean of an image of a wall over that of a white one."""
    quality = Quality(samples, samples, samples, 1, target=None, denoise=False)
    image = Renderer(scene).render(camera, ["electrons"], quality)["electrons"].astype(float)
    return image.mean(axis=(0, 1)) / electrons(camera, lambertian_surface("white", 1.0), EVEN_SKY, 256)


def own_leaf_scene(folder: Path, *, is_backed: bool = True, **table) -> Scene:
    surfaces = {"leaf": own_leaf(folder, **table), "black": lambertian_surface("black", 0.0)}
    walls = [wall(0.5, "leaf"), *([wall(0.501, "black")] if is_backed else [])]
    return assemble_scene(concatenate_meshes(walls), surfaces, EVEN_SKY)


# An integrating sphere measures the directional-hemispherical reflectance. By reciprocity, a camera sees it
# of a leaf that faces it under an even sky. The gloss of light in the cone of incidence of PROSPECT, which is
# taken off the curve, is .1 % of the light more than that at right angles.
@pytest.mark.parametrize(("gloss", "tolerance"), [(False, 1e-4), (True, 2e-3)], ids=["matt", "glossy"])
def test_rendered_leaf_has_its_own_measured_curve(tmp_path, gloss, tolerance):
    camera = small_camera(FIVE_BANDS, flash=False)
    measured = over_white(camera, own_leaf_scene(tmp_path, gloss=gloss))
    expected = seen(camera, NM, leaf_curve(NM)[0], EVEN_SKY)
    assert measured == pytest.approx(expected, abs=tolerance + 1e-3 * expected.max())
    assert ndvi(measured[2], measured[4]) == pytest.approx(ndvi(expected[2], expected[4]), abs=4 * tolerance)


def test_rendered_leaf_transmits_its_own_measured_curve(tmp_path):
    # Without a wall behind it, a leaf in an even sky has the radiance of its reflectance and transmittance.
    camera = small_camera(FIVE_BANDS, flash=False)
    measured = over_white(camera, own_leaf_scene(tmp_path, is_backed=False, gloss=False))
    assert measured == pytest.approx(seen(camera, NM, sum(leaf_curve(NM)), EVEN_SKY), rel=0.002)


def test_hue_of_a_leaf_is_that_of_its_own_measured_curve(tmp_path):
    # The camera's red, green and blue over those of a white card, without a matrix.
    camera = axis_camera(16, 12, flash=False)
    measured = over_white(camera, own_leaf_scene(tmp_path, gloss=False))
    expected = seen(camera, NM, leaf_curve(NM)[0], EVEN_SKY)
    hues = [360.0 * colorsys.rgb_to_hsv(*rgb)[0] for rgb in (measured.tolist(), expected.tolist())]
    assert hues[0] == pytest.approx(hues[1], abs=0.3)
    assert 80.0 < hues[1] < 160.0


# --- the white reference ------------------------------------------------------------------------------------


NOISELESS = Developing(shot_noise=False, read_noise=False, saturation=False, quantise=False)
DIRECT = Quality(samples=512, soft=512, most=512, bounces=0, target=None, denoise=False)
DISTANCE_M = 0.5


def band_camera(pose=None, flash=None, columns=8, rows=6):
    sensor = replace(load_sensor("micasense_rededge_mx"), columns=columns, rows=rows)
    pose = np.eye(4) if pose is None else pose
    return Camera(load_lens("micasense_rededge_mx"), sensor, pose, 1e-3, flash, NOISELESS)


def measured(camera, surface, sky, panel, outputs=("reflectance",)):
    """Outputs of a card half a metre in front of a camera, facing it."""
    mesh = card(0.0, 0.0, 1.0, 1.0, "grey", DISTANCE_M).moved(camera.pose[:3, :3], camera.pose[:3, 3])
    scene = assemble_scene(mesh, {"grey": surface}, sky)
    return Renderer(scene).render(camera, outputs, DIRECT, partners=Partners(white_reference=panel))


def looking(direction, up=(0.0, 1.0, 0.0)):
    """A pose whose optical axis has a direction."""
    pose, forward = np.eye(4), np.asarray(direction, float) / np.linalg.norm(direction)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    return pose


def daylight(illuminance_lx=20_000.0, sun_fraction=0.4):
    return partly_cloudy_sky(
        np.random.default_rng(3),
        illuminance_lx=illuminance_lx,
        sun_azimuth_rad=-1.2,
        sun_elevation_rad=0.9,
        sun_fraction=sun_fraction,
        cloud_cover=0.5,
    )


def test_each_band_has_the_mean_reflectance_over_its_response():
    # A ramp over wavelength: the mean over a symmetric band in even light per photon is that of its centre.
    ramp = np.interp(RANGE_NM, [300.0, 1100.0], [0.1, 0.9])
    frame = measured(band_camera(), matt("grey", RANGE_NM, ramp), EVEN_SKY, WhiteReference())
    response = band_camera().sensor
    nm = np.arange(400.0, 1000.0, 0.25)
    # EVEN_SKY has the same power at all wavelengths, and a band counts electrons.
    weights = response.electrons_per_joule(nm)
    expected = (weights * np.interp(nm, RANGE_NM, ramp)).sum(axis=1) / weights.sum(axis=1)
    np.testing.assert_allclose(frame["reflectance"].mean((0, 1)), expected, rtol=0.005)


def test_panel_sees_the_sun_and_the_sky_that_the_card_sees():
    camera = band_camera(looking((0.1, 1.0, -0.2), (0.0, 0.0, 1.0)))
    frame = measured(camera, lambertian_surface("grey", 0.5), daylight(), WhiteReference())
    np.testing.assert_allclose(frame["reflectance"].mean((0, 1)), np.full(5, 0.5), rtol=0.01)


def test_flash_lights_the_panel_at_its_distance():
    flash = load_flash("led_matrix_200klx")
    camera, surface = band_camera(flash=flash), lambertian_surface("grey", 0.3)
    frame = measured(camera, surface, None, WhiteReference(distance_m=DISTANCE_M))
    # The middle of the image is on the axis, where the panel is.
    np.testing.assert_allclose(frame["reflectance"][2:4, 3:5, :3].mean((0, 1)), np.full(3, 0.3), rtol=0.005)
    twice = measured(camera, surface, None, WhiteReference(distance_m=2 * DISTANCE_M))
    ratio = twice["reflectance"][..., :3] / frame["reflectance"][..., :3]
    # Close to the square of the distance; the flash has a size.
    assert 3.7 < ratio.mean() < 4.1


def test_radiance_of_a_card_in_even_light():
    grey = lambertian_surface("grey", 0.5)
    frame = measured(band_camera(), grey, EVEN_SKY, WhiteReference(), ("radiance",))
    # Half of the sky's radiance, which is the same at all wavelengths.
    expected = 0.5 * EVEN_SKY.radiance.values.max()
    np.testing.assert_allclose(frame["radiance"].mean((0, 1)), np.full(5, expected), rtol=0.005)


def test_measured_bands_have_the_noise_of_the_sensor():
    noisy = replace(band_camera(columns=64, rows=48), developing=Developing())
    grey = lambertian_surface("grey", 0.5)
    frame = measured(noisy, grey, EVEN_SKY, WhiteReference(), ("electrons", "bands"))
    mean, sensor = frame["electrons"].astype(float), noisy.sensor
    variance = mean + sensor.read_noise_e**2 + sensor.gain_e_per_dn**2 / 12
    residual = (frame["bands"] - mean) / np.sqrt(variance)
    count = residual[..., 0].size
    assert np.abs(residual.mean((0, 1))).max() < 5 / np.sqrt(count)
    assert np.abs((residual**2).mean((0, 1)) - 1).max() < 5 * np.sqrt(2 / count)


def test_light_between_cards_is_part_of_the_measured_reflectance():
    # A white card beside the grey one adds light that the white reference, which is alone, does not get.
    camera, grey = band_camera(), lambertian_surface("grey", 0.5)
    surfaces = {"grey": grey, "white": lambertian_surface("white", 0.95)}
    facing = card(0.0, 0.0, 1.0, 1.0, "white", 0.0).moved(
        np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([0.3, 0.0, 0.3])
    )
    mesh = concatenate_meshes([card(0.0, 0.0, 1.0, 1.0, "grey", DISTANCE_M), facing])
    quality = replace(DIRECT, bounces=1)
    frame = Renderer(assemble_scene(mesh, surfaces, EVEN_SKY)).render(camera, ("reflectance",), quality)
    assert not np.allclose(frame["reflectance"].mean(), 0.5, rtol=0.01)


@pytest.mark.parametrize(("illuminance_lx", "is_detected"), [(1e-6, False), (0.01, False), (2e4, True)])
def test_reflectance_needs_a_signal_of_three_times_the_noise(illuminance_lx, is_detected):
    sky, panel = daylight(illuminance_lx, sun_fraction=0.0), WhiteReference(facing="up")
    camera = replace(band_camera(), developing=Developing())
    frame = measured(camera, lambertian_surface("grey", 0.5), sky, panel)
    assert np.isfinite(frame["reflectance"]).all() == is_detected
    assert ("bands_without_light" in frame.metadata["white_reference"]) == (not is_detected)
    # Never a quotient of noise by nearly nothing.
    assert np.nanmax(np.abs(frame["reflectance"]), initial=0.0) < 10.0

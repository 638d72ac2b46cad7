"""Reflectance by a white reference: that of grey cards, in daylight and in the light of a flash."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, RANGE_NM, card, matt

from pepperscene.camera import (
    Camera,
    Developing,
    Partners,
    WhiteReference,
    load_flash,
    load_lens,
    load_sensor,
)
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import lambertian_surface
from pepperscene.render import Quality, Renderer
from pepperscene.scene import assemble_scene, partly_cloudy_sky

NOISELESS = Developing(shot_noise=False, read_noise=False, saturation=False, quantise=False)
QUALITY = Quality(samples=512, soft=512, most=512, bounces=0, target=None, denoise=False)
DISTANCE_M = 0.5


def band_camera(pose=None, flash=None, columns=8, rows=6):
    sensor = replace(load_sensor("micasense_rededge_mx"), columns=columns, rows=rows)
    pose = np.eye(4) if pose is None else pose
    return Camera(load_lens("micasense_rededge_mx"), sensor, pose, 1e-3, flash, NOISELESS)


def measured(camera, surface, sky, panel, outputs=("reflectance",)):
    """Outputs of a card half a metre in front of a camera, facing it."""
    mesh = card(0.0, 0.0, 1.0, 1.0, "grey", DISTANCE_M).moved(camera.pose[:3, :3], camera.pose[:3, 3])
    scene = assemble_scene(mesh, {"grey": surface}, sky)
    return Renderer(scene).render(camera, outputs, QUALITY, partners=Partners(white_reference=panel))


def looking(direction, up=(0.0, 1.0, 0.0)):
    """A pose whose optical axis has a direction."""
    pose, forward = np.eye(4), np.asarray(direction, float) / np.linalg.norm(direction)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    return pose


def daylight():
    return partly_cloudy_sky(
        np.random.default_rng(3),
        illuminance_lx=20_000.0,
        sun_azimuth_rad=-1.2,
        sun_elevation_rad=0.9,
        sun_fraction=0.4,
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


def test_level_panel_receives_what_a_level_card_does():
    # The camera looks straight down, so both panels are level.
    camera = band_camera(looking((0.0, 0.0, -1.0)))
    frames = [
        measured(camera, lambertian_surface("grey", 0.5), daylight(), WhiteReference(facing=facing))
        for facing in ("camera", "up")
    ]
    np.testing.assert_allclose(frames[0]["reflectance"], frames[1]["reflectance"], rtol=1e-5)


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
    mesh = card(0.0, 0.0, 1.0, 1.0, "grey", DISTANCE_M)
    scene = assemble_scene(mesh, {"grey": lambertian_surface("grey", 0.5)}, EVEN_SKY)
    frame = Renderer(scene).render(noisy, ("electrons", "bands"), QUALITY)
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
    quality = replace(QUALITY, bounces=1)
    frame = Renderer(assemble_scene(mesh, surfaces, EVEN_SKY)).render(camera, ("reflectance",), quality)
    assert not np.allclose(frame["reflectance"].mean(), 0.5, rtol=0.01)


def test_without_light_on_the_panel_reflectance_is_not_a_number():
    frame = measured(band_camera(), lambertian_surface("grey", 0.5), None, WhiteReference())
    assert np.isnan(frame["reflectance"]).all()
    assert frame.metadata["white_reference"]["bands_without_light"] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(("illuminance_lx", "is_detected"), [(1e-6, False), (0.01, False), (2e4, True)])
def test_reflectance_needs_a_signal_of_three_times_the_noise(illuminance_lx, is_detected):
    sky = partly_cloudy_sky(
        np.random.default_rng(3),
        illuminance_lx=illuminance_lx,
        sun_azimuth_rad=0.0,
        sun_elevation_rad=0.9,
        sun_fraction=0.0,
        cloud_cover=0.5,
    )
    camera = replace(band_camera(), developing=Developing())
    panel = WhiteReference(facing="up")
    frame = measured(camera, lambertian_surface("grey", 0.5), sky, panel)
    assert np.isfinite(frame["reflectance"]).all() == is_detected
    assert ("bands_without_light" in frame.metadata["white_reference"]) == (not is_detected)
    # Never a quotient of noise by nearly nothing.
    assert np.nanmax(np.abs(frame["reflectance"]), initial=0.0) < 10.0

"""The chain from lux to electrons against a calculation by hand.

A wrong factor of 2 stays undetected if tests check shapes only. Here every factor of the chain is computed
again, with its unit, from the numbers of the data files.
"""

from __future__ import annotations

import numpy as np
import pytest
from bodies import (
    EVEN_SKY,
    axis_camera,
    columns_of,
    irradiance_by_hand,
    point_flash_camera,
    response_by_hand,
    sheet,
)

from pepperscene.materials import lambertian_surface
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

REFLECTANCE = 0.18
NM = np.arange(360.0, 831.0, 0.5)


def electrons_by_hand(irradiance: np.ndarray) -> np.ndarray:
    """Electrons of a photosite on the axis for the grey patch under an irradiance W m-2 nm-1."""
    return np.trapezoid(REFLECTANCE / np.pi * irradiance * response_by_hand("ueye_ui5250re", NM), NM)


def electrons_of_patch(camera, sky=None, quality: str = "standard") -> np.ndarray:
    """Rendered electrons in the middle of an 18 % matt patch at 50 cm."""
    surfaces = {"grey": lambertian_surface("grey", REFLECTANCE)}
    scene = assemble_scene(sheet(1.0, 1.0, 0.5, "grey"), surfaces, sky)
    return Renderer(scene).render(camera, ["electrons"], quality)["electrons"][1:5, 2:6].mean((0, 1))


def test_point_flash_gives_its_illuminance():
    spd = columns_of("flashes/spectra/lumileds_cool_white")["lumileds_cool_white"]
    expected = electrons_by_hand(irradiance_by_hand(spd, 200_000.0, NM))
    assert electrons_of_patch(point_flash_camera(8, 6)) == pytest.approx(expected, rel=0.01)


def test_matrix_flash_equals_its_integral():
    # A matrix of discs beside the lens: integrate cosine, profile and distance.
    camera = axis_camera(8, 6)
    flash = camera.flash
    radii = flash.radius_m * np.sqrt((np.arange(200) + 0.5) / 200)
    turns = (np.arange(64) + 0.5) / 64 * 2 * np.pi
    points = np.broadcast_arrays(radii[:, None] * np.cos(turns), radii[:, None] * np.sin(turns), 0.0)
    centres = np.pad(flash.emitters_m, ((0, 0), (0, 1))) + np.array(flash.offset_m)
    ray = np.array([0.0, 0.0, 0.5]) - (np.stack(points, -1)[..., None, :] + centres)
    distance = np.linalg.norm(ray, axis=-1)
    cosine = ray[..., 2] / distance
    profile = np.interp(np.arccos(cosine), flash.profile.angle_rad, flash.profile.relative_intensity)
    falloff = float(np.mean(profile * cosine / distance**2))
    expected = electrons_by_hand(flash.radiant_intensity(NM) * falloff)
    assert electrons_of_patch(camera) == pytest.approx(expected, rel=0.01)


def test_uniform_sky_gives_its_illuminance():
    # The patch faces a uniform sky: it receives the whole illuminance.
    irradiance = irradiance_by_hand((NM, np.ones(NM.size)), 5500.0, NM)
    electrons = electrons_of_patch(axis_camera(8, 6, flash=False), EVEN_SKY, "reference")
    assert electrons == pytest.approx(electrons_by_hand(irradiance), rel=0.01)
    # By estimate, 5.5 klx on 18 % grey in 50 us at f/2 give about 90 electrons in green.
    assert electrons[1] == pytest.approx(90.0, rel=0.3)


def test_light_of_the_sky_falls_with_the_fourth_power_of_the_cosine():
    # A uniform sky has the same radiance everywhere; only the lens makes a difference.
    camera = axis_camera(flash=False)
    behind = assemble_scene(
        sheet(0.01, 0.01, -1.0, "grey"), {"grey": lambertian_surface("grey", 0.5)}, EVEN_SKY
    )
    electrons = Renderer(behind).render(camera, ["electrons"], "draft")["electrons"]
    lens = camera.to_metadata()
    v, u = np.mgrid[0:600, 0:800] + 0.5
    slope2 = ((u - lens["cx"]) / lens["fx"]) ** 2 + ((v - lens["cy"]) / lens["fy"]) ** 2
    measured, expected = (
        image.reshape(30, 20, 40, 20).mean((1, 3))
        for image in (electrons[..., 1].astype(float), (1.0 + slope2) ** -2.0)
    )
    assert measured / measured.max() == pytest.approx(expected / expected.max(), rel=5e-3)

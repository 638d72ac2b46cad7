"""The chain from lux to electrons, against a calculation by hand.

Rationale: a factor of 2 stays undetected if tests check shapes only. Here every factor of the chain is
computed again, with its unit, from the numbers of the data files; nothing of the renderer is reused.
"""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from bodies import axis_camera, sheet

from pepperscene.materials import lambertian_surface
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import Spectrum

REFLECTANCE = 0.18
H, C = 6.62607015e-34, 2.99792458e8  # J s, m/s (SI 2019, exact)


def photopic() -> tuple[np.ndarray, np.ndarray]:
    """CIE 1924 V(lambda) on 1 nm, from colour-science."""
    import colour

    v = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    return np.asarray(v.wavelengths, float), np.asarray(v.values, float)


def electrons_by_hand(irradiance_nm: np.ndarray, irradiance: np.ndarray, camera) -> np.ndarray:
    """Electrons of a photosite on the axis for a Lambertian patch under an irradiance W m-2 nm-1."""
    nm = np.arange(380.0, 701.0, 0.5)
    radiance = REFLECTANCE / np.pi * np.interp(nm, irradiance_nm, irradiance)  # W m-2 sr-1 nm-1
    qe = camera.sensor.quantum_efficiency
    sensed = np.array([np.interp(nm, qe.wavelength_nm, channel) for channel in qe.values])
    photons_per_joule = nm * 1e-9 / (H * C)
    rate = np.trapezoid(radiance * sensed * photons_per_joule, nm, axis=-1)  # per s, m2 and sr
    solid_angle = np.pi / (4.0 * camera.lens.f_number**2)  # of the aperture, projected
    area = camera.sensor.pitch_m**2
    return rate * area * solid_angle * camera.lens.transmittance * camera.exposure_s


def centre(scene, camera, quality: str = "standard") -> np.ndarray:
    electrons = Renderer(scene).render(camera, ["electrons"], quality)["electrons"]
    rows, columns = electrons.shape[:2]
    return electrons[rows // 2 - 2 : rows // 2 + 2, columns // 2 - 2 : columns // 2 + 2].mean((0, 1))


def grey_under_sky(illuminance_lx: float):
    """The grey patch at 50 cm under a uniform sky of equal energy per nanometre."""
    nm = np.arange(380.0, 781.0)
    sky = uniform_sky(Spectrum(nm, np.ones(nm.size)), illuminance_lx)
    return assemble_scene(
        sheet(1.0, 1.0, 0.5, "grey"), {"grey": lambertian_surface("grey", REFLECTANCE)}, sky
    )


def test_flash_on_a_patch_gives_the_calculated_electrons():
    # Set-up: an 18 % matt patch 50 cm in front of the camera, a point flash at the lens.
    camera = axis_camera(
        columns=8, rows=6, radius_m=0.0, emitters_m=np.zeros((1, 2)), offset_m=(0.0, 0.0, 0.0)
    )
    scene = assemble_scene(sheet(1.0, 1.0, 0.5, "grey"), {"grey": lambertian_surface("grey", REFLECTANCE)})
    # Expected: on the patch, the SPD times 683 lm/W x V integrates to 200,000 lx.
    with open(shipped_folder("materials") / "flashes" / "spectra" / "lumileds_cool_white.csv") as file:
        rows = [row for row in csv.reader(file) if row and not row[0].startswith("#")]
    spd_nm, spd = np.array(rows[1:], float)[:, :2].T
    v_nm, v = photopic()
    lux_per_unit = 683.002 * np.trapezoid(np.interp(v_nm, spd_nm, spd, 0, 0) * v, v_nm)
    irradiance = spd * 200_000.0 / lux_per_unit
    expected = electrons_by_hand(spd_nm, irradiance, camera)
    assert centre(scene, camera) == pytest.approx(expected, rel=0.01)


def test_matrix_flash_equals_its_integral():
    # The shipped flash is a matrix of discs beside the lens: integrate cosine, profile and distance.
    camera = axis_camera(columns=8, rows=6)
    flash = camera.flash
    scene = assemble_scene(sheet(1.0, 1.0, 0.5, "grey"), {"grey": lambertian_surface("grey", REFLECTANCE)})
    radii = flash.radius_m * np.sqrt((np.arange(200) + 0.5) / 200)
    turns = (np.arange(64) + 0.5) / 64 * 2 * np.pi
    spots = np.stack(
        np.broadcast_arrays(radii[:, None] * np.cos(turns), radii[:, None] * np.sin(turns), 0.0), -1
    )
    centres = np.pad(flash.emitters_m, ((0, 0), (0, 1))) + np.array(flash.offset_m)
    away = np.array([0.0, 0.0, 0.5]) - (spots[..., None, :] + centres)
    distance = np.linalg.norm(away, axis=-1)
    cosine = away[..., 2] / distance
    profile = np.interp(np.arccos(cosine), flash.profile.angle_rad, flash.profile.relative_intensity)
    falloff = float(np.mean(profile * cosine / distance**2))
    nm = np.arange(380.0, 701.0)
    expected = electrons_by_hand(nm, flash.radiant_intensity(nm) * falloff, camera)
    assert centre(scene, camera) == pytest.approx(expected, rel=0.01)


def test_uniform_sky_on_a_patch_gives_its_illuminance():
    # A patch that faces a whole uniform sky receives its illuminance.
    camera = axis_camera(columns=8, rows=6, flash=False)
    scene = grey_under_sky(5500.0)
    nm = np.arange(380.0, 781.0)
    v_nm, v = photopic()
    visible = (v_nm >= 380) & (v_nm <= 780)
    irradiance = np.full(nm.size, 5500.0 / (683.002 * np.trapezoid(v[visible], v_nm[visible])))
    expected = electrons_by_hand(nm, irradiance, camera)
    assert centre(scene, camera, "reference") == pytest.approx(expected, rel=0.01)


def test_relative_illumination_falls_with_the_fourth_power_of_the_cosine():
    # A uniform sky seen directly has the same radiance everywhere; only the lens makes a difference.
    camera = axis_camera(flash=False)
    nm = np.arange(380.0, 781.0)
    far = assemble_scene(
        sheet(0.01, 0.01, -1.0, "grey"),
        {"grey": lambertian_surface("grey", 0.5)},
        uniform_sky(Spectrum(nm, np.ones(nm.size)), 5500.0),
    )
    electrons = Renderer(far).render(camera, ["electrons"], "draft")["electrons"]
    lens = json.loads(json.dumps(camera.metadata()))
    v, u = np.mgrid[0:600, 0:800] + 0.5
    slope2 = ((u - lens["cx"]) / lens["fx"]) ** 2 + ((v - lens["cy"]) / lens["fy"]) ** 2
    expected = (1.0 + slope2) ** -2.0

    def blocks(image):
        return image.reshape(30, 20, 40, 20).mean((1, 3))

    measured = blocks(electrons[..., 1].astype(float))
    assert measured / measured.max() == pytest.approx(blocks(expected) / blocks(expected).max(), rel=5e-3)


def test_daylight_at_the_paper_level_gives_about_eighty_electrons():
    # By estimate, 5 klx on an 18 % grey in 50 us at f/2 give about 80 electrons in green.
    camera = axis_camera(columns=8, rows=6, flash=False)
    scene = grey_under_sky(5000.0)
    assert 50.0 < centre(scene, camera)[1] < 110.0

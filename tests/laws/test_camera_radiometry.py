"""Electrons of a grey patch in the flash, by a calculation that shares no code with the camera."""

from __future__ import annotations

import csv
import math

import colour
import numpy as np
import pytest

from pepperscene.camera import Camera, expected_electrons, load_flash, load_lens, load_sensor
from pepperscene.shipped import shelf

DISTANCE_M = 0.5
REFLECTANCE = 0.18


def column(path, name):
    with path.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    return np.array([float(row["wavelength_nm"]) for row in rows]), np.array(
        [float(row[name]) for row in rows]
    )


def one_page_calculation(lux):
    """Photo-electrons in red, green and blue of a photosite on the axis, after 50 us."""
    nm = np.arange(380.0, 781.0, 0.5)
    spd = np.interp(
        nm, *column(shelf("materials") / "flashes/spectra/lumileds_cool_white.csv", "lumileds_cool_white")
    )
    v = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    v = np.interp(nm, v.wavelengths, v.values, left=0, right=0)
    # Lux to W m-2 nm-1, to the radiance of a matt patch, through f/2 and 0.9 of glass onto the sensor.
    irradiance = spd * lux / (683.002 * np.trapezoid(spd * v, nm))
    radiance = REFLECTANCE * irradiance / math.pi
    on_sensor = radiance * math.pi / (4 * 2.0**2) * 0.9
    photons = on_sensor * nm * 1e-9 / (6.62607015e-34 * 299792458.0) * 4.5e-6**2 * 50e-6
    srf = shelf("materials") / "sensors/spectra/ev76c570_rgb_qe_MODEL.csv"
    return [np.trapezoid(photons * np.interp(nm, *column(srf, channel)), nm) for channel in "rgb"]


def signal_of_the_patch(camera):
    """What a renderer hands over: the patch straight ahead of the flash, seen along the optical axis."""
    nm = np.arange(380.0, 781.0)
    irradiance = camera.flash.radiant_intensity(nm) / camera.flash.axial_area_m2 * camera.flash_duty
    radiance = REFLECTANCE * irradiance / np.pi
    return np.trapezoid(radiance * camera.sensor.electrons_per_joule(nm), nm, axis=-1)


def test_a_grey_patch_at_half_a_metre_in_the_flash():
    camera = Camera(
        load_lens("lensagon_cmfa0420nd"), load_sensor("ueye_ui5250re"), flash=load_flash("led_matrix_200klx")
    )
    signal = np.broadcast_to(signal_of_the_patch(camera), (600, 800, 3))
    electrons = expected_electrons(signal, camera)[299:301, 399:401].mean(axis=(0, 1))
    predicted = one_page_calculation(200_000)
    np.testing.assert_allclose(electrons, predicted, rtol=2e-3)
    # An independent estimate by hand (f/2, 50 us): 2.6 to 3.5 thousand in green, half of the full well.
    assert 2600 < electrons[1] < 3500


def test_daylight_is_faint_beside_the_flash():
    # The same estimate puts 5,000 lx at about 80 electrons: the flash outshines a greenhouse forty times.
    assert one_page_calculation(5_000)[1] == pytest.approx(82, rel=0.1)

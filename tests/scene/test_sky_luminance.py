"""Skies have the luminance of ISO 15469 and the IES, and blue skies the colours that were measured."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from pepperscene.scene import partly_cloudy_sky
from pepperscene.scene.sky import cloud_opacity, diffuse_lux, standard_sky
from pepperscene.spectra import Spectrum, read_spectra

ELEVATION = np.radians(40.0)
SUN = np.array([np.cos(ELEVATION), 0.0, np.sin(ELEVATION)])


def direction(elevation_deg: float, azimuth_deg: float) -> np.ndarray:
    elevation, azimuth = np.radians([elevation_deg, azimuth_deg])
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def test_overcast_zenith_is_three_times_as_bright_as_the_horizon():
    # Moon & Spencer 1942: (1 + 2 sin(elevation)) / 3, from which type 1 differs by up to 0.06.
    for elevation in (0.0, 20.0, 45.0, 70.0):
        relative = [float(standard_sky("overcast", direction(e, 30.0), SUN)) for e in (elevation, 90.0)]
        assert relative[0] / relative[1] == pytest.approx(
            (1 + 2 * np.sin(np.radians(elevation))) / 3, abs=0.06
        )


def test_clear_sky_is_that_of_the_standard():
    # Worked by hand from ISO 15469: type 12, zenith and the horizon opposite of the sun at 40 degrees.
    angle = np.radians(50.0)
    zenith = (1 - np.exp(-0.32)) * (
        1 + 10 * (np.exp(-3 * angle) - np.exp(-1.5 * np.pi)) + 0.45 * np.cos(angle) ** 2
    )
    assert standard_sky("clear", direction(90.0, 0.0), SUN) == pytest.approx(zenith)
    angle = np.radians(140.0)
    horizon = 1 + 10 * (np.exp(-3 * angle) - np.exp(-1.5 * np.pi)) + 0.45 * np.cos(angle) ** 2
    assert standard_sky("clear", direction(0.0, 180.0), SUN) == pytest.approx(horizon)


@pytest.mark.parametrize(
    ("kind", "expected"), [("clear", 8.55), ("partly cloudy", 11.55), ("overcast", 5.55)]
)
def test_sky_has_the_illuminance_of_the_ies(kind, expected):
    # For a sine of 1/4.
    assert diffuse_lux(kind, np.arcsin(0.25)) == pytest.approx(1e3 * expected)


@pytest.mark.parametrize(("cover", "seed"), [(0.1, 0), (0.5, 1), (0.9, 2)])
def test_clouds_hide_the_requested_fraction(cover, seed):
    # Soft edges count in part.
    polar = (np.arange(200) + 0.5) / 400 * np.pi
    azimuth = (np.arange(400) + 0.5) / 400 * 2 * np.pi
    level, height = np.sin(polar)[:, None], np.cos(polar)
    towards = np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), np.broadcast_to(height[:, None], (200, 400))], -1
    )
    opacity = cloud_opacity(towards, np.random.default_rng(seed), cover)
    hidden = (opacity * np.sin(polar)[:, None]).sum() / (400 * np.sin(polar).sum())
    assert hidden == pytest.approx(cover, abs=0.03)


@pytest.fixture(scope="module")
def clear():
    """Luminance, cd/m2, x, y and correlated colour temperature of a clear sky, by direction."""
    sky = partly_cloudy_sky(
        np.random.default_rng(0),
        illuminance_lx=diffuse_lux("clear", ELEVATION) / 0.3,
        sun_azimuth_rad=0.0,
        sun_elevation_rad=ELEVATION,
        sun_fraction=0.7,
        cloud_cover=0.0,
    )
    rows, columns = sky.weights.shape[1:]
    observer = read_spectra("light/cie_1931_observer")
    spectra = [Spectrum(sky.radiance.wavelength_nm, row) for row in sky.radiance.values]
    xyz = np.array([[float(s.integral(observer[k])) for k in "xyz"] for s in spectra])

    def look(elevation_deg: float, azimuth_deg: float) -> tuple[float, float, float, float]:
        row, column = int((90 - elevation_deg) / 180 * rows), int(azimuth_deg % 360 / 360 * columns)
        x, y, z = sky.weights[:, row, column].astype(float) @ xyz
        xy = np.array([x, y]) / (x + y + z)
        return 683.002 * y, *xy, float(colour.temperature.xy_to_CCT_Hernandez1999(xy))

    return look


def test_clear_sky_is_bluest_at_a_right_angle_to_the_sun(clear):
    # In the vertical plane of the sun, from the sun over the zenith to the horizon opposite.
    elevations = np.concatenate([np.arange(42.0, 90.0, 2.0), np.arange(88.0, 8.0, -2.0)])
    azimuths = np.where(np.arange(elevations.size) < 24, 0.0, 180.0)
    kelvin = np.array([clear(e, a)[3] for e, a in zip(elevations, azimuths, strict=True)])
    from_sun = np.where(azimuths == 0.0, elevations - 40.0, 140.0 - elevations)
    assert 75.0 <= from_sun[kelvin.argmax()] <= 105.0
    # Measured narrow fields of view: 3,800 K to infinity (Hernandez-Andres et al. 2001, JOSA A 18:412).
    assert 3800.0 < kelvin.min() < 0.6 * kelvin.max()
    # Whiter near the horizon and near the sun.
    assert clear(8.0, 180.0)[3] < 0.8 * kelvin.max()
    assert clear(42.0, 0.0)[3] < 0.6 * kelvin.max()


def test_colour_of_the_clear_sky_follows_its_luminance(clear):
    # Chain, Dumortier & Fontoynont 1999, with chromaticities on the CIE daylight locus.
    for elevation, azimuth in ((15.0, 90.0), (45.0, 20.0), (50.0, 180.0), (80.0, 90.0)):
        luminance, x, y, kelvin = clear(elevation, azimuth)
        mired = -132.1 + 59.77 * np.log10(luminance)
        assert 1e6 / kelvin == pytest.approx(mired, abs=2.0)
        assert y == pytest.approx(-3 * x**2 + 2.87 * x - 0.275, abs=0.001)


def test_full_cover_is_as_white_as_d65_everywhere():
    sky = partly_cloudy_sky(
        np.random.default_rng(1),
        illuminance_lx=1e4,
        sun_azimuth_rad=0.0,
        sun_elevation_rad=ELEVATION,
        sun_fraction=0.0,
        cloud_cover=1.0,
    )
    upper = sky.weights[:3, : sky.weights.shape[1] * 2 // 5].astype(float)
    nm = np.arange(380.0, 781.0, 5.0)
    d65 = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(380, 780, 5)).values
    for row, column in ((0, 0), (40, 100), (90, 300)):
        seen = Spectrum(sky.radiance.wavelength_nm, upper[:, row, column] @ sky.radiance.values[:3]).at(nm)
        assert seen / seen[nm == 560] * 100 == pytest.approx(d65, abs=0.1)

"""Skies provide the requested light, integrated over solid angle by a quadrature of the tests."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from pepperscene.scene import partly_cloudy_sky, uniform_sky
from pepperscene.scene.sky import SUN_ANGULAR_RADIUS, _sum_of_waves
from pepperscene.spectra import sky_spectrum

PAPER = {
    "illuminance_lx": 5500.0,
    "sun_azimuth_rad": np.radians(60.0),
    "sun_elevation_rad": np.radians(40.0),
    "sun_fraction": 0.3,
    "cloud_cover": 0.5,
}
HORIZON = 0.2
"""Sine of the elevation up and down to which sky and floor may blend at the horizon."""


def sky_of(seed=0, **changes):
    return partly_cloudy_sky(np.random.default_rng(seed), **{**PAPER, **changes})


def lux(wavelength_nm, irradiance):
    """683.002 lm/W times the integral with V(lambda), both on 1 nm."""
    v = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    nm = np.arange(wavelength_nm[0], wavelength_nm[-1] + 0.5)
    table = np.interp(nm, v.wavelengths, v.values, left=0, right=0)
    return 683.002 * np.trapezoid(np.interp(nm, wavelength_nm, irradiance) * table, nm)


def upper_half(sky, lines=400):
    """Weights `(k, n)` and cosines `(n,)` in `n` directions that represent equal solid angles of 2 pi / n.

    Height above the horizon and azimuth in equal steps: equal heights cut equal areas of a sphere.
    """
    rows, columns = sky.weights.shape[1:]
    height = np.repeat((np.arange(lines) + 0.5) / lines, 2 * lines)
    azimuth = np.tile((np.arange(2 * lines) + 0.5) / (2 * lines), lines)
    row = (np.arccos(height) / np.pi * rows).astype(int)
    return sky.weights[:, row, (azimuth * columns).astype(int)].astype(float), height


def diffuse_lux(sky):
    weights, cosine = upper_half(sky)
    received = (weights * cosine).mean(axis=1) * 2.0 * np.pi
    return lux(sky.radiance.wavelength_nm, received @ sky.radiance.values)


def sun_lux(sky):
    return sky.sun.direction[2] * lux(sky.sun.irradiance.wavelength_nm, sky.sun.irradiance.values)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sun_fraction": 0.0},
        {"sun_fraction": 0.9, "sun_elevation_rad": np.radians(5.0)},
        {"cloud_cover": 0.0},
        {"cloud_cover": 1.0},
        {"illuminance_lx": 80_000.0, "sun_elevation_rad": np.pi / 2},
    ],
    ids=str,
)
def test_level_plane_receives_the_requested_illuminance(changes):
    sky = sky_of(**changes)
    requested = {**PAPER, **changes}
    # 320,000 directions against texels of 0.7 degrees: the quadrature is exact to 0.1 %.
    diffuse = diffuse_lux(sky)
    direct = sun_lux(sky) if requested["sun_fraction"] > 0 else 0.0
    assert diffuse + direct == pytest.approx(requested["illuminance_lx"], rel=3e-3)
    assert direct / (diffuse + direct) == pytest.approx(requested["sun_fraction"], abs=1e-3)
    assert (sky.sun is None) == (requested["sun_fraction"] == 0)
    assert sky.horizontal_illuminance() == pytest.approx(diffuse + direct, rel=3e-3)


def test_sun_has_the_requested_direction_and_its_true_size():
    sky = sky_of()
    east, north, up = sky.sun.direction
    assert np.degrees(np.arctan2(north, east)) == pytest.approx(60.0)
    assert np.degrees(np.arcsin(up)) == pytest.approx(40.0)
    assert np.linalg.norm(sky.sun.direction) == pytest.approx(1.0)
    # Its disc is half a degree wide.
    assert np.degrees(2 * SUN_ANGULAR_RADIUS) == pytest.approx(0.533, abs=0.001)
    assert sky.sun.angular_radius == SUN_ANGULAR_RADIUS


@pytest.mark.parametrize("azimuth_deg", [-120.0, 10.0, 90.0])
def test_blue_is_brightest_around_the_sun(azimuth_deg):
    # This ties the map's rows and columns to the sun's direction: a mirrored or rotated map fails.
    sky = sky_of(sun_azimuth_rad=np.radians(azimuth_deg), cloud_cover=0.0)
    rows, columns = sky.weights.shape[1:]
    # The spectra of the blue have 1 lux each.
    row, column = np.unravel_index(np.argmax(sky.weights[:3].sum(axis=0)), (rows, columns))
    polar, azimuth = (row + 0.5) / rows * np.pi, (column + 0.5) / columns * 2 * np.pi
    brightest = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    assert np.degrees(np.arccos(brightest @ sky.sun.direction)) < 1.0


@pytest.mark.parametrize("count", [1, 1023, 1024, 5000])
def test_waves_in_single_precision_match_double_precision(count):
    # Points and frequencies as extreme as a sky's: 1 / 0.15 on the plane overhead, 24 waves per unit.
    rng = np.random.default_rng(count)
    points = rng.uniform(-1.0, 1.0, (count, 2)) / 0.15
    frequency = np.exp(rng.uniform(0.0, np.log(24.0), 256))
    heading, phase = rng.uniform(0.0, 2.0 * np.pi, (2, 256))
    vectors = frequency * np.stack([np.cos(heading), np.sin(heading)])
    expected = np.cos(points @ vectors + phase) @ (1.0 / frequency)
    deviation = np.sqrt(0.5 * np.sum(frequency**-2.0))
    assert np.abs(_sum_of_waves(points, vectors, phase) - expected).max() < 2e-5 * deviation


@pytest.mark.parametrize("cover", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("elevation_deg", [1.0, 40.0, 90.0])
def test_radiance_is_finite_and_never_negative(cover, elevation_deg):
    sky = sky_of(cloud_cover=cover, sun_elevation_rad=np.radians(elevation_deg))
    assert sky.weights.dtype == np.float32
    for values in (sky.weights, sky.radiance.values, sky.sun.irradiance.values):
        assert np.isfinite(values).all()
        assert values.min() >= 0.0


@pytest.mark.parametrize("leaf_area_index", [0.0, 3.0, 20.0])
def test_floor_is_uniform_and_reflects_less_than_it_receives(leaf_area_index):
    sky = sky_of(leaf_area_index=leaf_area_index)
    rows = sky.weights.shape[1]
    below = sky.weights[:, int(np.ceil(np.arccos(-HORIZON) / np.pi * rows)) :]
    assert np.ptp(below, axis=(1, 2)).max() == 0.0
    luminance = lux(sky.radiance.wavelength_nm, below[:, 0, 0] @ sky.radiance.values)
    assert 0.0 < np.pi * luminance < 5500.0


def test_clouds_depend_on_the_seed_but_not_the_illuminance():
    first, again, other = sky_of(4), sky_of(4), sky_of(5)
    np.testing.assert_array_equal(first.weights, again.weights)
    assert np.abs(first.weights - other.weights).max() > 0.5 * first.weights.mean()
    clear, cloudy = sky_of(0, cloud_cover=0.0), sky_of(0, cloud_cover=0.2)
    np.testing.assert_array_equal(clear.weights, sky_of(1, cloud_cover=0.0).weights)
    assert np.abs(cloudy.weights - clear.weights).max() > 0.1 * clear.weights.max()
    # A dark sky has none.
    dark = sky_of(illuminance_lx=0.0)
    assert not dark.weights.any()
    assert (dark.sun, dark.horizontal_illuminance()) == (None, 0.0)


@pytest.mark.parametrize("illuminance_lx", [1.0, 5500.0])
def test_uniform_sky_lights_any_plane_equally(illuminance_lx):
    sky = uniform_sky(sky_spectrum("d65"), illuminance_lx)
    assert np.ptp(sky.weights) == 0.0
    assert sky.sun is None
    # The projected solid angle of a half space is pi.
    radiance = sky.weights[0, 0, 0] * sky.radiance.values[0]
    assert np.pi * lux(sky.radiance.wavelength_nm, radiance) == pytest.approx(illuminance_lx, rel=1e-3)
    assert diffuse_lux(sky) == pytest.approx(illuminance_lx, rel=1e-3)
    # Its colour is that of the given spectrum.
    ratio = sky.radiance.values[0] / sky_spectrum("d65").at(sky.radiance.wavelength_nm)
    assert np.ptp(ratio) < 1e-9 * ratio.max()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("illuminance_lx", -5.0),
        ("sun_fraction", 1.2),
        ("cloud_cover", 2.0),
        ("sun_elevation_rad", 0.0),
        ("leaf_area_index", -1.0),
    ],
)
def test_raises_on_argument_out_of_range(name, value):
    with pytest.raises(ValueError, match=name):
        sky_of(**{name: value})

"""Daylight below a cover: energy conservation and the cover's spectrum.

Solid angles of a map's texels are in closed form here; lux are integrated on 1 nm.
"""

import numpy as np
import pytest
from bodies import lux as lux_of
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.scene import Cover, load_cover, partly_cloudy_sky
from pepperscene.spectra import Spectrum, daylight_basis, sun_spectrum

PAPER = {
    "illuminance_lx": 5500.0,
    "sun_azimuth_rad": np.radians(60.0),
    "sun_elevation_rad": np.radians(40.0),
    "sun_fraction": 0.3,
    "cloud_cover": 0.5,
}
GREEN = Spectrum(
    np.array([380.0, 500.0, 560.0, 640.0, 1000.0]), np.array([0.05, 0.4, 0.95, 0.1, 0.7]), "hold"
)


def sky_of(cover=None, seed=0, **changes):
    return partly_cloudy_sky(np.random.default_rng(seed), **{**PAPER, **changes}, cover=cover)


def hazy(haze, width_deg=15.0, sheet=GREEN):
    return Cover("test", sheet, haze, np.radians(width_deg))


def lux(spectrum):
    nm = np.arange(360, 831)  # the curves are nearly linear between whole nanometres: 1e-5
    return lux_of(nm, spectrum.at(nm))


def level_lux(sky):
    """Lux on a level plane from each of the map's spectra, `(k,)`, and from the sun's disc."""
    rows, columns = sky.weights.shape[1:]
    edges = np.sin(np.minimum(np.arange(rows + 1) / rows * np.pi, np.pi / 2)) ** 2
    received = (sky.weights.astype(float).sum(axis=2) * np.diff(edges) * np.pi / columns).sum(axis=1)
    parts = received * lux(sky.radiance)
    return parts, sky.sun.direction[2] * lux(sky.sun.irradiance) if sky.sun else 0.0


COVERS = st.one_of(
    st.none(),
    st.sampled_from(["float_glass_4mm", "diffuse_glass_4mm", "polyethylene_film"]).map(load_cover),
    st.builds(hazy, st.floats(0.0, 1.0), st.sampled_from([2.0, 15.0, 90.0])),
)


# Clouds take a third of a second.
@settings(max_examples=10)
@given(
    cover=COVERS,
    sun=st.fixed_dictionaries(
        {"sun_elevation_rad": st.floats(0.01, np.pi / 2), "sun_azimuth_rad": st.floats(-np.pi, np.pi)}
    ),
    sun_fraction=st.floats(0.0, 0.99),
    cloud_cover=st.sampled_from([0.0, 0.0, 0.3, 1.0]),
    illuminance_lx=st.sampled_from([0.0, 1e-3, 5500.0, 120_000.0]),
)
def test_light_below_any_cover_is_the_requested_one(cover, sun, sun_fraction, cloud_cover, illuminance_lx):
    light = {"sun_fraction": sun_fraction, "cloud_cover": cloud_cover, "illuminance_lx": illuminance_lx}
    sky = sky_of(cover, **sun, **light)
    parts, disc = level_lux(sky)
    assert parts.sum() + disc == pytest.approx(illuminance_lx, rel=1e-3)
    assert sky.horizontal_illuminance() == pytest.approx(illuminance_lx, rel=1e-5)
    # The lobe gains what the disc loses.
    lobe = parts[4] if len(parts) == 5 else 0.0
    haze = cover.haze if cover else 0.0
    assert lobe + disc == pytest.approx(sun_fraction * illuminance_lx, rel=1e-3)
    assert lobe == pytest.approx(haze * sun_fraction * illuminance_lx, rel=1e-3)
    # No radiance is negative.
    for values in (sky.weights, sky.radiance.values, sky.sun.irradiance.values if sky.sun else np.zeros(1)):
        assert np.isfinite(values).all()
        assert values.min() >= 0.0


@pytest.mark.parametrize("haze", [0.0, 0.6])
def test_cover_filters_sky_clouds_and_sun(haze):
    # Except for a common factor that sets the lux, every light is multiplied by the transmittance.
    below = sky_of(hazy(haze))
    nm = np.arange(300.0, 1101.0, 5.0)
    basis, sun = daylight_basis(), sun_spectrum(PAPER["sun_elevation_rad"])
    lights = [*basis.at(nm), sun.at(nm)]
    sky = [0, 1, 2, 4][: len(below.weights) - 1]  # the fourth is the floor's
    spectra = list(below.radiance.at(nm)[sky]) + ([below.sun.irradiance.at(nm)] if below.sun else [])
    expected = [lights[i] * GREEN.at(nm) for i in range(len(sky))]
    expected += [lights[3] * GREEN.at(nm)] if below.sun else []
    for a, b in zip(spectra, expected, strict=True):
        np.testing.assert_allclose(a / a.max(), b / b.max(), rtol=1e-9, atol=1e-12)


def test_coloured_cover_changes_the_ratio_of_blue_and_pale_daylight():
    # Through a red filter the blue parts of the sky are darker against the pale ones.
    red = Spectrum(np.array([590.0, 610.0]), np.array([0.0, 0.9]), "hold")
    ratios = []
    for cover in (None, Cover("red", red)):
        sky = sky_of(cover, sun_fraction=0.0, cloud_cover=0.5)
        upper = slice(0, sky.weights.shape[1] // 4)
        sums = sky.weights[:, upper].astype(float).sum(axis=(1, 2))
        ratios.append(sums[0] * lux(sky.radiance)[0] / (sums[1] * lux(sky.radiance)[1]))
    basis = daylight_basis()
    blue, pale = (
        lux(Spectrum(basis.wavelength_nm, row * red.at(basis.wavelength_nm)))
        / lux(Spectrum(basis.wavelength_nm, row))
        for row in basis.values[:2]
    )
    assert blue < 0.97 * pale
    assert ratios[1] / ratios[0] == pytest.approx(blue / pale, rel=1e-3)


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(90.0, 10.0), (10.0, 40.0)])
def test_lobe_is_centred_on_the_sun(azimuth_deg, elevation_deg):
    # For the camera, which looks to +y, the sun is in front at 90 degrees.
    sky = sky_of(
        hazy(0.6, 10.0), sun_azimuth_rad=np.radians(azimuth_deg), sun_elevation_rad=np.radians(elevation_deg)
    )
    rows, columns = sky.weights.shape[1:]
    polar = (np.arange(rows)[:, None] + 0.5) / rows * np.pi
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    x, y = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth)
    energy = sky.weights[4] * np.sin(polar)
    mean = np.array([(axis * energy).sum() for axis in (x, y, np.cos(polar))])
    mean /= np.linalg.norm(mean)
    # The horizon cuts a low sun's lobe, which raises its mean direction but keeps its azimuth.
    east, north, _ = sky.sun.direction
    angle = np.degrees(np.arccos(np.clip(mean @ sky.sun.direction, -1, 1)))
    assert angle < (2.0 if elevation_deg == 40 else 8.0)
    assert np.arctan2(mean[1], mean[0]) == pytest.approx(np.arctan2(north, east), abs=np.radians(0.5))
    in_front = energy[:, : columns // 2].sum() / energy.sum()  # azimuths of 0 to 180 degrees: +y
    assert in_front == pytest.approx({90.0: 1.0, 10.0: in_front}[azimuth_deg], abs=0.01)


def test_haze_smooths_the_scattered_fraction_of_clouds():
    # A lobe of 12 degrees removes edges a texel (0.7 degrees) wide: what stays sharp was not scattered.
    def sharpness(haze):
        sky = sky_of(hazy(haze, 12.0), sun_fraction=0.0, cloud_cover=0.4)
        rows = sky.weights.shape[1]
        return np.diff(sky.weights[:3, rows // 16 : rows // 3].sum(axis=0, dtype=float), n=2, axis=1).std()

    clear = sharpness(0.0)
    assert sharpness(0.5) == pytest.approx(0.5 * clear, rel=0.1)
    assert sharpness(1.0) < 0.02 * clear


def test_floor_is_as_bright_as_without_a_cover():
    # Its luminance follows from the light that it receives, the same below a grey cover without haze.
    grey = Cover("grey", Spectrum(np.array([300.0, 1100.0]), np.array([0.5, 0.5]), "hold"))
    floors = []
    for sky in (sky_of(leaf_area_index=4.0), sky_of(grey, leaf_area_index=4.0)):
        assert not sky.weights[[0, 1, 2, *range(4, len(sky.weights))], -20:].any()
        floors.append(sky.weights[3, -1, 0] * lux(sky.radiance)[3])
    assert floors[0] == pytest.approx(floors[1], rel=1e-4)

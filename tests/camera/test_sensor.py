"""The sensor: what it allows, its settings, its filter, and the mosaic of its photosites."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest

from pepperscene.camera import (
    Camera,
    Developing,
    camera_rgb,
    develop,
    encode_tone,
    load_flash,
    load_lens,
    load_sensor,
    raw_frame,
    reference_correction,
)
from pepperscene.camera.readout import bin_photosites, demosaic_image, spread_to_photosites
from pepperscene.spectra import Spectrum

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of scipy, at the library's import
    from colour_demosaicing import masks_CFA_Bayer, mosaicing_CFA_Bayer

UEYE, MONO = load_sensor("ueye_ui5250re"), load_sensor("onsemi_mt9v024_mono")
LENS, FLASH = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
PATTERNS, METHODS = ("rggb", "bggr", "grbg", "gbrg"), ("malvar", "menon", "bilinear")
STILL = Developing(shot_noise=False, read_noise=False, quantise=False)


def small(sensor=UEYE, rows=12, columns=16, **changes):
    return dataclasses.replace(sensor, rows=rows, columns=columns, **changes)


def camera_of(sensor, developing=STILL, flash=FLASH):
    return Camera(LENS, sensor, flash=flash, developing=developing)


# Settings ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"binning": 3}, "1 or even"),
        ({"binning": 0}, "at least 1"),
        ({"binning": 1, "columns": 15}, "no whole Bayer quads"),
        ({"binning": 1, "rows": 13}, "no whole Bayer quads"),
        ({"pattern": "mono"}, "does not go with 3 colours"),
        ({"pattern": "rgbg"}, "does not go with"),
        ({"bits": 0}, r"bits must lie in \[1, 16\]"),
        ({"bits": 17}, r"bits must lie in \[1, 16\]"),
        ({"gain": 0.0}, "gain must be positive"),
        ({"gain": np.inf}, "gain must be positive"),
        ({"gain": np.nan}, "gain must be positive"),
        ({"black_level_dn": 1023}, "black level"),
        ({"full_well_e": 0}, "must be positive"),
        ({"read_noise_e": np.nan}, "read noise"),
        ({"quantum_efficiency": Spectrum(np.array([400.0, 700.0]), np.full((3, 2), 1.1))}, "within"),
        ({"quantum_efficiency": Spectrum(np.array([400.0, 700.0]), np.full((2, 2), 0.1))}, r"\(3, n\)"),
    ],
)
def test_what_no_sensor_can_be_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        small(**change)


def test_settings_scale_the_black_level_with_the_range():
    for bits in (1, 8, 10, 12, 14, 16):
        other = UEYE.with_settings(bits=bits)
        assert other.full_scale_dn == 2**bits - 1
        assert other.black_level_dn / other.full_scale_dn == pytest.approx(16 / 1023)
        # The same light is the same share of the range.
        assert other.gain_e_per_dn * other.full_scale_dn == pytest.approx(UEYE.gain_e_per_dn * 1023)
    louder = UEYE.with_settings(gain=2.0)
    assert (louder.bits, louder.black_level_dn) == (UEYE.bits, UEYE.black_level_dn)
    assert louder.gain_e_per_dn == UEYE.gain_e_per_dn / 2
    both = UEYE.with_settings(bits=12, gain=4.0).with_settings(bits=10)
    assert both.gain == 4.0
    assert both.black_level_dn == pytest.approx(16)
    for wrong in ({"bits": 0}, {"bits": 17}, {"gain": 0.0}):
        with pytest.raises(ValueError, match=r"must"):
            UEYE.with_settings(**wrong)


@pytest.mark.parametrize("sensor", [UEYE, MONO])
def test_a_filter_multiplies_the_efficiency(sensor):
    nm = np.linspace(380, 900, 2081)
    glass = Spectrum(np.array([430.0, 505.0, 643.0, 820.0]), np.array([0.0, 0.9, 0.4, 0.1]))
    behind = sensor.behind(glass)
    assert behind.channels == sensor.channels
    # Exact at all knots of both curves; between them the product is bent, by at most a quarter of the steps.
    knots = behind.quantum_efficiency.wavelength_nm
    np.testing.assert_allclose(
        behind.quantum_efficiency.at(knots), sensor.quantum_efficiency.at(knots) * glass.at(knots)
    )
    found, exact = behind.quantum_efficiency.at(nm), sensor.quantum_efficiency.at(nm) * glass.at(nm)
    np.testing.assert_allclose(found, exact, atol=5e-3)


def test_counts_of_photosites():
    assert (UEYE.channels, UEYE.site_shape, UEYE.photosites) == (3, (1200, 1600), (1, 2, 1))
    assert small(binning=4).photosites == (4, 8, 4)
    assert small(binning=1).photosites == (1, 1, 1)
    assert (MONO.channels, MONO.photosites, small(MONO, binning=3).photosites) == (1, (1,), (9,))
    assert small(MONO, binning=3).pixel_pitch_m == pytest.approx(18e-6)


# Mosaic -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("binning", [1, 2, 4])
def test_pure_colours_land_on_their_photosites(pattern, binning):
    sensor = small(pattern=pattern, binning=binning)
    for channel, mask in enumerate(masks_CFA_Bayer(sensor.site_shape, pattern.upper())):
        light = np.zeros((sensor.rows, sensor.columns, 3))
        light[..., channel] = 3000.0
        raw = raw_frame(light, camera_of(sensor))
        assert raw.dtype == np.uint16
        assert np.all(raw[mask] == round(3000 / sensor.gain_e_per_dn + 16))
        assert np.all(raw[~mask] == 16)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_mosaic_is_that_of_the_library(pattern):
    light = np.random.default_rng(1).uniform(0, 6000, (12, 16, 3))
    sensor = small(pattern=pattern, binning=1)
    np.testing.assert_allclose(
        spread_to_photosites(light, sensor), mosaicing_CFA_Bayer(light, pattern.upper()), rtol=1e-6
    )


@pytest.mark.parametrize(
    "sensor",
    [*(small(pattern=p, binning=b) for p in PATTERNS for b in (2, 4)), small(MONO), small(MONO, binning=3)],
)
def test_averaged_photosites_give_their_pixel_back(sensor):
    light = np.random.default_rng(2).uniform(0, 6000, (12, 16, sensor.channels))
    np.testing.assert_allclose(bin_photosites(spread_to_photosites(light, sensor), sensor), light, rtol=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_demosaicing_returns_a_flat_colour_everywhere_and_a_gradient_nearly(pattern, method):
    sensor = small(pattern=pattern, binning=1)
    # To single precision, up to the border and for colours of one channel alone as well.
    for colour in ([0.2, 0.7, 0.4], [0.6, 0.0, 0.0], [0.0, 0.0, 0.9]):
        flat = np.broadcast_to(np.array(colour), (12, 16, 3))
        np.testing.assert_allclose(
            demosaic_image(spread_to_photosites(flat, sensor), pattern, method), flat, atol=1e-6
        )

    # A ramp across the picture, of another slope in each colour: 1 % of the range inside; at the border,
    # where a mirrored ramp turns back, what it climbs over the two photosites that the mirror shows, 2/60.
    y, x = np.mgrid[0:40, 0:60] / 60
    ramp = np.stack([0.2 + 0.5 * x, 0.1 + 0.6 * y + 0.2 * x, 0.8 - 0.4 * x], axis=-1)
    found = demosaic_image(
        spread_to_photosites(ramp, small(rows=40, columns=60, pattern=pattern, binning=1)), pattern, method
    )
    wrong = np.abs(found - ramp)
    assert wrong[4:-4, 4:-4].max() < 0.01
    assert wrong.max() < 2 / 60


@pytest.mark.parametrize("rows_columns", [(2, 2), (2, 6), (4, 2)])
@pytest.mark.parametrize("method", METHODS)
def test_the_smallest_mosaics_are_demosaiced(rows_columns, method):
    rows, columns = rows_columns
    sensor = small(rows=rows, columns=columns, binning=1)
    flat = np.broadcast_to(np.array([0.2, 0.7, 0.4]), (rows, columns, 3))
    np.testing.assert_allclose(
        demosaic_image(spread_to_photosites(flat, sensor), "rggb", method), flat, atol=1e-6
    )


# Raw frame and picture --------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_picture_is_made_from_the_raw_frame(pattern, method):
    light = np.random.default_rng(3).uniform(0, 6000, (12, 16, 3))
    for binning in (1, 2):
        sensor = small(pattern=pattern, binning=binning)
        camera = camera_of(sensor, Developing(demosaic=method))
        raw = raw_frame(light, camera, np.random.default_rng(4)).astype(float)
        rgb = camera_rgb(light, camera, np.random.default_rng(4)) * (1023 - 16) + 16
        for channel, mask in enumerate(masks_CFA_Bayer(sensor.site_shape, pattern.upper())):
            if binning == 1:  # what was measured stays as it was
                np.testing.assert_allclose(rgb[..., channel][mask], raw[mask], atol=1e-3)
            else:
                blocks = np.where(mask, raw, np.nan).reshape(12, 2, 16, 2)
                np.testing.assert_allclose(rgb[..., channel], np.nanmean(blocks, axis=(1, 3)), atol=1e-3)


@pytest.mark.parametrize("left_out", ["quantise", "saturation"])
def test_the_raw_frame_is_always_the_converter_s(left_out):
    light = np.random.default_rng(5).uniform(0, 12000, (12, 16, 3))
    whole = raw_frame(light, camera_of(small(), Developing()), np.random.default_rng(6))
    part = raw_frame(light, camera_of(small(), Developing(**{left_out: False})), np.random.default_rng(6))
    np.testing.assert_array_equal(whole, part)
    assert whole.max() <= 1023


def test_types_and_ranges():
    for sensor in (small(), small(binning=1), small(MONO), small(MONO, binning=3)):
        light = np.random.default_rng(7).uniform(0, 20000, (12, 16, sensor.channels))
        camera = camera_of(sensor, Developing())
        raw, rgb, picture = (
            step(light, camera, np.random.default_rng(8)) for step in (raw_frame, camera_rgb, develop)
        )
        assert (raw.dtype, raw.shape) == (np.uint16, sensor.site_shape)
        assert (rgb.dtype, rgb.shape) == (np.float32, (12, 16, sensor.channels))
        assert (picture.dtype, picture.shape) == (np.uint8, (12, 16, 3))
        assert raw.max() == sensor.full_scale_dn


def test_a_monochrome_picture_is_grey_and_needs_no_reference_light():
    sensor = small(MONO)
    light = np.random.default_rng(9).uniform(0, 14000, (12, 16, 1))
    camera = camera_of(sensor, flash=None)
    picture = develop(light, camera)
    assert np.all(picture == picture[..., :1])
    np.testing.assert_array_equal(picture[..., 0], encode_tone((light[..., 0] / 14000).astype(np.float32)))
    with pytest.raises(ValueError, match="sees no colours"):
        reference_correction(camera)
    with pytest.raises(ValueError, match="are needed"):
        develop(np.zeros((12, 16, 3)), camera)

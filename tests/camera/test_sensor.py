"""Sensors: validation, settings, mosaics, read-out, and modes of any image size."""

from __future__ import annotations

import warnings
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pepperscene.camera import (
    Camera,
    Developing,
    Sensor,
    camera_rgb,
    develop,
    encode_tone,
    load_flash,
    load_lens,
    load_sensor,
    raw_frame,
    reference_correction,
)
from pepperscene.camera.sensor.area_average import AreaAverage
from pepperscene.camera.sensor.readout import (
    average_areas,
    bin_photosites,
    demosaic_image,
    spread_to_photosites,
)
from pepperscene.spectra import Spectrum

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of SciPy, at the library's import
    from colour_demosaicing import masks_CFA_Bayer, mosaicing_CFA_Bayer

UEYE, MONO = load_sensor("ueye_ui5250re"), load_sensor("onsemi_mt9v024_mono")
LENS, FLASH = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
PATTERNS, METHODS = ("rggb", "bggr", "grbg", "gbrg"), ("malvar", "menon", "bilinear")
NOISELESS = Developing(shot_noise=False, read_noise=False, quantise=False)
all_patterns = pytest.mark.parametrize("pattern", PATTERNS)
all_methods = pytest.mark.parametrize("method", METHODS)


def small(sensor=UEYE, rows=12, columns=16, **changes):
    return replace(sensor, rows=rows, columns=columns, **changes)


def camera_with(sensor, developing=NOISELESS, flash=FLASH):
    return Camera(LENS, sensor, flash=flash, developing=developing)


def random_electrons(most, channels=3, seed=1):
    return np.random.default_rng(seed).uniform(0, most, (12, 16, channels))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"binning": 3}, "1 or even"),
        ({"binning": 1, "columns": 15}, "no whole Bayer quads"),
        ({"binning": 1, "rows": 13}, "no whole Bayer quads"),
        ({"pattern": "mono"}, "does not match 3 colours"),
        ({"bits": 17}, r"bits must be in \[1, 16\]"),
        ({"gain": np.nan}, "gain must be positive"),
        ({"black_level_dn": 1023}, "black level"),
        ({"full_well_e": 0}, "must be positive"),
        ({"read_noise_e": np.nan}, "read noise"),
        ({"quantum_efficiency": Spectrum(np.array([400.0, 700.0]), np.full((3, 2), 1.1))}, "within"),
    ],
)
def test_raises_on_invalid_sensor(change, message):
    with pytest.raises(ValueError, match=message):
        small(**change)


@pytest.mark.parametrize("bits", [1, 10, 16])
def test_black_level_scales_with_the_range(bits):
    other = UEYE.with_settings(bits=bits)
    assert other.full_scale_dn == 2**bits - 1
    assert other.black_level_dn / other.full_scale_dn == pytest.approx(16 / 1023)
    # The same light is the same fraction of the range.
    assert other.gain_e_per_dn * other.full_scale_dn == pytest.approx(UEYE.gain_e_per_dn * 1023)


def test_gain_keeps_the_black_level_and_settings_combine():
    doubled = UEYE.with_settings(gain=2.0)
    assert (doubled.bits, doubled.black_level_dn) == (UEYE.bits, UEYE.black_level_dn)
    assert doubled.gain_e_per_dn == UEYE.gain_e_per_dn / 2
    both = UEYE.with_settings(bits=12, gain=4.0).with_settings(bits=10)
    assert both.gain == 4.0
    assert both.black_level_dn == pytest.approx(16)
    for invalid in ({"bits": 0}, {"gain": 0.0}):
        with pytest.raises(ValueError, match=r"must be"):
            UEYE.with_settings(**invalid)


@all_patterns
@pytest.mark.parametrize("binning", [1, 4])
def test_pure_colours_reach_only_their_photosites(pattern, binning):
    sensor = small(pattern=pattern, binning=binning)
    for channel, mask in enumerate(masks_CFA_Bayer(sensor.site_shape, pattern.upper())):
        electrons = np.zeros((sensor.rows, sensor.columns, 3))
        electrons[..., channel] = 3000.0
        raw = raw_frame(electrons, camera_with(sensor))
        assert raw.dtype == np.uint16
        assert np.all(raw[mask] == round(3000 / sensor.gain_e_per_dn + 16))
        assert np.all(raw[~mask] == 16)


@all_patterns
def test_mosaic_matches_the_library(pattern):
    electrons = random_electrons(6000)
    sites = spread_to_photosites(electrons, small(pattern=pattern, binning=1))
    np.testing.assert_allclose(sites, mosaicing_CFA_Bayer(electrons, pattern.upper()), rtol=1e-6)
    # Binning inverts it.
    for sensor in (small(pattern=pattern, binning=4), small(MONO, binning=3)):
        electrons = random_electrons(6000, sensor.channels)
        binned = bin_photosites(spread_to_photosites(electrons, sensor), sensor)
        np.testing.assert_allclose(binned, electrons, rtol=1e-6)


@all_methods
@all_patterns
def test_demosaicing_is_exact_for_uniform_colours_and_close_for_gradients(pattern, method):
    # To single precision, up to the border and for pure colours too.
    for colour in ([0.2, 0.7, 0.4], [0.6, 0.0, 0.0], [0.0, 0.0, 0.9]):
        uniform = np.broadcast_to(np.array(colour), (12, 16, 3))
        sites = spread_to_photosites(uniform, small(pattern=pattern, binning=1))
        np.testing.assert_allclose(demosaic_image(sites, pattern, method), uniform, atol=1e-6)

    # A ramp across the image with another slope in each colour: 1 % of the range inside; at the border, where
    # a mirrored ramp turns back, what it rises over the two photosites that the mirror shows, 2/60.
    y, x = np.mgrid[0:40, 0:60] / 60
    ramp = np.stack([0.2 + 0.5 * x, 0.1 + 0.6 * y + 0.2 * x, 0.8 - 0.4 * x], axis=-1)
    sites = spread_to_photosites(ramp, small(rows=40, columns=60, pattern=pattern, binning=1))
    error = np.abs(demosaic_image(sites, pattern, method) - ramp)
    assert error[4:-4, 4:-4].max() < 0.01
    assert error.max() < 2 / 60


@pytest.mark.parametrize(("rows", "columns"), [(2, 2), (4, 2)])
@all_methods
def test_smallest_mosaics_can_be_demosaiced(rows, columns, method):
    uniform = np.broadcast_to(np.array([0.2, 0.7, 0.4]), (rows, columns, 3))
    sites = spread_to_photosites(uniform, small(rows=rows, columns=columns, binning=1))
    np.testing.assert_allclose(demosaic_image(sites, "rggb", method), uniform, atol=1e-6)


@pytest.mark.parametrize(("pattern", "method"), [("rggb", "malvar"), ("gbrg", "menon"), ("bggr", "bilinear")])
def test_image_is_made_from_the_raw_frame(pattern, method):
    electrons = random_electrons(6000)
    for binning in (1, 2):
        sensor = small(pattern=pattern, binning=binning)
        camera = camera_with(sensor, Developing(demosaic=method))
        raw = raw_frame(electrons, camera, np.random.default_rng(4)).astype(float)
        rgb = camera_rgb(electrons, camera, np.random.default_rng(4)) * (1023 - 16) + 16
        for channel, mask in enumerate(masks_CFA_Bayer(sensor.site_shape, pattern.upper())):
            if binning == 1:  # measured values are kept
                np.testing.assert_allclose(rgb[..., channel][mask], raw[mask], atol=1e-3)
            else:
                blocks = np.where(mask, raw, np.nan).reshape(12, 2, 16, 2)
                np.testing.assert_allclose(rgb[..., channel], np.nanmean(blocks, axis=(1, 3)), atol=1e-3)


@pytest.mark.parametrize("step", ["quantise", "saturation"])
def test_raw_frame_is_always_quantised_and_saturated(step):
    full, part = (
        raw_frame(random_electrons(12000), camera_with(small(), developing), np.random.default_rng(6))
        for developing in (Developing(), Developing(**{step: False}))
    )
    np.testing.assert_array_equal(full, part)
    assert full.max() == 1023


def test_monochrome_image_is_grey_and_needs_no_reference_light():
    electrons, camera = random_electrons(14000, 1), camera_with(small(MONO), flash=None)
    image = develop(electrons, camera)
    assert np.all(image == image[..., :1])
    expected = encode_tone((electrons[..., 0] / 14000).astype(np.float32))
    np.testing.assert_array_equal(image[..., 0], expected)
    with pytest.raises(ValueError, match="is monochrome"):
        reference_correction(camera)
    with pytest.raises(ValueError, match="must have the shape"):
        develop(np.zeros((12, 16, 3)), camera)


# Zero, numbers below the smallest normal one, single electrons, and unrealistically strong light.
ELECTRONS = st.one_of(
    st.sampled_from([0.0, 1e30, np.finfo(float).max]), st.floats(0, 1e-300), st.floats(0, 100),
    st.floats(0, 1e10), st.floats(0, 1e30),
)  # fmt: skip


@st.composite
def sensors(draw):
    """Small sensors with any values that a sensor file and a recipe allow."""
    pattern = draw(st.sampled_from([*PATTERNS, "mono"]))
    bits = draw(st.integers(1, 16))
    return Sensor(
        name="any",
        columns=2 * draw(st.integers(1, 3)),
        rows=2 * draw(st.integers(1, 3)),
        pitch_m=5e-6,
        quantum_efficiency=(MONO if pattern == "mono" else UEYE).quantum_efficiency,
        full_well_e=draw(st.floats(1, 1e9)),
        read_noise_e=draw(st.floats(0, 1e9)),
        bits=bits,
        black_level_dn=draw(st.floats(0, 0.999)) * (2**bits - 1),
        binning=draw(st.integers(1, 4) if pattern == "mono" else st.sampled_from([1, 2, 4])),
        pattern=pattern,
        gain=draw(st.floats(1e-3, 1e3)),
    )


DEVELOPING = st.builds(
    Developing,
    **dict.fromkeys(("falloff", "shot_noise", "read_noise", "saturation", "quantise"), st.booleans()),
    demosaic=st.sampled_from(METHODS),
    white_balance=st.sampled_from([None, "daylight"]),
    colour_matrix=st.booleans(),
    tone=st.sampled_from(["srgb", "linear"]),
)


@given(sensor=sensors(), developing=DEVELOPING, seed=st.integers(0, 2**32) | st.none(), data=st.data())
@settings(max_examples=60)
def test_any_light_on_any_sensor_stays_in_range(sensor, developing, seed, data):
    shape = (sensor.rows, sensor.columns, sensor.channels)
    electrons = data.draw(arrays(np.float64, shape, elements=ELECTRONS))
    camera = Camera(LENS, sensor, developing=developing)
    raw, rgb, image = (
        step(electrons, camera, None if seed is None else np.random.default_rng(seed))
        for step in (raw_frame, camera_rgb, develop)
    )
    assert (raw.dtype, raw.shape) == (np.uint16, sensor.site_shape)
    assert raw.max() <= sensor.full_scale_dn
    assert (rgb.dtype, rgb.shape) == (np.float32, shape)
    assert (image.dtype, image.shape) == (np.uint8, (*shape[:2], 3))
    assert np.isfinite(rgb).all()
    if developing.saturation and (sensor.channels == 1 or sensor.binning > 1):
        # Single precision covers the full range, of which a high black level leaves little.
        span = sensor.full_scale_dn - sensor.black_level_dn
        rounding = 4 * np.finfo(np.float32).eps * sensor.full_scale_dn / span
        assert rgb.min() >= -sensor.black_level_dn / span - rounding
        assert rgb.max() <= 1 + rounding


# --- image sizes that are no whole fraction of the photosites -----------------------------------------------

BAYER, WIDE = load_sensor("onsemi_mt9v024_full"), load_lens("nikkor_18_55mm_at_18mm")
EXACT = Developing(shot_noise=False, read_noise=False, quantise=False, saturation=False)


def full_size(sensor, columns, rows):
    return replace(sensor, columns=columns, rows=rows)


def electrons_to_rgb(electrons, sensor, developing=EXACT, rng=None):
    return camera_rgb(electrons, Camera(WIDE, sensor, flash=FLASH, developing=developing), rng)


def test_a_whole_even_factor_is_binned_like_the_shipped_file():
    shipped, mode = load_sensor("ueye_ui5250re"), load_sensor("ueye_ui5250re_full").with_size(800, 600)
    for name in ("columns", "rows", "binning", "pattern", "reduction", "site_shape", "pixel_pitch_m"):
        assert getattr(mode, name) == getattr(shipped, name), name
    assert shipped.with_size(800, 600).site_shape == (1200, 1600)


def test_1920_by_1080_photosites_give_1280_by_720_pixels():
    sensor = full_size(BAYER, 1920, 1080)
    mode = sensor.with_size(1280, 720)
    assert (mode.reduction, mode.binning, mode.site_shape) == (Fraction(3, 2), 1, (1080, 1920))
    assert mode.pixel_pitch_m == pytest.approx(1.5 * sensor.pitch_m, rel=1e-15)
    # The same field of view: the focal length in pixels is shorter by the same factor.
    before, after = Camera(WIDE, sensor).intrinsics, Camera(WIDE, mode).intrinsics
    np.testing.assert_allclose(after[:2], before[:2] / 1.5, rtol=1e-14)


def test_another_shape_is_the_largest_part_in_the_middle():
    mode = full_size(MONO, 1280, 960).with_size(1280, 720)
    assert (mode.binning, mode.reduction, mode.site_shape) == (1, None, (720, 1280))
    mode = full_size(MONO, 1920, 1080).with_size(848, 480)  # 2.25 photosites per pixel: 1908 x 1080
    assert (mode.reduction, mode.site_shape) == (Fraction(9, 4), (1080, 1908))


@pytest.mark.parametrize(("rows", "pattern"), [(478, "gbrg"), (476, "rggb"), (480, "rggb")])
def test_a_cropped_mosaic_begins_with_the_colour_of_its_first_photosite(rows, pattern):
    assert BAYER.with_size(752, rows).pattern == pattern


def test_a_mode_has_its_own_time_from_row_to_row():
    sensor = replace(full_size(BAYER, 1920, 1080), line_time_s=15e-6)
    assert sensor.with_size(1280, 720).line_time_s == pytest.approx(22.5e-6)
    assert sensor.with_size(960, 540).line_time_s == pytest.approx(30e-6)
    assert sensor.with_size(960, 540).with_size(640, 360).line_time_s == pytest.approx(45e-6)
    assert sensor.with_size(1920, 540).line_time_s == pytest.approx(15e-6)


@pytest.mark.parametrize("size", [(753, 480), (752, 481), (0, 10)])
def test_an_image_has_no_more_pixels_than_photosites(size):
    with pytest.raises(ValueError, match="must be 1 x 1 to 752 x 480, the photosites of"):
        BAYER.with_size(*size)


# 1.5 and 2.25 photosites per pixel, and sizes of another shape, all of 752 x 480 photosites.
@pytest.mark.parametrize("size", [(501, 320), (334, 213), (640, 360), (751, 3), (1, 1), (752, 479)])
@pytest.mark.parametrize("sensor", [BAYER, MONO], ids=["bayer", "mono"])
def test_uniform_light_keeps_its_value_in_every_pixel_and_colour(sensor, size):
    mode = sensor.with_size(*size)
    level = np.array([300.0, 700.0, 500.0])[: mode.channels]
    electrons = np.broadcast_to(level, (mode.rows, mode.columns, mode.channels))
    full = mode.full_scale_dn - mode.black_level_dn
    expected = np.broadcast_to(level / mode.gain_e_per_dn / full, electrons.shape)
    np.testing.assert_allclose(electrons_to_rgb(electrons, mode), expected, rtol=2e-6)


@pytest.mark.parametrize("size", [(334, 213), (751, 3), (100, 100)])
def test_spreading_and_averaging_keep_the_mean_of_any_image(size):
    mode = MONO.with_size(*size)
    electrons = np.random.default_rng(1).uniform(0, 1000, (mode.rows, mode.columns, 1))
    assert mode.reduction is not None
    down, right = mode.areas
    sites = spread_to_photosites(electrons, mode)
    mean = average_areas(sites[..., None], mode).mean(dtype=float)
    assert mean == pytest.approx(electrons.mean(), rel=1e-6)
    assert sites.shape == (down.sites, right.sites)


def test_photosites_have_their_part_of_every_pixel():
    # 1.5 photosites per pixel: every third lies half in one pixel and half in the next.
    mode = replace(MONO, columns=2, rows=2, reduction=Fraction(3, 2))
    sites = spread_to_photosites(np.array([[[0.0], [60]], [[0], [60]]]), mode)
    # Four photosites are read out, of which the three in the middle, from 0.5 on, are of the image.
    np.testing.assert_allclose(sites, [[0, 0, 60, 60]] * 4, atol=1e-5)
    mode = replace(mode, columns=4)
    sites = spread_to_photosites(np.broadcast_to(np.array([[0.0], [60], [0], [60]]), (2, 4, 1)), mode)
    np.testing.assert_allclose(sites[0], [0, 30, 60, 0, 30, 60], atol=1e-5)


@pytest.mark.parametrize("factor", [Fraction(3, 2), Fraction(9, 4), Fraction(7, 1)])
def test_noise_of_a_monochrome_pixel_is_that_of_its_weighted_photosites(factor):
    # Independent of the module: overlaps on a fine grid of equal parts of a photosite.
    part = factor.denominator
    area = AreaAverage(40, factor)
    margin = (area.sites - 40 * factor) / 2
    grid = np.arange(area.sites * 2 * part) // (2 * part)
    begin, length = int(margin * 2 * part), int(factor * 2 * part)
    counts = [np.bincount(grid[begin + i * length :][:length], minlength=area.sites) for i in range(40)]
    weights = np.array(counts) / length
    expected = np.mean(np.sum(weights**2, axis=1)) ** 2

    mode = replace(MONO, columns=40, rows=40, reduction=factor)
    developing = replace(EXACT, shot_noise=True, read_noise=True)
    electrons = np.full((40, 40, 1), 4000.0)
    rng = np.random.default_rng(3)
    frames = np.array([electrons_to_rgb(electrons, mode, developing, rng) for _ in range(60)])
    scale = mode.gain_e_per_dn * (mode.full_scale_dn - mode.black_level_dn)
    variance = np.var(frames * scale)
    assert variance == pytest.approx((4000 + mode.read_noise_e**2) * expected, rel=0.02)
    assert mode.photosites[0] == pytest.approx(1 / expected, rel=1e-9)
    assert frames.mean() * scale == pytest.approx(4000, rel=2e-4)


def test_noise_of_averaged_colours_is_that_of_averaged_demosaiced_frames():
    mode = full_size(BAYER, 120, 80).with_size(80, 53)
    site_rows, site_columns = mode.site_shape
    developing = replace(EXACT, shot_noise=True, read_noise=True, demosaic="bilinear")
    rng = np.random.default_rng(4)
    electrons = np.full((53, 80, 3), 3000.0)
    frames = np.array([electrons_to_rgb(electrons, mode, developing, rng) for _ in range(40)])
    scale = mode.gain_e_per_dn * (mode.full_scale_dn - mode.black_level_dn)

    # The same by hand: white noise of the photosites, OpenCV's or the library's bilinear filter, and a mean
    # over each pixel's area with finely repeated photosites.
    sd = np.sqrt(3000 + mode.read_noise_e**2)
    factor = mode.reduction
    assert (site_rows, site_columns, factor) == (80, 120, Fraction(3, 2))
    by_hand = []
    for _ in range(10):
        colours = demosaic_image(rng.normal(0, sd, (80, 120)).astype(np.float32), mode.pattern, "bilinear")
        fine = colours.repeat(4, axis=0).repeat(4, axis=1)
        top = int((80 - 53 * factor) / 2 * 4)
        fine = fine[top : top + 53 * 6]
        by_hand.append(fine.reshape(53, 6, 80, 6, 3).mean(axis=(1, 3)))
    variances = (np.var(part, axis=(0, 1, 2)) for part in (frames * scale, by_hand))
    np.testing.assert_allclose(*variances, rtol=0.04)


def test_a_soft_edge_of_grey_light_stays_in_its_place_in_every_colour():
    mode = full_size(BAYER, 240, 160).with_size(160, 107)
    # As soft as a lens makes it; at a hard step every demosaic method shows coloured fringes.
    row = 500 + 3500 / (1 + np.exp(-(np.arange(160) + 0.5 - 80) / 3))
    rgb = electrons_to_rgb(np.broadcast_to(row[None, :, None], (107, 160, 3)), mode)[40:-40].mean(axis=0)
    np.testing.assert_allclose(rgb, np.broadcast_to(rgb[:, 1:2], (160, 3)), rtol=0, atol=2e-3)
    middle = rgb[[10, -10]].mean(axis=0)
    position = [np.interp(middle[c], rgb[75:85, c], np.arange(75, 85) + 0.5) for c in range(3)]
    np.testing.assert_allclose(position, 80, atol=0.02)


def test_raw_frames_have_all_photosites():
    mode = full_size(BAYER, 24, 16).with_size(16, 10)
    electrons = np.full((10, 16, 3), 800.0)
    raw = raw_frame(electrons, Camera(WIDE, mode, flash=FLASH, developing=EXACT))
    assert raw.shape == mode.site_shape == (16, 24)
    np.testing.assert_array_equal(raw, np.rint(800 / mode.gain_e_per_dn + mode.black_level_dn))
    metadata = Camera(WIDE, mode).to_metadata()
    assert (metadata["reduction"], metadata["site_shape"], metadata["binning"]) == (1.5, [16, 24], 1)
    assert not {"reduction", "site_shape", "line_time_s"} & Camera(WIDE, BAYER).to_metadata().keys()
    assert Camera(WIDE, replace(BAYER, line_time_s=1e-5)).to_metadata()["line_time_s"] == 1e-5

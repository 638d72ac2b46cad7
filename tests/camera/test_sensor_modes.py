"""Image sizes that are no whole fraction of the photosites: geometry, mean, noise and colours."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from pepperscene.camera import Camera, Developing, camera_rgb, load_flash, load_lens, load_sensor, raw_frame
from pepperscene.camera.sensor.area_average import AreaAverage
from pepperscene.camera.sensor.readout import average_areas, demosaic_image, spread_to_photosites

BAYER, MONO = load_sensor("onsemi_mt9v024_full"), load_sensor("onsemi_mt9v024_mono")
LENS, FLASH = load_lens("nikkor_18_55mm_at_18mm"), load_flash("led_matrix_200klx")
NOISELESS = Developing(shot_noise=False, read_noise=False, quantise=False, saturation=False)


def full_size(sensor, columns, rows):
    return replace(sensor, columns=columns, rows=rows)


def electrons_to_rgb(electrons, sensor, developing=NOISELESS, rng=None):
    return camera_rgb(electrons, Camera(LENS, sensor, flash=FLASH, developing=developing), rng)


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
    before, after = Camera(LENS, sensor).intrinsics, Camera(LENS, mode).intrinsics
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
    developing = replace(NOISELESS, shot_noise=True, read_noise=True)
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
    developing = replace(NOISELESS, shot_noise=True, read_noise=True, demosaic="bilinear")
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


def test_no_photosite_leaves_the_range_of_the_pixels_around_it():
    mode = MONO.with_size(334, 213)
    electrons = np.random.default_rng(5).choice([0.0, 1.0, 1000.0], (213, 334, 1))
    sites = spread_to_photosites(electrons, mode)
    assert sites.min() >= -1e-4
    assert sites.max() <= 1000.01


def test_raw_frames_have_all_photosites():
    mode = full_size(BAYER, 24, 16).with_size(16, 10)
    electrons = np.full((10, 16, 3), 800.0)
    raw = raw_frame(electrons, Camera(LENS, mode, flash=FLASH, developing=NOISELESS))
    assert raw.shape == mode.site_shape == (16, 24)
    np.testing.assert_array_equal(raw, np.rint(800 / mode.gain_e_per_dn + mode.black_level_dn))
    metadata = Camera(LENS, mode).to_metadata()
    assert (metadata["reduction"], metadata["site_shape"], metadata["binning"]) == (1.5, [16, 24], 1)
    assert not {"reduction", "site_shape", "line_time_s"} & Camera(LENS, BAYER).to_metadata().keys()
    assert Camera(LENS, replace(BAYER, line_time_s=1e-5)).to_metadata()["line_time_s"] == 1e-5

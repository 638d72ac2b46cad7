from __future__ import annotations

import tracemalloc

import cv2
import numpy as np
import pytest

from pepperscene.truth import (
    HUE_BINS,
    ImageStatistics,
    centre_falloff,
    grey_values,
    hue_bins,
    saturated_share,
)


def picture(rng, shape=(20, 30), top=8):
    colour = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    return colour, rng.integers(0, top, shape).astype(np.uint8)


@pytest.fixture
def gathered():
    rng = np.random.default_rng(4)
    pictures = [picture(rng) for _ in range(6)]
    statistics = ImageStatistics()
    for colour, class_id in pictures:
        statistics.add(colour, class_id)
    return statistics, np.stack([p[0] for p in pictures]), np.stack([p[1] for p in pictures])


def test_sums_are_those_of_the_whole_stack(gathered):
    statistics, colour, class_id = gathered
    assert (statistics.pictures, statistics.photographs, statistics.labelled) == (6, 6, 6)
    masks = class_id[:, None] == np.arange(8)[:, None, None]
    np.testing.assert_allclose(statistics.shares(), masks.mean(axis=(0, 2, 3)))
    assert statistics.shares().sum() == pytest.approx(1.0)
    np.testing.assert_allclose(statistics.mean_masks(), masks.mean(axis=0))
    grey = np.stack([cv2.cvtColor(one, cv2.COLOR_RGB2GRAY) for one in colour])
    np.testing.assert_allclose(statistics.mean_intensity(), grey.mean(axis=0), atol=0.51)
    np.testing.assert_allclose(statistics.intensities, grey.mean(axis=(1, 2)), atol=0.05)
    np.testing.assert_allclose(statistics.saturated, (colour == 255).any(-1).mean(axis=(1, 2)))


def test_every_picture_counts_the_same_in_a_hue_spectrum():
    # One picture with a single red leaf pixel, one full of green leaf: half and half, as averaged.
    red, green = np.zeros((2, 10, 10, 3), np.uint8)
    red[..., 0], green[..., 1] = 200, 90
    single = np.zeros((10, 10), np.uint8)
    single[5, 5] = 1
    statistics = ImageStatistics()
    statistics.add(red, single)
    statistics.add(green, np.ones((10, 10), np.uint8))
    spectra = statistics.hue_spectra()
    assert spectra.shape == (8, HUE_BINS)
    assert spectra[1, 0] == pytest.approx(50.0)
    assert spectra[1, 60] == pytest.approx(50.0)
    # The background is in one of the two, and a class that nobody has seen has no spectrum.
    assert spectra[0, 0] == pytest.approx(100.0)
    assert np.isnan(spectra[2]).all()
    assert statistics.hue_pictures.tolist() == [1, 2, 0, 0, 0, 0, 0, 0]


def test_spectra_and_grey_pixels_add_up(gathered):
    statistics, colour, class_id = gathered
    np.testing.assert_allclose(statistics.hue_spectra().sum(axis=1) + 100 * statistics.grey_shares(), 100.0)
    bins = hue_bins(colour)
    by_picture = [[(b[c == 3] == 40).mean() for b, c in zip(bins, class_id, strict=True)]]
    assert statistics.hue_spectra()[3, 40] == pytest.approx(100 * np.mean(by_picture))


def test_hues_are_of_the_middle_alone_and_all_else_of_the_whole():
    colour = np.zeros((400, 500, 3), np.uint8)
    colour[..., 2] = 255
    colour[50:350, 100:400] = (0, 128, 0)
    statistics = ImageStatistics()
    statistics.add(colour, np.full((400, 500), 2, np.uint8))
    assert statistics.hue_spectra()[2, 60] == pytest.approx(100.0)
    assert statistics.saturated == [pytest.approx(1 - 0.09 / 0.2)]
    assert statistics.mean_intensity().shape == (400, 500)


def test_pictures_of_other_sizes_are_fitted_where_places_are_compared():
    rng = np.random.default_rng(5)
    colour, class_id = picture(rng, (12, 16))
    alone, both = ImageStatistics(), ImageStatistics()
    alone.add(colour, class_id)
    both.add(colour, class_id)
    # Twice as large by repeating pixels: nothing but the number of pixels changes.
    both.add(*(image.repeat(2, axis=0).repeat(2, axis=1) for image in (colour, class_id)))
    np.testing.assert_array_equal(both.mean_masks(), alone.mean_masks())
    np.testing.assert_array_equal(both.mean_intensity(), alone.mean_intensity())
    assert both.pixels.sum() == 5 * alone.pixels.sum()


def test_what_has_no_label_is_counted_apart():
    class_id = np.full((4, 5), 255, np.uint8)
    class_id[0] = 2
    statistics = ImageStatistics()
    statistics.add(None, class_id)
    assert statistics.unlabelled == 15
    assert statistics.shares().tolist() == [0, 0, 0.25, 0, 0, 0, 0, 0]
    assert statistics.mean_masks()[:, 1:].sum() == 0
    assert statistics.mean_intensity() is None


def test_nothing_gives_no_numbers():
    statistics = ImageStatistics()
    statistics.add(np.zeros((3, 3, 3), np.uint8), None)
    assert np.isnan(statistics.shares()).all()
    assert np.isnan(statistics.hue_spectra()).all()
    assert statistics.mean_masks() is None
    assert statistics.mean_intensity().max() == 0


def test_counters_do_not_run_over_and_memory_stays():
    class_id = np.ones((50, 60), np.uint8)
    colour = np.full((50, 60, 3), 255, np.uint8)
    statistics = ImageStatistics()
    statistics.add(colour, class_id)
    tracemalloc.start()
    for _ in range(599):
        statistics.add(colour, class_id)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Two numbers a picture are kept.
    assert grown < 200_000
    np.testing.assert_array_equal(statistics.mean_masks()[1], 1.0)
    np.testing.assert_array_equal(statistics.mean_intensity(), 255.0)


def test_single_measures():
    assert grey_values(np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255]]], np.uint8)).tolist() == [
        [76, 150, 29]
    ]
    assert saturated_share(np.array([[[255, 0, 0], [254, 254, 254]]], np.uint8)) == 0.5
    with pytest.raises(ValueError, match="uint8"):
        grey_values(np.zeros((2, 2)))


@pytest.mark.parametrize("shape", [(60, 80), (61, 81), (90, 90)])
def test_the_fall_towards_the_corners_is_that_of_a_picture_made_of_rings(shape):
    rows, columns = (np.arange(length) - (length - 1) / 2 for length in shape)
    away = np.hypot(rows[:, None], columns[None]) / np.hypot(shape[0] / 2, shape[1] / 2)
    assert away.max() < 1.0
    radii = np.linspace(0.0, 1.0, 11)
    # What falls evenly has in each ring a mean between the values at its borders.
    found = centre_falloff(200.0 * (1.0 - away), radii)
    assert (found[1:-1] < 200.0 * (1.0 - radii[1:-2])).all()
    assert (found[1:-1] > 200.0 * (1.0 - radii[2:-1])).all()
    np.testing.assert_allclose(centre_falloff(np.full(shape, 7.0), radii), 7.0)


def test_rings_without_a_pixel_have_no_mean():
    found = centre_falloff(np.ones((2, 2)), np.array([0.0, 0.25, 0.75, 1.0]))
    np.testing.assert_array_equal(found, [np.nan, 1.0, np.nan])

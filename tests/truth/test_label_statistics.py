"""Image statistics against OpenCV, the standard library, and sums over whole stacks."""

import colorsys
import tracemalloc

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.truth.statistics import (
    HUE_BINS,
    ImageStatistics,
    centre_crop,
    centre_falloff,
    grey_values,
    hue_bins,
    hue_counts,
    hue_spectrum_correlation,
    mean_hue,
)


def test_hue_bin_contains_the_hue_of_colorsys():
    levels = np.linspace(0, 255, 6).astype(np.uint8)
    grid = np.stack(np.meshgrid(levels, levels, levels), axis=-1).reshape(-1, 3)
    codes = np.concatenate([grid, np.random.default_rng(1).integers(0, 256, (9784, 3)).astype(np.uint8)])
    expected = np.array([colorsys.rgb_to_hsv(*(code / 255.0)) for code in codes])
    bins = hue_bins(codes.reshape(100, 100, 3)).ravel()
    np.testing.assert_array_equal(bins == -1, expected[:, 1] == 0.0)
    difference = np.abs(360.0 * expected[:, 0] - 2.0 * bins)[bins >= 0] % 360.0
    assert np.minimum(difference, 360.0 - difference).max() <= 1.0 + 1e-9


def test_each_pixel_is_counted_once_for_its_class():
    rng = np.random.default_rng(2)
    colour = rng.integers(0, 4, (40, 30, 3)).astype(np.uint8)
    class_id = rng.choice(np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 255], np.uint8), (40, 30))
    counts = hue_counts(colour, class_id)
    assert counts.shape == (8, HUE_BINS + 1)
    bins = hue_bins(colour)
    for organ_class in range(8):
        of_class = bins[class_id == organ_class]
        assert counts[organ_class].sum() == of_class.size
        assert counts[organ_class, HUE_BINS] == (of_class == -1).sum()
        assert all(counts[organ_class, k] == (of_class == k).sum() for k in range(HUE_BINS))


def test_raises_on_wrong_shapes_and_types():
    with pytest.raises(ValueError, match="three channels"):
        hue_bins(np.zeros((2, 2, 4), np.uint8))
    with pytest.raises(ValueError, match="uint8"):
        hue_bins(np.zeros((2, 2, 3)))
    with pytest.raises(ValueError, match="one size"):
        hue_counts(np.zeros((2, 2, 3), np.uint8), np.zeros((2, 3), np.uint8))
    with pytest.raises(ValueError, match="uint8"):
        grey_values(np.zeros((2, 2)))


@given(st.floats(0.0, 359.0), st.floats(5.0, 40.0))
def test_mean_hue_of_a_bell_is_its_middle(middle, width):
    distance = (2.0 * np.arange(HUE_BINS) - middle + 180.0) % 360.0 - 180.0
    mean = mean_hue(np.exp(-0.5 * (distance / width) ** 2))
    assert abs((mean - middle + 180.0) % 360.0 - 180.0) < 0.01


def test_correlation_is_independent_of_scale_and_offset():
    spectrum = np.random.default_rng(3).random(HUE_BINS)
    assert hue_spectrum_correlation(spectrum, 3.0 * spectrum + 1.0) == pytest.approx(1.0)
    assert hue_spectrum_correlation(spectrum, 2.0 - spectrum) == pytest.approx(-1.0)


@pytest.mark.parametrize(
    ("shape", "size_px", "cropped"),
    [
        ((600, 800), None, (300, 300)),
        ((346, 613), None, (199, 199)),
        ((720, 1280), None, (416, 416)),
        # A long image has fewer rows than the square would need.
        ((90, 900), None, (90, 90)),
        ((1, 1), None, (1, 1)),
        ((200, 900), 300, (200, 300)),
    ],
)
def test_crop_is_central(shape, size_px, cropped):
    centre = centre_crop(np.arange(shape[0] * shape[1]).reshape(shape), size_px)
    assert centre.shape == cropped
    for positions, length in zip(np.divmod(centre, shape[1]), shape, strict=True):
        # The same margin on both sides, to a pixel.
        assert abs(positions.min() - (length - 1 - positions.max())) <= 1


@pytest.mark.parametrize("shape", [(60, 80), (61, 81), (90, 90)])
def test_falloff_of_a_radial_image(shape):
    rows, columns = (np.arange(length) - (length - 1) / 2 for length in shape)
    distance = np.hypot(rows[:, None], columns[None]) / np.hypot(shape[0] / 2, shape[1] / 2)
    assert distance.max() < 1.0
    radii = np.linspace(0.0, 1.0, 11)
    # In a linear falloff, the mean of each ring is between the values at its borders.
    falloff = centre_falloff(200.0 * (1.0 - distance), radii)
    assert (falloff[1:-1] < 200.0 * (1.0 - radii[1:-2])).all()
    assert (falloff[1:-1] > 200.0 * (1.0 - radii[2:-1])).all()
    np.testing.assert_allclose(centre_falloff(np.full(shape, 7.0), radii), 7.0)


def test_falloff_is_nan_in_rings_without_pixels():
    falloff = centre_falloff(np.ones((2, 2)), np.array([0.0, 0.25, 0.75, 1.0]))
    np.testing.assert_array_equal(falloff, [np.nan, 1.0, np.nan])


def random_image(rng, shape=(20, 30)):
    colour = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    return colour, rng.integers(0, 8, shape).astype(np.uint8)


Stack = tuple[ImageStatistics, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def stack() -> Stack:
    """Statistics of six images, and their colours and classes in arrays."""
    rng = np.random.default_rng(4)
    images = [random_image(rng) for _ in range(6)]
    statistics = ImageStatistics()
    for colour, class_id in images:
        statistics.add(colour, class_id)
    return statistics, *(np.stack(arrays) for arrays in zip(*images, strict=True))


def test_sums_equal_those_of_the_whole_stack(stack: Stack):
    statistics, colour, class_id = stack
    assert (statistics.image_count, statistics.photograph_count, statistics.labelled_count) == (6, 6, 6)
    masks = class_id[:, None] == np.arange(8)[:, None, None]
    np.testing.assert_allclose(statistics.class_fractions(), masks.mean(axis=(0, 2, 3)))
    assert statistics.class_fractions().sum() == pytest.approx(1.0)
    np.testing.assert_allclose(statistics.mean_masks(), masks.mean(axis=0))
    grey = np.stack([cv2.cvtColor(one, cv2.COLOR_RGB2GRAY) for one in colour])
    np.testing.assert_allclose(grey_values(colour[0]), grey[0], atol=1)
    np.testing.assert_allclose(statistics.mean_intensity(), grey.mean(axis=0), atol=0.51)
    np.testing.assert_allclose(statistics.intensities, grey.mean(axis=(1, 2)), atol=0.05)
    np.testing.assert_allclose(statistics.saturated_fractions, (colour == 255).any(-1).mean(axis=(1, 2)))


def test_spectra_and_grey_pixels_add_up(stack: Stack):
    statistics, colour, class_id = stack
    np.testing.assert_allclose(
        statistics.hue_spectra().sum(axis=1) + 100 * statistics.grey_fractions(), 100.0
    )
    by_image = []
    for bins, ids in zip(hue_bins(colour), class_id, strict=True):
        central = centre_crop(bins)[centre_crop(ids) == 3]
        by_image.append((central == 40).mean())
    assert statistics.hue_spectra()[3, 40] == pytest.approx(100 * np.mean(by_image))


def test_each_image_has_the_same_weight_in_a_hue_spectrum():
    # One image with a single red leaf pixel, one full of green leaf: half and half in the mean.
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
    # The background is in one of the two; a class that is in none has no spectrum.
    assert spectra[0, 0] == pytest.approx(100.0)
    assert np.isnan(spectra[2]).all()
    assert statistics.hue_image_counts.tolist() == [1, 2, 0, 0, 0, 0, 0, 0]


def test_only_hues_are_restricted_to_the_centre():
    colour = np.zeros((400, 500, 3), np.uint8)
    colour[..., 2] = 255
    colour[50:350, 100:400] = (0, 128, 0)
    statistics = ImageStatistics()
    statistics.add(colour, np.full((400, 500), 2, np.uint8))
    assert statistics.hue_spectra()[2, 60] == pytest.approx(100.0)
    assert statistics.saturated_fractions == [pytest.approx(1 - 0.09 / 0.2)]
    assert statistics.mean_intensity().shape == (400, 500)


def test_images_of_other_sizes_are_resized_where_positions_are_compared():
    colour, class_id = random_image(np.random.default_rng(5), (12, 16))
    alone, both = ImageStatistics(), ImageStatistics()
    alone.add(colour, class_id)
    both.add(colour, class_id)
    # An image enlarged by repeating pixels only changes the number of pixels.
    both.add(*(image.repeat(2, axis=0).repeat(2, axis=1) for image in (colour, class_id)))
    np.testing.assert_array_equal(both.mean_masks(), alone.mean_masks())
    np.testing.assert_array_equal(both.mean_intensity(), alone.mean_intensity())
    assert both.class_pixels.sum() == 5 * alone.class_pixels.sum()


def test_unlabelled_pixels_are_counted_separately():
    class_id = np.full((4, 5), 255, np.uint8)
    class_id[0] = 2
    statistics = ImageStatistics()
    statistics.add(None, class_id)
    assert statistics.unlabelled_pixels == 15
    assert statistics.class_fractions().tolist() == [0, 0, 0.25, 0, 0, 0, 0, 0]
    assert statistics.mean_masks()[:, 1:].sum() == 0
    assert statistics.mean_intensity() is None


def test_measures_without_labels_are_nan_or_none():
    statistics = ImageStatistics()
    statistics.add(np.zeros((3, 3, 3), np.uint8), None)
    assert np.isnan(statistics.class_fractions()).all()
    assert np.isnan(statistics.hue_spectra()).all()
    assert statistics.mean_masks() is None
    assert statistics.mean_intensity().max() == 0


def test_many_images_neither_overflow_counters_nor_grow_memory():
    colour, class_id = np.full((30, 40, 3), 255, np.uint8), np.ones((30, 40), np.uint8)
    statistics = ImageStatistics()
    statistics.add(colour, class_id)
    tracemalloc.start()
    for _ in range(299):
        statistics.add(colour, class_id)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Two numbers per image are kept, not its 1,200 pixels.
    assert grown < 100_000
    np.testing.assert_array_equal(statistics.mean_masks()[1], 1.0)
    np.testing.assert_array_equal(statistics.mean_intensity(), 255.0)

"""Saturation, texture, gloss and power spectra of images whose statistics are known."""

from __future__ import annotations

import numpy as np
import pytest
from image_sets import MemorySet, image_set, uniform

from pepperscene.camera import decode_tone, encode_tone
from pepperscene.classes import OrganClass
from pepperscene.colour import compare, linear_srgb_to_lab
from pepperscene.colour.appearance import (
    circular_median,
    coherence,
    gloss_fraction,
    histogram_percentiles,
    patch_grid,
    principal_gradients,
    radial_power_spectrum,
    resize_labels,
    resize_linear,
    saturation,
    spectrum_slope,
    structure_tensors,
)
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.errors import InputError


def coloured_noise(exponent, size=512, seed=0):
    """An image whose power falls with this power of the frequency."""
    rng = np.random.default_rng(seed)
    radius = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij"))
    radius[0, 0] = np.inf
    spectrum = np.fft.fft2(rng.standard_normal((size, size))) * radius ** (exponent / 2.0)
    noise = np.fft.ifft2(spectrum).real
    return 1.0 + 0.1 * noise / noise.std()


def waves(across, down, angle_deg=0.0, size=256):
    """Two crossed waves of these amplitudes, wavelength 16 pixels."""
    y, x = np.mgrid[:size, :size]
    angle = np.radians(angle_deg)
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    return across * np.sin(2 * np.pi * u / 16) + down * np.sin(2 * np.pi * v / 16)


def mean_tensor(lightness):
    return structure_tensors(lightness)[16:-16, 16:-16].mean(axis=(0, 1))


def test_saturation_does_not_depend_on_the_exposure():
    leaf = np.array([0.05, 0.1, 0.02])
    values = saturation(linear_srgb_to_lab(leaf * np.array([0.5, 1.0, 4.0, 9.0])[:, None]))
    assert values == pytest.approx(values[0], rel=1e-9)
    lab = linear_srgb_to_lab(leaf)
    assert values[0] == pytest.approx(np.hypot(lab[1], lab[2]) / (lab[0] + 16.0))
    assert saturation(linear_srgb_to_lab([0.3, 0.3, 0.3])) == pytest.approx(0.0, abs=1e-3)


def test_circular_median_crosses_zero_and_ignores_outliers():
    angles = np.arange(360.0)
    weight = np.zeros(360)
    weight[[358, 0, 1]] = 1.0, 1.0, 1.0
    assert circular_median(angles, weight) == 0.0
    weight[90] = 0.9
    assert circular_median(angles, weight) in (0.0, 1.0)
    assert np.isnan(circular_median(angles, np.zeros(360)))


def test_percentiles_of_histograms():
    counts = np.array([np.ones(100), np.zeros(100)])
    np.testing.assert_allclose(histogram_percentiles(counts, 0.01, [10, 50, 90])[0], [0.1, 0.5, 0.9])
    assert np.isnan(histogram_percentiles(counts, 0.01, [50])[1]).all()


@pytest.mark.parametrize("angle_deg", [0.0, 100.0])
def test_gradient_ratio_is_that_of_the_amplitudes_in_any_direction(angle_deg):
    for across, along, tolerance in ((3.0, 2.0, 0.015), (1.0, 1.0, 0.03)):
        greater, lesser = principal_gradients(mean_tensor(waves(across, along, angle_deg)))
        assert np.sqrt(greater / lesser) == pytest.approx(across / along, abs=tolerance)
    # (9 - 4) / (9 + 4)
    assert coherence(mean_tensor(waves(3.0, 2.0, angle_deg))) == pytest.approx(5.0 / 13.0, abs=0.01)
    assert coherence(mean_tensor(waves(1.0, 0.0, angle_deg))) == pytest.approx(1.0, abs=1e-6)


def test_patches_are_inside_one_region():
    regions = np.zeros((70, 100), int)
    regions[:, :40], regions[:, 64:] = 1, 2
    corners = patch_grid(regions)
    assert corners.tolist() == [[0, 0], [0, 64], [32, 0], [32, 64]]
    assert patch_grid(np.ones((31, 99), int)).shape == (0, 2)


def test_gloss_is_brighter_and_less_saturated():
    luminance, saturations = np.full(100, 0.1), np.full(100, 0.6)
    luminance[:10], saturations[:5] = 0.3, 0.2
    assert gloss_fraction(luminance, saturations) == pytest.approx(0.05)
    saturations[:] = 0.6
    assert gloss_fraction(np.stack([luminance] * 2), np.stack([saturations] * 2)).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("exponent", [-1.0, -3.0])
def test_slope_of_the_power_spectrum_is_that_of_the_noise(exponent):
    slopes = [spectrum_slope(radial_power_spectrum(coloured_noise(exponent, seed=k))) for k in range(4)]
    assert np.mean(slopes) == pytest.approx(exponent, abs=0.08)


def test_power_is_that_of_white_noise_and_does_not_depend_on_the_exposure():
    rng = np.random.default_rng(2)
    image = 1.0 + 0.2 * rng.standard_normal((300, 400))
    # White noise of variance s2 has the power s2 at every frequency.
    assert radial_power_spectrum(image).mean() == pytest.approx(0.04, rel=0.03)
    np.testing.assert_allclose(radial_power_spectrum(7.0 * image), radial_power_spectrum(image))
    assert np.isnan(spectrum_slope(radial_power_spectrum(np.zeros((300, 400)))))
    assert np.isnan(spectrum_slope(radial_power_spectrum(image[:20, :20])))


def test_resizing_keeps_the_mean_light_and_the_labels():
    rng = np.random.default_rng(1)
    image = rng.uniform(0.2, 0.8, (90, 120, 3))
    small = resize_linear(image, 60)
    assert small.shape == (45, 60, 3)
    np.testing.assert_allclose(small.mean(axis=(0, 1)), image.mean(axis=(0, 1)), atol=0.003)
    labels = np.zeros((90, 120), np.uint8)
    labels[:, 60:] = 7
    assert resize_labels(labels, (45, 60)).tolist() == [[0] * 30 + [7] * 30] * 45


def leaf_picture(lightness_sd, size=(128, 640), seed=0):
    """A grey-green leaf with noise of several pixels, as 8-bit sRGB."""
    rng = np.random.default_rng(seed)
    linear = np.full((*size, 3), (0.1, 0.14, 0.06))
    return encode_tone((linear * np.exp(rng.normal(0.0, lightness_sd, (*size, 1)))).astype(np.float32))


def test_compare_measures_whole_images_and_classes():
    colour = leaf_picture(0.1)
    classes = np.full(colour.shape[:2], OrganClass.LEAF, np.uint8)
    classes[:, :64], colour[:, :64] = OrganClass.STEM, (255, 200, 0)
    appearance = compare(image_set((colour, classes)), image_set((colour, None))).appearance
    assert list(appearance) == ["image", "leaf", "stem"]
    stem, leaf = appearance["stem"].first, appearance["leaf"].first
    assert (stem.clipped_share.value, stem.blue_dark_share.value) == (1.0, 1.0)
    assert (leaf.clipped_share.value, leaf.blue_dark_share.value) == (0.0, 0.0)
    assert appearance["image"].first.clipped_share.value == pytest.approx(0.1)
    expected = saturation(linear_srgb_to_lab([0.1, 0.14, 0.06]))
    assert leaf.saturation[1].value == pytest.approx(expected, abs=0.02)
    assert stem.gradient_ratio.why == "no patch has a texture"
    assert leaf.spectrum_slope.why == "measured in whole images"
    assert appearance["leaf"].second.gloss_share.why == "no labels in memory (B)"
    assert appearance["image"].second == appearance["image"].first


def test_organs_are_instances_or_connected_areas():
    colour = np.full((64, 640, 3), 90, np.uint8)
    colour[:, 320:] = 160
    classes = np.full((64, 640), OrganClass.LEAF, np.uint8)
    instances = np.ones((64, 640), np.uint16)
    instances[:, 320:] = 2
    halves = (
        MemorySet(name="instances", items=(LabelledImage("a", colour, classes, instances),)),
        image_set((colour, classes), name="areas"),
    )
    leaf = compare(*halves, width_px=640).appearance["leaf"]
    # Each instance is uniform; the area that joins them is not.
    assert leaf.first.organ_lightness_sd.value == pytest.approx(0.0, abs=1e-9)
    grey = decode_tone(np.array([[90] * 3, [160] * 3], np.uint8))
    lightness = linear_srgb_to_lab(grey)
    assert leaf.second.organ_lightness_sd.value == pytest.approx(np.ptp(lightness[:, 0]) / 2, rel=1e-3)


def test_images_are_compared_at_one_scale():
    fine = leaf_picture(0.4, size=(192, 1280))
    coarse = encode_tone(resize_linear(decode_tone(fine), 640).astype(np.float32))
    sets = image_set((fine, None)), image_set((coarse, None))
    for options in ({"width_px": 640}, {"pixel_mm": (0.5, 1.0)}):
        pair = compare(*sets, **options).appearance["image"]
        for measure in ("patch_lightness_sd", "gradient_ratio", "spectrum_slope"):
            first, second = (getattr(side, measure).value for side in (pair.first, pair.second))
            assert first == pytest.approx(second, rel=0.02, abs=0.01)
    # At their own scales they differ.
    pair = compare(*sets, pixel_mm=(1.0, 1.0)).appearance["image"]
    assert pair.first.patch_lightness_sd.value > 1.3 * pair.second.patch_lightness_sd.value


def test_narrow_images_have_colours_and_no_texture():
    narrow = image_set(uniform((60, 90, 40)))
    image = compare(narrow, narrow).appearance["image"].first
    assert image.saturation[1].value is not None
    for measure in (image.patch_lightness_sd, image.gradient_ratio, image.gloss_share, image.spectrum_slope):
        assert (measure.value, measure.why) == (None, "no image is 580 pixels wide")
    for options in ({"width_px": 0}, {"pixel_mm": (1.0, 0.0)}, {"pixel_mm": (1.0, float("nan"))}):
        with pytest.raises(InputError, match="must be"):
            compare(narrow, narrow, **options)

"""Augmentations change images and labels together, make up no label, and are as strong as documented."""

from __future__ import annotations

import numpy as np
import pytest
from memory_set import SIZE, coded_arrays

from pepperscene.dataset.readers.torch_augment import Augmentation
from pepperscene.dataset.readers.torch_augment_steps import (
    ColourJitter,
    RandomBlur,
    RandomFlip,
    RandomJpeg,
    RandomNoise,
    RandomResizedCrop,
)
from pepperscene.errors import ArgumentError

PADDING = {"image": 0, "mask": 255, "instances": 0, "distance": np.inf, "depth_z": np.inf}
COLOUR_STEPS = (ColourJitter, RandomBlur, RandomNoise, RandomJpeg)
NONE = dict.fromkeys(("brightness", "contrast", "saturation", "hue", "gamma", "gains"), 0.0)
LUMA = np.array([0.299, 0.587, 0.114])


def generator(seed=0):
    return np.random.default_rng(seed)


def results(step, arrays, count=20):
    return [step.apply(arrays, generator(seed)) for seed in range(count)]


def origin(numbers, width):
    """Row and column in the original image of each pixel of a result."""
    return np.divmod(numbers.astype(int) - 1, width)


def noise_image(size=(64, 96), low=80, high=170):
    return generator(7).integers(low, high, (*size, 3)).astype(np.uint8)


# Geometry.


def test_flip_mirrors_image_and_labels_together():
    arrays = coded_arrays()
    for key, array in RandomFlip(probability=1.0).apply(arrays, generator()).items():
        np.testing.assert_array_equal(array, arrays[key][:, ::-1])
    flipped = [result["mask"][0, 0] != arrays["mask"][0, 0] for result in results(RandomFlip(), arrays, 200)]
    assert 70 <= sum(flipped) <= 130


@pytest.mark.parametrize("size", [(40, 60), (50, 30)])
def test_crop_without_scaling_copies_the_same_pixels_of_all_arrays(size):
    arrays = coded_arrays()
    corners = set()
    for result in results(RandomResizedCrop(size, scale=(1.0, 1.0)), arrays):
        inside = result["instances"] > 0
        rows, columns = origin(result["instances"][inside], SIZE[1])
        for key, array in arrays.items():
            assert result[key].shape[:2] == size
            assert result[key].dtype == array.dtype
            np.testing.assert_array_equal(result[key][inside], array[rows, columns])
            assert (result[key][~inside] == PADDING[key]).all()
        assert inside.sum() == min(size[0], SIZE[0]) * min(size[1], SIZE[1])
        place = np.argwhere(inside)[0] - (rows[0], columns[0])
        corners.add(tuple(place))
    assert (len(corners) == 1) == (size == SIZE)


@pytest.mark.parametrize("size", [(64, 48), (300, 420)])
def test_scaled_crop_moves_image_and_labels_together(size):
    arrays = coded_arrays(200, 240)
    for result in results(RandomResizedCrop(size), arrays):
        assert {array.shape[:2] for array in result.values()} == {size}
        inside = result["instances"] > 0
        rows, columns = origin(result["instances"][inside], 240)
        # Labels are those of one pixel, all of the same one.
        for key in ("mask", "instances", "distance"):
            np.testing.assert_array_equal(result[key][inside], arrays[key][rows, columns])
            assert (result[key][~inside] == PADDING[key]).all()
        # An interpolated pixel is less than a pixel of the result, or of the original, from its label.
        for channel, coordinate in enumerate((rows, columns)):
            distance = np.abs(result["image"][inside][:, channel].astype(int) - coordinate)
            assert distance.max() <= 2
            assert distance.mean() < 0.8
        assert (result["image"][~inside] == 0).all()


def test_scale_is_within_its_bounds_and_log_uniform():
    arrays = {"mask": np.zeros((100, 100), np.uint8)}
    step = RandomResizedCrop((400, 400), scale=(0.5, 2.0))
    sides = [np.sqrt((result["mask"] == 0).sum()) for result in results(step, arrays, 300)]
    assert 50 <= min(sides) < 53
    assert 192 < max(sides) <= 200
    assert np.mean(np.log2(np.array(sides) / 100)) == pytest.approx(0.0, abs=0.1)
    never = RandomResizedCrop((400, 400), probability=0.0)
    assert {int((result["mask"] == 0).sum()) for result in results(never, arrays)} == {100 * 100}


def test_resizing_makes_up_no_label():
    # Between 0 and 6 of alternate pixels, interpolation would give all classes.
    rows, columns = np.mgrid[:50, :50]
    labels = np.where((rows + columns) % 2 == 0, 0, 6).astype(np.uint8)
    arrays = {"mask": labels, "instances": labels.astype(np.uint16) * 10_000}
    for result in results(RandomResizedCrop((60, 60)), arrays):
        assert set(np.unique(result["mask"])) <= {0, 6, 255}
        assert set(np.unique(result["instances"])) <= {0, 60_000}
        inside = result["mask"] != 255
        np.testing.assert_array_equal(result["instances"][inside], result["mask"][inside] * np.uint16(10_000))


def test_images_of_one_pixel_can_be_scaled():
    for result in results(RandomResizedCrop((5, 3)), coded_arrays(1, 1)):
        assert result["image"].shape == (5, 3, 3)
        assert (result["instances"] == 1).any()


# Colour.


@pytest.mark.parametrize("step", [kind() for kind in COLOUR_STEPS], ids=lambda step: type(step).__name__)
def test_colour_steps_change_the_image_alone(step):
    arrays = {**coded_arrays(), "image": noise_image(SIZE)}
    copies = {key: array.copy() for key, array in arrays.items()}
    changed = 0
    for result in results(step, arrays):
        assert result["image"].shape == arrays["image"].shape
        assert result["image"].dtype == np.uint8
        changed += not np.array_equal(result["image"], arrays["image"])
        assert all(result[key] is arrays[key] for key in ("mask", "instances", "distance"))
    assert 0 < changed < 20
    for key, array in arrays.items():
        np.testing.assert_array_equal(array, copies[key])


@pytest.mark.parametrize(
    "step",
    [
        ColourJitter(**NONE, probability=1.0),
        RandomBlur(sigma_px=0.0, probability=1.0),
        RandomNoise(sigma=0.0, probability=1.0),
        *(kind(probability=0.0) for kind in COLOUR_STEPS),
        RandomFlip(probability=0.0),
        RandomResizedCrop(SIZE, scale=(1.0, 1.0)),
        Augmentation(()),
    ],
    ids=lambda step: type(step).__name__,
)
def test_strength_zero_is_the_identity(step):
    arrays = {**coded_arrays(), "image": noise_image(SIZE, 0, 256)}
    for result in results(step, arrays, 5):
        for key, array in arrays.items():
            np.testing.assert_array_equal(result[key], array)


def jittered(image, **strengths):
    step = ColourJitter(**{**NONE, **strengths}, probability=1.0)
    return [result["image"].astype(float) for result in results(step, {"image": image})]


def test_contrast_keeps_the_mean_grey():
    image = noise_image()
    deviations = [result.std() / image.std() for result in jittered(image, contrast=0.5)]
    assert min(deviations) < 0.7
    assert max(deviations) > 1.3
    for result in jittered(image, contrast=0.5):
        assert (result @ LUMA).mean() == pytest.approx((image @ LUMA).mean(), abs=1.0)


def test_saturation_keeps_the_grey_of_each_pixel():
    image = noise_image(low=110, high=140)
    for result in jittered(image, saturation=1.0):
        np.testing.assert_allclose(result @ LUMA, image @ LUMA, atol=1.01)


def test_hue_keeps_greys_and_the_sum_of_the_channels():
    image = noise_image(low=100, high=150)
    for result in jittered(image, hue=0.5):
        np.testing.assert_allclose(result.sum(-1), image.sum(-1), atol=3.01)
    grey = np.full((4, 4, 3), 120, np.uint8)
    assert all(np.array_equal(result, grey) for result in jittered(grey, hue=0.5))


def test_brightness_and_gains_multiply():
    grey = np.full((8, 8, 3), 100, np.uint8)
    factors = [result.mean() / 100 for result in jittered(grey, brightness=0.25)]
    assert 0.74 < min(factors) < 0.85
    assert 1.15 < max(factors) < 1.26
    for result in jittered(grey, gains=0.06):
        assert np.ptp(result.reshape(-1, 3), axis=0).max() == 0
        assert (np.abs(result[0, 0] - 100) <= 6).all()


def test_gamma_keeps_black_and_white():
    ends = np.zeros((2, 2, 3), np.uint8)
    ends[0] = 255
    assert all(np.array_equal(result, ends) for result in jittered(ends, gamma=1.0))
    greys = [result.mean() for result in jittered(np.full((2, 2, 3), 64, np.uint8), gamma=0.5)]
    lowest, highest = (255 * (64 / 255) ** np.exp(sign * 0.5) for sign in (1, -1))
    assert lowest - 0.6 <= min(greys) < 64 < max(greys) <= highest + 0.6


def test_noise_has_mean_zero_and_the_documented_deviation():
    image = np.full((100, 100, 3), 128, np.uint8)
    step = RandomNoise(sigma=8.0, probability=1.0)
    noises = [result["image"].astype(float) - 128 for result in results(step, {"image": image})]
    assert all(abs(noise.mean()) < 0.2 for noise in noises)
    deviations = [noise.std() for noise in noises]
    assert min(deviations) < 3
    assert 6 < max(deviations) < 8.3
    # Channels and neighbours are independent.
    loudest = noises[int(np.argmax(deviations))]
    assert abs(np.corrcoef(loudest[..., 0].ravel(), loudest[..., 1].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(loudest[:, 1:].ravel(), loudest[:, :-1].ravel())[0, 1]) < 0.05


def test_blur_and_jpeg_keep_the_mean():
    image = noise_image()
    for step in (RandomBlur(sigma_px=3.0, probability=1.0), RandomJpeg(probability=1.0)):
        for result in results(step, {"image": image}):
            assert result["image"].mean() == pytest.approx(image.mean(), abs=1.0)


def test_colour_steps_take_mirrored_images():
    arrays = {"image": noise_image()}
    steps = tuple(kind(probability=1.0) for kind in COLOUR_STEPS)
    result = Augmentation((RandomFlip(probability=1.0), *steps)).apply(arrays, generator())
    assert result["image"].shape == arrays["image"].shape


# Whole augmentations.


def test_a_step_moves_the_same_whatever_the_keys():
    arrays = coded_arrays()
    everything = Augmentation.standard((30, 50)).apply(arrays, generator(3))
    again = Augmentation.standard((30, 50)).apply(arrays, generator(3))
    np.testing.assert_array_equal(again["image"], everything["image"])
    for keys in (("mask",), ("image", "mask"), ("instances", "distance")):
        part = Augmentation.standard((30, 50)).apply({key: arrays[key] for key in keys}, generator(3))
        for key in keys:
            if key != "image":
                np.testing.assert_array_equal(part[key], everything[key])


def test_augmentation_of_a_sample_keeps_other_keys_and_the_sample():
    torch = pytest.importorskip("torch", reason="torch is an extra, which is not installed")
    arrays = coded_arrays()
    sample = {
        "name": "one", "image": torch.from_numpy(arrays["image"].transpose(2, 0, 1).copy()),
        "mask": torch.from_numpy(arrays["mask"].astype(np.int64)),
    }  # fmt: skip
    result = Augmentation((RandomFlip(probability=1.0),))(sample, generator())
    assert result["name"] == "one"
    assert torch.equal(result["image"], sample["image"].flip(-1))
    assert torch.equal(result["mask"], sample["mask"].flip(-1))
    assert result["mask"].dtype == torch.int64
    unchanged = Augmentation(())(sample)
    unchanged["image"].zero_()
    assert sample["image"].max() > 0
    with pytest.raises(ArgumentError, match="image: must be uint8 to be augmented: pass augmentation="):
        Augmentation(())({"image": torch.zeros(3, 4, 4)})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RandomFlip(probability=1.1), "probability: must be from 0 to 1, not 1.1"),
        (lambda: RandomResizedCrop(256), "size: must be height and width, integers above 0, not 256"),
        (lambda: RandomResizedCrop((0, 4)), "size: must be height and width"),
        (lambda: RandomResizedCrop((4, 4), scale=(2.0, 1.0)), "scale: must be the smallest and the largest"),
        (lambda: RandomResizedCrop((4, 4), scale=(0.0, 1.0)), "from .01 to 100"),
        (lambda: ColourJitter(hue=0.6), "hue: must be from 0 to 0.5, not 0.6"),
        (lambda: ColourJitter(brightness=-0.1), "brightness: must be from 0 to 1, not -0.1"),
        (lambda: RandomNoise(sigma=300), "sigma: must be from 0 to 255, not 300"),
        (
            lambda: RandomJpeg(quality=90),
            "quality: must be the lowest and the highest, integers from 1 to 100",
        ),
        (lambda: Augmentation(RandomFlip()), "steps: must be a sequence of augmentation steps"),
        (lambda: Augmentation((len,)), "steps: must be augmentation steps, such as RandomFlip"),
    ],
)
def test_invalid_arguments_are_one_sentence(make, message):
    with pytest.raises(ArgumentError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)

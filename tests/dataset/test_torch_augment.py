"""Augmentation moves images and labels together and makes up no labels."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from torch_stand_in import coded_images

from pepperscene.dataset import (
    Augmentation,
    ColourJitter,
    RandomBlur,
    RandomFlip,
    RandomJpeg,
    RandomNoise,
    RandomResizedCrop,
)
from pepperscene.errors import ArgumentError

HEIGHT, WIDTH = 40, 60


@pytest.fixture
def arrays():
    image = coded_images(1)[0]
    return {
        "image": image.colour,
        "mask": image.classes,
        "instances": image.instances,
        "distance": image.distance_m,
    }


def grey(value=(90, 120, 60), size=(64, 48)):
    return {"image": np.full((*size, 3), value, np.uint8)}


def coordinates(arrays):
    """Row and column of the original at each pixel, by the image and by the instances, and where both are."""
    image, instances = arrays["image"].astype(float), arrays["instances"].astype(int)
    inside = instances > 0
    by_image = (image[..., 0] - 1) / 2, (image[..., 1] - 1) / 2
    return by_image, ((instances - 1) // WIDTH, (instances - 1) % WIDTH), inside


def test_flip_moves_all_arrays(arrays):
    flipped = RandomFlip(probability=1.0).apply(arrays, np.random.default_rng(0))
    for key, array in arrays.items():
        np.testing.assert_array_equal(flipped[key], array[:, ::-1])
    assert RandomFlip(probability=0.0).apply(arrays, np.random.default_rng(0)) is arrays


@pytest.mark.parametrize("size", [(40, 60), (25, 30), (70, 100), (20, 90), (1, 1)])
@pytest.mark.parametrize("scale", [(0.5, 0.5), (2.0, 2.0), (1.0, 1.0), (0.5, 2.0)])
def test_resized_crop_keeps_image_and_labels_together(arrays, size, scale):
    crop = RandomResizedCrop(size, scale)
    for seed in range(12):
        result = crop.apply(arrays, np.random.default_rng(seed))
        assert {key: array.shape[:2] for key, array in result.items()} == dict.fromkeys(arrays, size)
        by_image, by_labels, inside = coordinates(result)
        assert inside.any()
        for value, expected, length in zip(by_image, by_labels, (HEIGHT, WIDTH), strict=True):
            # The image is interpolated between pixel centres, and labels are of the nearest: half a pixel,
            # plus half a code of rounding. Filters are cut off at the border, where the centre shifts.
            borders = (expected < 2) | (expected > length - 3)
            tolerance = np.where(borders, 1.3, 0.8)
            assert (np.abs(value - expected) <= tolerance)[inside].all()
        rows, columns = by_labels
        np.testing.assert_array_equal(result["mask"][inside], (columns[inside] // 8) % 8)
        np.testing.assert_array_equal(result["distance"][inside], (rows + columns)[inside])
        # Outside the original.
        assert (result["mask"][~inside] == 255).all()
        assert np.isinf(result["distance"][~inside]).all()
        assert (result["image"][~inside] == 0).all()


def test_scale_is_the_ratio_of_side_lengths(arrays):
    for scale, area in ((0.5, 20 * 30), (2.0, 80 * 120)):
        result = RandomResizedCrop((100, 130), (scale, scale)).apply(arrays, np.random.default_rng(0))
        assert (result["instances"] > 0).sum() == area
    sides = [
        np.sqrt((RandomResizedCrop((90, 130)).apply(arrays, np.random.default_rng(k))["instances"] > 0).sum())
        for k in range(200)
    ]
    ratios = np.array(sides) / np.sqrt(HEIGHT * WIDTH)
    assert ratios.min() < 0.55
    assert 1.8 < ratios.max() <= 2.0
    assert np.median(ratios) == pytest.approx(1.0, abs=0.15)


def test_crop_without_scaling_copies_pixels(arrays):
    crop = RandomResizedCrop((20, 30), probability=0.0)
    corners = set()
    for seed in range(30):
        result = crop.apply(arrays, np.random.default_rng(seed))
        row, column = divmod(int(result["instances"][0, 0]) - 1, WIDTH)
        corners.add((row, column))
        for key, array in arrays.items():
            np.testing.assert_array_equal(result[key], array[row : row + 20, column : column + 30])
    assert len(corners) > 20
    assert max(row for row, _ in corners) <= HEIGHT - 20


def test_resizing_makes_up_no_label(arrays):
    arrays = {**arrays, "mask": np.where(arrays["mask"] % 2, 2, 6).astype(np.uint8)}
    for seed in range(40):
        result = RandomResizedCrop((33, 47)).apply(arrays, np.random.default_rng(seed))
        assert set(np.unique(result["mask"])) <= {2, 6, 255}
        assert set(np.unique(result["instances"])) <= {0, *arrays["instances"].ravel().tolist()}


def test_jitter_changes_the_values_as_documented():
    off = {"brightness": 0, "contrast": 0, "saturation": 0, "hue": 0, "gamma": 0, "gains": 0}
    rng = np.random.default_rng

    def mean(seed=0, value=(90, 120, 60), **strengths):
        step = ColourJitter(**{**off, **strengths}, probability=1.0)
        return step.apply(grey(value), rng(seed))["image"].mean((0, 1))

    np.testing.assert_array_equal(mean(), (90, 120, 60))
    ratios = np.array([mean(seed, brightness=0.5) / (90, 120, 60) for seed in range(60)])
    assert np.ptp(ratios, axis=1).max() < 0.02
    assert 0.5 <= ratios.min() < 0.6
    assert 1.4 < ratios.max() <= 1.51
    # Contrast and saturation keep the mean grey; greys have neither saturation nor hue.
    for strength in ("contrast", "saturation"):
        luma = np.array([mean(seed, **{strength: 0.9}) @ (0.299, 0.587, 0.114) for seed in range(20)])
        assert np.abs(luma - luma.mean()).max() < 1.0
    for seed in range(10):
        np.testing.assert_allclose(mean(seed, (80, 80, 80), saturation=1.0, hue=0.5), 80, atol=1)
        assert mean(seed, hue=0.5).sum() == pytest.approx(270, abs=2)
    # Half a turn or less of red towards green and blue.
    assert np.ptp([mean(seed, (200, 20, 20), hue=0.3)[1] for seed in range(30)]) > 50
    exponents = [np.log(mean(seed, gamma=0.5)[0] / 255) / np.log(90 / 255) for seed in range(60)]
    assert np.exp(-0.5) - 0.02 < min(exponents) < 0.7
    assert 1.5 < max(exponents) < np.exp(0.5) + 0.02
    gains = np.array([mean(seed, gains=0.2) / (90, 120, 60) for seed in range(40)])
    assert np.abs(np.corrcoef(gains.T) - np.eye(3)).max() < 0.5
    assert 0.79 < gains.min() < gains.max() < 1.21


def test_contrast_is_about_the_mean_of_the_image():
    image = np.full((8, 8, 3), 50, np.uint8)
    image[4:] = 150
    step = ColourJitter(brightness=0, contrast=0.5, saturation=0, hue=0, gamma=0, gains=0, probability=1)
    for seed in range(10):
        result = step.apply({"image": image}, np.random.default_rng(seed))["image"].astype(float)
        assert result.mean() == pytest.approx(100, abs=1)
        assert 0.5 < (result[4:].mean() - result[:4].mean()) / 100 < 1.5


def test_noise_has_the_documented_distribution():
    arrays, sigmas = grey((128, 128, 128), (300, 300)), []
    for seed in range(30):
        result = RandomNoise(sigma=10, probability=1.0).apply(arrays, np.random.default_rng(seed))["image"]
        error = result.astype(float) - 128
        assert abs(error.mean()) < 0.15
        if error.std() > 1:
            assert abs(np.corrcoef(error[:, 1:].ravel(), error[:, :-1].ravel())[0, 1]) < 0.02
        sigmas.append(error.std())
    assert 0.0 <= min(sigmas) < 2.0
    assert 8.0 < max(sigmas) <= 10.2
    dark = RandomNoise(sigma=10, probability=1.0).apply(grey((0, 255, 3)), np.random.default_rng(1))["image"]
    assert dark[..., 0].mean() < 10  # no value wraps around
    assert dark[..., 1].mean() > 245


def test_blur_and_jpeg_change_details_alone():
    rng = np.random.default_rng(3)
    arrays = {
        "image": rng.integers(90, 160, (64, 64, 3)).astype(np.uint8),
        "mask": np.zeros((64, 64), np.uint8),
    }
    blurred = RandomBlur(sigma_px=4, probability=1.0).apply(arrays, np.random.default_rng(1))
    assert blurred["image"].std() < 0.7 * arrays["image"].std()
    assert blurred["image"].mean() == pytest.approx(arrays["image"].mean(), abs=1)
    errors = []
    for quality in (20, 95):
        step = RandomJpeg(quality=(quality, quality), probability=1.0)
        result = step.apply(arrays, rng)
        assert result["mask"] is arrays["mask"]
        errors.append(np.abs(result["image"].astype(int) - arrays["image"]).mean())
    assert errors[0] > errors[1] > 0


def test_steps_write_to_no_input_and_labels_alone_are_augmented(arrays):
    copies = {key: array.copy() for key, array in arrays.items()}
    for array in arrays.values():
        array.setflags(write=False)
    every = Augmentation.standard((30, 30))
    for seed in range(8):
        every.apply(arrays, np.random.default_rng(seed))
    for key, array in copies.items():
        np.testing.assert_array_equal(arrays[key], array)
    result = every.apply({"mask": arrays["mask"]}, np.random.default_rng(0))
    assert set(result) == {"mask"}
    assert result["mask"].shape == (30, 30)


def test_samples_of_tensors_keep_their_types_and_other_keys(arrays):
    torch = pytest.importorskip("torch")
    sample = {
        "name": "one",
        "image": torch.from_numpy(arrays["image"].transpose(2, 0, 1).copy()),
        "mask": torch.from_numpy(arrays["mask"].astype(np.int64)),
    }
    augmentation = Augmentation((RandomFlip(probability=1.0),))
    result = augmentation(sample, np.random.default_rng(0))
    assert result["name"] == "one"
    assert torch.equal(result["image"], sample["image"].flip(-1))
    assert torch.equal(result["mask"], sample["mask"].flip(-1))
    assert result["mask"].dtype == torch.int64
    standard = Augmentation.standard((24, 32))
    one, two = (standard(sample, np.random.default_rng(5)) for _ in range(2))
    assert torch.equal(one["image"], two["image"])
    assert one["image"].shape == (3, 24, 32)
    # Without a generator, torch's decides.
    results = []
    for seed in (1, 1, 2):
        torch.manual_seed(seed)
        results.append(standard(sample)["image"])
    assert torch.equal(results[0], results[1])
    assert not torch.equal(results[0], results[2])
    # Nothing shares memory with the sample.
    kept = Augmentation(())(sample)
    kept["mask"].zero_()
    assert sample["mask"].any()
    with pytest.raises(ArgumentError, match="image: must be uint8 to be augmented: pass augmentation="):
        augmentation({"image": torch.zeros(3, 4, 4)})


def test_augmentations_are_values():
    one = Augmentation.standard((30, 40))
    assert one == Augmentation.standard((30, 40))
    assert pickle.loads(pickle.dumps(one)) == one
    assert Augmentation([RandomFlip()]).steps == (RandomFlip(),)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RandomFlip(probability=1.5), "probability: must be from 0 to 1, not 1.5"),
        (lambda: RandomResizedCrop((0, 4)), "size: must be height and width, integers above 0"),
        (lambda: RandomResizedCrop((4, 4), (2.0, 1.0)), "scale: must be the smallest and the largest"),
        (lambda: ColourJitter(hue=0.7), "hue: must be from 0 to 0.5, not 0.7"),
        (lambda: ColourJitter(gains=float("nan")), "gains: must be from 0 to 1, not nan"),
        (lambda: RandomBlur(sigma_px=-1), "sigma_px: must be from 0 to 100"),
        (lambda: RandomNoise(sigma=300), "sigma: must be from 0 to 255"),
        (lambda: RandomJpeg(quality=(0, 50)), "quality: must be the lowest and the highest"),
        (lambda: Augmentation((lambda x: x,)), r"steps: must be augmentation steps, such as RandomFlip\(\)"),
    ],
)
def test_invalid_values_give_one_sentence(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()

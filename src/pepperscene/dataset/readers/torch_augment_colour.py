"""Steps of an augmentation that change the values of images, in sRGB; labels stay as they are."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from statistics import NormalDist
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.readers.torch_augment_step import (
    Arrays,
    AugmentationStep,
    check_probability,
    check_strength,
    is_range,
)
from pepperscene.errors import ArgumentError

_LUMA: Final = np.array([0.299, 0.587, 0.114])
"""Weights of encoded red, green and blue in grey: Rec. ITU-R BT.601, as of Pillow and torchvision."""


@dataclass(frozen=True, kw_only=True)
class _ImageStep(AugmentationStep):
    """A step that changes the image alone, with a probability."""

    probability: float = 1.0

    def __post_init__(self) -> None:
        check_probability(self.probability)

    def apply(self, arrays: Arrays, rng: np.random.Generator) -> Arrays:
        """The arrays with the changed image, or the same ones."""
        if rng.random() >= self.probability or "image" not in arrays:
            return arrays
        return {**arrays, "image": self.change(np.ascontiguousarray(arrays["image"]), rng)}

    @abstractmethod
    def change(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """The changed image `(h, w, 3)`; `image` is contiguous and is not written to."""


@final
@dataclass(frozen=True, kw_only=True)
class ColourJitter(_ImageStep):
    """Changes brightness, contrast, saturation, hue, gamma and the three channels, all by random amounts.

    Attributes:
        brightness: factors are uniform from 1 - brightness to 1 + brightness.
        contrast: the same for differences from the mean grey of the image.
        saturation: the same for differences from the grey of each pixel.
        hue: largest rotation about the grey axis of RGB, in turns.
        gamma: the exponent is from exp(-gamma) to exp(gamma), log-uniform.
        gains: the same as brightness for each channel alone, as by another white balance.
        probability: of any change.

    Raises:
        ArgumentError: a value is out of range: hue .5, all others 1.
    """

    brightness: float = 0.25
    contrast: float = 0.25
    saturation: float = 0.25
    hue: float = 0.02
    gamma: float = 0.2
    gains: float = 0.06
    probability: float = 0.8

    def __post_init__(self) -> None:
        check_probability(self.probability)
        check_strength("hue", self.hue, 0.5)
        for name in ("brightness", "contrast", "saturation", "gamma", "gains"):
            check_strength(name, getattr(self, name), 1.0)

    def change(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """One matrix and one table for all changes together."""
        from PIL import Image

        uniform = rng.uniform(-1.0, 1.0, 8)
        brightness, contrast, saturation = 1.0 + uniform[:3] * (
            self.brightness,
            self.contrast,
            self.saturation,
        )
        gains = brightness * (1.0 + self.gains * uniform[5:])
        colour = _rotation(2.0 * np.pi * self.hue * uniform[3])
        colour = colour @ (saturation * np.eye(3) + (1.0 - saturation) * np.outer(np.ones(3), _LUMA))
        matrix = gains[:, None] * colour
        # Every fourth pixel is enough for a mean.
        mean_grey = float(_LUMA @ matrix @ image[::4, ::4].reshape(-1, 3).mean(0)) if contrast != 1.0 else 0.0
        rows = np.column_stack([contrast * matrix, np.full(3, (1.0 - contrast) * mean_grey)])
        picture = Image.fromarray(image).convert("RGB", tuple(rows.ravel().tolist()))
        if self.gamma > 0:
            picture = picture.point(_gamma_table(float(np.exp(self.gamma * uniform[4]))) * 3)
        return np.array(picture)


def _rotation(angle: float) -> NDArray[np.float64]:
    """Rotation about the axis of greys (Rodrigues' formula)."""
    cos, sin = np.cos(angle), np.sin(angle) / np.sqrt(3.0)
    cross = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
    return cos * np.eye(3) + sin * cross + (1.0 - cos) / 3.0


def _gamma_table(exponent: float) -> list[int]:
    return np.rint(255.0 * (np.arange(256) / 255.0) ** exponent).astype(int).tolist()


@final
@dataclass(frozen=True, kw_only=True)
class RandomBlur(_ImageStep):
    """Blurs the image.

    Attributes:
        sigma_px: largest standard deviation of the Gaussian filter, in pixels; uniform from 0.
        probability: of any blur.
    """

    sigma_px: float = 1.5
    probability: float = 0.3

    def __post_init__(self) -> None:
        check_probability(self.probability)
        check_strength("sigma_px", self.sigma_px, 100.0)

    def change(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """The blurred image."""
        from PIL import Image, ImageFilter

        blur = ImageFilter.GaussianBlur(float(rng.uniform(0.0, self.sigma_px)))
        return np.array(Image.fromarray(image).filter(blur))


@final
@dataclass(frozen=True, kw_only=True)
class RandomNoise(_ImageStep):
    """Adds Gaussian noise, independent in each pixel and channel.

    Attributes:
        sigma: largest standard deviation, in 8-bit codes; uniform from 0.
        probability: of any noise.
    """

    sigma: float = 8.0
    probability: float = 0.5

    def __post_init__(self) -> None:
        check_probability(self.probability)
        check_strength("sigma", self.sigma, 255.0)

    def change(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """The noisy image."""
        sigma = rng.uniform(0.0, self.sigma)
        # Random bytes choose from 256 quantiles, a tenth of the time of normal numbers.
        noise = np.rint(sigma * _normal_quantiles()).astype(np.int16)
        choice = np.frombuffer(rng.bytes(image.size), np.uint8).reshape(image.shape)
        noisy = np.take(noise, choice)
        noisy += image
        return np.clip(noisy, 0, 255, out=noisy).astype(np.uint8)


@cache
def _normal_quantiles() -> NDArray[np.float64]:
    """256 values of equal probability, with mean 0 and standard deviation 1."""
    distribution = NormalDist()
    values = np.array([distribution.inv_cdf((k + 0.5) / 256) for k in range(256)])
    return values / values.std()


@final
@dataclass(frozen=True, kw_only=True)
class RandomJpeg(_ImageStep):
    """Compresses the image as JPEG does.

    Attributes:
        quality: lowest and highest quality of Pillow, uniform.
        probability: of any compression.
    """

    quality: tuple[int, int] = (40, 95)
    probability: float = 0.3

    def __post_init__(self) -> None:
        check_probability(self.probability)
        if not is_range(self.quality, 1, 100, of_integers=True):
            problem = f"must be the lowest and the highest, integers from 1 to 100, not {self.quality!r}"
            raise ArgumentError("quality", problem)

    def change(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """The image as it is after writing and reading a JPEG."""
        from PIL import Image

        low, high = self.quality
        file: Any = BytesIO()
        Image.fromarray(image).save(file, "JPEG", quality=int(rng.integers(low, high + 1)))
        with Image.open(file, formats=["JPEG"]) as picture:
            return np.array(picture)

"""Steps of an augmentation: random changes of images, or of images together with their labels."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from statistics import NormalDist
from typing import Any, ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.readers.image_set import LABELLED_OUTPUTS
from pepperscene.errors import ArgumentError
from pepperscene.outputs import OUTPUTS

Arrays = Mapping[str, NDArray[Any]]
"""Arrays of one sample by key: `image` (h, w, 3) uint8 in sRGB; `mask`, `instances` and the others of
`ARRAY_KEYS`, each (h, w). All have the same height and width; any of them may be missing."""

Strengths = Mapping[str, float]
"""Largest value that is allowed for each attribute of these names."""

_KEYS: Final = {"colour": "image", "class": "mask", "instance": "instances"}
SAMPLE_KEYS: Final = {name: _KEYS.get(name, name) for name in LABELLED_OUTPUTS}
"""Key of each output in a sample, mostly its name."""
ARRAY_KEYS: Final = tuple(SAMPLE_KEYS.values())

_PADDING: Final = {key: OUTPUTS[name].padding for name, key in SAMPLE_KEYS.items()}
"""Value of pixels outside the original image: black, void, no organ, nothing, a hole, no tissue."""

_LUMA: Final = np.array([0.299, 0.587, 0.114])
"""Weights of encoded red, green and blue in grey: Rec. ITU-R BT.601, as of Pillow and torchvision."""


class AugmentationStep(ABC):
    """One random change of a sample. Steps are frozen: all random numbers come from the generator."""

    @abstractmethod
    def apply(self, arrays: Arrays, rng: np.random.Generator) -> Arrays:
        """The changed arrays; those that the step does not change are returned as they are.

        Args:
            arrays: of one sample; they are not written to.
            rng: source of all random numbers.
        """


def _check_probability(probability: float) -> None:
    """Raise `ArgumentError` unless a probability is from 0 to 1."""
    if not _is_number(probability) or not 0.0 <= probability <= 1.0:
        raise ArgumentError("probability", f"must be from 0 to 1, not {probability!r}")


def _check_strength(name: str, value: float, largest: float) -> None:
    """Raise `ArgumentError` unless the strength of this name is from 0 to the largest allowed."""
    if not _is_number(value) or not 0.0 <= value <= largest:
        raise ArgumentError(name, f"must be from 0 to {largest:g}, not {value!r}")


def _is_range(pair: Any, smallest: float, largest: float, *, of_integers: bool = False) -> bool:
    """Whether a value is two ascending numbers from `smallest` to `largest`."""
    if not isinstance(pair, Sequence) or len(pair) != 2 or not all(map(_is_number, pair)):
        return False
    is_integer = all(isinstance(number, int | np.integer) for number in pair)
    return (is_integer or not of_integers) and bool(smallest <= pair[0] <= pair[1] <= largest)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating)


@final
@dataclass(frozen=True, kw_only=True)
class RandomFlip(AugmentationStep):
    """Exchanges left and right.

    Attributes:
        probability: of a flip.
    """

    probability: float = 0.5

    def __post_init__(self) -> None:
        _check_probability(self.probability)

    def apply(self, arrays: Arrays, rng: np.random.Generator) -> Arrays:
        """The mirrored arrays, or the same ones."""
        if rng.random() >= self.probability:
            return arrays
        return {key: array[:, ::-1] for key, array in arrays.items()}


@final
@dataclass(frozen=True)
class RandomResizedCrop(AugmentationStep):
    """Scales a sample, and crops or pads it to a fixed size at a random position.

    Images are interpolated (bilinear, with a filter as wide as the pixels of the result); labels take the
    nearest pixel, so that no label is made up. Pixels outside the image are black, void (255), without organ
    and infinitely far. Distances keep their values in metres.

    Attributes:
        size: height and width of the result, in pixels.
        scale: smallest and largest side length of the image relative to the original, log-uniform.
        probability: of a scale other than 1; the result always has the same size.
    """

    size: tuple[int, int]
    scale: tuple[float, float] = (0.5, 2.0)
    probability: float = 1.0

    def __post_init__(self) -> None:
        _check_probability(self.probability)
        if not _is_size(self.size):
            problem = f"must be height and width, integers above 0, not {self.size!r}"
            raise ArgumentError("size", problem)
        if not _is_range(self.scale, 0.01, 100):
            problem = f"must be the smallest and the largest, from .01 to 100, not {self.scale!r}"
            raise ArgumentError("scale", problem)

    def apply(self, arrays: Arrays, rng: np.random.Generator) -> Arrays:
        """The arrays `(height, width, ...)` of the fixed size."""
        is_scaled, exponent = rng.random() < self.probability, rng.random()
        smallest, largest = self.scale
        scale = smallest * (largest / smallest) ** exponent if is_scaled else 1.0
        height, width = next(iter(arrays.values())).shape[:2]
        rows = _Span.random(height, self.size[0], scale, rng.random())
        columns = _Span.random(width, self.size[1], scale, rng.random())
        return {key: self._resample(key, array, rows, columns) for key, array in arrays.items()}

    def _resample(self, key: str, array: NDArray[Any], rows: _Span, columns: _Span) -> NDArray[Any]:
        if rows.is_copy and columns.is_copy:
            part = array[int(rows.low) : int(rows.high), int(columns.low) : int(columns.high)]
        elif key == "image":
            part = _interpolate(array, rows, columns)
        else:
            # Two steps are five times as fast as indexing rows and columns together.
            part = np.take(np.take(array, rows.nearest(), axis=0), columns.nearest(), axis=1)
        if part.shape[:2] == tuple(self.size):
            return part
        result = np.full((*self.size, *array.shape[2:]), _PADDING[key], array.dtype)
        result[rows.start : rows.start + rows.count, columns.start : columns.start + columns.count] = part
        return result


def _is_size(size: Any) -> bool:
    if not isinstance(size, Sequence) or len(size) != 2:
        return False
    return all(isinstance(length, int | np.integer) and length > 0 for length in size)


@dataclass(frozen=True)
class _Span:
    """Pixels of a result along one axis, and the interval of the original that they show."""

    start: int  # first pixel of the result
    count: int  # of pixels of the result
    low: float  # in the original, where pixel k reaches from k to k + 1
    high: float

    @classmethod
    def random(cls, original: int, size: int, scale: float, position: float) -> _Span:
        """Place a result of `size` pixels; `position` is uniform from 0 to 1."""
        scaled = max(1, round(original * scale))
        if scaled <= size:
            return cls(int(position * (size - scaled + 1)), scaled, 0.0, float(original))
        window = size * original / scaled
        # Whole pixels without scaling, so that they are copied.
        low = (
            float(int(position * (original - size + 1)))
            if scaled == original
            else position * (original - window)
        )
        return cls(0, size, low, min(low + window, float(original)))

    @property
    def is_copy(self) -> bool:
        """Whether each pixel of the result is one of the original."""
        return self.low.is_integer() and self.high - self.low == self.count

    def nearest(self) -> NDArray[np.intp]:
        """The pixel of the original at the centre of each pixel of the result."""
        step = (self.high - self.low) / self.count
        return (self.low + (np.arange(self.count) + 0.5) * step).astype(np.intp)


def _interpolate(image: NDArray[np.uint8], rows: _Span, columns: _Span) -> NDArray[np.uint8]:
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(image))
    box = (columns.low, rows.low, columns.high, rows.high)
    return np.array(picture.resize((columns.count, rows.count), Image.Resampling.BILINEAR, box=box))


@dataclass(frozen=True, kw_only=True)
class _ImageStep(AugmentationStep):
    """A step that changes the image alone, with a probability; its strengths have largest values."""

    probability: float = 1.0
    _largest: ClassVar[Strengths] = {}

    def __post_init__(self) -> None:
        _check_probability(self.probability)
        for name, largest in self._largest.items():
            _check_strength(name, getattr(self, name), largest)

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
    _largest: ClassVar[Strengths] = {
        "hue": 0.5,
        **dict.fromkeys(("brightness", "contrast", "saturation", "gamma", "gains"), 1.0),
    }

    def change(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """One matrix and one table for all changes together."""
        from PIL import Image

        uniform = rng.uniform(-1.0, 1.0, 8)
        strengths = (self.brightness, self.contrast, self.saturation)
        brightness, contrast, saturation = 1.0 + uniform[:3] * strengths
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
    _largest: ClassVar[Strengths] = {"sigma_px": 100.0}

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
    _largest: ClassVar[Strengths] = {"sigma": 255.0}

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
        _check_probability(self.probability)
        if not _is_range(self.quality, 1, 100, of_integers=True):
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

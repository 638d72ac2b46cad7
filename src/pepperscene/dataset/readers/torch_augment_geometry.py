"""Steps of an augmentation that move pixels: the same for images and labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.readers.torch_augment_step import (
    SAMPLE_KEYS,
    Arrays,
    AugmentationStep,
    check_probability,
    is_range,
)
from pepperscene.errors import ArgumentError
from pepperscene.outputs import OUTPUTS

_PADDING: Final = {key: OUTPUTS[name].padding for name, key in SAMPLE_KEYS.items()}
"""Value of pixels outside the original image: black, void, no organ, nothing, a hole, no tissue."""


@final
@dataclass(frozen=True, kw_only=True)
class RandomFlip(AugmentationStep):
    """Exchanges left and right.

    Attributes:
        probability: of a flip.
    """

    probability: float = 0.5

    def __post_init__(self) -> None:
        check_probability(self.probability)

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
        check_probability(self.probability)
        if not _is_size(self.size):
            problem = f"must be height and width, integers above 0, not {self.size!r}"
            raise ArgumentError("size", problem)
        if not is_range(self.scale, 0.01, 100):
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
        part = _interpolate(array, rows, columns) if key == "image" else _nearest(array, rows, columns)
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


def _nearest(array: NDArray[Any], rows: _Span, columns: _Span) -> NDArray[Any]:
    if rows.is_copy and columns.is_copy:
        return array[int(rows.low) : int(rows.high), int(columns.low) : int(columns.high)]
    # Two steps are five times as fast as indexing rows and columns together.
    return np.take(np.take(array, rows.nearest(), axis=0), columns.nearest(), axis=1)


def _interpolate(image: NDArray[np.uint8], rows: _Span, columns: _Span) -> NDArray[np.uint8]:
    if rows.is_copy and columns.is_copy:
        return image[int(rows.low) : int(rows.high), int(columns.low) : int(columns.high)]
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(image))
    box = (columns.low, rows.low, columns.high, rows.high)
    return np.array(picture.resize((columns.count, rows.count), Image.Resampling.BILINEAR, box=box))

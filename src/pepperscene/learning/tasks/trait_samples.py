"""Organs as samples of a trait: mean reflectance of each one's pixels in each band, and the mean trait."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SMALLEST_PX: Final = 50
"""Least pixels of an organ. Chosen: at fewer, its rim, where pixels show what is behind it, is half of it."""


@dataclass(frozen=True, eq=False)
class OrganSamples:
    """Visible organs of frames.

    Attributes:
        reflectance: `(n, c)` mean of its pixels in each band, 0 to 1.
        trait: `(n,)` mean of its pixels, in the trait's unit.
        frame: `(n,)` index of the frame.
        instance: `(n,)` number of the organ in the frame.
        pixels: `(n,)` number of its pixels.
    """

    reflectance: FloatArray
    trait: FloatArray
    frame: NDArray[np.int64]
    instance: NDArray[np.int64]
    pixels: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.trait)


def organ_samples(
    frame: int,
    reflectance: NDArray[Any],
    trait: NDArray[Any],
    instances: NDArray[np.integer[Any]],
    counted: NDArray[np.bool_],
    smallest_px: int = SMALLEST_PX,
) -> OrganSamples:
    """The organs of one frame.

    Args:
        frame: its index.
        reflectance: `(h, w, c)`; pixels where a band is not finite do not count.
        trait: `(h, w)`; pixels where it is not finite do not count.
        instances: `(h, w)` number of the organ at each pixel, 0 for none.
        counted: `(h, w)` pixels of the class of organs that has the trait.
        smallest_px: least pixels of an organ.
    """
    used = counted & (instances > 0) & np.isfinite(trait) & np.isfinite(reflectance).all(axis=-1)
    numbers, place, pixels = np.unique(instances[used], return_inverse=True, return_counts=True)
    bands = reflectance[used].astype(np.float64)
    sums = [
        np.bincount(place, weights=bands[:, band], minlength=len(numbers)) for band in range(bands.shape[1])
    ]
    kept = pixels >= smallest_px
    return OrganSamples(
        (np.stack(sums, axis=-1) / np.maximum(pixels, 1)[:, None])[kept],
        organ_means(trait, instances, used)[1][kept],
        np.full(int(kept.sum()), frame, np.int64),
        numbers[kept].astype(np.int64),
        pixels[kept].astype(np.int64),
    )


def organ_means(
    values: NDArray[Any], instances: NDArray[np.integer[Any]], used: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], FloatArray]:
    """Numbers `(n,)` of the organs of some pixels, ascending, and the mean `(n,)` of a map over each."""
    numbers, place, pixels = np.unique(instances[used], return_inverse=True, return_counts=True)
    sums = np.bincount(place, weights=values[used].astype(np.float64), minlength=len(numbers))
    return numbers.astype(np.int64), sums / np.maximum(pixels, 1)


def join_samples(parts: Sequence[OrganSamples]) -> OrganSamples:
    """The organs of several frames; at least one."""
    names = ("reflectance", "trait", "frame", "instance", "pixels")
    return OrganSamples(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

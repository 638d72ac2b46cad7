"""Labels and distances as colours that a person can read; for looking at, never for measuring."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

VIRIDIS: Final = (
    "#440154", "#472D7B", "#3B528B", "#2C728E", "#21908C", "#27AD81", "#5DC863", "#AADC32", "#FDE725",
)  # fmt: skip
"""Nine even steps of viridis (S. van der Walt and N. Smith 2015, CC0), as R's viridisLite prints them."""

_NOTHING: Final = (13, 15, 20)  # chosen: nearly black, apart from viridis' dark violet
_GOLDEN: Final = 0.6180339887498949


@dataclass(frozen=True, eq=False)
class View:
    """One frame as it is shown.

    Attributes:
        index: of the frame.
        facts: its JSON.
        pictures: `(h, w, 3)` uint8 by output name, in the order shown.
    """

    index: int
    facts: dict[str, Any]
    pictures: dict[str, NDArray[np.uint8]]


def distance_colours(distance_m: NDArray[np.floating[Any]], near_m: float, far_m: float) -> NDArray[np.uint8]:
    """Distances `(h, w)` as colours `(h, w, 3)`: near is yellow, far dark violet, nothing almost black."""
    found = np.isfinite(distance_m)
    depth = np.where(found, distance_m, far_m)
    place = np.clip((far_m - depth) / max(far_m - near_m, 1e-9), 0.0, 1.0) * (len(VIRIDIS) - 1)
    steps = np.array([[int(code[k : k + 2], 16) for k in (1, 3, 5)] for code in VIRIDIS], dtype=float)
    below = np.minimum(place.astype(int), len(VIRIDIS) - 2)
    share = (place - below)[..., None]
    rgb = np.rint((1.0 - share) * steps[below] + share * steps[below + 1]).astype(np.uint8)
    rgb[~found] = _NOTHING
    return rgb


def instance_colours(instance: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """Instance numbers `(h, w)` as colours `(h, w, 3)`: neighbouring numbers get hues far apart."""
    numbers, place = np.unique(instance, return_inverse=True)
    palette = np.array([_hue(int(number)) for number in numbers], dtype=np.uint8)
    return palette[place.reshape(instance.shape)]


def _hue(number: int) -> tuple[int, int, int]:
    """Hues by the golden ratio, never close to the last few; two lightnesses and two saturations."""
    if number == 0:
        return _NOTHING
    value = 1.0 if number % 2 else 0.78
    saturation = 0.62 if number // 2 % 2 else 0.85
    red, green, blue = colorsys.hsv_to_rgb(number * _GOLDEN % 1.0, saturation, value)
    return round(255 * red), round(255 * green), round(255 * blue)

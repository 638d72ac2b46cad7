"""Photographs that cannot be right: black, hardly lit, burnt out, of one value."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_BLACK: Final = 2
"""Chosen: no grey value of a picture is above this, which no noise of a sensor leaves."""
_DARK: Final = 25
"""Grey value that 99 of 100 values of a picture reach at most. Of the paper's camera with the lens cap on it
is 21; a hundredth of the paper's light makes 22 to 25, a thirtieth 29 to 45."""
_BURNT: Final = 0.5
"""Chosen: more than half of a picture is burnt out; where the recipe expects less, that counts."""


@dataclass(frozen=True)
class Tone:
    """How bright a photograph is.

    Attributes:
        mean: of all its grey values, 0 to 255.
        saturated: share of pixels with a channel at 255.
    """

    mean: float
    saturated: float


def tone(picture: NDArray[np.uint8]) -> Tone:
    """How bright an `(h, w, 3)` photograph is."""
    full = picture[..., 0] == 255
    for channel in range(1, picture.shape[2]):
        full |= picture[..., channel] == 255
    return Tone(float(picture.mean()), float(np.count_nonzero(full) / full.size))


def picture_faults(picture: NDArray[np.uint8]) -> Iterator[tuple[str, str]]:
    """Kind and description of what is wrong with an `(h, w, 3)` photograph; at most one fault."""
    values = np.bincount(picture.ravel(), minlength=256)
    there = np.flatnonzero(values)
    if there[-1] <= _BLACK:
        yield "black", f"no grey value is above {there[-1]}"
    elif len(there) == 1:
        yield "constant", f"every grey value is {there[0]}"
    elif (usual := int(np.searchsorted(values.cumsum(), 0.99 * picture.size))) <= _DARK:
        yield "dark", f"99 % of its grey values are at most {usual} of 255"
    elif (share := tone(picture).saturated) > _BURNT:
        yield "saturated", f"{share:.0%} of its pixels have a channel at 255"


def flat(image: Any) -> bool:
    """Whether an image has one value only."""
    return isinstance(image, np.ndarray) and bool((image == image.flat[0]).all())

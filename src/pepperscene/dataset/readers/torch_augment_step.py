"""The interface of one random change of an image together with its labels."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.readers.image_set import LABELLED_OUTPUTS
from pepperscene.errors import ArgumentError

Arrays = Mapping[str, NDArray[Any]]
"""Arrays of one sample by key: `image` (h, w, 3) uint8 in sRGB; `mask`, `instances`, `distance`, `depth_z`,
`depth_sensor`, and the traits of tissue, `chlorophyll`, `carotenoids`, `water`, `ripeness` and `leaf_age`,
each (h, w). All have the same height and width; any of them may be missing."""

_KEYS: Final = {"colour": "image", "class": "mask", "instance": "instances"}
SAMPLE_KEYS: Final = {name: _KEYS.get(name, name) for name in LABELLED_OUTPUTS}
"""Key of each output in a sample, mostly its name."""
ARRAY_KEYS: Final = tuple(SAMPLE_KEYS.values())


class AugmentationStep(ABC):
    """One random change of a sample. Steps are frozen: all random numbers come from the generator."""

    @abstractmethod
    def apply(self, arrays: Arrays, rng: np.random.Generator) -> Arrays:
        """The changed arrays; those that the step does not change are returned as they are.

        Args:
            arrays: of one sample; they are not written to.
            rng: source of all random numbers.
        """


def check_probability(probability: float) -> None:
    """Raise `ArgumentError` unless a probability is from 0 to 1."""
    if not _is_number(probability) or not 0.0 <= probability <= 1.0:
        raise ArgumentError("probability", f"must be from 0 to 1, not {probability!r}")


def check_strength(name: str, value: float, largest: float) -> None:
    """Raise `ArgumentError` unless the strength of this name is from 0 to the largest allowed."""
    if not _is_number(value) or not 0.0 <= value <= largest:
        raise ArgumentError(name, f"must be from 0 to {largest:g}, not {value!r}")


def is_range(pair: Any, smallest: float, largest: float, *, of_integers: bool = False) -> bool:
    """Whether a value is two ascending numbers from `smallest` to `largest`."""
    if not isinstance(pair, Sequence) or len(pair) != 2 or not all(map(_is_number, pair)):
        return False
    is_integer = all(isinstance(number, int | np.integer) for number in pair)
    return (is_integer or not of_integers) and bool(smallest <= pair[0] <= pair[1] <= largest)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating)

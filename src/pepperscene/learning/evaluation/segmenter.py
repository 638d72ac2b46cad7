"""What evaluation and prediction need of a trained model."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.learning.class_table import ClassTable


class Segmenter(Protocol):
    """A model that gives each pixel of an image the probabilities of its classes."""

    @property
    def classes(self) -> ClassTable:
        """Its classes, in the order of the probabilities."""

    def probabilities(self, colour: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Probabilities `(k, h, w)` of the classes, from an sRGB image `(h, w, 3)`."""


def predict_classes(
    model: Segmenter, colour: NDArray[np.uint8], merging: NDArray[np.float32] | None = None
) -> NDArray[np.uint8]:
    """The most probable class of each pixel; of equal ones, the first.

    Args:
        model: the model.
        colour: sRGB `(h, w, 3)`.
        merging: matrix `(n, k)` that adds probabilities of the model's k classes (`ClassTable.merging`); a
            class of the model without a row is left out. None for the model's own classes.

    Returns:
        `(h, w)` indices of the merged classes.

    Raises:
        InputError: the model's probabilities have another shape, or are not finite.
    """
    probabilities = model.probabilities(colour)
    expected = (len(model.classes), *colour.shape[:2])
    if probabilities.shape != expected:
        raise InputError("model", f"gives probabilities of the shape {probabilities.shape}, not {expected}")
    if not np.isfinite(probabilities).all():
        raise InputError("model", "gives probabilities that are not finite numbers")
    if merging is not None:
        probabilities = np.tensordot(merging, probabilities, axes=1)
    return probabilities.argmax(axis=0).astype(np.uint8)

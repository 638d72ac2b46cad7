"""What evaluation and prediction need of a trained model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.models.trained_model import TrainedModel


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

    A trained network is applied to an image above 12.5 million pixels in tiles of 2048 x 2048, each with 640
    pixels around it, which is farther than the networks of this package see.

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
    classes = np.empty(colour.shape[:2], np.uint8)
    for (rows, columns), probabilities in _probability_parts(model, colour):
        expected = (len(model.classes), *classes[rows, columns].shape)
        if probabilities.shape != expected:
            problem = f"gives probabilities of the shape {probabilities.shape}, not {expected}"
            raise InputError("model", problem)
        if not np.isfinite(probabilities).all():
            raise InputError("model", "gives probabilities that are not finite numbers")
        if merging is not None:
            probabilities = np.tensordot(merging, probabilities, axes=1)
        classes[rows, columns] = probabilities.argmax(axis=0)
    return classes


def _probability_parts(
    model: Segmenter, colour: NDArray[np.uint8]
) -> Iterator[tuple[tuple[slice, slice], NDArray[np.float32]]]:
    """Rows and columns of the parts of an image, and the probabilities there; most images are one part."""
    if isinstance(model, TrainedModel):
        from pepperscene.learning.models.large_images import is_large, probability_parts

        if is_large(colour, model.width):
            model.module.eval()
            yield from probability_parts(model.module, colour, model.width)
            return
    yield (slice(0, colour.shape[0]), slice(0, colour.shape[1])), model.probabilities(colour)

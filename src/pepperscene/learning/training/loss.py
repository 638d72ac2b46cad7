"""The loss of a training, also where labels are coarser than the network's classes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from pepperscene.classes import IGNORE_CLASS
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.errors import InputError
from pepperscene.learning.class_table import ClassTable

_COUNTED: Final = 200
"""Images whose pixels are counted for the frequencies of classes. Chosen: frequencies are known to some
percent."""

_MOST_WEIGHT: Final = 30.0
"""Of a class, times that of the most frequent one. Chosen: a class of a few pixels must not drown the
others."""


@final
class SegmentationLoss(nn.Module):
    """Cross-entropy of labels, whose classes may be mergers of the network's.

    The probability of a merged class is the sum of its members' probabilities, so a network keeps apart what
    labels do not distinguish.

    Args:
        labels: classes of the labels.
        outputs: classes of the network; `labels` merges them.
        weights: `(len(labels),)` of the classes.
    """

    def __init__(self, labels: ClassTable, outputs: ClassTable, weights: NDArray[np.float64]) -> None:
        super().__init__()
        merging = labels.merging(outputs)
        self._members: list[list[int]] = [np.flatnonzero(line).tolist() for line in merging]
        self._is_plain = labels.members == outputs.members
        self.register_buffer("weights", torch.tensor(weights, dtype=torch.float32), persistent=False)

    def forward(self, logits: torch.Tensor, labels: torch.Tensor) -> torch.Tensor:
        """Weighted mean over pixels, of logits `(n, k, h, w)` and labels `(n, h, w)` with 255 for void."""
        logits = logits.float()
        if not self._is_plain:
            merged = [logits[:, members].logsumexp(dim=1) for members in self._members]
            logits = torch.stack(merged, dim=1)
        losses = functional.cross_entropy(
            logits, labels, weight=self.weights, ignore_index=IGNORE_CLASS, reduction="sum"
        )
        labelled = labels != IGNORE_CLASS
        total = self.weights[labels[labelled]].sum()
        # A batch of void pixels alone has no loss, instead of nan.
        return losses / total.clamp(min=1e-6)


def class_weights(sets: Sequence[ImageSet], labels: ClassTable, balance: float) -> NDArray[np.float64]:
    """Weights `(k,)` of classes: their frequency to the power of `-balance`, 1 on average over pixels.

    Raises:
        InputError: no image has a pixel of any of the classes.
    """
    counts = np.zeros(len(labels))
    for images in sets:
        positions = np.unique(np.linspace(0, len(images) - 1, _COUNTED // len(sets) + 1).round().astype(int))
        for image in images.select("classes").take(positions.tolist()):
            if image.classes is not None:
                counts += np.bincount(labels.indices(image.classes).ravel(), minlength=256)[: len(labels)]
    if not counts.any():
        names = ", ".join(images.name for images in sets)
        raise InputError(names, f"has no pixel of the classes {labels}")
    frequencies = counts / counts.sum()
    weights = np.maximum(frequencies, frequencies.max() * 1e-9) ** -balance
    weights = np.minimum(weights, weights[frequencies.argmax()] * _MOST_WEIGHT)
    return np.asarray(weights / (weights * frequencies).sum())

"""The loss of a segmentation, also where labels are coarser than the network's classes."""

from __future__ import annotations

from typing import Final, final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from pepperscene.classes import IGNORE_CLASS
from pepperscene.learning.class_table import ClassTable

_STEP: Final = 2
"""Every second row and column count for the overlap. Chosen: it takes 2 % of a step; of all pixels, 24 %."""


@final
class SegmentationLoss(nn.Module):
    """Cross-entropy of labels, whose classes may be mergers of the network's, and the overlap of classes.

    The probability of a merged class is the sum of its members' probabilities, so a network keeps apart what
    labels do not distinguish.

    Args:
        labels: classes of the labels.
        outputs: classes of the network; `labels` merges them.
        weights: `(len(labels),)` of the classes in the cross-entropy.
        lovasz: factor of the loss of `overlap_loss`, which is added.
    """

    def __init__(
        self, labels: ClassTable, outputs: ClassTable, weights: NDArray[np.float64], lovasz: float = 0.0
    ) -> None:
        super().__init__()
        merging = labels.merging(outputs)
        self._members: list[list[int]] = [np.flatnonzero(line).tolist() for line in merging]
        self._is_plain = labels.members == outputs.members
        self._lovasz = lovasz
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
        total = self.weights[labels[labels != IGNORE_CLASS]].sum()
        # A batch of void pixels alone has no loss, instead of nan.
        loss = losses / total.clamp(min=1e-6)
        if not self._lovasz:
            return loss
        part = logits[..., ::_STEP, ::_STEP].softmax(dim=1)
        return loss + self._lovasz * overlap_loss(part, labels[..., ::_STEP, ::_STEP])


def overlap_loss(probabilities: torch.Tensor, labels: torch.Tensor) -> torch.Tensor:
    """The Lovász extension of 1 - IoU, averaged over the classes that occur; 0 without any.

    Berman, Rannen Triki and Blaschko (2018), "The Lovász-Softmax loss", CVPR. A pixel's error is 1 - p in its
    own class and p in another one. With the pixels in the order of falling errors, each error counts as much
    as the IoU falls when the pixel joins those before it, if all of these are wrong. Probabilities are
    `(n, k, h, w)`, and labels `(n, h, w)` with 255 for void.
    """
    known = labels != IGNORE_CLASS
    truth, losses = labels[known], []
    for index, ours in enumerate(probabilities.movedim(1, 0)):
        inside = (truth == index).to(ours.dtype)
        if not inside.any():
            continue
        errors, order = (inside - ours[known]).abs().sort(descending=True)
        hit = inside[order]
        count = hit.sum()
        loss_of_first = 1.0 - (count - hit.cumsum(0)) / (count + (1.0 - hit).cumsum(0))
        losses.append(errors @ loss_of_first.diff(prepend=loss_of_first.new_zeros(1)))
    return torch.stack(losses).mean() if losses else probabilities.sum() * 0.0

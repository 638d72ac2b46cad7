"""Progress of a training."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TrainingProgress:
    """A finished step.

    Attributes:
        step, steps: number of finished steps, and of all.
        loss: mean over the steps since the last validation or checkpoint.
        images_per_s: since the start or the resumption.
        left_s: estimated time to the end, in seconds.
        mean_iou: of a validation after this step; None if there was none, or no labelled pixel in it.
    """

    step: int
    steps: int
    loss: float
    images_per_s: float
    left_s: float
    mean_iou: float | None = None

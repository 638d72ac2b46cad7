"""Measures of the experiments, from the confusion matrices of all seeds and folds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.colour.comparison.bootstrap import (
    BootstrapSums,
    Estimate,
    bootstrap_weights,
    estimate_values,
)
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.confusion import (
    ABSENT,
    intersection_over_union,
    mean_intersection_over_union,
)
from pepperscene.learning.evaluation.evaluation import Evaluation

Matrices = Mapping[str, NDArray[np.float64]]
"""Confusion matrix of each image, by its name."""


@dataclass(frozen=True, eq=False)
class Results:
    """The measures of one experiment.

    Attributes:
        letter: "A" to "E".
        classes: of the matrices.
        seeds: confusion matrices of the images for each seed; of all folds together.
    """

    letter: str
    classes: ClassTable
    seeds: tuple[Matrices, ...]

    @property
    def images(self) -> Matrices:
        """Matrix of each image, the mean over the seeds."""
        return {name: np.mean([seed[name] for seed in self.seeds], axis=0) for name in self.seeds[0]}

    def iou(self) -> tuple[Estimate, ...]:
        """IoU of each class, with 95 % intervals over images."""
        values = intersection_over_union(self._totals())
        return tuple(estimate_values(column, len(self.images) > 1, ABSENT) for column in values.T)

    def mean_iou(self) -> Estimate:
        """Mean IoU, with its 95 % interval over images."""
        return estimate_values(self._mean_values(), len(self.images) > 1, ABSENT)

    def seed_deviation(self) -> float | None:
        """Standard deviation of the mean IoU over the seeds; None for a single one."""
        values = [float(mean_intersection_over_union(sum(seed.values()))) for seed in self.seeds]  # type: ignore[arg-type]
        return float(np.std(values, ddof=1)) if len(values) > 1 else None

    def above(self, other: Results) -> Estimate:
        """Difference of the mean IoU from another's on the same images, with its own interval."""
        difference = self._mean_values() - other._mean_values()
        return estimate_values(difference, len(self.images) > 1, ABSENT)

    def to_json(self) -> dict[str, Any]:
        """All numbers as JSON values."""
        return {
            "classes": list(self.classes.names),
            "iou": {
                name: _as_json(value) for name, value in zip(self.classes.names, self.iou(), strict=True)
            },
            "mean_iou": _as_json(self.mean_iou()),
            "seed_deviation": self.seed_deviation(),
            "images": len(self.images),
            "seeds": len(self.seeds),
        }

    def _totals(self) -> NDArray[np.float64]:
        """Summed matrices `(1 + replicates, k, k)`, the plain sum first."""
        count = len(self.classes)
        sums = BootstrapSums(count**2)
        for name, matrix in self.images.items():
            # By name, so that an image has the same weights in all experiments.
            sums.add(matrix.ravel(), bootstrap_weights(name.encode("utf-8", "surrogateescape")))
        return sums.totals().reshape(-1, count, count)

    def _mean_values(self) -> NDArray[np.float64]:
        return mean_intersection_over_union(self._totals())


def matrices_of(evaluation: Evaluation) -> dict[str, list[list[int]]]:
    """Confusion matrices of an evaluation as JSON values, by the images' set and name."""
    names = [item.name for item in evaluation.sets]
    return {f"{names[image.set_number]}/{image.name}": image.matrix.tolist() for image in evaluation.images}


def combine(letter: str, classes: ClassTable, records: Sequence[Sequence[Mapping[str, Any]]]) -> Results:
    """The results of an experiment from its evaluations.

    Args:
        letter: of the experiment.
        classes: of the matrices.
        records: for each seed, the matrices of each fold, as of `matrices_of`; folds share no image.
    """
    seeds = []
    for folds in records:
        merged: dict[str, NDArray[np.float64]] = {}
        for fold in folds:
            assert not merged.keys() & fold.keys()
            merged |= {name: np.array(matrix, float) for name, matrix in fold.items()}
        seeds.append(merged)
    return Results(letter, classes, tuple(seeds))


def _as_json(estimate: Estimate) -> dict[str, float | None]:
    return {"value": estimate.value, "low": estimate.low, "high": estimate.high}

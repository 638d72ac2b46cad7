"""Results of the experiments: IoU with intervals over images, and paired differences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.colour.comparison.bootstrap import (
    BootstrapSums,
    Estimate,
    bootstrap_weights,
    estimate_values,
)
from pepperscene.learning.evaluation.measures import (
    ABSENT,
    estimate_json,
    intersection_over_union,
    mean_intersection_over_union,
)

Floats = NDArray[np.float64]

MEAN: Final = "mean"
"""Name of the mean over classes, in tables."""

_ONE_IMAGE: Final = "a class is absent in one of the two"


@dataclass(frozen=True)
class Measure:
    """IoU of a class, or the mean over classes.

    Attributes:
        name: of the class, or `MEAN`.
        estimate: of all seeds and folds together; the interval is over images.
        seeds: value of each seed; nan where the class is absent.
    """

    name: str
    estimate: Estimate
    seeds: tuple[float, ...]

    @property
    def deviation(self) -> float | None:
        """Standard deviation over seeds; None for fewer than two."""
        finite = [value for value in self.seeds if np.isfinite(value)]
        return float(np.std(finite, ddof=1)) if len(finite) > 1 else None

    def to_json(self) -> dict[str, Any]:
        """JSON values; an unknown number is null."""
        seeds = [value if np.isfinite(value) else None for value in self.seeds]
        return {
            "name": self.name,
            **estimate_json(self.estimate),
            "sd_over_seeds": self.deviation,
            "seeds": seeds,
        }


@dataclass(frozen=True, eq=False)
class ExperimentResult:
    """Confusion matrices of an experiment.

    Attributes:
        key: of `TITLES`.
        classes: that were evaluated.
        images: set and name of each test image, in order.
        matrices: `(images, seeds, k, k)`, truth in rows and prediction in columns.
    """

    key: str
    classes: tuple[str, ...]
    images: tuple[tuple[str, str], ...]
    matrices: NDArray[np.int64]

    @cached_property
    def totals(self) -> NDArray[np.int64]:
        """Sum of the matrices of all images and seeds, `(k, k)`."""
        return np.asarray(self.matrices.sum(axis=(0, 1)))

    @cached_property
    def replicates(self) -> Floats:
        """IoU of the classes, and their mean in the last column, `(1 + replicates, k + 1)`."""
        k = len(self.classes)
        sums = BootstrapSums(k**2)
        # The mean over seeds makes each image one observation.
        for (folder, name), matrix in zip(self.images, self.matrices.mean(axis=1), strict=True):
            sums.add(
                matrix.ravel(), bootstrap_weights(f"{folder}\n{name}".encode("utf-8", "surrogateescape"))
            )
        return _iou_and_mean(sums.totals().reshape(-1, k, k))

    def measures(self) -> tuple[Measure, ...]:
        """IoU of each class and their mean."""
        seeds = _iou_and_mean(self.matrices.sum(axis=0))
        columns = zip((*self.classes, MEAN), self.replicates.T, seeds.T, strict=True)
        resampled = len(self.images) > 1
        return tuple(
            Measure(name, estimate_values(values, resampled, ABSENT), tuple(map(float, own)))
            for name, values, own in columns
        )

    def image_mean_iou(self) -> Floats:
        """Mean IoU of each image `(n,)`, its matrices added over seeds."""
        return mean_intersection_over_union(self.matrices.sum(axis=1))

    def to_json(self, title: str) -> dict[str, Any]:
        """JSON values."""
        return {
            "key": self.key,
            "title": title,
            "ran": True,
            "images": len(self.images),
            "measures": [measure.to_json() for measure in self.measures()],
            "confusion": self.totals.tolist(),
        }


@dataclass(frozen=True)
class Difference:
    """How much higher an IoU is in one experiment than in another, on the same images.

    Attributes:
        first, second: keys of the experiments; the second is subtracted.
        measures: name of the class or `MEAN`, and the difference.
    """

    first: str
    second: str
    measures: tuple[tuple[str, Estimate], ...]

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "first": self.first,
            "second": self.second,
            "measures": [{"name": name, **estimate_json(item)} for name, item in self.measures],
        }


def collect_result(key: str, evaluations: Mapping[int, Sequence[Mapping[str, Any]]]) -> ExperimentResult:
    """The result of an experiment from evaluations as JSON, those of the folds of each seed.

    Raises:
        ValueError: seeds were not tested on the same images.
    """
    by_seed = [_matrices(folds) for _, folds in sorted(evaluations.items())]
    images = tuple(sorted(by_seed[0]))
    if any(set(matrices) != set(images) for matrices in by_seed):
        raise ValueError(f"the networks of experiment {key} were not tested on the same images")
    stacked = np.array([[matrices[image] for matrices in by_seed] for image in images], np.int64)
    first = next(iter(evaluations.values()))[0]
    return ExperimentResult(key, tuple(item["name"] for item in first["classes"]), images, stacked)


def compare_results(first: ExperimentResult, second: ExperimentResult) -> Difference:
    """Paired differences of two experiments, which were tested on the same images in the same classes."""
    if first.images != second.images or first.classes != second.classes:
        raise ValueError(f"{first.key} and {second.key} were not tested on the same images and classes")
    # Both have the same weights in each replicate, which removes what the images have in common.
    differences = first.replicates - second.replicates
    resampled = len(first.images) > 1
    estimates = [estimate_values(column, resampled, _ONE_IMAGE) for column in differences.T]
    return Difference(first.key, second.key, tuple(zip((*first.classes, MEAN), estimates, strict=True)))


def _matrices(folds: Iterable[Mapping[str, Any]]) -> dict[tuple[str, str], NDArray[np.int64]]:
    """Matrix of each image by set and name; images of the same name in sets of the same name are added."""
    found: dict[tuple[str, str], NDArray[np.int64]] = {}
    for evaluation in folds:
        for image in evaluation["images"]:
            key = (image["set"], image["name"])
            matrix = np.array(image["confusion"], np.int64)
            found[key] = found[key] + matrix if key in found else matrix
    return found


def _iou_and_mean(matrices: NDArray[Any]) -> Floats:
    """IoU `(n, k + 1)` of matrices `(n, k, k)`, with the mean in the last column."""
    iou = intersection_over_union(matrices)
    return np.column_stack([iou, mean_intersection_over_union(matrices)])

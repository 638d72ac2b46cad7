"""Confusion matrices, and the measures that follow from them: IoU, precision and recall.

The IoU is Eq. 2 of Barth et al. 2018, "Data synthesis methods for semantic segmentation in agriculture",
Comput. Electron. Agric. 144:284: of the matrix that is summed over all images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS
from pepperscene.colour.comparison.bootstrap import BootstrapSums, Estimate, estimate_values

Floats = NDArray[np.float64]

ABSENT = "the class is neither in the masks nor predicted"


@dataclass(frozen=True)
class ClassMeasures:
    """Measures of each class of a summed confusion matrix, with 95 % intervals.

    Attributes:
        iou: of each class; without a value if neither truth nor prediction has the class.
        mean_iou: mean over the classes that truth or prediction have. A class that is only predicted counts
            as 0.
        precision: share of the pixels predicted as a class that belong to it; without a value if there are
            none.
        recall: share of the pixels of a class that are predicted as it; without a value if there are none.
    """

    iou: tuple[Estimate, ...]
    mean_iou: Estimate
    precision: tuple[Estimate, ...]
    recall: tuple[Estimate, ...]


def confusion_matrix(
    truth: NDArray[np.uint8], prediction: NDArray[np.uint8], classes: int
) -> NDArray[np.int64]:
    """Number of pixels of each class of the truth (row) and of the prediction (column), `(k, k)`.

    Args:
        truth: indices of classes, any shape; pixels with `IGNORE_CLASS` are left out.
        prediction: indices of the same shape.
        classes: the number k of classes.

    Raises:
        ValueError: the shapes differ, or an index is not below k.
    """
    if truth.shape != prediction.shape:
        raise ValueError(f"truth {truth.shape} and prediction {prediction.shape} differ in shape")
    labelled = truth != IGNORE_CLASS
    rows, columns = truth[labelled].astype(np.intp), prediction[labelled].astype(np.intp)
    if rows.size and max(int(rows.max()), int(columns.max())) >= classes:
        raise ValueError(f"indices of classes must be below {classes}")
    return np.bincount(classes * rows + columns, minlength=classes**2).reshape(classes, classes)


def intersection_over_union(matrix: NDArray[Any]) -> Floats:
    """IoU of each class `(..., k)` of confusion matrices `(..., k, k)`; nan for a class that is absent.

    Absent is what neither truth nor prediction has; a class that is only predicted has an IoU of 0.
    """
    both = _diagonal(matrix)
    return _ratio(both, matrix.sum(axis=-1) + matrix.sum(axis=-2) - both)


def mean_intersection_over_union(matrix: NDArray[Any]) -> Floats:
    """Mean IoU `(...)` of confusion matrices `(..., k, k)`, without absent classes; nan if all are absent."""
    iou = intersection_over_union(matrix)
    return _ratio(np.nansum(iou, axis=-1), np.isfinite(iou).sum(axis=-1))


def class_precision(matrix: NDArray[Any]) -> Floats:
    """Precision of each class `(..., k)`; nan where the class is not predicted."""
    return _ratio(_diagonal(matrix), matrix.sum(axis=-2))


def class_recall(matrix: NDArray[Any]) -> Floats:
    """Recall of each class `(..., k)`; nan where the truth does not have the class."""
    return _ratio(_diagonal(matrix), matrix.sum(axis=-1))


def measure_classes(matrices: Sequence[NDArray[np.int64]], weights: Sequence[Floats]) -> ClassMeasures:
    """Measures of the sum of the images' matrices; intervals are over images, and need two of them.

    Args:
        matrices: `(k, k)` of each image; at least one.
        weights: of each image, by `bootstrap_weights`.
    """
    # Sum the matrices, plain and in all replicates.
    classes = len(matrices[0])
    sums = BootstrapSums(classes**2)
    for matrix, image_weights in zip(matrices, weights, strict=True):
        sums.add(matrix.ravel(), image_weights)
    totals = sums.totals().reshape(-1, classes, classes)

    # Each measure of the sums.
    resampled = len(matrices) > 1
    return ClassMeasures(
        _estimate_columns(intersection_over_union(totals), resampled, ABSENT),
        estimate_values(mean_intersection_over_union(totals), resampled, "no pixel is labelled"),
        _estimate_columns(class_precision(totals), resampled, "the class is not predicted"),
        _estimate_columns(class_recall(totals), resampled, "the class is not in the masks"),
    )


def _estimate_columns(values: Floats, resampled: bool, why: str) -> tuple[Estimate, ...]:
    """Estimates of `(1 + replicates, k)` values."""
    return tuple(estimate_values(column, resampled, why) for column in values.T)


def _diagonal(matrix: NDArray[Any]) -> NDArray[Any]:
    return np.diagonal(matrix, axis1=-2, axis2=-1)


def _ratio(numerator: NDArray[Any], denominator: NDArray[Any]) -> Floats:
    """The quotient; nan where the denominator is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(denominator > 0, numerator / denominator, np.nan))

"""Measures of predictions: confusion matrices with IoU, precision and recall, and fruit as objects.

The IoU is Eq. 2 of Barth et al. 2018, "Data synthesis methods for semantic segmentation in agriculture",
Comput. Electron. Agric. 144:284: of the matrix that is summed over all images.

An object of the truth is an instance, where the image set has instances, or else a connected region of the
mask; a predicted object is a connected region. A truth and a predicted object match if their IoU is above
0.5; then no object of either side can match two of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS
from pepperscene.colour.comparison.bootstrap import BootstrapSums, Estimate, estimate_values

Floats = NDArray[np.float64]

ABSENT: Final = "the class is neither in the masks nor predicted"


LEAST_IOU: Final = 0.5
"""IoU above which two objects match, as in the panoptic quality (Kirillov et al. 2019, CVPR)."""

SMALLEST_PX: Final = 25
"""Least visible pixels of an object. Chosen: a square of 5 x 5, in which a person can still see a fruit."""

_MOST_VOID: Final = 0.5
"""Share of a prediction in void above which it is not counted as wrong, as for the crowds of COCO."""

Mask = NDArray[np.bool_]


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
    """
    labelled = truth != IGNORE_CLASS
    rows, columns = truth[labelled].astype(np.intp), prediction[labelled].astype(np.intp)
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


def estimate_json(estimate: Estimate) -> dict[str, Any]:
    """An estimate as JSON values; an unknown number is null."""
    numbers: dict[str, Any] = {"value": estimate.value, "low": estimate.low, "high": estimate.high}
    return {**numbers, "why": estimate.why} if estimate.value is None else numbers


def _estimate_columns(values: Floats, resampled: bool, why: str) -> tuple[Estimate, ...]:
    """Estimates of `(1 + replicates, k)` values."""
    return tuple(estimate_values(column, resampled, why) for column in values.T)


def _diagonal(matrix: NDArray[Any]) -> NDArray[Any]:
    return np.diagonal(matrix, axis1=-2, axis2=-1)


def _ratio(numerator: NDArray[Any], denominator: NDArray[Any]) -> Floats:
    """The quotient; nan where the denominator is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(denominator > 0, numerator / denominator, np.nan))


@dataclass(frozen=True)
class ObjectCounts:
    """Objects of one image, or of several.

    Attributes:
        matched: pairs of truth and prediction.
        truth: objects of the truth.
        predicted: predicted objects that count as right or wrong.
        ignored: predicted objects that match nothing and are mostly in void.
    """

    matched: int
    truth: int
    predicted: int
    ignored: int = 0


@dataclass(frozen=True)
class ObjectMeasures:
    """Objects of a set of images.

    Attributes:
        counts: sums over the images.
        precision: matched predictions among all predicted objects.
        recall: matched objects among those of the truth.
    """

    counts: ObjectCounts
    precision: Estimate
    recall: Estimate


def count_objects(
    truth: Mask,
    prediction: Mask,
    void: Mask,
    instances: NDArray[np.integer[Any]] | None = None,
    smallest_px: int = SMALLEST_PX,
) -> ObjectCounts:
    """Match the objects of one image, all arrays `(h, w)`.

    Args:
        truth: the pixels of the class in the mask.
        prediction: the pixels predicted as the class.
        void: pixels without a label; they do not count for or against a predicted object.
        instances: number of the organ at each pixel, 0 for none; None takes connected regions of `truth`.
        smallest_px: least pixels of an object. Smaller objects of the truth, and pixels of the class without
            an instance (a crowd), are treated as void; smaller predictions are left out.
    """
    # Number the objects of both sides; the rest of the class has no objects, so nothing there is wrong.
    truth_objects = connected_objects(truth) if instances is None else np.where(truth, instances, 0)
    truth_objects = _renumber(truth_objects, smallest_px)
    predicted_objects = _renumber(connected_objects(prediction), smallest_px)
    void = void | (truth & (truth_objects == 0))

    # Pixels of each pair of objects, without those of the prediction that are void.
    areas = np.bincount(predicted_objects.ravel())[1:]
    shape = (int(truth_objects.max(initial=0)) + 1, len(areas) + 1)
    overlaps = _overlaps(truth_objects, np.where(void, 0, predicted_objects), shape)
    pairs = match_objects(overlaps[1:, 1:], overlaps[1:].sum(axis=1), overlaps[:, 1:].sum(axis=0))

    # Predictions that match nothing are wrong, except those that are mostly in void.
    void_share = 1.0 - overlaps[:, 1:].sum(axis=0) / areas
    unmatched = np.ones(len(areas), bool)
    unmatched[[column for _, column in pairs]] = False
    ignored = int((unmatched & (void_share > _MOST_VOID)).sum())
    return ObjectCounts(len(pairs), len(overlaps) - 1, len(areas) - ignored, ignored)


def match_objects(
    overlaps: NDArray[np.integer[Any]],
    truth_px: NDArray[np.integer[Any]],
    predicted_px: NDArray[np.integer[Any]],
    least_iou: float = LEAST_IOU,
) -> list[tuple[int, int]]:
    """One-to-one pairs of objects whose IoU is above a limit.

    Pairs are taken in the order of their IoU, the highest first; of equal ones the first truth object, then
    the first predicted object.

    Args:
        overlaps: common pixels of each truth object and each predicted object, `(n, m)`.
        truth_px: pixels of the truth objects `(n,)`.
        predicted_px: pixels of the predicted objects `(m,)`.
        least_iou: the limit.

    Returns:
        Row and column of each pair.
    """
    unions = np.maximum(truth_px[:, None] + predicted_px - overlaps, 1)
    iou = overlaps / unions
    rows, columns = np.nonzero(iou > least_iou)
    order = np.argsort(-iou[rows, columns], kind="stable")
    pairs: dict[int, int] = {}
    for row, column in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        if row not in pairs and column not in pairs.values():
            pairs[row] = column
    return list(pairs.items())


def measure_objects(counts: Sequence[ObjectCounts], weights: Sequence[NDArray[np.float64]]) -> ObjectMeasures:
    """Precision and recall of objects with intervals over images, which need two of them.

    Args:
        counts: of each image; at least one.
        weights: of each image, by `bootstrap_weights`.
    """
    sums = BootstrapSums(3)
    for count, image_weights in zip(counts, weights, strict=True):
        sums.add([count.matched, count.truth, count.predicted], image_weights)
    totals = sums.totals()
    matched, truth, predicted = totals.T
    plain, resampled = [int(value) for value in totals[0]], len(counts) > 1
    return ObjectMeasures(
        ObjectCounts(plain[0], plain[1], plain[2], sum(count.ignored for count in counts)),
        estimate_values(_ratio(matched, predicted), resampled, "no object is predicted"),
        estimate_values(_ratio(matched, truth), resampled, "the masks have no object"),
    )


def connected_objects(mask: Mask) -> NDArray[np.int32]:
    """Number of the connected region at each pixel `(h, w)`, 0 for none; pixels connect at corners too."""
    from scipy import ndimage

    numbers, _ = ndimage.label(mask, np.ones((3, 3), bool))
    return np.asarray(numbers, np.int32)


def _renumber(objects: NDArray[np.integer[Any]], smallest_px: int) -> NDArray[np.intp]:
    """Objects numbered from 1 in the order of their numbers, without those of fewer pixels."""
    numbers, inverse, counts = np.unique(objects, return_inverse=True, return_counts=True)
    kept = (numbers != 0) & (counts >= smallest_px)
    new = np.where(kept, np.cumsum(kept), 0)
    return np.asarray(new[inverse].reshape(objects.shape))


def _overlaps(first: NDArray[np.intp], second: NDArray[np.intp], shape: tuple[int, int]) -> NDArray[np.int64]:
    """Common pixels of objects, `(1 + n, 1 + m)`; row and column 0 are pixels of no object."""
    pairs = (shape[1] * first + second).ravel()
    return np.bincount(pairs, minlength=shape[0] * shape[1]).reshape(shape)

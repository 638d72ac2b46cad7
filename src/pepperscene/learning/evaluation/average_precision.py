"""Average precision of objects as COCO defines it, computed by pycocotools."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.learning.evaluation.measures import ObjectCounts
from pepperscene.libraries import import_library

_ALL_AREAS: Final = 0  # position of the range of all areas in the arrays of pycocotools
_MOST_OBJECTS: Final = -1  # position of the largest number of objects of an image, 100
_AT_HALF: Final = 0  # position of the IoU .5
_BOX_DECIMALS: Final = 3  # chosen: thousandths of a pixel


@dataclass(frozen=True)
class AveragePrecision:
    """Average precision of a class; None if no image has an object of it.

    Attributes:
        ap: mean over IoU from .5 to .95 in steps of .05.
        ap50: at an IoU of .5.
    """

    ap: float | None
    ap50: float | None


@dataclass(frozen=True)
class ObjectRecords:
    """Objects of the images with the numbers 0, 1 and so on, as annotations of COCO without `id`.

    Attributes:
        images: number of images.
        truth: labelled objects: `image_id`, `category_id`, `bbox`, `segmentation`, `area`.
        found: the same of detections, with `score`.
    """

    images: int
    truth: Sequence[Mapping[str, Any]]
    found: Sequence[Mapping[str, Any]]


def average_precision(
    records: ObjectRecords, classes: int, kind: str, least_score: float
) -> tuple[list[AveragePrecision], list[list[ObjectCounts]]]:
    """Average precision of each class, and objects of each class and image from a score on.

    Objects of the second result are matched at an IoU of .5.

    Args:
        records: the objects; categories are indices of classes.
        classes: number of classes.
        kind: "bbox" or "segm", by which objects are matched.
        least_score: of detections that are counted.

    Raises:
        SetupError: pycocotools is not installed.
    """
    evaluation = import_library("pycocotools.cocoeval").COCOeval
    # It prints its progress.
    with redirect_stdout(io.StringIO()):
        measured = evaluation(
            _coco(records.truth, records.images, classes), _coco(records.found, records.images, classes), kind
        )
        measured.evaluate()
        measured.accumulate()
    precision = measured.eval["precision"][..., _ALL_AREAS, _MOST_OBJECTS]
    results = [_summary(precision[:, :, index]) for index in range(classes)]
    # By class, range of areas and image.
    images = len(measured.evalImgs) // (classes * len(measured.params.areaRng))
    counts = [
        [_counts(image, least_score) for image in measured.evalImgs[first : first + images]]
        for first in range(0, len(measured.evalImgs), images * len(measured.params.areaRng))
    ]
    return results, counts


def record(
    image: int, label: int, box: NDArray[np.floating[Any]], mask: NDArray[np.bool_], **others: Any
) -> dict[str, Any]:
    """The record of an object: its box `(4,)` of sides and its mask `(h, w)`."""
    coder = import_library("pycocotools.mask")
    left, top, right, bottom = (round(float(side), _BOX_DECIMALS) for side in box)
    segmentation = coder.encode(np.asfortranarray(mask, np.uint8))
    return {
        "image_id": image,
        "category_id": label,
        "bbox": [left, top, right - left, bottom - top],
        "area": int(np.count_nonzero(mask)),
        "segmentation": {**segmentation, "counts": segmentation["counts"].decode()},
        **others,
    }


def _coco(records: Sequence[Mapping[str, Any]], images: int, classes: int) -> Any:
    """An object of pycocotools with these records."""
    content = import_library("pycocotools.coco").COCO()
    content.dataset = {
        # Sizes are read, and not used for masks of run lengths.
        "images": [{"id": number, "height": 0, "width": 0} for number in range(images)],
        "categories": [{"id": index} for index in range(classes)],
        # An id of 0 would stand for no match.
        "annotations": [
            {"iscrowd": 0, **entry, "id": number} for number, entry in enumerate(records, start=1)
        ],
    }
    content.createIndex()
    return content


def _summary(precision: NDArray[np.float64]) -> AveragePrecision:
    """Of precisions at each IoU and recall `(10, 101)`, which are -1 without objects."""
    if (precision < 0).all():
        return AveragePrecision(None, None)
    return AveragePrecision(float(precision.mean()), float(precision[_AT_HALF].mean()))


def _counts(image: Mapping[str, Any] | None, least_score: float) -> ObjectCounts:
    """Objects of an image and a class; None is an image without any."""
    if image is None:
        return ObjectCounts(0, 0, 0)
    certain = np.asarray(image["dtScores"]) >= least_score
    matched = image["dtMatches"][_AT_HALF] > 0
    return ObjectCounts(int((matched & certain).sum()), len(image["gtIds"]), int(certain.sum()))

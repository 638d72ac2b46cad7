"""Average precision of objects as COCO defines it, computed by pycocotools."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pepperscene.learning.evaluation.measures import ObjectCounts
from pepperscene.libraries import import_library

_AT_HALF: Final = 0  # position of the IoU .5 in the arrays of pycocotools
_BOX_DECIMALS: Final = 3  # chosen: thousandths of a pixel

Records = Sequence[Mapping[str, Any]]
"""Objects as annotations of COCO without `id`, as of `object_record`, with `score` if they are detected."""


class AveragePrecision(NamedTuple):
    """Mean over IoU from .5 to .95 in steps of .05, and at .5; None if no image has an object."""

    ap: float | None
    ap50: float | None


def average_precision(
    truth: Records, found: Records, images: int, classes: int, kind: str, least_score: float
) -> tuple[list[AveragePrecision], list[list[ObjectCounts]]]:
    """Average precision of each class; and of each class and image, the objects from a score on.

    Objects of the second result are matched at an IoU of .5.

    Args:
        truth: labelled objects.
        found: detected objects.
        images: number of images, whose ids are 0, 1 and so on.
        classes: number of classes, whose indices are the ids of categories.
        kind: "bbox" or "segm", by which objects are matched.
        least_score: of detections that are counted.

    Raises:
        SetupError: pycocotools is not installed.
    """
    evaluation = import_library("pycocotools.cocoeval").COCOeval
    # It prints its progress.
    with redirect_stdout(io.StringIO()):
        measured = evaluation(_coco(truth, images, classes), _coco(found, images, classes), kind)
        measured.evaluate()
        measured.accumulate()
    # By IoU, recall, class, range of areas (the first is all) and number of objects (the last is 100).
    precision = measured.eval["precision"][..., 0, -1]
    results = []
    for index in range(classes):
        own = precision[:, :, index]
        known = (own >= 0).any()
        values = (float(own.mean()), float(own[_AT_HALF].mean())) if known else (None, None)
        results.append(AveragePrecision(*values))
    # By class, range of areas and image.
    step = images * len(measured.params.areaRng)
    counts = [
        [_counts(image, least_score) for image in measured.evalImgs[first : first + images]]
        for first in range(0, step * classes, step)
    ]
    return results, counts


def object_record(
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


def _coco(records: Records, images: int, classes: int) -> Any:
    """An object of pycocotools with these records."""
    content = import_library("pycocotools.coco").COCO()
    content.dataset = {
        # Sizes are read, but not used for masks of run lengths.
        "images": [{"id": number, "height": 0, "width": 0} for number in range(images)],
        "categories": [{"id": index} for index in range(classes)],
        # An id of 0 would stand for no match.
        "annotations": [{"iscrowd": 0, **item, "id": number} for number, item in enumerate(records, start=1)],
    }
    content.createIndex()
    return content


def _counts(image: Mapping[str, Any] | None, least_score: float) -> ObjectCounts:
    """Objects of an image and a class; None is an image without any."""
    if image is None:
        return ObjectCounts(0, 0, 0)
    certain = np.asarray(image["dtScores"]) >= least_score
    matched = image["dtMatches"][_AT_HALF] > 0
    return ObjectCounts(int((matched & certain).sum()), len(image["gtIds"]), int(certain.sum()))

"""Evaluation of a detector on images with labelled objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.colour.comparison.bootstrap import LEVEL, REPLICATES
from pepperscene.colour.comparison.tables import UNKNOWN, TextTable, format_estimate, format_tables
from pepperscene.dataset.readers.image_set import ImageSet, LabelledImage
from pepperscene.dataset.readers.torch_data import DetectionObjects
from pepperscene.errors import InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.average_precision import (
    AveragePrecision,
    average_precision,
    object_record,
)
from pepperscene.learning.evaluation.evaluate import OnProgress, colour_of, for_each_image, image_weights
from pepperscene.learning.evaluation.evaluation import EvaluatedSet, describe_sets
from pepperscene.learning.evaluation.measures import (
    ObjectMeasures,
    connected_objects,
    estimate_json,
    measure_objects,
)
from pepperscene.learning.models.detections import Detections
from pepperscene.learning.models.trained_model import TrainedModel
from pepperscene.learning.objects import labelled_objects, object_indices
from pepperscene.learning.options import DECIDED_SCORE
from pepperscene.libraries import import_library

FORMAT: Final = "pepperscene detection 1"
_MOST_IGNORED: Final = 0.5
"""Share of a detection in ignored pixels above which it is left out, as for COCO's crowds at an IoU of .5."""


@dataclass(frozen=True)
class DetectedClass:
    """How well objects of a class are found.

    Attributes:
        name: of the class.
        boxes, masks: average precision, where objects match by their boxes or their masks.
        decided: precision and recall of the masks from the least score on, at an IoU of .5.
    """

    name: str
    boxes: AveragePrecision
    masks: AveragePrecision
    decided: ObjectMeasures


@dataclass(frozen=True)
class DetectionEvaluation:
    """How well a detector finds the labelled objects of images.

    Attributes:
        sets: whose images are evaluated.
        classes: the measures of each class.
        least_area: least pixels of an object, in images of the model's width.
        least_score: from which detections are decided to be objects.
    """

    sets: tuple[EvaluatedSet, ...]
    classes: tuple[DetectedClass, ...]
    least_area: int
    least_score: float

    @property
    def mean_ap50(self) -> float:
        """Mean AP50 of the masks of the classes that have objects; nan if none has."""
        known = [item.masks.ap50 for item in self.classes if item.masks.ap50 is not None]
        return float(np.mean(known)) if known else float("nan")

    def to_json(self) -> dict[str, Any]:
        """JSON data: all numbers are finite, and an unknown one is null."""
        return {
            "format": FORMAT,
            "sets": [vars(item) for item in self.sets],
            "least_area": self.least_area,
            "least_score": self.least_score,
            "interval": {"level": LEVEL, "replicates": REPLICATES},
            "classes": [
                {
                    "name": item.name,
                    "boxes": item.boxes._asdict(),
                    "masks": item.masks._asdict(),
                    **vars(item.decided.counts),
                    "precision": estimate_json(item.decided.precision),
                    "recall": estimate_json(item.decided.recall),
                }
                for item in self.classes
            ],
        }

    def tables(self) -> tuple[TextTable, ...]:
        """Average precision of each class, precision and recall."""
        rows = [
            (
                item.name,
                f"{item.decided.counts.truth:,}",
                *map(_percent, (*item.boxes, *item.masks)),
                format_estimate(item.decided.precision, 1, 100.0),
                format_estimate(item.decided.recall, 1, 100.0),
            )
            for item in self.classes
        ]
        heads = ("class", "objects", "boxes: AP", "AP50", "masks: AP", "AP50", "precision [95 %]", "recall")
        note = f"precision and recall of masks from a score of {self.least_score:g} on, at an IoU of .5"
        area = f"objects below {self.least_area} pixels at the model's width are ignored"
        return (TextTable(f"Objects, %: {describe_sets(self.sets)}", heads, tuple(rows), (note, area)),)

    def format(self) -> str:
        """The table as plain text."""
        return format_tables(self.tables())


def evaluate_detector(
    model: TrainedModel,
    sets: ImageSet | Sequence[ImageSet],
    *,
    classes: ClassTable | None = None,
    least_score: float = DECIDED_SCORE,
    regions: bool = False,
    limit: int | None = None,
    on_progress: OnProgress | None = None,
) -> DetectionEvaluation:
    """Compare the objects that a detector finds with the labelled ones, by COCO's average precision.

    Objects that were too small for the training are ignored, and so are void pixels and pixels of a class
    without an instance: a detection of which more than half is there, and whose box has an IoU below .5 with
    all labelled ones of its class, is left out. Images without a mask are left out and counted.

    Args:
        model: a trained detector.
        sets: one or more sets of images.
        classes: to evaluate, to which the model's are merged; None for the model's.
        least_score: from which detections count for precision and recall.
        regions: take connected regions of the masks as objects where images have no instances.
        limit: most images of each set, evenly spaced; None for all.
        on_progress: called after each image.

    Raises:
        ArgumentError: the model is no detector.
        InputError: a set is empty, or has no masks; an image has no colours or no instances; or the model's
            classes cannot be merged to `classes`.
        SetupError: pycocotools is not installed.
    """
    model.check_task("detect")
    sets = (sets,) if isinstance(sets, ImageSet) else tuple(sets)
    table = model.classes if classes is None else classes
    merged = table.merging(model.classes)
    truth: list[dict[str, Any]] = []
    found: list[dict[str, Any]] = []
    weights: list[NDArray[np.float64]] = []

    def find(number: int, _position: int, image: LabelledImage) -> None:
        colour = colour_of(image)
        objects, ignored = _objects(sets[number].name, image, model, table, regions)
        own = [
            object_record(len(weights), int(label), box, mask.astype(bool))
            for label, box, mask in zip(objects.labels, objects.boxes, objects.masks, strict=True)
        ]
        truth.extend(own)
        found.extend(_detected(model.detections(colour), merged, len(weights), own, ignored))
        weights.append(image_weights(image))

    summaries = for_each_image(sets, limit, on_progress, find)
    # Measures by boxes and by masks, with the same objects.
    boxes, _ = average_precision(truth, found, len(weights), len(table), "bbox", least_score)
    masks, counts = average_precision(truth, found, len(weights), len(table), "segm", least_score)
    measured = zip(table.names, boxes, masks, counts, strict=True)
    results = tuple(
        DetectedClass(name, box, mask, measure_objects(count, weights)) for name, box, mask, count in measured
    )
    return DetectionEvaluation(summaries, results, _least_area_of(model), least_score)


def _least_area_of(model: TrainedModel) -> int:
    """Least pixels of an object in the training of a detector, in images of its width."""
    return int(model.training.get("options", {}).get("least_area", 1))


def _objects(
    name: str, image: LabelledImage, model: TrainedModel, table: ClassTable, regions: bool
) -> tuple[DetectionObjects, NDArray[np.bool_]]:
    """Labelled objects and ignored pixels of an image in a set of this name."""
    assert image.classes is not None
    indices, instances = object_indices(table, image.classes), image.instances
    if instances is None and regions:
        instances = np.zeros(indices.shape, np.int32)
        for index in range(len(table)):
            region = connected_objects(indices == index)
            instances[region > 0] = region[region > 0] + instances.max()
    if instances is None:
        problem = f"{image.name} has a mask without numbers of instances, with which detections are compared"
        raise InputError(name, f"{problem}; --regions takes connected regions as objects")
    # Areas are those of the network's image, whose pixels may be larger.
    factor = 1.0 if model.width is None else image.size[1] / model.width
    return labelled_objects(indices, instances, len(table), _least_area_of(model) * factor**2)


def _detected(
    detections: Detections,
    merged: NDArray[np.float32],
    number: int,
    truth: Sequence[dict[str, Any]],
    ignored: NDArray[np.bool_],
) -> list[dict[str, Any]]:
    """Records of the detections that are to be compared with the labelled objects."""
    coder = import_library("pycocotools.mask")
    records = []
    for position, model_label in enumerate(detections.labels):
        lines = np.flatnonzero(merged[:, model_label])
        if not len(lines):
            continue
        mask, label = detections.mask(position), int(lines[0])
        score = float(detections.scores[position])
        own = object_record(number, label, detections.boxes[position], mask, score=score)
        if own["area"] and ignored[mask].mean() > _MOST_IGNORED:
            others = [item["bbox"] for item in truth if item["category_id"] == label]
            overlaps = coder.iou([own["bbox"]], others, [0] * len(others)) if others else np.zeros(1)
            if np.max(overlaps) < _MOST_IGNORED:
                continue
        records.append(own)
    return records


def _percent(value: float | None) -> str:
    return UNKNOWN if value is None else f"{100.0 * value:.1f}"

"""The result of an evaluation, as JSON data and as text tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.colour.comparison.bootstrap import LEVEL, REPLICATES
from pepperscene.colour.comparison.tables import UNKNOWN, TextTable, format_estimate, format_tables
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.measures import (
    LEAST_IOU,
    SMALLEST_PX,
    ClassMeasures,
    ObjectCounts,
    ObjectMeasures,
    estimate_json,
    mean_intersection_over_union,
)

FORMAT: Final = "pepperscene evaluation 1"


@dataclass(frozen=True, eq=False)
class EvaluatedImage:
    """One image of an evaluation.

    Attributes:
        set_number: position of its set among the evaluated sets.
        position: of the image in its set.
        name: of the image, unique in its set.
        matrix: its confusion matrix `(k, k)`, truth in rows and prediction in columns.
        objects: its fruit as objects; None if no class holds them.
    """

    set_number: int
    position: int
    name: str
    matrix: NDArray[np.int64]
    objects: ObjectCounts | None

    @property
    def mean_iou(self) -> float:
        """Mean IoU of the classes that it has; nan if no pixel is labelled."""
        return float(mean_intersection_over_union(self.matrix))


@dataclass(frozen=True)
class EvaluatedSet:
    """Name of an evaluated set, and numbers of its images: all, evaluated, and chosen ones without a mask."""

    name: str
    available: int
    evaluated: int
    unlabelled: int


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How well a model's predictions agree with the masks of images.

    Attributes:
        classes: that are evaluated.
        sets: whose images are evaluated.
        images: in the order of the sets.
        measures: IoU, precision and recall of the classes, of the sum of all images' matrices.
        fruit_class: index of the class that holds fruit; None if none does.
        fruit: fruit as objects; None if no class holds them.
    """

    classes: ClassTable
    sets: tuple[EvaluatedSet, ...]
    images: tuple[EvaluatedImage, ...]
    measures: ClassMeasures
    fruit_class: int | None
    fruit: ObjectMeasures | None

    @cached_property
    def matrix(self) -> NDArray[np.int64]:
        """Sum of the images' confusion matrices, `(k, k)`."""
        return np.sum([image.matrix for image in self.images], axis=0)

    def shares(self) -> NDArray[np.float64]:
        """Share of each class in the labelled pixels, `(k,)`."""
        return np.asarray(self.matrix.sum(axis=1) / self.matrix.sum())

    def to_json(self) -> dict[str, Any]:
        """JSON data: all numbers are finite, and an unknown one is null."""
        measures = self.measures
        rows = zip(
            self.classes.names, self.classes.members, self.shares(),
            measures.iou, measures.precision, measures.recall,
            strict=True,
        )  # fmt: skip
        return {
            "format": FORMAT,
            "sets": [vars(item) for item in self.sets],
            "interval": {"level": LEVEL, "replicates": REPLICATES},
            "mean_iou": estimate_json(measures.mean_iou),
            "classes": [
                {
                    "name": name,
                    "members": sorted(members),
                    "share": float(share),
                    "iou": estimate_json(iou),
                    "precision": estimate_json(precision),
                    "recall": estimate_json(recall),
                }
                for name, members, share, iou, precision, recall in rows
            ],
            "confusion": self.matrix.tolist(),
            "fruit": None if self.fruit is None else self._fruit_json(self.fruit),
            "images": [self._image_json(image) for image in self.images],
        }

    def tables(self) -> tuple[TextTable, ...]:
        """IoU, precision and recall; confusion in percent of the truth; fruit as objects."""
        return (self._class_table(), self._confusion_table(), *self._fruit_tables())

    def format(self) -> str:
        """The tables as plain text."""
        return format_tables(self.tables())

    def _fruit_json(self, fruit: ObjectMeasures) -> dict[str, Any]:
        assert self.fruit_class is not None
        return {
            "class": self.classes.names[self.fruit_class],
            "least_iou": LEAST_IOU,
            "smallest_px": SMALLEST_PX,
            **vars(fruit.counts),
            "precision": estimate_json(fruit.precision),
            "recall": estimate_json(fruit.recall),
        }

    def _image_json(self, image: EvaluatedImage) -> dict[str, Any]:
        iou = image.mean_iou
        return {
            "set": self.sets[image.set_number].name,
            "name": image.name,
            "mean_iou": iou if np.isfinite(iou) else None,
            "confusion": image.matrix.tolist(),
            "fruit": None if image.objects is None else vars(image.objects),
        }

    def _class_table(self) -> TextTable:
        measures = self.measures
        columns = zip(
            self.classes.names, measures.iou, measures.precision, measures.recall, self.shares(), strict=True
        )
        rows = [
            (
                name,
                *(format_estimate(estimate, 1, 100.0) for estimate in estimates),
                _format_share(float(share)),
            )
            for name, *estimates, share in columns
        ]
        rows.append(("mean", format_estimate(measures.mean_iou, 1, 100.0), "", "", ""))
        heads = ("class", "IoU, % [95 %]", "precision, %", "recall, %", "share of pixels, %")
        return TextTable(f"IoU: {describe_sets(self.sets)}", heads, tuple(rows), self._notes())

    def _notes(self) -> tuple[str, ...]:
        """Lines below the first table: images without masks, absent classes, missing intervals."""
        notes = [
            f"{item.name}: {item.unlabelled:,} image{'s have' if item.unlabelled > 1 else ' has'} no mask"
            for item in self.sets
            if item.unlabelled
        ]
        pairs = zip(self.classes.names, self.measures.iou, strict=True)
        absent = [name for name, iou in pairs if iou.value is None]
        if absent:
            notes.append(f"neither in the masks nor predicted, and not in the mean: {', '.join(absent)}")
        if len(self.images) < 2:
            notes.append("a single image gives no intervals")
        return tuple(notes)

    def _confusion_table(self) -> TextTable:
        totals = self.matrix.sum(axis=1)
        rows = [
            (name, *(_format_share(count / total) if total else UNKNOWN for count in line))
            for name, line, total in zip(self.classes.names, self.matrix.tolist(), totals, strict=True)
        ]
        title = "Predicted classes (columns) of the pixels of each class (rows), %"
        return TextTable(title, ("", *self.classes.names), tuple(rows))

    def _fruit_tables(self) -> Sequence[TextTable]:
        if self.fruit is None:
            return ()
        counts = self.fruit.counts
        row = (
            *(f"{number:,}" for number in (counts.truth, counts.predicted, counts.matched)),
            *(format_estimate(item, 1, 100.0) for item in (self.fruit.precision, self.fruit.recall)),
        )
        heads = ("in masks", "predicted", "matched", "precision, % [95 %]", "recall, %")
        title = f"Fruit as objects of {SMALLEST_PX} pixels or more, matched at an IoU above {LEAST_IOU:g}"
        return (TextTable(title, heads, (row,)),)


def describe_sets(sets: Sequence[EvaluatedSet]) -> str:
    """Names of sets and numbers of their images, for a table's title."""
    return "; ".join(f"{item.name}, {item.evaluated:,} of {item.available:,} images" for item in sets)


def _format_share(share: float) -> str:
    return f"{100.0 * share:.1f}"

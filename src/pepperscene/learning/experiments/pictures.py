"""Pictures of the page: photographs with their masks and the predictions of several networks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.evaluate import label_image
from pepperscene.learning.experiments.results import ExperimentResult
from pepperscene.learning.experiments.runner import JobRunner
from pepperscene.learning.experiments.schedule import NetworkJob
from pepperscene.learning.page_parts import class_palette_of, ranked_examples

_SHOWN: tuple[str, ...] = ("B", "C", "D", "E")


@dataclass(frozen=True, eq=False)
class PictureRow:
    """A photograph and what networks make of it.

    Attributes:
        word: "best", "median" or "worst".
        name: of the image.
        mean_iou: of experiment B.
        photo: `(h, w, 3)` uint8.
        panels: title and colours `(h, w, 3)` uint8: the truth, then experiments.
    """

    word: str
    name: str
    mean_iou: float
    photo: NDArray[np.uint8]
    panels: tuple[tuple[str, NDArray[np.uint8]], ...]


def picture_rows(
    results: Mapping[str, ExperimentResult],
    jobs: Sequence[NetworkJob],
    runner: JobRunner,
    real: ImageSet,
    classes: ClassTable,
) -> tuple[PictureRow, ...]:
    """The best, the median and the worst image of experiment B, with predictions of the first seed."""
    result = results["B"]
    mean_iou = result.image_mean_iou()
    return tuple(
        _picture_row(word, result.images[at][1], float(mean_iou[at]), jobs, runner, real, classes)
        for word, at in ranked_examples(mean_iou)
    )


def _picture_row(
    word: str,
    name: str,
    mean_iou: float,
    jobs: Sequence[NetworkJob],
    runner: JobRunner,
    real: ImageSet,
    classes: ClassTable,
) -> PictureRow:
    image = real.select("colour", "classes")[real.names().index(name)]
    palette = class_palette_of(classes)
    assert image.colour is not None
    assert image.classes is not None
    panels = [("truth", palette[classes.indices(image.classes)])]
    for experiment in _SHOWN:
        job = _job_that_tests(jobs, experiment, name)
        if job is not None:
            model = runner.load(job)
            _, prediction = label_image(model, classes, classes.merging(model.classes), image)
            panels.append((experiment, palette[prediction]))
    return PictureRow(word, name, mean_iou, image.colour, tuple(panels))


def _job_that_tests(jobs: Sequence[NetworkJob], experiment: str, name: str) -> NetworkJob | None:
    """The first job, that is of the first seed, that is tested on an image in an experiment."""
    for job in jobs:
        for test in job.tests:
            if test.experiment == experiment and any(name in images.names() for images in test.images):
                return job
    return None

"""Segmentation across sensors: a network that learned from one camera, tested on the same views of others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.evaluate import predict_classes
from pepperscene.learning.evaluation.measures import (
    confusion_matrix,
    intersection_over_union,
    mean_intersection_over_union,
)
from pepperscene.learning.options import TrainingOptions, TrainingProgress
from pepperscene.learning.tasks.frames import PredictionFolder, TaskFrames, TaskSplit, open_task_frames
from pepperscene.learning.tasks.result import Score, TaskMeasure, TaskResult

SENSOR_OUTPUTS: Final = ("colour", "class")
"""Outputs that the frames of a data set must have."""

CLASSES: Final = ClassTable.organs()

TRAINING: Final = TrainingOptions(steps=300, size=(128, 128), width=320, precision="float32")
"""Chosen: minutes on a laptop without a GPU, and the same numbers on all processors as far as possible."""

SegmentImage = Callable[[int, LabelledImage], NDArray[np.uint8]]
"""From the index of a frame and its image to class ids `(h, w)`."""

OnTraining = Callable[[str, TrainingProgress], None]


@dataclass(frozen=True)
class SensorBaseline:
    """How the shipped network is trained: the strength of random changes of images, and on which cameras."""

    augmentation: float
    all_twins: bool = False


SENSOR_BASELINES: Final[Mapping[str, SensorBaseline]] = {
    "small_plain": SensorBaseline(0.0),
    "small": SensorBaseline(1.0),
    "small_all_sensors": SensorBaseline(1.0, all_twins=True),
}
"""Trainings of the network `small` by name: without random changes of images, with them, on all cameras."""


def evaluate_sensors(
    folder: str | Path,
    baselines: Sequence[str] | None = None,
    predictions: Sequence[str | Path] = (),
    *,
    out: str | Path | None = None,
    twin: int = 0,
    split: str | None = None,
    options: TrainingOptions | None = None,
    on_training: OnTraining | None = None,
) -> TaskResult:
    """Score networks on the twin that they learned from, and on the others.

    Twins show the same views, so the difference of both mean IoU is that of the cameras alone.

    Args:
        folder: a data set with twins and the outputs `colour` and `class`.
        baselines: names in `SENSOR_BASELINES`, which are trained; None for all, unless there are predictions.
        predictions: folders as `predict` writes them: class ids as PNG for each frame of the test.
        out: folder of the trainings; each is resumed if it is there. Needed for baselines.
        twin: number of the twin that methods learn from.
        split: as for an export, see `open_task_frames`.
        options: of the trainings; None for `TRAINING`.
        on_training: called with the name of a baseline and its progress.

    Raises:
        InputError: the data set has no twins, or something else is not as it must be.
        SetupError: torch is not installed.
    """
    folders = [PredictionFolder(Path(path)) for path in predictions]
    names = tuple((SENSOR_BASELINES if not folders else ()) if baselines is None else baselines)
    unknown = [name for name in names if name not in SENSOR_BASELINES]
    if unknown:
        raise ArgumentError("baseline", f"must be one of {', '.join(SENSOR_BASELINES)}, not {unknown[0]}")
    frames = open_task_frames(folder, SENSOR_OUTPUTS, split)
    twins = _twins(frames.test)
    if len(twins) < 2 or twin not in twins:
        problem = f"must be the number of one of two twins or more; the test frames have {sorted(twins)}"
        raise ArgumentError("twin", problem)
    if names and out is None:
        raise ArgumentError("out", "must be a folder for the trained networks")
    scores: list[Score] = []
    for name in names:
        assert out is not None
        segment = _train_baseline(name, frames, twin, Path(out), options, on_training)
        scores += score_twins(name, segment, frames.test, twin)
    for one in folders:
        scores += score_twins(one.name, _reader(one), frames.test, twin)
    return _result(frames, scores, twin)


def score_twins(name: str, segment: SegmentImage, test: TaskFrames, twin: int) -> list[Score]:
    """IoU of each class on the twin that a method learned from, on the others, and the gap."""
    matrices = {number: np.zeros((len(CLASSES), len(CLASSES)), np.int64) for number in _twins(test)}
    images = test.images().select("colour", "classes")
    for position, index in enumerate(test.indices):
        image = images[position]
        assert image.classes is not None
        truth = CLASSES.indices(image.classes)
        found = confusion_matrix(truth, segment(index, image), len(CLASSES))
        matrices[twin_number(test, index)] += found
    parts = {"own": matrices[twin], "other": sum(matrix for key, matrix in matrices.items() if key != twin)}
    scores = [Score(name, part, _iou_values(np.asarray(matrix))) for part, matrix in parts.items()]
    gap = {key: value - scores[1].values[key] for key, value in scores[0].values.items()}
    each = [
        Score(name, f"twin {number}", _iou_values(matrix))
        for number, matrix in matrices.items()
        if number != twin
    ]
    return [*scores, Score(name, "gap", gap), *(each if len(each) > 1 else [])]


def twin_number(frames: TaskFrames, index: int) -> int:
    """The number of the twin that a frame belongs to."""
    plan = frames.plan
    return int(index // (plan["frames"] * plan.get("cameras", 1)) % plan.get("twins", 1))


def _twins(frames: TaskFrames) -> list[int]:
    return sorted({twin_number(frames, index) for index in frames.indices})


def _iou_values(matrix: NDArray[np.int64]) -> dict[str, float]:
    values = intersection_over_union(matrix).tolist()
    return {
        "mean": float(mean_intersection_over_union(matrix)),
        **dict(zip(CLASSES.names, values, strict=True)),
    }


def _reader(folder: PredictionFolder) -> SegmentImage:
    return lambda index, image: folder.read_classes(index, image.size, len(OrganClass))


def _train_baseline(
    name: str,
    frames: TaskSplit,
    twin: int,
    out: Path,
    options: TrainingOptions | None,
    on_training: OnTraining | None,
) -> SegmentImage:
    """Train the network of a baseline, or resume its training."""
    from pepperscene.learning.training.run import train

    baseline = SENSOR_BASELINES[name]
    chosen = frames.train
    if not baseline.all_twins:
        own = tuple(index for index in chosen.indices if twin_number(chosen, index) == twin)
        chosen = replace(chosen, indices=own)
    if not len(chosen):
        raise InputError(frames.test.dataset.folder, f"has no frames of twin {twin} to train on")
    model = train(
        [chosen.images()],
        out / name,
        replace(options or TRAINING, augmentation=baseline.augmentation),
        resume=True,
        on_progress=None if on_training is None else lambda progress: on_training(name, progress),
    )

    def segment(_: int, image: LabelledImage) -> NDArray[np.uint8]:
        assert image.colour is not None
        return predict_classes(model, image.colour)

    return segment


def _result(frames: TaskSplit, scores: Sequence[Score], twin: int) -> TaskResult:
    each = (TaskMeasure(name, name, 1, 100.0) for name in CLASSES.names)
    measures = (TaskMeasure("mean", "mean, %", 1, 100.0), *each)
    others = ", ".join(str(number) for number in _twins(frames.test) if number != twin)
    title = f"Segmentation across sensors: {frames.title}, IoU"
    notes = (f"own: twin {twin}; other: twin{'s' if ',' in others else ''} {others}", *frames.notes)
    return TaskResult("cross_sensor", title, measures, tuple(scores), "images of", notes)

"""The networks of the experiments: in which order they are trained, and what each is tested on."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from pepperscene.atomic import write_json
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.document import parse_json
from pepperscene.errors import InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.evaluate import evaluate
from pepperscene.learning.experiments.sets import ExperimentSets
from pepperscene.learning.models.trained_model import TrainedModel, load_model
from pepperscene.learning.options import ExperimentOptions, TrainingOptions, TrainingProgress
from pepperscene.learning.training.loop import LOG_FILE, read_log
from pepperscene.learning.training.run import train
from pepperscene.user_files import read_file

MERGED: Final = "A_merged"
"""Key of the result of experiment A in the classes of the others."""

TITLES: Final = MappingProxyType(
    {
        "A": "synthetic, tested on synthetic",
        MERGED: "synthetic, tested on synthetic, in the classes of photographs",
        "B": "synthetic, tested on real",
        "C": "real only",
        "D": "unrelated, fine-tuned on real",
        "E": "synthetic, fine-tuned on real",
    }
)
"""Experiments of section 2.8 of the paper, by key."""

NO_OTHER: Final = "no unrelated set or model was named (--other)"


TRAININGS: Final = "trainings"
TESTS: Final = "tests"
TIMES: Final = "times.json"


@dataclass(frozen=True, eq=False)
class NetworkTest:
    """Sets that test a network together, in an experiment of `TITLES`, and the classes; None for its own."""

    experiment: str
    images: tuple[ImageSet, ...]
    classes: ClassTable | None = None


@dataclass(frozen=True, eq=False)
class NetworkJob:
    """A network to train and to test.

    Attributes:
        name: of its folder.
        experiment: key of `TITLES`, or "D start" for the unrelated training.
        seed: number of the network among its kind, from 1.
        fold: of the photographs, from 1; None for a training without them.
        options: of the training.
        images, validation: sets of the training.
        start: name of the job, or path of the model, whose weights it starts from; None for random ones.
        tests: what the network is tested on.
    """

    name: str
    experiment: str
    seed: int
    fold: int | None
    options: TrainingOptions
    images: tuple[ImageSet, ...]
    validation: tuple[ImageSet, ...] = ()
    start: str | Path | None = None
    tests: tuple[NetworkTest, ...] = ()

    def describe(self, experiment: str) -> str:
        """Seed, fold and an experiment in words."""
        fold = "" if self.fold is None else f", fold {self.fold}"
        return f"seed {self.seed}{fold}, experiment {experiment}"


def schedule_jobs(
    sets: ExperimentSets, options: ExperimentOptions, other: ImageSet | Path | None
) -> tuple[NetworkJob, ...]:
    """All jobs; each comes after the one that it starts from."""
    jobs: list[NetworkJob] = []
    classes = ClassTable.parse(options.classes)
    for seed in range(1, options.seeds + 1):
        synthetic = _synthetic_jobs(sets, options, classes, seed)
        jobs += synthetic
        unrelated: str | Path | None = other if isinstance(other, Path) else None
        if isinstance(other, ImageSet):
            unrelated = f"seed{seed}_D_start"
            jobs.append(NetworkJob(unrelated, "D start", seed, None, options.synthetic(seed), (other,)))
        for fold, split in enumerate(sets.folds, start=1):
            scratch, fine = options.from_scratch(seed, fold), options.fine_tuning(seed, fold)
            train, test = (sets.real.take(split.train),), (sets.real.take(split.test),)
            validation = (sets.real.take(split.validation),) if split.validation else ()
            starts = {"C": None, "D": unrelated, "E": synthetic[-1].name}
            for key, start in starts.items():
                if key == "C" or start is not None:
                    name, training = f"seed{seed}_fold{fold}_{key}", scratch if key == "C" else fine
                    tests = (NetworkTest(key, test, classes),)
                    jobs.append(NetworkJob(name, key, seed, fold, training, train, validation, start, tests))
    return tuple(jobs)


def _synthetic_jobs(
    sets: ExperimentSets, options: ExperimentOptions, classes: ClassTable, seed: int
) -> list[NetworkJob]:
    """The networks of A, in all eight classes, and of B, in those of photographs; one if they are equal."""
    synthetic = tuple(item.part("test") for item in sets.synthetic)
    tested = sorted(position for fold in sets.folds for position in fold.test)
    on_real = NetworkTest("B", (sets.real.take(tested),), classes)
    training = options.synthetic(seed)

    train = tuple(item.part("train") for item in sets.synthetic)
    validation = tuple(item.part("validation") for item in sets.synthetic)

    def job(key: str, trained: TrainingOptions, *tests: NetworkTest) -> NetworkJob:
        return NetworkJob(f"seed{seed}_{key}", key, seed, None, trained, train, validation, tests=tests)

    if classes.members == ClassTable.organs().members:
        return [job("A", training, NetworkTest("A", synthetic), on_real)]
    merged = replace(training, classes=options.classes)
    return [
        job("A", training, NetworkTest("A", synthetic)),
        job("B", merged, NetworkTest(MERGED, synthetic, classes), on_real),
    ]


class JobRunner:
    """Trains and tests networks in a folder.

    Args:
        training: options that all jobs share: the device, and whether a `module:factory` may be called.
        on_message: as of `run_experiments`.
    """

    def __init__(
        self,
        out: Path,
        jobs: Sequence[NetworkJob],
        training: TrainingOptions,
        on_message: Callable[[str, bool], None],
    ) -> None:
        self._out, self._jobs, self._training, self._on_message = out, jobs, training, on_message
        self._images = {job.name: _count_images(job) for job in jobs}
        self._left = sum(self._images[job.name] for job in jobs if not self.is_trained(job))

    def run(self) -> None:
        """Train and test all networks that are not there yet."""
        for job in self._jobs:
            if not self.is_trained(job):
                self._train(job)
            for test in job.tests:
                if not self._test_file(job, test).is_file():
                    self._evaluate(job, test)

    def folder(self, job: NetworkJob) -> Path:
        """Folder of a job's training."""
        return self._out / TRAININGS / job.name

    def load(self, job: NetworkJob) -> TrainedModel:
        """The network of a finished job."""
        model = load_model(self.folder(job), factory=job.options.model, allow_code=self._training.allow_code)
        device = self._training.device
        return model if device is None else model.to(device)

    def result(self, job: NetworkJob, test: NetworkTest) -> dict[str, Any]:
        """The evaluation of a finished test, as JSON values."""
        return _read_json(self._test_file(job, test))

    def log(self, job: NetworkJob) -> list[dict[str, Any]]:
        """Loss and validations of a training."""
        return read_log(self.folder(job) / LOG_FILE)

    def times(self) -> dict[str, float]:
        """Seconds that each training and test took."""
        file = self._out / TIMES
        return _read_json(file) if file.is_file() else {}

    def is_trained(self, job: NetworkJob) -> bool:
        """Whether the training of a job has taken its last step."""
        log = self.log(job)
        return bool(log) and log[-1]["step"] == job.options.steps

    def _train(self, job: NetworkJob) -> None:
        start = job.start if not isinstance(job.start, str) else self._out / TRAININGS / job.start
        begin, name = time.monotonic(), job.describe(job.experiment)

        def report(progress: TrainingProgress) -> None:
            seconds = f"{_duration(progress.left_s)} left"
            later = (self._left - self._images[job.name]) / max(progress.images_per_s, 1e-9)
            total = f", {_duration(progress.left_s + later)} for all trainings" if later > 0 else ""
            text = f"{name}: step {progress.step:,} of {progress.steps:,}, {seconds}{total}"
            self._on_message(text, progress.step < progress.steps)

        self._on_message(f"{name}: training", False)
        try:
            train(
                job.images,
                self.folder(job),
                job.options,
                validation=job.validation,
                start=start,
                resume=True,
                on_progress=report,
            )
        finally:
            self._add_time(job.name, time.monotonic() - begin)
        self._left -= self._images[job.name]

    def _evaluate(self, job: NetworkJob, test: NetworkTest) -> None:
        name = job.describe(test.experiment)
        self._on_message(f"{name}: testing on {sum(map(len, test.images)):,} images", False)
        begin = time.monotonic()
        evaluation = evaluate(
            self.load(job),
            test.images,
            classes=test.classes,
            on_progress=lambda done, total: self._on_message(f"{name}: image {done:,} of {total:,}", True),
        )
        self._add_time(self._test_file(job, test).stem, time.monotonic() - begin)
        self._test_file(job, test).parent.mkdir(exist_ok=True)
        write_json(self._test_file(job, test), evaluation.to_json())

    def _test_file(self, job: NetworkJob, test: NetworkTest) -> Path:
        return self._out / TESTS / f"{job.name}_tests_{test.experiment}.json"

    def _add_time(self, name: str, seconds: float) -> None:
        times = self.times()
        write_json(self._out / TIMES, {**times, name: round(times.get(name, 0.0) + seconds, 3)})


def _count_images(job: NetworkJob) -> int:
    options = job.options.completed()
    return (options.steps or 0) * (options.batch or 0)


def _duration(seconds: float) -> str:
    """Hours, minutes or seconds."""
    if seconds >= 3600:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 60:.0f} min" if seconds >= 120 else f"{seconds:.0f} s"


def _read_json(file: Path) -> dict[str, Any]:
    try:
        content = parse_json(read_file(file, "json"))
    except (InputError, ValueError):
        raise InputError(file, "cannot be read; remove it to test the network again") from None
    if not isinstance(content, Mapping):
        raise InputError(file, "is damaged; remove it to test the network again")
    return dict(content)

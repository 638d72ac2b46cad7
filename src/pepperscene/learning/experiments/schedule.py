"""The networks of the experiments in the order in which they are trained, and what each is tested on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.experiments.sets import ExperimentSets
from pepperscene.learning.options import ExperimentOptions, TrainingOptions

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


@dataclass(frozen=True, eq=False)
class NetworkTest:
    """Images that test a network.

    Attributes:
        experiment: key of `TITLES`.
        images: sets that are evaluated together.
        classes: to which the network's are merged; None for its own.
    """

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

    def describe(self) -> str:
        """Seed, fold and experiment in words."""
        fold = "" if self.fold is None else f", fold {self.fold}"
        return f"seed {self.seed}{fold}, experiment {self.experiment}"


def schedule_jobs(
    sets: ExperimentSets, options: ExperimentOptions, other: ImageSet | Path | None
) -> tuple[NetworkJob, ...]:
    """All jobs; each comes after the one that it starts from."""
    jobs: list[NetworkJob] = []
    classes = ClassTable.parse(options.classes)
    for seed in range(1, options.seeds + 1):
        synthetic = _synthetic_job(sets, options, classes, seed)
        jobs.append(synthetic)
        start = other if isinstance(other, Path) else None
        if isinstance(other, ImageSet):
            unrelated = NetworkJob(
                f"seed{seed}_D_start", "D start", seed, None, options.synthetic(seed), (other,)
            )
            jobs.append(unrelated)
        for fold in range(1, len(sets.folds) + 1):
            scratch, fine = options.from_scratch(seed, fold), options.fine_tuning(seed, fold)
            jobs.append(_real_job("C", sets, classes, seed, fold, scratch, None))
            if other is not None:
                origin = start or unrelated.name
                jobs.append(_real_job("D", sets, classes, seed, fold, fine, origin))
            jobs.append(_real_job("E", sets, classes, seed, fold, fine, synthetic.name))
    return tuple(jobs)


def _synthetic_job(
    sets: ExperimentSets, options: ExperimentOptions, classes: ClassTable, seed: int
) -> NetworkJob:
    """The network of A and B, which is tested on synthetic images and on all photographs that test."""
    synthetic = tuple(item.part("test") for item in sets.synthetic)
    tested = sorted(position for fold in sets.folds for position in fold.test)
    tests = [NetworkTest("A", synthetic)]
    if classes.members != ClassTable.organs().members:
        tests.append(NetworkTest(MERGED, synthetic, classes))
    tests.append(NetworkTest("B", (sets.real.take(tested),), classes))
    return NetworkJob(
        f"seed{seed}_A",
        "A",
        seed,
        None,
        options.synthetic(seed),
        tuple(item.part("train") for item in sets.synthetic),
        tuple(item.part("validation") for item in sets.synthetic),
        tests=tuple(tests),
    )


def _real_job(
    experiment: str,
    sets: ExperimentSets,
    classes: ClassTable,
    seed: int,
    fold: int,
    options: TrainingOptions,
    start: str | Path | None,
) -> NetworkJob:
    """A network that is trained on the photographs of a fold and tested on its others."""
    split = sets.folds[fold - 1]
    return NetworkJob(
        f"seed{seed}_fold{fold}_{experiment}",
        experiment,
        seed,
        fold,
        options,
        (sets.real.take(split.train),),
        (sets.real.take(split.validation),) if split.validation else (),
        start,
        (NetworkTest(experiment, (sets.real.take(split.test),), classes),),
    )

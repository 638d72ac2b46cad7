"""Running the experiments: trainings and evaluations, each of which is resumed after an interruption."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

from pepperscene.dataset import BuildProgress
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.store.atomic import check_can_create, write_error, write_json
from pepperscene.errors import ArgumentError, InputError, OutputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.evaluate import evaluate
from pepperscene.learning.experiment_options import ExperimentOptions
from pepperscene.learning.experiments.images import RealFold, SyntheticImages, real_folds, synthetic_images
from pepperscene.learning.experiments.results import Results, combine, matrices_of
from pepperscene.learning.models.trained_model import TrainedModel, load_model
from pepperscene.learning.training.checkpoint import STATE_FILE
from pepperscene.learning.training.loop import LOG_FILE, TrainingProgress, train
from pepperscene.learning.training_options import TrainingOptions
from pepperscene.version import __version__

SETTINGS: Final = "settings.json"

NOT_RUN_D: Final = "D was not run: it starts from an unrelated set or model, which --other names"

_LINE_S: Final = 20.0  # chosen: seconds between lines of a training


@dataclass(frozen=True, eq=False)
class ExperimentRun:
    """All that the page shows.

    Attributes:
        out: folder of sets, models and evaluations.
        options: with all values filled in.
        results: of each experiment that was run, by its letter.
        synthetic, folds: the images.
        logs: entries of the log of each training, by its name.
        notes: what a reader should know, as sentences.
    """

    out: Path
    options: ExperimentOptions
    results: Mapping[str, Results]
    synthetic: tuple[SyntheticImages, ...]
    folds: tuple[RealFold, ...]
    logs: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def model(self, name: str) -> TrainedModel:
        """A trained network, such as "A-seed0" or "E-fold1-seed0"."""
        return load_model(self.out / "models" / name)


def run_experiments(
    sources: Sequence[str],
    real: ImageSet,
    out: str | Path,
    options: ExperimentOptions | None = None,
    *,
    other: str | Path | None = None,
    device: str | None = None,
    on_line: Callable[[str], None] | None = None,
) -> ExperimentRun:
    """Run the experiments A to E of section 2.8 of the paper, end to end.

    A: trained and tested on synthetic images, of plants never seen. B: the networks of A, tested on real
    images. C: trained on real images alone. D: started from an unrelated set, then adapted to real images.
    E: the networks of A, adapted to real images. The network of A is the best one by a validation on
    synthetic images; all others are those after their last step, so that no real test image has a part in
    any choice.

    The same call goes on after an interruption: frames, trainings and evaluations that are complete are kept.

    Args:
        sources: recipes by name or file, which are built, or folders of sets.
        real: labelled photographs.
        out: new or empty folder, or that of an earlier call with the same arguments.
        options: see `ExperimentOptions`.
        other: a set, or a trained model, to start D from.
        device: of torch; None for a GPU if there is one.
        on_line: called with lines of progress.

    Raises:
        InputError: a recipe or set cannot be used, or the folder holds other experiments.
    """
    if len(set(sources)) < len(sources) or not sources:
        raise ArgumentError("recipes", "must be one or more recipes or sets, each once")
    folder, chosen = Path(out), (options or ExperimentOptions()).completed()
    settings = {
        "version": __version__,
        "options": chosen.as_record(),
        "sources": list(sources),
        "real": {"name": real.name, "images": len(real)},
        "other": None if other is None else str(other),
    }
    _check_settings(folder, settings)
    try:
        return _Runner(folder, chosen, device, on_line or _ignore).run(sources, real, other)
    except OSError as error:
        raise write_error(error, folder) from None


class _Runner:
    """Trainings and evaluations in a folder."""

    def __init__(
        self, out: Path, options: ExperimentOptions, device: str | None, on_line: Callable[[str], None]
    ) -> None:
        self.out, self.options, self.device, self.on_line = out, options, device, on_line
        self.real_classes = ClassTable.parse(options.classes)

    def run(self, sources: Sequence[str], real: ImageSet, other: str | Path | None) -> ExperimentRun:
        """All experiments, seed by seed."""
        folds = real_folds(real)
        synthetic = tuple(
            synthetic_images(source, self.out / "sets", self.options, self._report_frame)
            for source in sources
        )
        records: dict[str, list[list[Any]]] = {letter: [] for letter in "ABCDE" if letter != "D" or other}
        for seed in range(self.options.seeds):
            for letter, matrices in self._run_seed(seed, synthetic, folds, other).items():
                records[letter].append(matrices)
        tables = dict.fromkeys(records, self.real_classes) | {"A": ClassTable.organs()}
        results = {letter: combine(letter, tables[letter], found) for letter, found in records.items()}
        notes = [images.note for images in synthetic]
        notes += [] if other else [NOT_RUN_D]
        return ExperimentRun(self.out, self.options, results, synthetic, folds, self._logs(), tuple(notes))

    def _run_seed(
        self,
        seed: int,
        synthetic: Sequence[SyntheticImages],
        folds: Sequence[RealFold],
        other: str | Path | None,
    ) -> dict[str, list[Any]]:
        """Matrices of each fold, by experiment."""
        options, name_a = self.options, f"A-seed{seed}"
        scratch = self._training(seed, options.steps, options.learning_rate)
        adapted = self._training(seed, options.fine_steps, options.fine_rate, self.options.classes)

        def train_a() -> TrainedModel:
            parts = [images.training for images in synthetic]
            return self._train(name_a, parts, scratch, [images.validation for images in synthetic])

        def train_d() -> TrainedModel:
            assert other is not None
            return self._other_model(Path(other), scratch, f"D-start-seed{seed}")

        # A, and B by the same network.
        found: dict[str, list[Any]] = {
            "A": [
                self._evaluate(name_a, train_a, [images.test for images in synthetic], ClassTable.organs())
            ],
            "B": [],
            "C": [],
            "E": [],
            **({"D": []} if other else {}),
        }
        alone = self._training(seed, options.real_steps, options.learning_rate, options.classes)
        starts = {"E": train_a, **({"D": train_d} if other else {})}
        for number, fold in enumerate(folds, start=1):
            place = f"fold{number}-seed{seed}"
            found["B"].append(self._evaluate(f"B-{place}", train_a, [fold.test], self.real_classes))
            # C: real images alone.
            train_c = partial(self._train, f"C-{place}", [fold.training], alone)
            found["C"].append(self._evaluate(f"C-{place}", train_c, [fold.test], self.real_classes))
            # D and E: adapted to real images.
            for letter, start in starts.items():
                adapt = partial(self._adapt, f"{letter}-{place}", [fold.training], adapted, start)
                found[letter].append(
                    self._evaluate(f"{letter}-{place}", adapt, [fold.test], self.real_classes)
                )
        return found

    def _training(
        self, seed: int, steps: int | None, rate: float | None, classes: str | None = None
    ) -> TrainingOptions:
        options = self.options
        return TrainingOptions(
            model=options.model,
            classes=classes,
            steps=steps,
            batch=options.batch,
            size=options.crop,
            width=options.size[0],
            learning_rate=rate,
            augmentation=options.augmentation,
            seed=seed,
        )

    def _train(
        self,
        name: str,
        sets: Sequence[ImageSet],
        options: TrainingOptions,
        validation: Sequence[ImageSet] = (),
        start: TrainedModel | None = None,
    ) -> TrainedModel:
        """A network, trained or read."""
        shown = [float("-inf")]

        def report(progress: TrainingProgress) -> None:
            now = time.monotonic()
            if now - shown[0] >= _LINE_S or progress.step == progress.steps:
                shown[0] = now
                text = (
                    f"training {name}: step {progress.step:,} of {progress.steps:,}, loss {progress.loss:.3f}"
                )
                self.on_line(f"{text}, {progress.images_per_s:.1f} images/s, {progress.left_s:.0f} s left")

        folder = self.out / "models" / name
        return train(
            sets,
            folder,
            options,
            validation=validation,
            start=start,
            resume=True,
            device=self.device,
            on_progress=report,
        )

    def _adapt(
        self,
        name: str,
        sets: Sequence[ImageSet],
        options: TrainingOptions,
        start: Callable[[], TrainedModel],
    ) -> TrainedModel:
        """A network that starts from another one."""
        return self._train(name, sets, options, start=start())

    def _other_model(self, other: Path, options: TrainingOptions, name: str) -> TrainedModel:
        """The model that D starts from: a trained one, or one trained on the unrelated set."""
        if other.is_file() or (other / STATE_FILE).is_file():
            return load_model(other)
        return self._train(name, [open_images(other)], options)

    def _evaluate(
        self, name: str, network: Callable[[], TrainedModel], sets: Sequence[ImageSet], classes: ClassTable
    ) -> dict[str, Any]:
        """Matrices of the images, measured or read."""
        file = self.out / "evaluations" / f"{name}.json"
        if file.is_file():
            content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
            return content
        model = network()
        matrices = matrices_of(evaluate(model, sets, classes=classes))
        file.parent.mkdir(parents=True, exist_ok=True)
        write_json(file, matrices)
        self.on_line(f"evaluated {name}")
        return matrices

    def _logs(self) -> dict[str, list[Any]]:
        """Entries of the log of each training."""
        logs = sorted((self.out / "models").glob(f"*/{LOG_FILE}"))
        return {
            log.parent.name: [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
            for log in logs
        }

    def _report_frame(self, progress: BuildProgress) -> None:
        if progress.done % 20 == 0 or progress.done == progress.total:
            left = "" if progress.left_s is None else f", {progress.left_s:.0f} s left"
            self.on_line(f"rendering: {progress.done} of {progress.total} frames{left}")


def _check_settings(folder: Path, settings: Mapping[str, Any]) -> None:
    """Write the settings into a new folder, or compare them with those of an earlier call."""
    check_can_create(folder)
    file = folder / SETTINGS
    if not file.is_file():
        if folder.is_dir() and any(folder.iterdir()):
            raise OutputError(f"{folder}: is not empty and holds no experiments; choose another folder")
        folder.mkdir(parents=True, exist_ok=True)
        write_json(file, settings)
        return
    found = json.loads(file.read_text(encoding="utf-8"))
    for key, value in settings.items():
        if found.get(key) != value:
            problem = f"is {found.get(key)!r} there and {value!r} here; choose another folder"
            raise InputError(file, f"holds other experiments: {key} {problem}")


def _ignore(line: str) -> None:
    pass

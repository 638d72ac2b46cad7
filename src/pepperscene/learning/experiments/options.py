"""Options of the experiments."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Self

from pepperscene.errors import ArgumentError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable
from pepperscene.learning.training_options import TrainingOptions

_FINE_RATE: Final = 0.2  # chosen: part of the learning rate, so that what was learned is not lost at once
_FINE_STEPS: Final = 0.25  # chosen: part of the steps; a few dozen photographs are seen often enough


@dataclass(frozen=True)
class ExperimentOptions:
    """Options of the experiments; those that are None are derived from the others.

    Attributes:
        training: of experiment A; the other trainings differ in classes, steps and learning rate. Its seed
            and classes are not used.
        classes: text for `ClassTable.parse` of experiments B to E.
        seeds: number of networks of each kind, with the seeds 1, 2 and so on.
        frames: number of frames that are built, of all recipes together.
        size: height and width in pixels of the frames that are built.
        quality: of the frames that are built.
        real_steps: of experiment C; None for as many as of A.
        fine_steps: of fine-tuning (D and E); None for a quarter of those of A.
        fine_rate: learning rate of fine-tuning; None for a fifth of that of A.
    """

    training: TrainingOptions = TrainingOptions()  # noqa: RUF009 - frozen
    classes: str = FRUIT_CLASSES
    seeds: int = 3
    frames: int = 1000
    size: tuple[int, int] = (300, 400)
    quality: str = "standard"
    real_steps: int | None = None
    fine_steps: int | None = None
    fine_rate: float | None = None

    def completed(self) -> Self:
        """The options with all values filled in.

        Raises:
            ArgumentError: an option is not allowed.
        """
        training = _completed_training(replace(self.training, classes=None, seed=1))
        assert training.steps is not None
        assert training.learning_rate is not None
        fine_steps, fine_rate = self.fine_steps, self.fine_rate
        filled = replace(
            self,
            training=training,
            classes=str(ClassTable.parse(self.classes)),
            real_steps=training.steps if self.real_steps is None else self.real_steps,
            fine_steps=max(1, round(_FINE_STEPS * training.steps)) if fine_steps is None else fine_steps,
            fine_rate=_FINE_RATE * training.learning_rate if fine_rate is None else fine_rate,
        )
        filled._check()
        return filled

    def _check(self) -> None:
        for name, least in (("seeds", 1), ("frames", 3), ("real_steps", 1), ("fine_steps", 1)):
            if getattr(self, name) < least:
                raise ArgumentError(name, f"must be {least} or more, not {getattr(self, name)}")
        if min(self.size) < 1:
            raise ArgumentError("size", f"must be two numbers of pixels, 1 or more, not {self.size}")
        rate = self.fine_rate
        if rate is None or not (math.isfinite(rate) and rate > 0):
            raise ArgumentError("fine_rate", f"must be above 0, not {rate}")
        # The options of all trainings are checked before the first frame is built.
        self.from_scratch(1, 1).completed()
        self.fine_tuning(1, 1).completed()

    def synthetic(self, seed: int) -> TrainingOptions:
        """Options of a training on synthetic images, in all eight classes."""
        return replace(self.training, seed=seed)

    def from_scratch(self, seed: int, fold: int) -> TrainingOptions:
        """Options of a training on real images alone."""
        return self._on_real(seed, fold, self.real_steps, self.training.learning_rate)

    def fine_tuning(self, seed: int, fold: int) -> TrainingOptions:
        """Options of fine-tuning on real images."""
        return self._on_real(seed, fold, self.fine_steps, self.fine_rate)

    def _on_real(self, seed: int, fold: int, steps: int | None, rate: float | None) -> TrainingOptions:
        # Folds have seeds of their own, or else both would draw the same numbers.
        return replace(
            self.training,
            classes=self.classes,
            steps=steps,
            learning_rate=rate,
            seed=1000 * fold + seed,
            validate=max(1, (steps or 1) // 10),
        )

    def as_record(self) -> dict[str, Any]:
        """The options as JSON values."""
        record: Mapping[str, Any] = vars(self)
        return {**record, "training": self.training.as_record(), "size": list(self.size)}


def _completed_training(options: TrainingOptions) -> TrainingOptions:
    """Complete the options of A; "size" is that of frames here, and that of the crops has another name."""
    try:
        return options.completed()
    except ArgumentError as error:
        if error.where != "size":
            raise
        raise ArgumentError("crop", error.problem) from None

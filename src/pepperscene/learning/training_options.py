"""Options of a training."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Final, Self

from pepperscene.errors import ArgumentError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.model_names import model_defaults

SCHEDULES: Final = ("constant", "cosine")
PRECISIONS: Final = ("auto", "float32", "bfloat16")

_SEEDS: Final = 2**32  # chosen: seeds times steps fit into the 64 bits of torch's generator
LEAST_SIDE: Final = 32  # chosen: two cells of the coarsest layer of the models
MOST_SIDE: Final = 8192  # chosen: a network takes some 20 GB for a square of that side
_MOST_BATCH: Final = 4096  # chosen: far beyond the batches of such networks


@dataclass(frozen=True)
class TrainingOptions:
    """Options of a training; those that are None are the model's defaults.

    Attributes:
        model: text for `build_model`.
        classes: text for `ClassTable.parse`; None for all eight classes.
        steps: of the optimiser.
        batch: images per step.
        size: height and width in pixels of the crops that the network sees.
        width: to which images are scaled before they are cropped, and later before they are segmented; None
            to keep their own.
        learning_rate: of Adam, whose other parameters are the paper's (.9, .999, 1e-8).
        schedule: of the learning rate: "constant", or "cosine": a warm-up of a twentieth of the steps, then
            half a cosine down to zero.
        balance: the loss weights a class by its frequency to the power of minus this; 0 for equal weights.
        augmentation: strength of random changes of crops: 0 for none, 1 for the usual ones.
        seed: of weights, crops and dropout.
        validate: number of steps between validations and checkpoints; None for a tenth of all.
        precision: "float32", "bfloat16", or "auto": bfloat16 where the processor has instructions for it.
    """

    model: str = "small"
    classes: str | None = None
    steps: int | None = None
    batch: int | None = None
    size: tuple[int, int] = (256, 256)
    width: int | None = 400
    learning_rate: float | None = None
    schedule: str | None = None
    balance: float | None = None
    augmentation: float = 1.0
    seed: int = 0
    validate: int | None = None
    precision: str = "auto"

    def completed(self) -> Self:
        """The options with the model's defaults filled in.

        Raises:
            ArgumentError: an option is not allowed.
        """
        defaults = model_defaults(self.model)
        values = {
            name: getattr(defaults, name)
            for name in ("steps", "batch", "learning_rate", "schedule", "balance")
            if getattr(self, name) is None
        }
        filled = replace(self, classes=str(ClassTable.parse(self.classes)), **values)
        if filled.validate is None and filled.steps is not None:
            filled = replace(filled, validate=max(1, filled.steps // 10))
        filled._check()
        return filled

    def _check(self) -> None:
        for name in ("steps", "validate"):
            _require(name, getattr(self, name), getattr(self, name) >= 1, "1 or more")
        _require("batch", self.batch, 1 <= (self.batch or 0) <= _MOST_BATCH, f"1 to {_MOST_BATCH}")
        sides = f"{LEAST_SIDE} to {MOST_SIDE}"
        _require("width", self.width, self.width is None or LEAST_SIDE <= self.width <= MOST_SIDE, sides)
        is_allowed = LEAST_SIDE <= min(self.size) <= max(self.size) <= MOST_SIDE
        _require("size", self.size, is_allowed, f"two numbers of pixels, {sides}")
        rate = self.learning_rate
        _require("learning_rate", rate, rate is not None and math.isfinite(rate) and rate > 0, "above 0")
        _require("schedule", self.schedule, self.schedule in SCHEDULES, " or ".join(SCHEDULES))
        _require("balance", self.balance, 0 <= (self.balance or 0) <= 1, "0 to 1")
        _require("augmentation", self.augmentation, 0 <= self.augmentation <= 2, "0 to 2")
        _require("seed", self.seed, 0 <= self.seed < _SEEDS, f"0 to {_SEEDS - 1}")
        _require("precision", self.precision, self.precision in PRECISIONS, ", ".join(PRECISIONS))

    def as_record(self) -> dict[str, Any]:
        """The options as JSON values."""
        return {**asdict(self), "size": list(self.size)}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Self:
        """The options that `as_record` made; raises `KeyError` if one is missing."""
        values = {field.name: record[field.name] for field in fields(cls)}
        return cls(**{**values, "size": tuple(values["size"])})


def _require(name: str, value: object, allowed: bool, what: str) -> None:
    if not allowed:
        raise ArgumentError(name, f"must be {what}, not {value!r}")

"""Options of the experiments A to E."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Self

from pepperscene.errors import ArgumentError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable
from pepperscene.learning.model_names import model_defaults

_FINE_STEPS: Final = 0.25
"""Steps of fine-tuning, relative to a training. Chosen: six photographs are learnt in some hundred steps."""
_FINE_RATE: Final = 0.2
"""Its learning rate, relative to a training. Chosen: what was learnt before is adapted, not replaced."""


@dataclass(frozen=True)
class ExperimentOptions:
    """Options of the experiments; those that are None follow from the model.

    Attributes:
        frames: of each recipe, spread evenly over its scenes.
        size: width and height of the frames in pixels.
        quality: of rendering.
        classes: of experiments B to E, which the real masks must know.
        seeds: number of repetitions with other random weights and crops.
        model: text for `build_model`.
        steps: of a training on synthetic images; None for the model's.
        real_steps: of a training on real images alone (C); None for as many as `steps`.
        fine_steps: of fine-tuning (D, E); None for a quarter of `steps`.
        learning_rate: of a training; None for the model's.
        fine_rate: learning rate of fine-tuning; None for a fifth of a training's.
        batch: images per step; None for the model's.
        augmentation: strength of random changes of images.
        crop: height and width of the crops in pixels.
    """

    frames: int = 600
    size: tuple[int, int] = (400, 300)
    quality: str = "standard"
    classes: str = FRUIT_CLASSES
    seeds: int = 3
    model: str = "small"
    steps: int | None = None
    real_steps: int | None = None
    fine_steps: int | None = None
    learning_rate: float | None = None
    fine_rate: float | None = None
    batch: int | None = None
    augmentation: float = 1.0
    crop: tuple[int, int] = (256, 256)

    def completed(self) -> Self:
        """The options with all values filled in; raises `ArgumentError` if one is not allowed."""
        defaults = model_defaults(self.model)
        steps = self.steps or defaults.steps
        rate = self.learning_rate or defaults.learning_rate
        for name, least in (("frames", 3), ("seeds", 1)):
            if getattr(self, name) < least:
                raise ArgumentError(name, f"must be {least} or more, not {getattr(self, name)}")
        return replace(
            self,
            classes=str(ClassTable.parse(self.classes)),
            steps=steps,
            real_steps=self.real_steps or steps,
            fine_steps=self.fine_steps or max(1, round(_FINE_STEPS * steps)),
            learning_rate=rate,
            fine_rate=self.fine_rate or _FINE_RATE * rate,
            batch=self.batch or defaults.batch,
        )

    def as_record(self) -> dict[str, Any]:
        """The options as JSON values."""
        return {**asdict(self), "size": list(self.size), "crop": list(self.crop)}

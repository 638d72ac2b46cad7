"""Options of trainings and of the experiments, and the progress of a training; without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Annotated, Any, Final, Self

from pepperscene.classes import OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable
from pepperscene.options import NestedOptions, Option, check_options

LEAST_SIDE: Final = 32  # chosen: two cells of the coarsest layer of the models
MOST_SIDE: Final = 8192  # chosen: a network takes some 20 GB for a square of that side
_MOST_BATCH: Final = 4096  # chosen: far beyond the batches of such networks
_MOST_SEED: Final = 2**32 - 1  # chosen: seeds times steps fit into the 64 bits of torch's generator


_OTHER: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "steps": 2000,
        "batch": 8,
        "learning_rate": 1e-3,
        "schedule": "cosine",
        "balance": 0.5,
        "lovasz": 1.0,
    }
)
"""Training of a model of the user's, unless options say otherwise. Chosen: as `small`, at half the rate."""

MODELS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        # Chosen: 16,000 crops take less than half an hour on two cores.
        "small": {**_OTHER, "learning_rate": 2e-3},
        # Chosen: as `small`, at half the rate, so that weights learned on photographs change little.
        "efficientnet_lite0": _OTHER,
        # Section 2.8 of the paper.
        "deeplab_vgg16": {
            "steps": 30_000,
            "batch": 10,
            "learning_rate": 5e-5,
            "schedule": "constant",
            "balance": 0.0,
            "lovasz": 0.0,
        },
    }
)
"""Models of this package by name, with the options of the training that suits them."""


def model_name(model: str) -> str:
    """The name in a text as for `build_model`, without its options."""
    return model.partition(",")[0].strip()


def is_built_in(model: str) -> bool:
    """Whether a text as for `build_model` names a model of this package."""
    return model_name(model) in MODELS


TASKS: Final = ("segment", "detect")
"""What a network can be trained for."""

MEASURES: Final = {"segment": "mean_iou", "detect": "ap50"}
"""By which validations choose the best state of a network for each task: a field of `TrainingProgress`."""

FRUIT_OBJECTS: Final = "fruit=pepper,peduncle"
"""Classes of a detector, unless options say otherwise."""

DECIDED_SCORE: Final = 0.3
"""From which a detection is an object. Chosen: scores of centres are lower than probabilities of pixels."""


def parse_classes(task: str, text: str | None) -> ClassTable:
    """The classes of a network, of a text as for `ClassTable.parse` or None for the default of the task.

    Raises:
        ArgumentError: the text is not valid, or the background is one of the objects of a detector.
    """
    if task != "detect":
        return ClassTable.parse(text)
    table = ClassTable.parse(text or FRUIT_OBJECTS, least=1)
    if any(int(OrganClass.BACKGROUND) in members for members in table.members):
        raise ArgumentError("classes", "must be classes of objects for a detector, without the background")
    return table


@dataclass(frozen=True)
class TrainingOptions:
    """Options of a training; those that are None are the model's defaults.

    Attributes:
        model: text for `build_model`; a detector is made of `small` or `efficientnet_lite0`.
        classes: text for `ClassTable.parse`; None for all eight classes, or for fruit and peduncles.
        size: height and width in pixels of the crops that the network sees.
        width: to which images are scaled before they are cropped, and later before they are segmented; None
            to keep their own.
        learning_rate: of Adam, whose other parameters are the paper's (.9, .999, 1e-8).
        schedule: of the learning rate: "constant", or "cosine": a warm-up of a twentieth of the steps, then
            half a cosine down to zero.
        balance: the loss weights a class by its frequency to the power of minus this; not that of a detector.
        lovasz: factor of the Lovász-Softmax loss, which is added to the cross-entropy, for a greater IoU of
            rare classes; not that of a detector.
        least_area: least pixels of an object, in images of `width`; smaller ones count neither for nor
            against a detector, because a person would not label them.
        matching: key of `colour_matching.MATCHES`, by which colours come near to those of photographs.
        validate: number of steps between validations and checkpoints; None for a tenth of all.
        precision: "float32", "bfloat16", or "auto": bfloat16 where the processor has instructions for it.
        workers: processes that read images; 0 for this one. They do not change the result.
        device: of torch; None for a GPU if there is one.
        allow_code: whether a model `module:factory` may be imported and called.
        task: "segment" gives each pixel a class; "detect" finds objects, with boxes and masks.
    """

    model: Annotated[
        str,
        Option(
            "small, efficientnet_lite0, deeplab_vgg16 or module:factory, with options: small,width=0.5. "
            "Default: small.",
            "NAME",
            shows_default=False,
        ),
    ] = "small"
    classes: Annotated[
        str | None,
        Option(
            "Classes of the labels (fruit=pepper,other=leaf+stem). Default: all eight (detect: fruit and "
            "peduncle), or --start's.",
            "TEXT",
        ),
    ] = None
    steps: Annotated[int | None, Option("Steps of the optimiser.", "N", minimum=1)] = None
    batch: Annotated[int | None, Option("Images in a step.", "N", minimum=1, maximum=_MOST_BATCH)] = None
    size: Annotated[
        tuple[int, int],
        Option("Size of the crops in pixels.", "WxH", minimum=LEAST_SIDE, maximum=MOST_SIDE),
    ] = (256, 256)
    width: Annotated[
        int | None,
        Option(
            "Width to which images are scaled; 0 keeps their own. Default: 400, or --start's.",
            "PX",
            minimum=LEAST_SIDE,
            maximum=MOST_SIDE,
            none=0,
            shows_default=False,
        ),
    ] = 400
    learning_rate: Annotated[float | None, Option("Learning rate of Adam.", "F", above=0)] = None
    schedule: Annotated[
        str | None,
        Option("Of the learning rate: constant or cosine.", "NAME", choices=("constant", "cosine")),
    ] = None
    balance: Annotated[
        float | None, Option("0 weights all pixels alike, 1 all classes.", "F", minimum=0, maximum=1)
    ] = None
    lovasz: Annotated[
        float | None,
        Option("Part of the loss that is the overlap of classes.", "F", minimum=0, maximum=100),
    ] = None
    least_area: Annotated[
        int, Option("Pixels below which an object is ignored (detect), at the width.", "PX", minimum=1)
    ] = 50  # chosen: a square of 7 x 7, below which persons leave objects out
    augmentation: Annotated[
        float, Option("Strength of random changes of the images, 0 to 2.", "F", minimum=0, maximum=2)
    ] = 1.0
    matching: Annotated[
        str,
        Option(
            "What is matched to the images of --match: statistics of CIELAB, histogram, or transport.",
            "NAME",
            choices=("statistics", "histogram", "transport"),
        ),
    ] = "statistics"
    seed: Annotated[int, Option("Random seed: weights, crops, dropout.", minimum=0, maximum=_MOST_SEED)] = 0
    validate: Annotated[int | None, Option("Steps between validations and checkpoints.", "N", minimum=1)] = (
        None
    )
    precision: Annotated[
        str,
        Option(
            "float32, bfloat16, or auto for the faster one.",
            "NAME",
            choices=("auto", "float32", "bfloat16"),
        ),
    ] = "auto"
    workers: Annotated[int, Option("Processes that read images.", "N", minimum=0, shows_range=True)] = 0
    device: Annotated[str | None, Option("Device of torch, such as cpu or cuda:0.", "NAME")] = None
    allow_code: Annotated[bool, Option("Allow the code of --model module:factory to run.")] = False
    task: Annotated[
        str,
        Option("segment: a class for each pixel; detect: boxes and masks of objects.", "NAME", choices=TASKS),
    ] = "segment"

    def completed(self) -> Self:
        """The options with the model's defaults filled in.

        Raises:
            ArgumentError: an option is not allowed.
        """
        defaults = MODELS.get(model_name(self.model), _OTHER)
        missing = {name: value for name, value in defaults.items() if getattr(self, name) is None}
        filled = replace(self, classes=str(self.table()), **missing)
        if filled.validate is None and filled.steps is not None:
            filled = replace(filled, validate=max(1, filled.steps // 10))
        check_options(filled)
        return filled

    def table(self) -> ClassTable:
        """The classes; raises `ArgumentError` if their text is not allowed."""
        return parse_classes(self.task, self.classes)

    def as_record(self) -> dict[str, Any]:
        """The options that define the result of a training, as JSON values."""
        left_out = _UNRECORDED if self.task == "detect" else (*_UNRECORDED, *_OF_DETECTORS)
        names = [item.name for item in fields(self) if item.name not in left_out]
        return {**{name: getattr(self, name) for name in names}, "size": list(self.size)}


_UNRECORDED: Final = ("workers", "device", "allow_code")
_OF_DETECTORS: Final = ("task", "least_area")

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
        real_steps: of experiment C; None for as many as of A.
        fine_steps: of fine-tuning (D and E); None for a quarter of those of A.
        fine_rate: learning rate of fine-tuning; None for a fifth of that of A.
    """

    training: Annotated[
        TrainingOptions,
        NestedOptions(
            omitted=("task", "classes", "schedule", "balance", "lovasz", "least_area", "seed", "matching"),
            names={"size": "crop"},
            help={
                "model": "Model of the networks, as for `train`.",
                "steps": "Steps on synthetic images. Default: the model's.",
                "size": "Size of training crops in pixels.",
                "width": "Width to which images are scaled; 0 keeps their own.",
                "validate": "Steps between validations of experiments A and B.",
                "allow_code": "Allow the code of recipes and of --model module:factory to run.",
            },
        ),
    ] = TrainingOptions()
    classes: Annotated[
        str,
        Option(
            "Classes of experiments B to E. Default: other, fruit, peduncle.", "TEXT", shows_default=False
        ),
    ] = FRUIT_CLASSES
    seeds: Annotated[int, Option("Networks of each kind.", "N", minimum=1)] = 3
    frames: Annotated[int, Option("Frames to build, of all recipes.", "N", minimum=3)] = 1000
    size: Annotated[tuple[int, int], Option("Size of these frames in pixels.", "WxH", minimum=1)] = (300, 400)
    quality: Annotated[str, Option("Quality of these frames: draft, standard or reference.", "NAME")] = (
        "standard"
    )
    real_steps: Annotated[
        int | None, Option("Steps on real images alone. Default: as --steps.", "N", minimum=1)
    ] = None
    fine_steps: Annotated[
        int | None, Option("Steps of fine-tuning. Default: a quarter of --steps.", "N", minimum=1)
    ] = None
    fine_rate: Annotated[float | None, Option("The same in fine-tuning. Default: a fifth.", "F", above=0)] = (
        None
    )

    def completed(self) -> Self:
        """The options with all values filled in.

        Raises:
            ArgumentError: an option is not allowed.
        """
        try:
            training = replace(self.training, classes=None, seed=1).completed()
        except ArgumentError as error:
            # "size" is that of frames here.
            raise ArgumentError("crop" if error.where == "size" else error.where, error.problem) from None
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
        check_options(filled)
        return filled

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
        return {**vars(self), "training": self.training.as_record(), "size": list(self.size)}


@dataclass(frozen=True)
class TrainingProgress:
    """A finished step of a training.

    Attributes:
        step, steps: number of finished steps, and of all.
        loss: mean over the steps since the last validation or checkpoint.
        images_per_s: since the start or the resumption.
        left_s: estimated time to the end, in seconds.
        mean_iou: of a validation after this step; None if there was none, or no labelled pixel in it.
        ap50: likewise of a detector: the mean AP50 of its masks.
    """

    step: int
    steps: int
    loss: float
    images_per_s: float
    left_s: float
    mean_iou: float | None = None
    ap50: float | None = None

    @property
    def quality(self) -> str:
        """The measure of the validation in words; "" if there is none."""
        values = {"mean IoU": self.mean_iou, "AP50": self.ap50}
        return "".join(f"{name} {value:.3f}" for name, value in values.items() if value is not None)

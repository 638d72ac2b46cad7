"""Commands for networks: train, evaluate and predict."""

from __future__ import annotations

import json as json_text
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pepperscene.cli.application import (
    HalfOption,
    JsonOption,
    LabelsOption,
    app,
    handle_errors,
    print_ruled_table,
)
from pepperscene.cli.progress import image_progress
from pepperscene.cli.training_progress import training_progress
from pepperscene.errors import ArgumentError, InputError, SetupError

if TYPE_CHECKING:
    from pepperscene.learning.class_table import ClassTable
    from pepperscene.learning.evaluation.segmenter import Segmenter

DEFAULT_MODEL = "small"

ModelArgument = Annotated[Path, typer.Argument(metavar="MODEL", help="File of a trained model.")]
FactoryOption = Annotated[
    str | None,
    typer.Option(
        metavar="MODULE:NAME",
        help="Function that makes the model's network, with options, if it was trained with one.",
    ),
]
FactoryCodeOption = Annotated[bool, typer.Option("--allow-code", help="Allow the code of --factory to run.")]
ClassesOption = Annotated[
    str | None,
    typer.Option(
        metavar="TEXT",
        help="Classes that the model's are merged to (fruit=pepper,other=leaf+stem). Default: the model's.",
    ),
]


@app.command()
@handle_errors
def train(
    sets: Annotated[
        list[Path], typer.Argument(metavar="SET...", help="Folders of labelled images, in any layout.")
    ],
    out: Annotated[Path, typer.Option(metavar="MODEL", help="New or empty folder for the model.")],
    validation: Annotated[
        list[Path] | None,
        typer.Option(metavar="SET", help="Images that choose the best state of the network; repeatable."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="small, efficientnet_lite0, deeplab_vgg16 or module:factory, with options: small,width=0.5. "
            "Default: small.",
        ),
    ] = None,
    allow_code: Annotated[
        bool, typer.Option("--allow-code", help="Allow the code of --model module:factory to run.")
    ] = False,
    start: Annotated[
        Path | None, typer.Option(metavar="MODEL", help="Trained model whose weights are adapted.")
    ] = None,
    classes: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            help="Classes of the labels (fruit=pepper,other=leaf+stem). Default: all eight, or --start's.",
        ),
    ] = None,
    steps: Annotated[int | None, typer.Option(metavar="N", help="Steps of the optimiser.")] = None,
    batch: Annotated[int | None, typer.Option(metavar="N", help="Images in a step.")] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the crops in pixels.")] = "256x256",
    width: Annotated[
        int | None,
        typer.Option(
            metavar="PX",
            help="Width to which images are scaled; 0 keeps their own. Default: 400, or --start's.",
        ),
    ] = None,
    learning_rate: Annotated[float | None, typer.Option(metavar="F", help="Learning rate of Adam.")] = None,
    schedule: Annotated[
        str | None, typer.Option(metavar="NAME", help="Of the learning rate: constant or cosine.")
    ] = None,
    balance: Annotated[
        float | None, typer.Option(metavar="F", help="0 weights all pixels alike, 1 all classes.")
    ] = None,
    augmentation: Annotated[
        float, typer.Option(metavar="F", help="Strength of random changes of the images, 0 to 2.")
    ] = 1.0,
    validate: Annotated[
        int | None, typer.Option(metavar="N", help="Steps between validations and checkpoints.")
    ] = None,
    precision: Annotated[
        str, typer.Option(metavar="NAME", help="float32, bfloat16, or auto for the faster one.")
    ] = "auto",
    seed: Annotated[int, typer.Option(help="Random seed: weights, crops, dropout.")] = 0,
    workers: Annotated[int, typer.Option(min=0, metavar="N", help="Processes that read images.")] = 0,
    device: Annotated[
        str | None, typer.Option(metavar="NAME", help="Device of torch, such as cpu or cuda:0.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Resume the training in the folder.")] = False,
    labels: LabelsOption = None,
    half: HalfOption = None,
) -> None:
    """Train a network to separate the classes of labelled images."""
    from pepperscene.dataset.readers.several import open_image_sets
    from pepperscene.learning.model_names import is_built_in
    from pepperscene.learning.training_options import TrainingOptions

    # Find errors in the arguments before torch is imported, which takes seconds.
    if model is not None and start is not None and is_built_in(model):
        raise InputError("--model", "cannot be combined with --start, which has a model")
    scaled_to = TrainingOptions().width if width is None else width or None
    options = TrainingOptions(
        DEFAULT_MODEL if model is None else model, classes, steps, batch, parse_size(size), scaled_to,
        learning_rate, schedule, balance, augmentation, seed, validate, precision,
    )  # fmt: skip
    options.completed()
    opened = open_image_sets([*sets, *(validation or [])], labels=labels, half=half)
    require_torch()
    from pepperscene.learning.models.trained_model import load_model
    from pepperscene.learning.training.run import train as train_model

    origin = None if start is None else load_model(start, factory=model, allow_code=allow_code)
    if origin is not None and model is not None and is_built_in(origin.model):
        raise InputError("--model", "cannot be combined with --start, which has a model")
    if origin is not None and width is None:
        options = replace(options, width=origin.width)
    try:
        with training_progress() as on_progress:
            network = train_model(
                opened[: len(sets)],
                out,
                options,
                validation=opened[len(sets) :],
                start=origin,
                resume=resume,
                workers=workers,
                device=device,
                allow_code=allow_code,
                on_progress=on_progress,
            )
    except KeyboardInterrupt as error:
        error.add_note("the last checkpoint is kept; run the same command with --resume to continue")
        raise
    found = network.training["validation_mean_iou"]
    quality = "" if found is None else f", mean IoU {found:.3f} of the validation"
    typer.echo(f"trained, step {network.training['step']:,}{quality}: {out}")


@app.command()
@handle_errors
def evaluate(
    model: ModelArgument,
    sets: Annotated[
        list[Path], typer.Argument(metavar="SET...", help="Folders of labelled images, in any layout.")
    ],
    factory: FactoryOption = None,
    allow_code: FactoryCodeOption = False,
    classes: ClassesOption = None,
    labels: LabelsOption = None,
    half: HalfOption = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write evaluation.json and evaluation.html there.")
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Evaluate at most this many images of each set.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Compare a model's predictions with the masks of images: IoU, precision, recall and confusion."""
    from pepperscene.dataset.readers.several import open_image_sets
    from pepperscene.learning.evaluation.evaluate import evaluate as evaluate_model
    from pepperscene.learning.evaluation.page import write_evaluation

    # Open everything before the first image is predicted.
    table = _parse_classes(classes)
    images = open_image_sets(sets, labels=labels, half=half)
    if out is not None:
        _check_output(out)
    network = _load_model(model, factory, allow_code)

    with image_progress("evaluated") as on_progress:
        result = evaluate_model(network, images, classes=table, limit=limit, on_progress=on_progress)
    files = None if out is None else write_evaluation(result, network, images, out)
    if json:
        typer.echo(json_text.dumps(result.to_json(), indent=1, allow_nan=False))
        return
    if sys.stdout.isatty():
        for text_table in result.tables():
            print_ruled_table(text_table.heads, text_table.rows, text_table.title, text_table.notes)
    else:
        typer.echo(result.format())
    if files is not None:
        typer.echo(f"\n{files.data}\n{files.page}")


@app.command()
@handle_errors
def predict(
    model: ModelArgument,
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGES...", help="Pictures, or folders of images in any layout.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="New or empty folder for the class images.")],
    factory: FactoryOption = None,
    allow_code: FactoryCodeOption = False,
    classes: ClassesOption = None,
    half: HalfOption = None,
) -> None:
    """Write the classes that a model predicts for images: class ids and class colours as PNG."""
    from pepperscene.learning.evaluation.predict import predict as predict_images

    table = _parse_classes(classes)
    network = _load_model(model, factory, allow_code)
    with image_progress("predicted") as on_progress:
        result = predict_images(network, images, out, classes=table, half=half, on_progress=on_progress)
    count = len(result.names)
    typer.echo(f"{count:,} image{'' if count == 1 else 's'} predicted: {result.folder}")


def parse_size(text: str, option: str = "--size") -> tuple[int, int]:
    """Height and width of a text "WxH"."""
    width, _, height = text.lower().partition("x")
    if not (width.isascii() and width.isdecimal() and height.isascii() and height.isdecimal()):
        raise InputError(option, f"must be width and height in pixels, such as 256x192, not {text}")
    return int(height), int(width)


def _parse_classes(text: str | None) -> ClassTable | None:
    from pepperscene.learning.class_table import ClassTable

    return None if text is None else ClassTable.parse(text)


def _load_model(path: Path, factory: str | None, allow_code: bool) -> Segmenter:
    """Load a trained model; a factory makes its network."""
    require_torch()
    from pepperscene.learning.model_names import is_built_in
    from pepperscene.learning.models import load_model

    try:
        network = load_model(path, factory=factory, allow_code=allow_code)
    except ArgumentError as error:
        # The text of a model is the option --model elsewhere.
        where = "factory" if error.where == "model" else error.where
        raise ArgumentError(where, error.problem, key=error.key, value=error.value) from None
    if factory is not None and is_built_in(network.model):
        raise ArgumentError("factory", f"does not apply to {network.model}, a model of this package")
    return network


def require_torch() -> None:
    """Raise `SetupError` if torch is not installed."""
    from importlib.util import find_spec

    if find_spec("torch") is None:
        raise SetupError("torch is not installed; install it with `pip install 'pepperscene[learn]'`")


def _check_output(out: Path) -> None:
    """Raise `OutputError` before the evaluation, which can take hours, if its files cannot be written."""
    from pepperscene.atomic import check_can_write
    from pepperscene.learning.evaluation.page import JSON_NAME, PAGE_NAME

    check_can_write(out, (JSON_NAME, PAGE_NAME))

"""Commands for networks: evaluate and predict."""

from __future__ import annotations

import json as json_text
import sys
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
from pepperscene.errors import SetupError

if TYPE_CHECKING:
    from pepperscene.learning.class_table import ClassTable
    from pepperscene.learning.evaluation.segmenter import Segmenter

ModelArgument = Annotated[Path, typer.Argument(metavar="MODEL", help="File of a trained model.")]
ClassesOption = Annotated[
    str | None,
    typer.Option(
        metavar="TEXT",
        help="Classes that the model's are merged to (fruit=pepper,other=leaf+stem). Default: the model's.",
    ),
]


@app.command()
@handle_errors
def evaluate(
    model: ModelArgument,
    sets: Annotated[
        list[Path], typer.Argument(metavar="SET...", help="Folders of labelled images, in any layout.")
    ],
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
    network = _load_model(model)

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
    classes: ClassesOption = None,
    half: HalfOption = None,
) -> None:
    """Write the classes that a model predicts for images: class ids and class colours as PNG."""
    from pepperscene.learning.evaluation.predict import predict as predict_images

    table = _parse_classes(classes)
    network = _load_model(model)
    with image_progress("predicted") as on_progress:
        result = predict_images(network, images, out, classes=table, half=half, on_progress=on_progress)
    count = len(result.names)
    typer.echo(f"{count:,} image{'' if count == 1 else 's'} predicted: {result.folder}")


def _parse_classes(text: str | None) -> ClassTable | None:
    from pepperscene.learning.class_table import ClassTable

    return None if text is None else ClassTable.parse(text)


def _load_model(path: Path) -> Segmenter:
    """Load a trained model."""
    require_torch()
    from pepperscene.learning.models import load_model

    return load_model(path)


def require_torch() -> None:
    """Raise `SetupError` if torch is not installed."""
    from importlib.util import find_spec

    if find_spec("torch") is None:
        raise SetupError("torch is not installed; install it with `pip install 'pepperscene[learn]'`")


def _check_output(out: Path) -> None:
    """Raise `OutputError` before the evaluation, which can take hours, if its files cannot be written."""
    from pepperscene.dataset.store.atomic import check_can_write
    from pepperscene.learning.evaluation.page import JSON_NAME, PAGE_NAME

    check_can_write(out, (JSON_NAME, PAGE_NAME))

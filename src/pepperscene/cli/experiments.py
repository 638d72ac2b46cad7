"""The command that runs the paper's experiments: synthetic training, tested on photographs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final

import typer

from pepperscene.cli.application import LabelsOption, app, handle_errors
from pepperscene.cli.interrupts import raise_if_interrupted
from pepperscene.cli.learning import DEFAULT_MODEL, parse_size, require_torch
from pepperscene.cli.progress import echo_progress

_INTERVAL_S: Final = 5.0  # chosen: seconds between lines that are frequent


@app.command()
@handle_errors
def experiments(
    recipes: Annotated[
        list[str],
        typer.Argument(metavar="RECIPES...", help="Recipes to build, or folders of synthetic sets."),
    ],
    real: Annotated[Path, typer.Option(metavar="FOLDER", help="Photographs with masks, in any layout.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the results; created if missing.")],
    other: Annotated[
        Path | None,
        typer.Option(metavar="SET", help="Unrelated set or trained model, which experiment D starts from."),
    ] = None,
    labels: LabelsOption = None,
    classes: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Classes of experiments B to E. Default: other, fruit, peduncle."),
    ] = None,
    frames: Annotated[int, typer.Option(metavar="N", help="Frames to build, of all recipes.")] = 1000,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of these frames in pixels.")] = "400x300",
    quality: Annotated[
        str, typer.Option(metavar="NAME", help="Quality of these frames: draft, standard or reference.")
    ] = "standard",
    seeds: Annotated[int, typer.Option(metavar="N", help="Networks of each kind.")] = 3,
    model: Annotated[
        str, typer.Option(metavar="NAME", help="Model of the networks, as for `train`.")
    ] = DEFAULT_MODEL,
    allow_code: Annotated[
        bool,
        typer.Option("--allow-code", help="Allow the code of recipes and of --model module:factory to run."),
    ] = False,
    steps: Annotated[
        int | None, typer.Option(metavar="N", help="Steps on synthetic images. Default: the model's.")
    ] = None,
    real_steps: Annotated[
        int | None, typer.Option(metavar="N", help="Steps on real images alone. Default: as --steps.")
    ] = None,
    fine_steps: Annotated[
        int | None, typer.Option(metavar="N", help="Steps of fine-tuning. Default: a quarter of --steps.")
    ] = None,
    learning_rate: Annotated[float | None, typer.Option(metavar="F", help="Learning rate of Adam.")] = None,
    fine_rate: Annotated[
        float | None, typer.Option(metavar="F", help="The same in fine-tuning. Default: a fifth.")
    ] = None,
    batch: Annotated[int | None, typer.Option(metavar="N", help="Images in a step.")] = None,
    crop: Annotated[str, typer.Option(metavar="WxH", help="Size of training crops in pixels.")] = "256x256",
    width: Annotated[
        int, typer.Option(metavar="PX", help="Width to which images are scaled; 0 keeps their own.")
    ] = 400,
    augmentation: Annotated[
        float, typer.Option(metavar="F", help="Strength of random changes of the images, 0 to 2.")
    ] = 1.0,
    validate: Annotated[
        int | None, typer.Option(metavar="N", help="Steps between validations of experiment A.")
    ] = None,
    precision: Annotated[
        str, typer.Option(metavar="NAME", help="float32, bfloat16, or auto for the faster one.")
    ] = "auto",
    workers: Annotated[int, typer.Option(min=0, metavar="N", help="Processes that read images.")] = 0,
    device: Annotated[
        str | None, typer.Option(metavar="NAME", help="Device of torch, such as cpu or cuda:0.")
    ] = None,
) -> None:
    """Train networks on synthetic and on real images, and compare them on photographs.

    Run the same command again to resume.
    """
    require_torch()
    from pepperscene.learning.class_table import FRUIT_CLASSES
    from pepperscene.learning.experiments import ExperimentOptions, run_experiments
    from pepperscene.learning.training_options import TrainingOptions

    training = TrainingOptions(
        model, None, steps, batch, parse_size(crop, "--crop"), width or None, learning_rate,
        augmentation=augmentation, validate=validate, precision=precision,
    )  # fmt: skip
    options = ExperimentOptions(
        training, classes or FRUIT_CLASSES, seeds, frames, parse_size(size), quality, real_steps, fine_steps,
        fine_rate,
    )  # fmt: skip
    try:
        files = run_experiments(
            recipes,
            real,
            out,
            options,
            other=other,
            labels=labels,
            workers=workers,
            device=device,
            allow_code=allow_code,
            on_message=_message_printer(),
        )
    except KeyboardInterrupt as error:
        error.add_note("run the same command again to resume")
        raise
    for item in files.content["experiments"]:
        typer.echo(_format_result(item))
    typer.echo(f"\n{files.data}\n{files.page}")


def _message_printer() -> Callable[[str, bool], None]:
    """Function that prints messages to standard error, frequent ones every few seconds."""
    last = float("-inf")

    def show(text: str, is_frequent: bool) -> None:
        nonlocal last
        raise_if_interrupted()
        now = time.monotonic()
        if not is_frequent or now - last >= _INTERVAL_S:
            echo_progress(text)
            last = now

    return show


def _format_result(item: dict[str, object]) -> str:
    """One line of an experiment's mean IoU."""
    from pepperscene.learning.experiments.page import format_measure

    heading = f"{item['key']}: {item['title']}"
    if not item["ran"]:
        return f"{heading}: not run, {item['why']}"
    measures = item["measures"]
    assert isinstance(measures, list)
    values = ", ".join(f"{measure['name']} {format_measure(measure)}" for measure in measures)
    return f"{heading}: IoU in %: {values}"

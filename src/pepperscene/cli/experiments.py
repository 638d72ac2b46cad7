"""The command `experiments`: what synthetic images teach about real ones."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from pepperscene.cli.application import HalfOption, LabelsOption, app, handle_errors, print_ruled_table
from pepperscene.cli.learning import parse_size, require_torch
from pepperscene.cli.progress import echo_progress


@app.command()
@handle_errors
def experiments(
    recipes: Annotated[
        list[str], typer.Argument(metavar="RECIPE...", help="Recipes that are built, or folders of sets.")
    ],
    real: Annotated[Path, typer.Option(metavar="DIR", help="Folder of real images with masks.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="New folder, or that of an earlier call.")],
    other: Annotated[
        Path | None, typer.Option(metavar="SET", help="Unrelated set, or trained model, to start D from.")
    ] = None,
    frames: Annotated[int, typer.Option(metavar="N", help="Frames of each recipe.")] = 600,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the frames in pixels.")] = "400x300",
    quality: Annotated[str, typer.Option(metavar="NAME", help="Rendering quality.")] = "standard",
    classes: Annotated[
        str | None, typer.Option(metavar="TEXT", help="Classes of B to E. Default: other, fruit, peduncle.")
    ] = None,
    seeds: Annotated[int, typer.Option(metavar="N", help="Number of repetitions.")] = 3,
    model: Annotated[str, typer.Option(metavar="NAME", help="As for `train`.")] = "small",
    steps: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Steps on synthetic images. Default: the model's.")
    ] = None,
    real_steps: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Steps of C. Default: as many as --steps.")
    ] = None,
    fine_steps: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Steps of D and E. Default: a quarter of --steps.")
    ] = None,
    learning_rate: Annotated[
        float | None, typer.Option(metavar="F", help="Learning rate. Default: the model's.")
    ] = None,
    fine_rate: Annotated[
        float | None, typer.Option(metavar="F", help="That of D and E. Default: a fifth of it.")
    ] = None,
    batch: Annotated[int | None, typer.Option(metavar="N", min=1, help="Images in a step.")] = None,
    crop: Annotated[str, typer.Option(metavar="WxH", help="Size of the crops in pixels.")] = "256x256",
    augmentation: Annotated[float, typer.Option(metavar="F", help="As for `train`.")] = 1.0,
    device: Annotated[
        str | None, typer.Option(metavar="NAME", help="Device of torch, such as cpu or cuda:0.")
    ] = None,
    labels: LabelsOption = None,
    half: HalfOption = None,
) -> None:
    """Run the experiments A to E of Barth et al. 2018: train, adapt and test. Writes a page."""
    from pepperscene.dataset.readers import open_images
    from pepperscene.learning.class_table import FRUIT_CLASSES
    from pepperscene.learning.experiment_options import ExperimentOptions

    width, height = reversed(parse_size("--size", size))
    options = ExperimentOptions(
        frames, (width, height), quality, classes or FRUIT_CLASSES, seeds, model, steps, real_steps,
        fine_steps, learning_rate, fine_rate, batch, augmentation, parse_size("--crop", crop),
    )  # fmt: skip
    options.completed()
    photographs = open_images(real, labels=labels, half=half)
    require_torch()
    from pepperscene.learning.experiments import run_experiments, write_page
    from pepperscene.learning.experiments.page import result_tables

    try:
        run = run_experiments(
            recipes, photographs, out, options, other=other, device=device, on_line=echo_progress
        )
    except KeyboardInterrupt as error:
        error.add_note("run the same command again to go on")
        raise
    files = write_page(run)
    tables = result_tables(run)
    if sys.stdout.isatty():
        for table in tables:
            print_ruled_table(table.heads, table.rows, table.title, table.notes)
    else:
        from pepperscene.colour import format_tables

        typer.echo(format_tables(tables))
    for file in files:
        typer.echo(file)

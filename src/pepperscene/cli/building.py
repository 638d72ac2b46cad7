"""Commands that render: a data set, or one frame of it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pepperscene.cli.application import (
    DEFAULTS,
    OutputsOption,
    QualityOption,
    RecipeArgument,
    SeedOption,
    SetOption,
    TargetOption,
    app,
    explained,
    names_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pepperscene.dataset import Progress


@app.command()
@explained
def build(
    out: Annotated[Path, typer.Option(help="Folder of the data set; made when missing.")],
    recipe: RecipeArgument = "demo",
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="A:B", help="Indices A to B - 1, counted from 0; by default what the recipe selects."
        ),
    ] = None,
    outputs: OutputsOption = DEFAULTS,
    quality: QualityOption = "standard",
    target_error: TargetOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
) -> None:
    """Build a data set, or what is missing of it."""
    names = names_of(outputs)
    from pepperscene.dataset import build as build_dataset
    from pepperscene.dataset import load_recipe, read_changes

    told = load_recipe(recipe, read_changes(set or ()))
    with _progress() as on_frame:
        done = build_dataset(
            told, out, frames, names, quality, seed, on_frame=on_frame, target_error=target_error
        )
    kept = f", {len(done.kept)} were there already" if done.kept else ""
    typer.echo(f"{len(done.made)} frame{'' if len(done.made) == 1 else 's'} built{kept}: {out}")


@app.command()
@explained
def render(
    out: Annotated[Path, typer.Option(help="Folder of the frame; made when missing.")],
    recipe: RecipeArgument = "demo",
    frame: Annotated[
        int | None,
        typer.Option(metavar="N", help="Its index, counted from 0; by default the first that is selected."),
    ] = None,
    outputs: OutputsOption = DEFAULTS,
    quality: QualityOption = "standard",
    target_error: TargetOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
) -> None:
    """Render one frame of a recipe, to look at it or to try a setting."""
    names = names_of(outputs)
    from pepperscene.dataset import load_recipe, read_changes, render_frame

    told = load_recipe(recipe, read_changes(set or ()))
    for path in render_frame(told, out, frame, names, quality, seed, target_error=target_error):
        typer.echo(path)


@app.command()
@explained
def recipes() -> None:
    """List the shipped recipes."""
    from pepperscene.dataset import load_recipe
    from pepperscene.shipped import shelf

    for path in sorted(shelf("recipes").glob("*.toml")):
        plan = load_recipe(path.stem).plan
        chosen = len(plan.chosen(None))
        total = f"{plan.count:,} frames: {plan.sets} sets x {plan.rotations} rotations x {plan.frames} steps"
        typer.echo(f"{path.stem:<12} {total}{f'; builds {chosen} of them' if chosen < plan.count else ''}")


@contextmanager
def _progress() -> Iterator[Callable[[Progress], None]]:
    """What to call after every frame: a bar on a terminal, a line each elsewhere."""
    if not sys.stderr.isatty():
        yield _plain_line
        return
    from rich import progress
    from rich.console import Console

    columns: tuple[Any, ...] = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("growing plants", total=None)

        def step(told: Progress) -> None:
            bar.update(task, completed=told.done, total=told.total, description=f"frame {told.index:06d}")

        yield step


def _plain_line(told: Progress) -> None:
    state = "built" if told.made else "kept"
    typer.echo(f"frame {told.index:06d} {state} ({told.done} of {told.total})", err=True)

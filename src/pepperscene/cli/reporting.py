"""The command that shows a data set."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pepperscene.cli.application import app, explained, told
from pepperscene.errors import InputError

if TYPE_CHECKING:
    from pepperscene.dataset.labelled import ImageSet

_TOLD_EVERY = 200
"""Chosen: pictures measured from one line of progress to the next, some seconds."""


@app.command()
@explained
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set.")],
    beside: Annotated[
        Path | None,
        typer.Option(metavar="OTHER", help="A second set to compare with: its folder, whatever its layout."),
    ] = None,
    labels: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What the masks of OTHER mean, when it is a folder of images."),
    ] = None,
    half: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="synthetic or empirical, when OTHER is the published data set."),
    ] = None,
    limit: Annotated[int, typer.Option(min=1, max=200, help="Most frames shown.")] = 12,
    sample: Annotated[int, typer.Option(min=1, help="Most frames whose images are measured.")] = 1000,
) -> None:
    """Write a contact sheet and a web page into a data set's folder, with a second set beside it."""
    from pepperscene.dataset import report as write_report

    other = None if beside is None else _opened(beside, labels, half)
    for name, value in (("labels", labels), ("half", half)):
        if beside is None and value is not None:
            raise InputError(f"--{name}", "", None, "goes only with --beside")
    done = write_report(folder, limit, other, sample=sample, told=measuring)
    typer.echo(
        f"{done.shown} of {done.frames} frames shown, {done.measured} measured:\n"
        f"  {done.sheet}\n  {done.page}"
    )


def _opened(folder: Path, labels: str | None, half: str | None) -> ImageSet:
    from pepperscene.dataset.readers import open_images

    return open_images(folder, labels=labels, half=half)


def measuring(done: int, of: int) -> None:
    """A line now and then about how many pictures are measured."""
    if of > _TOLD_EVERY and (done % _TOLD_EVERY == 0 or done == of):
        told(f"{done:,} of {of:,} pictures measured")

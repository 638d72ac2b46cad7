"""The command that lets a data set pass, or tells its faults."""

from __future__ import annotations

import json as json_text
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from pepperscene.cli.application import app, handle_errors, told
from pepperscene.errors import InputError

if TYPE_CHECKING:
    from pepperscene.dataset.check import CheckResult, Finding
    from pepperscene.dataset.readers.image_set import ImageSet


EXIT_FAULTS: Final = 1
_HEADINGS: Final = ("kind", "frame", "file", "what is wrong")


@app.command()
@handle_errors
def check(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set.")],
    frames: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Indices that must be there; by default those of the manifest."),
    ] = None,
    rows: Annotated[int, typer.Option(min=1, help="Most rows shown of each kind of fault.")] = 10,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", help="Processes that read frames; one for each core if left out."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the whole verdict as JSON.")] = False,
) -> None:
    """Look for faults in a data set; exit code 1 if there are any."""
    from pepperscene.dataset import check_dataset as check_dataset

    with _progress() as on_frame:
        verdict = check_dataset(folder, workers, on_frame, frames)
    if json:
        typer.echo(json_text.dumps(verdict.as_json(), indent=1))
    else:
        _tell(verdict, folder, rows)
    if not verdict.good:
        raise typer.Exit(EXIT_FAULTS)


def _tell(verdict: CheckResult, folder: Path, most: int) -> None:
    """One line when all is well, else a table, the most serious faults first."""
    counted = f"{verdict.frames:,} frame{'' if verdict.frames == 1 else 's'}"
    for note in verdict.notes:
        typer.echo(f"note: {note}", err=True)
    if verdict.good:
        typer.echo(f"{folder}: {counted} without a fault")
        return
    _table(list(_lines(verdict, most)))
    kinds = ", ".join(f"{count} {kind}" for kind, count in verdict.counts().items())
    faults = f"{len(verdict.findings):,} fault{'' if len(verdict.findings) == 1 else 's'}"
    typer.echo(f"{folder}: {counted}, {faults}: {kinds}")


def _lines(verdict: CheckResult, most: int) -> Iterator[tuple[str, str, str, str]]:
    """Rows of the table; of each kind the first ones, then how many more there are."""
    for kind, found in groupby(verdict.findings, key=lambda one: one.kind):
        told = list(found)
        for one in told[:most]:
            yield kind, _frame(one), one.file, one.what
        if len(told) > most:
            yield kind, "", "", f"... and {len(told) - most:,} more"


def _frame(finding: Finding) -> str:
    return "" if finding.index is None else f"{finding.index:06d}"


def _table(lines: list[tuple[str, str, str, str]]) -> None:
    """With lines and wrapping on a terminal, plain columns elsewhere."""
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        table = Table(*_HEADINGS)
        for line in lines:
            table.add_row(*(Text(cell) for cell in line))
        Console().print(table)
        return
    widths = [max(len(line[place]) for line in (_HEADINGS, *lines)) for place in range(3)]
    for line in (_HEADINGS, *lines):
        cells = [cell.ljust(width) for cell, width in zip(line, widths, strict=False)]
        typer.echo("  ".join([*cells, line[3]]))


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None] | None]:
    """What to call after every frame: a bar on a terminal, nothing elsewhere."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich import progress
    from rich.console import Console

    with progress.Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("checking", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


_FEW: Final = 200  # chosen: frames that are told a line each
_EVERY_S: Final = 5.0  # chosen: of more frames, how often a line is told


@app.command()
@handle_errors
def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set.")],
    form: Annotated[
        str,
        typer.Option("--format", metavar="NAME", help="published, coco, yolo, webdataset or huggingface."),
    ],
    out: Annotated[Path, typer.Option(help="A new or an empty folder.")],
    split: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            help="Shares, train=.8,val=.1,test=.1, or ranges, train=0:8750,val=8750:8800; if left out, all "
            "frames are for training.",
        ),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="A:B", help="Indices A to B - 1, counted from 0; by default all that are there."
        ),
    ] = None,
    smallest: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Pixels that must be seen of an organ to be an object; coco 1, yolo 12 if left out.",
        ),
    ] = None,
) -> None:
    """Write a data set in the format that training code reads."""
    from pepperscene.dataset import export_dataset as export_dataset

    with _export_progress() as on_frame:
        done = export_dataset(folder, form, out, split, frames, on_frame, smallest)
    parts = ", ".join(f"{count} {name}" for name, count in done.splits.items())
    typer.echo(f"{done.frames} frame{'' if done.frames == 1 else 's'} as {form} ({parts}): {out}")


@contextmanager
def _export_progress() -> Iterator[Callable[[int, int, int], None]]:
    """What to call after every frame: a bar on a terminal, a line now and then elsewhere."""
    if not sys.stderr.isatty():
        yield _plain()
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("exporting", total=None)

        def step(index: int, done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, description=f"frame {index:06d}")

        yield step


def _plain() -> Callable[[int, int, int], None]:
    last = float("-inf")

    def step(index: int, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if total <= _FEW or done == total or now - last >= _EVERY_S:
            last = now
            told(f"frame {index:06d} ({done} of {total})")

    return step


_TOLD_EVERY = 200
"""Chosen: pictures measured from one line of progress to the next, some seconds."""


@app.command()
@handle_errors
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
    from pepperscene.dataset import write_report as write_report

    other = None if beside is None else _opened(beside, labels, half)
    for name, value in (("labels", labels), ("half", half)):
        if beside is None and value is not None:
            raise InputError(f"--{name}", "goes only with --beside")
    done = write_report(folder, limit, other, sample=sample, on_progress=measuring)
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

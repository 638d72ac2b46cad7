"""The command that lets a data set pass, or tells its faults."""

from __future__ import annotations

import json as json_text
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from pepperscene.cli.application import app, explained

if TYPE_CHECKING:
    from pepperscene.dataset.check import Finding, Verdict

EXIT_FAULTS: Final = 1
_HEADINGS: Final = ("kind", "frame", "file", "what is wrong")


@app.command()
@explained
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
    from pepperscene.dataset import check as check_dataset

    with _progress() as on_frame:
        verdict = check_dataset(folder, workers, on_frame, frames)
    if json:
        typer.echo(json_text.dumps(verdict.as_json(), indent=1))
    else:
        _tell(verdict, folder, rows)
    if not verdict.good:
        raise typer.Exit(EXIT_FAULTS)


def _tell(verdict: Verdict, folder: Path, most: int) -> None:
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


def _lines(verdict: Verdict, most: int) -> Iterator[tuple[str, str, str, str]]:
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

"""The command that compares two sets of images, or one with patches of measured colour."""

from __future__ import annotations

import json as json_text
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pepperscene.cli.application import app, handle_errors, told
from pepperscene.cli.datasets import measuring
from pepperscene.errors import InputError, OutputError

if TYPE_CHECKING:
    from pepperscene.colour.comparison.tables import TextTable


_SIDE = "Folder of images, or a file of patches or measured reflectances."


@app.command()
@handle_errors
def compare(
    one: Annotated[str, typer.Argument(metavar="A", help=_SIDE)],
    other: Annotated[str, typer.Argument(metavar="B", help=_SIDE)],
    labels: Annotated[
        str | None,
        typer.Option(metavar="NAME[,NAME]", help="What masks mean, where A or B is a folder of images."),
    ] = None,
    half: Annotated[
        str | None,
        typer.Option(
            metavar="NAME[,NAME]", help="synthetic or empirical, where A or B is the published data set."
        ),
    ] = None,
    limit: Annotated[int, typer.Option(min=1, help="Most pictures of each side that are measured.")] = 1000,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw Figs. 10 to 13 of the paper as an .svg.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Tell how alike two sets of images are: hues, CIELAB, class shares, places, light; with intervals."""
    from pepperscene.colour.comparison.compare import compare as compare_sets
    from pepperscene.colour.comparison.measure import open_comparison_sides

    if figure is not None and figure.suffix.lower() != ".svg":
        raise InputError("--figure", f"only .svg is written, not {figure.name}")
    found = compare_sets(*open_comparison_sides(one, other, labels, half), limit=limit, on_progress=measuring)
    if json:
        typer.echo(json_text.dumps(found.json(), indent=1, allow_nan=False))
    elif sys.stdout.isatty():
        _show(found.tables())
    else:
        typer.echo(found.table())
    if figure is not None:
        _write(figure, found.figure())


def _show(parts: tuple[TextTable, ...]) -> None:
    """Tables with lines, on a terminal."""
    from rich.console import Console
    from rich.table import Table as Lined
    from rich.text import Text

    console = Console()
    for part in parts:
        lined = Lined(*part.heads, title=Text(part.title), title_justify="left")
        for row in part.rows:
            lined.add_row(*(Text(cell) for cell in row))
        console.print(lined)
        for note in part.notes:
            console.print(Text(note))


def _write(file: Path, text: str) -> None:
    from pepperscene.dataset.store.atomic import atomic_write

    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(file) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as fault:
        raise OutputError(f"{file}: the figure cannot be written ({fault.strerror or fault})") from None
    told(f"figure: {file}")

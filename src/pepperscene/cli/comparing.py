"""The command `compare`: two image sets, or an image set and patches of measured colour."""

from __future__ import annotations

import json as json_text
import sys
from pathlib import Path
from typing import Annotated

import typer

from pepperscene.cli.application import JsonOption, app, handle_errors, print_ruled_table
from pepperscene.cli.progress import echo_measured, echo_progress
from pepperscene.errors import InputError, OutputError

_SET_HELP = "Folder of images, or file of patches or measured reflectances."


@app.command()
@handle_errors
def compare(
    first: Annotated[str, typer.Argument(metavar="A", help=_SET_HELP)],
    second: Annotated[str, typer.Argument(metavar="B", help=_SET_HELP)],
    labels: Annotated[
        str | None,
        typer.Option(metavar="NAME[,NAME]", help="Meaning of the masks, if A or B is a folder of images."),
    ] = None,
    half: Annotated[
        str | None,
        typer.Option(metavar="NAME[,NAME]", help="synthetic or empirical, for the published data set."),
    ] = None,
    limit: Annotated[int, typer.Option(min=1, help="Measure at most this many pictures of each set.")] = 1000,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw Figs. 10 to 13 of the paper as .svg or .png.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Compare two image sets: hues, CIELAB, class fractions, places, light; with confidence intervals."""
    from pepperscene.colour import comparison_figure, comparison_json, comparison_tables, format_tables
    from pepperscene.colour.comparison.compare import compare as compare_sets
    from pepperscene.colour.comparison.measure import open_two_sets

    if figure is not None and figure.suffix.lower() not in (".svg", ".png"):
        raise InputError("--figure", f"must end in .svg or .png, not {figure.name}")
    sets = open_two_sets(first, second, labels, half)
    comparison = compare_sets(*sets, limit=limit, on_progress=echo_measured)
    if json:
        typer.echo(json_text.dumps(comparison_json(comparison), indent=1, allow_nan=False))
    elif sys.stdout.isatty():
        for table in comparison_tables(comparison):
            print_ruled_table(table.heads, table.rows, table.title, table.notes)
    else:
        typer.echo(format_tables(comparison_tables(comparison)))
    if figure is not None:
        _write(figure, comparison_figure(comparison, figure.suffix.lower()[1:]))


def _write(file: Path, content: bytes) -> None:
    from pepperscene.dataset.store.atomic import atomic_write

    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(file) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise OutputError(f"{file}: the figure cannot be written ({error.strerror or error})") from None
    echo_progress(f"figure: {file}")

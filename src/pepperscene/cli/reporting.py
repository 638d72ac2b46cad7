"""The command that shows a data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepperscene.cli.application import app, explained


@app.command()
@explained
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set.")],
    limit: Annotated[int, typer.Option(min=1, max=200, help="Most frames shown.")] = 12,
) -> None:
    """Write a contact sheet and a web page into a data set's folder."""
    from pepperscene.dataset import report as write_report

    done = write_report(folder, limit)
    typer.echo(f"{done.shown} of {done.frames} frames shown:\n  {done.sheet}\n  {done.page}")

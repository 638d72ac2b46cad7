"""The command `view`."""

from __future__ import annotations

from typing import Annotated

import typer

from pepperscene.cli.application import FolderArgument, app, handle_errors
from pepperscene.cli.progress import echo_progress, export_progress
from pepperscene.errors import InputError, SetupError


@app.command()
@handle_errors
def view(
    folder: FolderArgument,
    frames: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Frames A to B - 1, counted from 0. Default: all. Rerun only."),
    ] = None,
    program: Annotated[
        str | None,
        typer.Option(metavar="rerun|browser", help="Default: rerun where it is installed, else browser."),
    ] = None,
) -> None:
    """Look at a data set in Rerun's viewer, or at its report in a browser."""
    from pepperscene.cli.viewer import PROGRAMS, choose_program, view_in_browser, view_in_rerun

    if program not in (None, *PROGRAMS):
        raise InputError("--program", f"must be {' or '.join(PROGRAMS)}, not {program!r}")
    chosen = choose_program(program)
    if chosen == "browser":
        if frames is not None:
            raise InputError("--frames", "applies only to rerun")
        page, opened = view_in_browser(folder)
        typer.echo(page)
        if not opened:
            echo_progress("note: no browser was found; open the page in one")
        return
    with export_progress() as on_frame:
        code = view_in_rerun(folder, frames, on_frame)
    if code:
        raise SetupError(f"Rerun's viewer ended with exit code {code}; try --program browser")

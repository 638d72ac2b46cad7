"""The command `view`: a data set in Rerun's viewer, or its report in a browser."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import webbrowser
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final

import typer

from pepperscene.cli.application import FolderArgument, command
from pepperscene.cli.progress import echo_progress, export_progress
from pepperscene.errors import InputError, SetupError

_PROGRAMS: Final = ("rerun", "browser")


@command
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
    if program not in (None, *_PROGRAMS):
        raise InputError("--program", f"must be {' or '.join(_PROGRAMS)}, not {program!r}")
    has_rerun = find_spec("rerun") is not None
    if program == "rerun" and not has_rerun:
        problem = "rerun is not installed; install it with `pip install 'pepperscene[rerun]'`"
        raise SetupError(f"{problem}, or use --program browser")
    if program == "browser" or not has_rerun:
        if frames is not None:
            raise InputError("--frames", "applies only to rerun")
        _view_in_browser(folder)
    else:
        _view_in_rerun(folder, frames)


def _view_in_browser(folder: Path) -> None:
    """Write the report and open it."""
    from pepperscene.review.report import write_report

    page = write_report(folder).page
    opened = webbrowser.open(page.absolute().as_uri())
    typer.echo(page)
    if not opened:
        echo_progress("note: no browser was found; open the page in one")


def _view_in_rerun(folder: Path, frames: str | None) -> None:
    """Show recordings in a temporary folder until the viewer is closed."""
    from pepperscene.export import export_dataset
    from pepperscene.export.rerun import RECORDING

    with tempfile.TemporaryDirectory(prefix="pepperscene_view_") as temporary:
        out = Path(temporary) / "recordings"
        with export_progress() as on_frame:
            export_dataset(folder, "rerun", out, frames=frames, on_frame=on_frame)
        files = [str(path) for path in sorted(out.rglob(RECORDING))]
        code = subprocess.run([sys.executable, "-P", "-m", "rerun", *files], check=False).returncode
    if code:
        raise SetupError(f"Rerun's viewer ended with exit code {code}; try --program browser")

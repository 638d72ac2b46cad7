"""Open a data set in Rerun's viewer, or its report in a browser."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import webbrowser
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from pepperscene.errors import SetupError
from pepperscene.export import export_dataset
from pepperscene.export.job import OnFrame
from pepperscene.export.rerun import RECORDING
from pepperscene.review.report import write_report

PROGRAMS: Final = ("rerun", "browser")


def choose_program(program: str | None = None) -> str:
    """The program to view with: as asked, or Rerun where it is installed, else a browser.

    Raises:
        SetupError: Rerun is asked for and not installed.
    """
    has_rerun = find_spec("rerun") is not None
    if program == "rerun" and not has_rerun:
        problem = "rerun is not installed; install it with `pip install 'pepperscene[rerun]'`"
        raise SetupError(f"{problem}, or use --program browser")
    return program or ("rerun" if has_rerun else "browser")


def view_in_rerun(folder: Path, frames: str | None = None, on_frame: OnFrame | None = None) -> int:
    """Show a data set in Rerun's viewer until it is closed, and return its exit code.

    Its recordings are in a temporary folder meanwhile. Arguments and errors as of `export_dataset`.
    """
    with tempfile.TemporaryDirectory(prefix="pepperscene_view_") as temporary:
        out = Path(temporary) / "recordings"
        export_dataset(folder, "rerun", out, frames=frames, on_frame=on_frame)
        files = [str(path) for path in sorted(out.rglob(RECORDING))]
        return subprocess.run([sys.executable, "-P", "-m", "rerun", *files], check=False).returncode


def view_in_browser(folder: Path) -> tuple[Path, bool]:
    """Write the report of a data set and open it; returns its page, and whether a browser was found.

    Raises:
        InputError, OutputError: as of `write_report`.
    """
    page = write_report(folder).page
    return page, webbrowser.open(page.absolute().as_uri())

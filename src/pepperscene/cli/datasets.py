"""Commands for image sets: check, export, report, compare and view."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import webbrowser
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from pepperscene.cli.application import (
    FolderArgument,
    JsonOption,
    LabelOptions,
    command,
    print_json,
    print_ruled_table,
    print_tables,
)
from pepperscene.cli.progress import check_progress, echo_measured, echo_note, echo_progress, export_progress
from pepperscene.errors import InputError, OutputError, SetupError
from pepperscene.export.formats import FORMATS
from pepperscene.options import Option

if TYPE_CHECKING:
    from pepperscene.review.check import CheckResult

EXIT_FAULTS: Final = 1
_SET_HELP: Final = "Folder of images, or file of patches or measured reflectances."
_HEADINGS: Final = ("kind", "frame", "file", "problem")


@command
def check(
    folder: FolderArgument,
    frames: Annotated[
        str | None, typer.Option(metavar="A:B", help="Frames that must exist. Default: the manifest's.")
    ] = None,
    rows: Annotated[int, typer.Option(min=1, help="Print at most this many faults of each kind.")] = 10,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", help="Threads that read frames. Default: one per core, at most 8."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Check a data set for faults. Exits with 1 if there are any."""
    from pepperscene.review.check import check_dataset

    with check_progress() as on_frame:
        result = check_dataset(folder, workers, on_frame, frames)
    if json:
        print_json(result.to_json())
    else:
        _print_result(result, folder, rows)
    if not result.passed:
        raise typer.Exit(EXIT_FAULTS)


def _print_result(result: CheckResult, folder: Path, limit: int) -> None:
    """Print one line if the data set is valid, else a table, most serious faults first."""
    frames = f"{result.frames:,} frame{'' if result.frames == 1 else 's'}"
    for note in result.notes:
        echo_note(note)
    if result.passed:
        typer.echo(f"{folder}: {frames}, no faults")
        return
    _print_table(list(_fault_rows(result, limit)))
    kinds = ", ".join(f"{count} {kind}" for kind, count in result.counts().items())
    faults = f"{len(result.findings):,} fault{'' if len(result.findings) == 1 else 's'}"
    typer.echo(f"{folder}: {frames}, {faults}: {kinds}")


def _fault_rows(result: CheckResult, limit: int) -> Iterator[tuple[str, str, str, str]]:
    """Rows of the table: the first faults of each kind, then the number of further ones."""
    for kind, group in groupby(result.findings, key=lambda finding: finding.kind):
        findings = list(group)
        for finding in findings[:limit]:
            frame = "" if finding.index is None else f"{finding.index:06d}"
            yield kind, frame, finding.file, finding.problem
        if len(findings) > limit:
            yield kind, "", "", f"... and {len(findings) - limit:,} more"


def _print_table(rows: list[tuple[str, str, str, str]]) -> None:
    """Print a table with rules and wrapping on a terminal, plain columns elsewhere."""
    if sys.stdout.isatty():
        print_ruled_table(_HEADINGS, rows)
        return
    widths = [max(len(row[column]) for row in (_HEADINGS, *rows)) for column in range(3)]
    for row in (_HEADINGS, *rows):
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        typer.echo("  ".join([*cells, row[3]]))


@dataclass(frozen=True)
class ExportSelection:
    """The frames and objects that an export has; the names are those of arguments of `export_dataset`."""

    split: Annotated[
        str | None,
        Option(
            "Fractions (train=.8,val=.1,test=.1) or ranges of frames (train=0:8750,val=8750:8800). "
            "Default: all frames are for training.",
            "TEXT",
        ),
    ] = None
    frames: Annotated[str | None, Option("Frames A to B - 1, counted from 0. Default: all.", "A:B")] = None
    smallest_px: Annotated[
        int | None, Option("Minimum visible pixels of an object. Default: yolo formats 12, others 1.", "N")
    ] = None
    classes: Annotated[
        str | None,
        Option(
            "Classes of objects, in order; merges and renames (fruit=pepper,stalk=peduncle+stem,leaf). "
            "pepper.ripe and pepper.unripe divide fruit. Default: all; yolo_pose pepper.",
            "TEXT",
        ),
    ] = None
    least_visible: Annotated[
        float | None, Option("Minimum visible fraction of a fruit (needs harvest).", "F")
    ] = None
    ripe_from: Annotated[
        float | None,
        Option(
            "Ripeness from which fruit is ripe (needs harvest); divides the class pepper. Default: 0.5 for "
            "pepper.ripe and pepper.unripe.",
            "F",
        ),
    ] = None
    frame_rate_hz: Annotated[
        float | None,
        Option("Frames per second of mcap. Default: the speed of the recipe's path, else 1.", "HZ"),
    ] = None
    truncated: Annotated[str, Option("Objects that the image border may cut.", "keep|drop")] = "keep"
    mask: Annotated[
        str | None,
        Option("Foreground of masks, points and depths: plant, fruit, or classes (leaf+stem).", "TEXT"),
    ] = None
    alpha: Annotated[bool, Option("Add the share of the foreground to pictures as a fourth channel.")] = False
    undistort: Annotated[bool, Option("Resample images to those of a pinhole camera.")] = False


@command
def export(
    folder: FolderArgument,
    form: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="NAME",
            help=f"{' or '.join((', '.join(tuple(FORMATS)[:-1]), tuple(FORMATS)[-1]))}.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="New or empty folder for the export.")],
    selection: ExportSelection,
) -> None:
    """Export a data set to a format that other programs read."""
    from pepperscene.export import export_dataset

    with export_progress() as on_frame:
        result = export_dataset(folder, form, out, on_frame=on_frame, **vars(selection))
    parts = ", ".join(f"{count} {name}" for name, count in result.splits.items())
    typer.echo(f"{result.frames} frame{'' if result.frames == 1 else 's'} as {form} ({parts}): {out}")
    for warning in result.warnings:
        echo_progress(f"warning: {warning}")


@command
def report(
    *,
    folder: FolderArgument,
    beside: Annotated[
        Path | None,
        typer.Option(metavar="OTHER", help="Folder of a second image set to compare with, in any layout."),
    ] = None,
    meaning: LabelOptions,
    limit: Annotated[int, typer.Option(min=1, max=200, help="Show at most this many frames.")] = 12,
    sample: Annotated[int, typer.Option(min=1, help="Measure at most this many frames.")] = 1000,
    scene: Annotated[
        bool, typer.Option(help="Add a 3D view of a scene and its cameras; its plants are grown again.")
    ] = False,
) -> None:
    """Write an HTML report and a contact sheet. The files are in the folder of the data set."""
    from pepperscene.dataset.readers import open_images
    from pepperscene.review.report import write_report

    other = None if beside is None else open_images(beside, **vars(meaning))
    for name, value in vars(meaning).items():
        if beside is None and value is not None:
            raise InputError(f"--{name}", "applies only with --beside")
    written = write_report(folder, limit, other, sample=sample, scene=scene, on_progress=echo_measured)
    typer.echo(
        f"{written.shown} of {written.frames} frames shown, {written.measured} measured:\n"
        f"  {written.sheet}\n  {written.page}"
    )
    if written.missing_scene:
        echo_note(f"the page has no 3D view: {written.missing_scene}")


@dataclass(frozen=True)
class MeasuredScale:
    """How many images are measured, and at which size."""

    limit: Annotated[
        int, Option("Measure at most this many images of each set.", minimum=1, shows_range=True)
    ] = 1000
    width: Annotated[
        int,
        Option(
            "Reduce images to this width in pixels before measuring texture.", minimum=1, shows_range=True
        ),
    ] = 580
    pixel_mm: Annotated[
        str | None, Option("Millimetres per pixel on the plants. Overrides --width.", "A,B")
    ] = None


@command
def compare(
    *,
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
    scale: MeasuredScale,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw Figs. 10 to 13 of the paper as .svg or .png.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Compare two image sets. Measures colour, saturation, texture, class fractions, positions and light."""
    from pepperscene.colour import comparison_figure, comparison_json, comparison_tables
    from pepperscene.colour.comparison.compare import compare as compare_sets
    from pepperscene.colour.comparison.compare import open_two_sets

    if figure is not None and figure.suffix.lower() not in (".svg", ".png"):
        raise InputError("--figure", f"must end in .svg or .png, not {figure.name}")
    pixel_mm = _pixel_sizes(scale.pixel_mm)
    sets = open_two_sets(first, second, labels, half)
    comparison = compare_sets(
        *sets, limit=scale.limit, width_px=scale.width, pixel_mm=pixel_mm, on_progress=echo_measured
    )
    if json:
        print_json(comparison_json(comparison))
    else:
        print_tables(comparison_tables(comparison))
    if figure is not None:
        _write_figure(figure, comparison_figure(comparison, figure.suffix.lower()[1:]))


def _pixel_sizes(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError("--pixel-mm", f"must be two numbers such as 1.2,0.9, not {text}") from None
    return first, second


def _write_figure(file: Path, content: bytes) -> None:
    from pepperscene.atomic import atomic_write, check_can_write

    check_can_write(file.absolute().parent, [file.name])
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(file) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise OutputError(f"{file}: the figure cannot be written ({error.strerror or error})") from None
    echo_progress(f"figure: {file}")


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
        echo_note("no browser was found; open the page in one")


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

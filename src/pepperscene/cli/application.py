"""The command-line application, its standard streams, and the options and errors that its commands share."""

from __future__ import annotations

import codecs
import errno
import functools
import io
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NoReturn, ParamSpec, TextIO, TypeVar, final

import typer

from pepperscene.cli.options import OPTION_NAMES, expand_options
from pepperscene.cli.progress import echo_progress
from pepperscene.errors import (
    EXIT_BAD_INPUT,
    ArgumentError,
    InputError,
    OutputError,
    PepperError,
    is_out_of_memory,
)
from pepperscene.interrupts import Interrupted, interruptible, raise_if_interrupted
from pepperscene.options import Option
from pepperscene.outputs import DEFAULT_OUTPUTS, OUTPUTS, check_outputs
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.colour.comparison.tables import TextTable

EXIT_NO_READER: Final = 141
"""As shells report a process that was ended by SIGPIPE."""

_STDOUT: Final = 1
_STDERR: Final = 2
_ESCAPE: Final = "pepperscene.escape"


def protect_streams() -> None:
    """Make failures of standard output and error errors that `main` understands.

    | | standard output | standard error |
    |---|---|---|
    | the reader of the pipe has ended | `SystemExit` with `EXIT_NO_READER` | the same |
    | other errors, such as a full disk | `OutputError` | the messages are lost |

    File names that are not valid text are written as the bytes that they are, and characters that the
    encoding lacks as escape sequences.
    """
    codecs.register_error(_ESCAPE, _escape)
    # Streams that were replaced, as tests do, stay.
    if sys.stdout is sys.__stdout__ and sys.stdout is not None:
        sys.stdout = sys.__stdout__ = _protected(sys.stdout, _STDOUT, _ESCAPE)  # type: ignore[misc]
    if sys.stderr is sys.__stderr__ and sys.stderr is not None:
        sys.stderr = sys.__stderr__ = _protected(sys.stderr, _STDERR, "backslashreplace")  # type: ignore[misc]


@final
class _Descriptor(io.FileIO):
    """Standard output or error, unbuffered."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)

    def write(self, data: Any, /) -> int:
        """Write some of the data; see `protect_streams` for errors."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno == errno.EPIPE:
                self._discard()
                raise SystemExit(EXIT_NO_READER) from None
            if self.fileno() == _STDERR:
                return memoryview(data).nbytes
            self._discard()
            raise OutputError(f"standard output: cannot be written ({error.strerror})") from None

    def _discard(self) -> None:
        """Discard what is still buffered; Python would try to write it again when it ends."""
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, self.fileno())
        os.close(null)


def _protected(stream: TextIO, descriptor: int, errors: str) -> io.TextIOWrapper:
    stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(_Descriptor(descriptor)),
        encoding=stream.encoding,
        errors=errors,
        line_buffering=bool(getattr(stream, "line_buffering", False)),
        write_through=bool(getattr(stream, "write_through", False)),
    )


def _escape(error: UnicodeError) -> tuple[str | bytes, int]:
    """Error handler: the original bytes of file names, escape sequences for other characters."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    try:
        return codecs.lookup_error("surrogateescape")(error)
    except UnicodeEncodeError:
        return codecs.lookup_error("backslashreplace")(error)


EXIT_SIGNAL: Final = 128
"""Exit code after a signal, without its number: as shells report a process that was ended by it."""

DEFAULTS: Final = ",".join(DEFAULT_OUTPUTS)

P = ParamSpec("P")
R = TypeVar("R")

app = typer.Typer(
    name="pepperscene",
    help="Render labelled, radiometrically calibrated images of sweet-pepper plants by spectral light "
    "transport.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main() -> NoReturn:
    """Run the command line."""
    protect_streams()
    try:
        app()
    except PepperError as error:
        # The help could not be written; commands handle their own errors.
        echo_progress(f"error: {error}")
        sys.exit(EXIT_BAD_INPUT)
    sys.exit(0)


_CONFIGURATIONS: Final = {"matplotlibrc": "Matplotlib", ".numba_config.yaml": "Numba"}
"""Files that libraries read in the current folder. They can name programs that charts start (TeX), and a
folder of compiled code that is loaded."""


TRACEBACK: Final = "PEPPERSCENE_TRACEBACK"
"""Environment variable: "1" for the traceback of system errors that no check has foreseen."""


def handle_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Wrap a command so that foreseeable errors and signals give one line on standard error, no traceback."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with interruptible():
            try:
                _check_current_folder()
                result = command(*args, **kwargs)
                raise_if_interrupted()
                return result
            except PepperError as error:
                message = str(error)
                if isinstance(error, ArgumentError):
                    option = OPTION_NAMES.get(error.where, error.where).replace("_", "-")
                    message = f"--{option}: {error.detail}"
                echo_progress(f"error: {' '.join(message.split())}")
                raise typer.Exit(EXIT_BAD_INPUT) from None
            except OSError as error:
                # No check has foreseen it, so the user may need the place in the program.
                if os.environ.get(TRACEBACK) == "1":
                    traceback.print_exc()
                echo_progress(f"error: {_describe_system_error(error)}")
                raise typer.Exit(EXIT_BAD_INPUT) from None
            except (MemoryError, RuntimeError) as error:
                if not is_out_of_memory(error):
                    raise
                echo_progress("error: memory ran out; use fewer or smaller images, or a larger machine")
                raise typer.Exit(EXIT_BAD_INPUT) from None
            except KeyboardInterrupt as error:
                # Commands note what was written.
                echo_progress("; ".join(("interrupted", *getattr(error, "__notes__", ()))))
                number = error.number if isinstance(error, Interrupted) else signal.SIGINT
                raise typer.Exit(EXIT_SIGNAL + number) from None

    return run


def command(function: Callable[P, R]) -> Callable[P, R]:
    """Add a command to the application: its name and help are those of the function.

    Option models among its parameters become options, and errors become one line.
    """
    name = function.__name__.replace("_", "-")
    app.command(name)(handle_errors(expand_options(function)))
    return function


def _check_current_folder() -> None:
    """Raise an error if the current folder was removed, which ends Mitsuba, or configures a library."""
    try:
        os.getcwd()
    except OSError:
        raise OutputError("the current folder does not exist any more; change to another folder") from None
    for name, library in _CONFIGURATIONS.items():
        if os.path.lexists(name):
            problem = f"is in the current folder, where {library} reads settings that can run programs"
            raise InputError(name, f"{problem}; remove it, or change to another folder")


def _describe_system_error(error: OSError) -> str:
    """A system error that no check has foreseen, in words."""
    problem = " ".join(str(error.strerror or error).split()) or type(error).__name__
    number = "" if error.errno is None else f", error {error.errno}"
    where = "" if error.filename is None else f"{error.filename}: "
    return f"{where}{problem} (a system error{number}; with {TRACEBACK}=1 it has a traceback)"


def _show_version(requested: bool) -> None:
    if requested:
        typer.echo(f"pepperscene {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit."),
    ] = False,
) -> None:
    pass


RecipeArgument = Annotated[
    str, typer.Argument(help="Recipe file, or name of a shipped recipe (see `recipes`).")
]
OutputsOption = Annotated[
    str, typer.Option(metavar="NAMES", help=f"Outputs to write, comma-separated: {', '.join(OUTPUTS)}.")
]
QualityOption = Annotated[
    str, typer.Option(metavar="NAME", help="Rendering quality: draft, standard or reference.")
]
SeedOption = Annotated[int | None, typer.Option(help="Random seed. Overrides the recipe's.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY=VALUE", help="Change one value of the recipe (camera.flash=none); can be repeated."
    ),
]
CodeOption = Annotated[
    bool,
    typer.Option(
        "--allow-code", help='Allow the code of the recipe to run, which views of the kind "function" need.'
    ),
]


@dataclass(frozen=True)
class LabelOptions:
    """How the masks of folders of images are read; the names are those of arguments of `open_images`."""

    labels: Annotated[str | None, Option("Meaning of the masks of a folder of images.", "NAME")] = None
    half: Annotated[str | None, Option("Half of the published data set: synthetic or empirical.", "NAME")] = (
        None
    )


FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the complete result as JSON.")]


def print_ruled_table(
    heads: Sequence[str], rows: Iterable[Sequence[str]], title: str | None = None, notes: Iterable[str] = ()
) -> None:
    """Print a table with rules and wrapped cells, for terminals."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    table = Table(*heads, title=None if title is None else Text(title), title_justify="left")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)
    for note in notes:
        console.print(Text(note))


def print_tables(tables: Sequence[TextTable]) -> None:
    """Print tables with rules on a terminal, as plain text elsewhere."""
    from pepperscene.colour import format_tables

    if not sys.stdout.isatty():
        typer.echo(format_tables(tables))
        return
    for table in tables:
        print_ruled_table(table.heads, table.rows, table.title, table.notes)


def print_json(content: Any) -> None:
    """Print the complete result of a command."""
    typer.echo(json.dumps(content, indent=1, allow_nan=False))


def print_paths(paths: Iterable[Path]) -> None:
    """Print the files that a command has written."""
    for path in paths:
        typer.echo(path)


def parse_outputs(outputs: str) -> tuple[str, ...]:
    """Output names from a comma-separated list."""
    return check_outputs(name.strip() for name in outputs.split(",") if name.strip())

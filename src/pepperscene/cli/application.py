"""The application that commands are added to, and what they share."""

from __future__ import annotations

import functools
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Final, ParamSpec, TypeVar

import typer

from pepperscene.errors import EXIT_BAD_INPUT, ArgumentError, PepperError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS, check_outputs
from pepperscene.version import __version__

EXIT_INTERRUPTED: Final = 130
"""As shells report a process that was ended by Ctrl-C."""

DEFAULTS: Final = ",".join(DEFAULT_OUTPUTS)

P = ParamSpec("P")
R = TypeVar("R")

app = typer.Typer(
    name="pepperscene",
    help="Labelled, radiometrically calibrated images of sweet-pepper plants, by spectral light transport.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main() -> None:
    """Run the command line."""
    app()


_OPTIONS: Final = {"changes": "set", "form": "format", "names": "fit", "smallest_px": "smallest"}
"""Options whose name is not that of the argument that they set."""


def handle_errors(command: Callable[P, R]) -> Callable[P, R]:
    """The command with every foreseeable error as one line on standard error, without a traceback."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except PepperError as fault:
            message = str(fault)
            if isinstance(fault, ArgumentError):
                message = f"--{_OPTIONS.get(fault.where, fault.where).replace('_', '-')}: {fault.detail}"
            typer.echo(f"error: {' '.join(message.split())}", err=True)
            raise typer.Exit(EXIT_BAD_INPUT) from None
        except KeyboardInterrupt:
            typer.echo("interrupted; a build keeps whole frames and goes on with the same command", err=True)
            raise typer.Exit(EXIT_INTERRUPTED) from None

    return run


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """SIGTERM, as a cluster sends it before the time is over, ends what is done as Ctrl-C does."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    # Signals can only be caught in a program's first thread.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pepperscene {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


RecipeArgument = Annotated[
    str, typer.Argument(help="A recipe file, or the name of a shipped one (see `recipes`).")
]
OutputsOption = Annotated[
    str, typer.Option(metavar="NAMES", help=f"Of {', '.join(OUTPUTS)}; separated by commas.")
]
QualityOption = Annotated[
    str, typer.Option(metavar="NAME", help="draft, standard or reference: how much light is traced.")
]
TargetOption = Annotated[
    float | None,
    typer.Option(
        help="Light's error over the sensor's noise at which sampling stops; the quality's own otherwise."
    ),
]
SeedOption = Annotated[int | None, typer.Option(help="Instead of the recipe's.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY=VALUE", help="Change one value of the recipe, as camera.flash=none; can be repeated."
    ),
]


def names_of(outputs: str) -> tuple[str, ...]:
    """Output names out of a list with commas."""
    return check_outputs(name.strip() for name in outputs.split(",") if name.strip())


def told(text: str) -> None:
    """A line of progress, beside what is printed for keeps."""
    typer.echo(text, err=True)

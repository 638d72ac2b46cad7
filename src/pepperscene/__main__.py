"""The start of the command line: of `pepperscene` and of `python -m pepperscene`.

Signals and missing standard streams are handled before anything else is imported, because the imports take
most of the first second. Programs that import the package get no signal handlers.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys

# Every import before the handlers delays them.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn

MIN_ADDRESS_SPACE = 600_000_000
"""Bytes; measured: with 400 MB the libraries of a build crash, with 500 MB they do not."""

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals that end a command, as far as the system has them."""


def main() -> NoReturn:
    """Run the command line."""
    _open_missing_streams()
    _end_at_signals()
    _check_address_space()
    from pepperscene.cli import main as run_command

    try:
        run_command()
    except SystemExit as end:
        # A command that was interrupted has cleaned up: a second signal has nothing left to break.
        if isinstance(end.code, int) and end.code > 128:
            os._exit(end.code)
        raise
    sys.exit(0)


def _open_missing_streams() -> None:
    """Connect standard streams that are closed with the null device.

    Otherwise the next file that is opened would become standard output, and messages would be written into
    it.
    """
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            # The system assigns the lowest free number, which is this one.
            os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)
        if getattr(sys, name) is None:
            mode = "w" if descriptor else "r"
            setattr(sys, name, open(descriptor, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


def _check_address_space() -> None:
    """End with one line if `ulimit -v` allows so little that compiled libraries crash or hang on import."""
    try:
        import resource
    except ImportError:
        # Windows has no such limit.
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < MIN_ADDRESS_SPACE:
        allowed, needed = limit / 1e9, MIN_ADDRESS_SPACE / 1e9
        os.write(
            2, b"error: needs %.1f GB of address space, but `ulimit -v` allows %.1f GB\n" % (needed, allowed)
        )
        os._exit(2)


def _end_at_signals() -> None:
    """End the process at once when a signal arrives, with one line on standard error and 128 + its number.

    Nothing is unwound: an exception in an import or in a destructor would become a traceback or an abort.
    While a command runs, `pepperscene.interrupts` replaces these handlers.
    """

    def end(number: int, _: object) -> None:
        try:
            os.write(2, b"interrupted\n")
        finally:
            os._exit(128 + number)

    def ignore() -> None:
        for number in numbers:
            signal.signal(number, signal.SIG_IGN)

    # `nohup` and shells ignore signals on behalf of background processes.
    present = [getattr(signal, name) for name in SIGNALS if hasattr(signal, name)]
    numbers = [number for number in present if signal.getsignal(number) is not signal.SIG_IGN]
    for number in numbers:
        signal.signal(number, end)
    # Registered first, so called last: the interpreter then takes itself apart, and handlers no longer work.
    atexit.register(ignore)


def _leave_current_folder() -> None:
    """Take the current folder, which `python -m` searches first, off the search path of modules.

    It stays if it is the folder that holds this package.
    """
    folder = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if not sys.flags.safe_path and os.path.abspath(sys.path[0]) != folder:
        del sys.path[0]


if __name__ == "__main__":
    _leave_current_folder()
    main()

"""Standard output and error of the command line when their reader has ended, or their disk is full."""

from __future__ import annotations

import codecs
import errno
import io
import os
import sys
from typing import Any, Final, TextIO, final

from pepperscene.errors import OutputError

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

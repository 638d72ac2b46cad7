"""Every error that a user can meet.

Each message is one sentence that names the file or argument, the key, the value and what is allowed. The
command line prints it without a traceback and exits with code 2.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

EXIT_BAD_INPUT: Final = 2


class PepperError(Exception):
    """Base of all errors that the user can fix; never raised itself."""


class InputError(PepperError):
    """A file holds something that is not allowed.

    Args:
        where: the file.
        problem: what is wrong, or what is allowed, as the end of a sentence ("must be ...").
        key: dotted key inside the file ("flash.illuminance_lx"), or "" when the whole file is meant.
        value: the value found, or None when it is missing or the fault is not a value's.
    """

    def __init__(self, where: str | Path, problem: str, *, key: str = "", value: object = None) -> None:
        self.where, self.problem, self.key, self.value = str(where), problem, key, value
        super().__init__(": ".join(part for part in (self.where, self.detail) if part))

    @property
    def detail(self) -> str:
        """The message without the name of the file or argument."""
        subject = f"{self.key} = {_shown(self.value)}" if self.key and self.value is not None else self.key
        return ": ".join(part for part in (subject, self.problem) if part)

    def __reduce__(self) -> tuple[object, ...]:
        """Errors are sent between processes, and not every value can be pickled."""
        value = self.value if isinstance(self.value, str | int | float | bool | None) else _shown(self.value)
        return _restored, (type(self), self.where, self.problem, self.key, value)


class ArgumentError(InputError):
    """An argument of a function has a value that is not allowed.

    `where` is the argument's name; the command line prints the option of that name instead.
    """


def _restored(kind: type[InputError], where: str, problem: str, key: str, value: object) -> InputError:
    return kind(where, problem, key=key, value=value)


class OutputError(PepperError):
    """The output folder cannot be used or written to."""


class WorkerError(PepperError):
    """Worker processes were lost; finished frames are kept."""


class SetupError(PepperError):
    """The machine lacks something (a JIT variant, an LLVM library); the message says what to install."""


def _shown(value: object, limit: int = 80) -> str:
    """The value as Python writes it, on one line and cut to `limit` characters."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        # Python writes neither integers of thousands of digits nor lists nested as deeply.
        return f"an integer of {value.bit_length()} bits" if isinstance(value, int) else type(value).__name__
    return text if len(text) <= limit else text[: limit - 1] + "…"

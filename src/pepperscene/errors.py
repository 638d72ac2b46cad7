"""All errors that users can encounter.

Each message is one sentence that names the file or argument, the key, the value and what is allowed. The
command line prints it without a traceback and exits with code 2.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

EXIT_BAD_INPUT: Final = 2

NEEDS_PERMISSION: Final = "runs only with --allow-code (in Python, allow_code=True)"
"""End of the sentence about code of the user's that a command would run."""


class PepperError(Exception):
    """Base class of all errors that users can fix; never raised itself."""


class InputError(PepperError):
    """A file contains something that is not allowed.

    Args:
        where: the file.
        problem: what is wrong or what is allowed, as the end of a sentence ("must be ...").
        key: dotted key inside the file ("flash.illuminance_lx"), or "" for the whole file.
        value: the value found, or None if it is missing or not the cause.
    """

    def __init__(self, where: str | Path, problem: str, *, key: str = "", value: object = None) -> None:
        self.where, self.problem, self.key, self.value = str(where), problem, key, value
        super().__init__(": ".join(part for part in (self.where, self.detail) if part))

    @property
    def detail(self) -> str:
        """The message without the name of the file or argument."""
        subject = self.key
        if self.key and self.value is not None:
            subject = f"{self.key} = {_one_line(self.value)}"
        return ": ".join(part for part in (subject, self.problem) if part)

    def __reduce__(self) -> tuple[object, ...]:
        """Support pickling with any value, because errors are sent between processes."""
        is_simple = isinstance(self.value, str | int | float | bool | None)
        value = self.value if is_simple else _one_line(self.value)
        return _restored, (type(self), self.where, self.problem, self.key, value)


class ArgumentError(InputError):
    """A function argument has a value that is not allowed.

    `where` is the argument's name; the command line prints the option of that name instead.
    """


def _restored(kind: type[InputError], where: str, problem: str, key: str, value: object) -> InputError:
    return kind(where, problem, key=key, value=value)


class OutputError(PepperError):
    """The output folder cannot be used or written to."""


class WorkerError(PepperError):
    """Worker processes were lost; finished frames are kept."""


class SetupError(PepperError):
    """The system lacks something (a JIT variant, an LLVM library); the message says what to install."""


def _one_line(value: object, limit: int = 80) -> str:
    """The value's `repr`, cut to `limit` characters."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        # Integers of thousands of digits and deeply nested lists have no `repr`.
        return f"an integer of {value.bit_length()} bits" if isinstance(value, int) else type(value).__name__
    return text if len(text) <= limit else text[: limit - 1] + "…"

"""Every error that a user can meet.

Each message is one sentence that names the file, the key, the value and what is allowed. The command line
prints it without a traceback and leaves with exit code 2.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

EXIT_BAD_INPUT: Final = 2


class PepperError(Exception):
    """Base of all errors that are the caller's to mend; never raised itself."""


class InputError(PepperError):
    """A file or an argument says something that is not allowed.

    Args:
        where: the file or the command-line option that holds the fault.
        key: dotted key inside it ("flash.illuminance_lx"), or "" when the whole is meant.
        value: the value found, or None when it is missing or the fault is not a value's.
        allowed: what would be right, as the end of a sentence ("must be ...").
    """

    def __init__(self, where: str | Path, key: str, value: object, allowed: str) -> None:
        self.where, self.key, self.value, self.allowed = str(where), key, value, allowed
        subject = f"{key} = {_shown(value)}" if key and value is not None else key
        super().__init__(": ".join(part for part in (str(where), subject, allowed) if part))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, object, str]]:
        """Another process may be the one that finds the fault."""
        value = self.value if isinstance(self.value, str | int | float | bool | None) else _shown(self.value)
        return type(self), (self.where, self.key, value, self.allowed)


class OutputError(PepperError):
    """The output folder cannot take what is to be written there."""


class WorkerError(PepperError):
    """Whoever was to make frames is lost; what was finished is kept."""


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

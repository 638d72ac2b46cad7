"""All errors that users can encounter.

Each message is one sentence that names the file or argument, the key, the value and what is allowed. The
command line prints it without a traceback and exits with code 2.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

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
            subject = f"{self.key} = {short_repr(self.value)}"
        return ": ".join(part for part in (subject, self.problem) if part)

    def __reduce__(self) -> tuple[object, ...]:
        """Support pickling with any value, because errors are sent between processes."""
        is_simple = isinstance(self.value, str | int | float | bool | None)
        value = self.value if is_simple else short_repr(self.value)
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


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that memory ran out; Dr.Jit and Open Image Denoise raise `RuntimeError`."""
    text = str(error).lower()
    return isinstance(error, MemoryError) or "out of memory" in text or "bad_alloc" in text


def short_repr(value: object, limit: int = 80) -> str:
    """The value's `repr`, cut to `limit` characters; no more of it is made, however long the value is."""
    text = ""
    try:
        for piece in _repr_pieces(value, limit):
            text += piece
            if len(text) > limit:
                break
    except (ValueError, RecursionError):
        # Integers of thousands of digits have no `repr`; that of deeply nested lists says nothing.
        return f"an integer of {value.bit_length()} bits" if isinstance(value, int) else type(value).__name__
    return text if len(text) <= limit else text[: limit - 1] + "…"


def _repr_pieces(value: Any, limit: int, depth: int = 0) -> Iterator[str]:
    """The `repr` of a value in pieces, which are made as they are needed."""
    if depth > _MAX_DEPTH:
        raise RecursionError
    if type(value) in (str, bytes):
        # Each character of a text is one or more of its `repr`.
        yield repr(value[: limit + 1])
    elif type(value) in _BRACKETS:
        opening, closing = _BRACKETS[type(value)]
        yield opening
        for number, item in enumerate(value):
            yield ", " if number else ""
            yield from _repr_pieces(item, limit, depth + 1)
            if type(value) is dict:
                yield ": "
                yield from _repr_pieces(value[item], limit, depth + 1)
        yield f",{closing}" if type(value) is tuple and len(value) == 1 else closing
    else:
        yield repr(value)


_MAX_DEPTH: Final = 32  # chosen: levels of nested values that a message shows
_BRACKETS: Final[Mapping[type, tuple[str, str]]] = {list: ("[", "]"), tuple: ("(", ")"), dict: ("{", "}")}

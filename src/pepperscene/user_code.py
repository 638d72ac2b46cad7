"""Functions and classes of the user's, by the name of their module: the only import by such a name."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

from pepperscene.errors import NEEDS_PERMISSION, ArgumentError, InputError, PepperError, is_out_of_memory


def import_callable(path: str, argument: str, *, allow_code: bool) -> Callable[..., Any]:
    """The callable of a text "module:name"; the module is looked for in the current folder, too.

    The text must come from the user: from the command line or from Python, never from a file.

    Args:
        path: the text, with both names.
        argument: that it is the value of, for messages.
        allow_code: whether the user has asked for code to run; without it, nothing is imported.

    Raises:
        ArgumentError: code is not allowed, the module cannot be imported, or it has no such callable.
    """
    if not allow_code:
        raise ArgumentError(argument, f"the code of {path} {NEEDS_PERMISSION}")
    module, _, attribute = path.partition(":")
    try:
        with _current_folder_searched():
            found = getattr(importlib.import_module(module), attribute)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        # The module is the user's and may raise anything, also `SystemExit`.
        if isinstance(error, AttributeError) and module in sys.modules:
            raise ArgumentError(argument, f"{module} has no {attribute}") from None
        reason = str(error) if isinstance(error, ImportError) else describe_error(error)
        raise ArgumentError(argument, f"{module} cannot be imported ({' '.join(reason.split())})") from None
    if not callable(found):
        raise ArgumentError(argument, f"{path} is not callable")
    return found


@contextmanager
def user_errors(where: str, argument: str = "", *, key: str = "") -> Iterator[None]:
    """Turn whatever a function of the user's raises into one sentence, except Ctrl-C and a lack of memory.

    What it prints is sent to standard error, because a program may read standard output, as with `--json`.

    Args:
        where: name of the function or of its file.
        argument: that it is the value of, if there is one.
        key: name of the function in the file.

    Raises:
        InputError: the function has failed; an `ArgumentError` if there is an argument.
    """
    try:
        with redirect_stdout(sys.stderr):
            yield
    except (KeyboardInterrupt, PepperError):
        raise
    except BaseException as error:
        if isinstance(error, MemoryError | RuntimeError) and is_out_of_memory(error):
            raise
        problem = f"failed with {describe_error(error)}"
        if argument:
            raise ArgumentError(argument, f"{where} {problem}") from error
        raise InputError(where, problem, key=key) from error


@contextmanager
def _current_folder_searched() -> Iterator[None]:
    """Search modules in the current folder last, as long as the block runs."""
    folder, before = os.getcwd(), list(sys.path)
    added = folder not in before and "" not in before
    if added:
        sys.path.append(folder)
    try:
        yield
    finally:
        if added and folder in sys.path:
            sys.path.remove(folder)


def describe_error(error: BaseException) -> str:
    """The type and the message of an error, in one line."""
    text = " ".join(str(error).split())
    return ": ".join(part for part in (type(error).__name__, text) if part)

"""Functions and classes of the user's, by the name of their module."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from typing import Any

from pepperscene.errors import ArgumentError


def import_callable(path: str, argument: str) -> Callable[..., Any]:
    """The callable of a text "module:name"; the module is looked for in the current folder, too.

    Args:
        path: the text, with both names.
        argument: that it is the value of, for messages.

    Raises:
        ArgumentError: the module cannot be imported, or has no such callable.
    """
    module, _, attribute = path.partition(":")
    # A module in the current folder, as `python` itself would find it.
    if "" not in sys.path:
        sys.path.append("")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except Exception as error:
        # The module is the user's and may raise anything.
        if isinstance(error, AttributeError) and module in sys.modules:
            raise ArgumentError(argument, f"{module} has no {attribute}") from None
        text = " ".join(str(error).split()) or type(error).__name__
        raise ArgumentError(argument, f"{module} cannot be imported ({text})") from None
    if not callable(found):
        raise ArgumentError(argument, f"{path} is not callable")
    return found

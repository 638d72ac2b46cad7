"""Libraries that only an export needs."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from pepperscene.errors import SetupError


def library(module: str) -> Any:
    """A module of a library that comes with the extra `export`.

    Raises:
        SetupError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        raise SetupError(
            f"this format needs {name}, which is not installed; `pip install 'pepperscene[export]'` brings it"
        ) from None

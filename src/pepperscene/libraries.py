"""Libraries of optional extras, imported where they are used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from pepperscene.errors import SetupError


def import_library(module: str, extra: str = "export") -> Any:
    """Import a module of a library that an extra installs."""
    try:
        return import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        problem = f"this needs {name}, which is not installed"
        raise SetupError(f"{problem}; install it with `pip install 'pepperscene[{extra}]'`") from None

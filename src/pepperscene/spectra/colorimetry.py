"""The one door to colour-science, whose import takes a second and complains where matplotlib is missing."""

from __future__ import annotations

import warnings
from functools import cache
from types import ModuleType


@cache
def colour_science() -> ModuleType:
    """The package `colour`, imported when first asked for.

    It warns where matplotlib is not installed, which only its plots need; nothing here plots, so that a user
    should not have to wonder.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", '"Matplotlib" related API features are not available')
        import colour
    return colour

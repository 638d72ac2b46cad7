"""Compilation of functions by Numba; only modules that are imported on the first contact use it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function on its first call, and keep the machine code on the disk if that can be written to.

    Multiplications and additions are rounded one by one, so that results do not depend on the processor.
    """
    import numba

    try:
        return cast(Function, numba.njit(cache=True, nogil=True, fastmath=False)(function))
    except RuntimeError:
        # Numba found no folder for the machine code.
        return cast(Function, numba.njit(nogil=True, fastmath=False)(function))

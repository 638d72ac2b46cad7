"""Functions that Numba compiles, where it is installed.

Each has a reference without Numba, which gives the same bits and is used where Numba is missing.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, TypeVar, cast

AVAILABLE = find_spec("numba") is not None
"""Whether Numba is installed (extra `fast`). Tests and benchmarks set it to False for the reference."""

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function on its first call, and keep the machine code on the disk.

    Multiplications and additions are rounded one by one, so that results equal those of NumPy.
    """
    import numba

    try:
        return cast(Function, numba.njit(cache=True, nogil=True, fastmath=False)(function))
    except RuntimeError:
        # No folder for the machine code can be written to.
        return cast(Function, numba.njit(nogil=True, fastmath=False)(function))

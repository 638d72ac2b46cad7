"""Tables from NumPy for the kernel, laid out so that new contents never mean new machine code.

Dr.Jit adopts memory of NumPy as it is, and writes other code for an array that does not begin at a whole
vector register: fetches of several neighbouring entries are then split up (slower), and since the arrays of
NumPy begin anywhere, the same scene can compile anew each time it is built. An array of a single entry is a
constant to it. So every table that a kernel reads goes through `device_table`, and every number that differs
from scene to scene through `device_number`.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from pepperscene.render.variant import kernel

ALIGNMENT: Final = 64
"""Bytes: the widest vector register there is (AVX-512), and a cache line."""


def device_table(values: ArrayLike, dtype: DTypeLike = np.float32) -> Any:
    """A flat table on the device, aligned, of at least two entries.

    Args:
        values: of any shape, taken row by row.
        dtype: `float32` gives a `Float`, `uint32` a `UInt32`.

    Raises:
        ValueError: there are no values, or no such tables.
    """
    mi, _ = kernel()
    kinds = {"float32": mi.Float, "uint32": mi.UInt32}
    wanted = np.dtype(dtype)
    if wanted.name not in kinds:
        raise ValueError(f"there are tables of float32 and of uint32, not of {wanted}")
    return kinds[wanted.name](aligned(values, wanted))


def device_number(value: float, *, whole: bool = False) -> Any:
    """A number that changes from scene to scene or from frame to frame: no constant of the kernel.

    Args:
        value: the number.
        whole: as a `UInt32` instead of a `Float`.
    """
    mi, dr = kernel()
    number = mi.UInt32(int(value)) if whole else mi.Float(float(value))
    dr.make_opaque(number)
    return number


def aligned(values: ArrayLike, dtype: DTypeLike = np.float32) -> NDArray[Any]:
    """A flat copy that begins at a multiple of `ALIGNMENT` bytes; a single entry is there twice.

    Raises:
        ValueError: there are no values.
    """
    given = np.asarray(values)
    if given.size == 0:
        raise ValueError("a table needs at least one value")
    kind = np.dtype(dtype)
    # As many entries more as the start can be off by; NumPy's own memory is aligned to one entry at least.
    room = np.empty(max(given.size, 2) + ALIGNMENT // kind.itemsize, kind)
    start = (-room.ctypes.data % ALIGNMENT) // kind.itemsize
    found = room[start : start + max(given.size, 2)]
    found[: given.size].reshape(given.shape)[...] = given
    found[given.size :] = found[0]
    return found

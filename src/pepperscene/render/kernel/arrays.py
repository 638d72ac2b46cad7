"""Tables from NumPy for the kernel, laid out so that new contents never mean new machine code.

Dr.Jit adopts memory of NumPy as it is, and writes other code for an array that does not begin at a whole
vector register: fetches of several neighbouring entries are then split up (slower), and since the arrays of
NumPy begin anywhere, the same scene can compile anew each time it is built. An array of a single entry is a
constant to it. So every table that a kernel reads goes through `device_table`, and every number that differs
from scene to scene through `device_number`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from pepperscene.geometry import Mesh
from pepperscene.render.variant import mitsuba_modules

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
    mi, _ = mitsuba_modules()
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
    mi, dr = mitsuba_modules()
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


_STEP: Final = 8.0
"""Units between grid points: chosen, so that plants on a bench and rows in a house keep the origin 0. Rays in
the scene's middle are lifted by up to 0.9 mm, as they are 4 m along a row."""
_TINY: Final = 1.0 / 16.0
"""Metres: chosen, the largest extent below which the unit is not a metre. At it the lift is 0.3 %."""
_LEAST_UNIT: Final = 2.0**-30
"""Metres: chosen, a nanometre; waves are longer than what would be told apart by less."""
_FARTHEST: Final = 1e7
"""Metres: chosen, beyond it single precision rounds a mesh's own vertices to whole metres."""


@dataclass(frozen=True)
class LocalCoordinates:
    """The kernel's coordinates: world metres less `origin`, over `unit`.

    Attributes:
        origin: metres.
        unit: metres, a power of two.
    """

    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: float = 1.0

    def places(self, points: ArrayLike) -> NDArray[np.float64]:
        """World points `(..., 3)`, metres, in the kernel's coordinates."""
        return np.asarray((np.asarray(points, float) - self.origin) / self.unit)

    def vertices(self, mesh: Mesh) -> NDArray[np.float32]:
        """`(v, 3)` a mesh's vertices in the kernel's coordinates; the mesh's own where they are those."""
        if self == WORLD:
            return mesh.vertices
        # Exact in single precision: the origin is a multiple of what neighbouring vertices differ by.
        return (mesh.vertices - np.array(self.origin, np.float32)) / np.float32(self.unit)


WORLD: Final = LocalCoordinates()
"""World coordinates in metres."""


def local_coordinates(mesh: Mesh) -> LocalCoordinates:
    """The region that suits a mesh.

    Raises:
        ValueError: the mesh has no triangles, or vertices that are no finite numbers or lie too far away.
    """
    if not len(mesh.faces) or not len(mesh.vertices):
        raise ValueError("the mesh has no triangles: there is nothing to render")
    low, high = mesh.bounds.astype(float)
    if not max(-low.min(), high.max()) <= _FARTHEST:
        raise ValueError(f"the mesh's vertices must be numbers within {_FARTHEST:g} m of the origin")
    extent = float((high - low).max())
    unit = 1.0 if extent >= _TINY else max(2.0 ** np.floor(np.log2(max(extent, _LEAST_UNIT))), _LEAST_UNIT)
    step = _STEP * unit
    x, y, z = (np.rint((low + high) / (2.0 * step)) * step).tolist()
    return LocalCoordinates((x, y, z), float(unit))

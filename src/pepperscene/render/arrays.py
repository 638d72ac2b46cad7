"""Device arrays and numbers, and the coordinates that a scene is stored in.

Dr.Jit adopts NumPy memory without a copy, and compiles other, slower code for an array that does not start at
a vector register boundary. NumPy arrays start anywhere, so a scene could be compiled again each time it is
built. An array with one entry becomes a constant of the code. Therefore every array that a kernel reads goes
through `device_array`, and every number that differs between scenes or frames through `device_float` or
`device_uint`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from pepperscene.geometry import Mesh
from pepperscene.render.variant import mitsuba_modules

ALIGNMENT: Final = 64
"""Bytes: the widest vector register (AVX-512), and a cache line."""

BATCH: Final = 4
"""Bands that one kernel computes at a time: as many as wavelengths, so that the same code serves both."""


def device_array(values: ArrayLike, dtype: DTypeLike = np.float32) -> Any:
    """Copy values to a flat device array, aligned to `ALIGNMENT`; a single entry is repeated.

    Args:
        values: any shape, flattened in C order.
        dtype: `float32` gives a `Float`, `uint32` a `UInt32`.

    Raises:
        ValueError: `values` is empty, or `dtype` is another type.
    """
    mi, _ = mitsuba_modules()
    source, kind = np.asarray(values), np.dtype(dtype)
    if source.size == 0 or kind.name not in ("float32", "uint32"):
        raise ValueError(f"a device array has at least one float32 or uint32, not {source.size} {kind}")
    # NumPy aligns memory to one entry at least, so this many spare entries cover any offset.
    size = max(source.size, 2)
    buffer = np.empty(size + ALIGNMENT // kind.itemsize, kind)
    start = (-buffer.ctypes.data % ALIGNMENT) // kind.itemsize
    aligned = buffer[start : start + size]
    aligned[: source.size].reshape(source.shape)[...] = source
    aligned[source.size :] = aligned[0]
    return (mi.Float if kind.name == "float32" else mi.UInt32)(aligned)


def channel_array(count: int) -> Any:
    """The type of light in so many sensor channels: 1, 3, or `BATCH` of the bands of a sensor with bands.

    The last is also that of light at wavelengths, of which a sample has as many.
    """
    mi, _ = mitsuba_modules()
    return {1: mi.Color1f, 3: mi.Color3f, BATCH: mi.Spectrum}[count]


def device_float(value: float) -> Any:
    """A `Float` that the kernel reads as data: another value does not recompile it."""
    mi, dr = mitsuba_modules()
    number = mi.Float(float(value))
    dr.make_opaque(number)
    return number


def device_uint(value: float) -> Any:
    """A `UInt32` that the kernel reads as data: another value does not recompile it."""
    mi, dr = mitsuba_modules()
    number = mi.UInt32(int(value))
    dr.make_opaque(number)
    return number


_GRID_STEP: Final = 8.0
"""Units between possible origins. Chosen so that plants near the origin and rows keep the origin 0: spawned
rays are offset by up to 0.9 mm in the middle of a scene, as they are 4 m along a row."""
_SMALL_EXTENT_M: Final = 1.0 / 16.0
"""Chosen: smaller scenes get a unit below one metre. At this extent the ray offset is 0.3 %."""
_SMALLEST_UNIT_M: Final = 2.0**-30
"""Chosen: a nanometre; light waves are longer than what a smaller unit would resolve."""
_FARTHEST_M: Final = 1e7
"""Chosen: beyond it single precision rounds the vertices of the mesh itself to whole metres."""


@dataclass(frozen=True)
class LocalCoordinates:
    """Coordinates that the kernel computes in: (world metres - `origin`) / `unit_m`."""

    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # metres
    unit_m: float = 1.0  # a power of two

    def from_world(self, points: ArrayLike) -> NDArray[np.float64]:
        """Transform world points `(..., 3)`, metres, to local coordinates."""
        return np.asarray((np.asarray(points, float) - self.origin) / self.unit_m)

    def vertices(self, mesh: Mesh) -> NDArray[np.float32]:
        """`(v, 3)` vertices of a mesh in local coordinates; no copy if these are world coordinates."""
        if self == WORLD:
            return mesh.vertices
        # Exact in single precision: the origin is a multiple of the spacing of neighbouring vertices.
        return (mesh.vertices - np.array(self.origin, np.float32)) / np.float32(self.unit_m)


WORLD: Final = LocalCoordinates()
"""World coordinates in metres."""


def local_coordinates(mesh: Mesh) -> LocalCoordinates:
    """Choose local coordinates whose single-precision error is small over a mesh.

    Raises:
        ValueError: the mesh has no triangles, or vertices that are not finite or too far from the origin.
    """
    if not len(mesh.faces) or not len(mesh.vertices):
        raise ValueError("the mesh has no triangles: there is nothing to render")
    low, high = mesh.bounds.astype(float)
    if not max(-low.min(), high.max()) <= _FARTHEST_M:
        raise ValueError(f"the mesh's vertices must be finite and within {_FARTHEST_M:g} m of the origin")
    extent = float((high - low).max())
    unit = 1.0
    if extent < _SMALL_EXTENT_M:
        unit = max(2.0 ** np.floor(np.log2(max(extent, _SMALLEST_UNIT_M))), _SMALLEST_UNIT_M)
    step = _GRID_STEP * unit
    x, y, z = (np.rint((low + high) / (2.0 * step)) * step).tolist()
    return LocalCoordinates((x, y, z), float(unit))

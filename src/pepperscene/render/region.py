"""Where the kernel's coordinates begin and what they count in, so that single precision suffices anywhere.

Single precision tells places 10 km away apart to a millimetre, and Mitsuba lifts rays off what they leave by
1.8e-4 (1 + max |p|): metres there, and more than a leaf measures in a scene that is millimetres wide. So the
kernel is given coordinates from a point near the scene's middle; and those of a tiny scene in a smaller unit.
The point lies on a coarse grid and the unit is a power of two: moving and scaling round nothing, and ordinary
scenes keep theirs to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.geometry import Mesh

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
class Region:
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


WORLD: Final = Region()
"""World coordinates in metres."""


def region_of(mesh: Mesh) -> Region:
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
    return Region((x, y, z), float(unit))

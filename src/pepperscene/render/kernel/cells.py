"""Small places on one side of an organ: where the light that a surface sends out is nearly the same.

Incident light is smooth over about two centimetres of one side of an organ, and unrelated between organs that
only look close to each other. A cell is a cube of `CELL_M` within an organ, seen from one side. A triangle
belongs to the cell of its centroid; one that is much larger than a cell is divided along its barycentric
coordinates. Cells are joined to larger ones, whose means serve where a cell has little light of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import FAR_ROW
from pepperscene.geometry import Mesh
from pepperscene.render.arrays import device_array
from pepperscene.render.variant import mitsuba_modules

CELL_M: Final = 0.03
"""Edge of a cell, metres. Chosen among 1.5, 3 and 6 cm, whose errors differed by 3 % in a prototype."""
_JOINED_M: Final = (0.15, 0.45, 1.35, 4.05)
"""Edges of larger cells, metres; each contains whole smaller ones. Chosen: without the two largest, frames of
`greenhouse` and `randomised` have 2 and 5 % more error, and steps of two instead of three, cells of 12 m, or
larger cells by the direction of surfaces change it by less than 1 %."""
DIVISION_BITS: Final = 28  # of a face's entry: its first cell is below them, its divisions above


@dataclass(frozen=True, eq=False)
class SurfaceCells:
    """Cells of the faces of a mesh, and the larger cells that they belong to.

    Each cell has two sides: side 2 k is the front of cell k, 2 k + 1 its back.

    Attributes:
        faces: `(f,)` on the device: first cell of a face, and log2 of the divisions of its edges.
        count: number of cells.
        parents: numbers of the larger cells: for each cell that of `_JOINED_M[0]` in its organ, for each of
            these that of all organs, and so on up to the largest edge.
    """

    faces: Any
    count: int
    parents: tuple[NDArray[np.int32], ...]

    def at(self, si: Any, hit: Any, active: Any) -> Any:
        """Number of the cell's side that is seen at surface interactions of preliminary hits."""
        mi, dr = mitsuba_modules()
        entry = dr.gather(mi.UInt32, self.faces, hit.prim_index, active)
        parts = mi.UInt32(1) << (entry >> DIVISION_BITS)
        u, v = (
            dr.minimum(mi.UInt32(coordinate * mi.Float(parts)), parts - 1)
            for coordinate in (hit.prim_uv.x, hit.prim_uv.y)
        )
        cell = (entry & ((1 << DIVISION_BITS) - 1)) + u * parts + v
        return 2 * cell + dr.select(si.wi.z > 0.0, mi.UInt32(0), mi.UInt32(1))


def surface_cells(mesh: Mesh) -> SurfaceCells:
    """Divide the surfaces of a mesh into cells.

    Raises:
        ValueError: there are more than 2^28.
    """
    # Compiled by Numba, which takes a second to import.
    from pepperscene.render.kernel.cell_numbers import cube_numbers, face_cells

    # Light does not depend on labels: whatever far rows are in these, their plants are one organ here.
    organ_of = np.arange(len(mesh.instances), dtype=np.uint32)
    organ_of[[item.far_row >= 0 or item.kind == FAR_ROW for item in mesh.instances]] = len(mesh.instances)
    entries, cells, points, organs = face_cells(
        mesh.vertices, mesh.faces, organ_of[mesh.face_instance], CELL_M, DIVISION_BITS
    )
    if cells >= 1 << DIVISION_BITS:
        raise ValueError(f"the scene is too large: its surfaces have {cells} cells of {CELL_M:g} m")
    parents = []
    for edge, is_shared in ((_JOINED_M[0], False), *((edge, True) for edge in _JOINED_M)):
        if is_shared:
            organs = np.zeros_like(organs)
        numbers, first = cube_numbers(points, organs, edge)
        parents.append(numbers)
        points, organs = points[first], organs[first]
    return SurfaceCells(device_array(entries, np.uint32), cells, tuple(parents))

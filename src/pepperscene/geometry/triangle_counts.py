"""An upper bound of the triangles of a plant, from its parameters, before an organ or a mesh is built."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from pepperscene.cultivar.organs import OrganForm
from pepperscene.geometry.blade.grid import max_blade_triangles
from pepperscene.geometry.fruit.scan_clean import MAX_TRIANGLES
from pepperscene.grammar.plant import KindParameters, PlantParameters

_AT_DETAIL_1: Final[Mapping[OrganForm, int]] = {
    "internode": 196,
    "node": 280,
    "stalk": 154,
    "peduncle": 330,
    "cut": 160,
    "flower": 168,
    "fruit": 1728,
}
"""Triangles of an organ of each form at detail 1; blades depend on their margins."""
_CALYX: Final = 1092  # of a calyx with long teeth, at detail 1; one with short teeth has fewer
_CLOSED_HOLES: Final = 1.1  # chosen: triangles of a scan with closed holes, over those without


def check_detail(detail: float) -> None:
    """Raise `ValueError` if the fineness of a mesh is not above zero and finite."""
    if not 0.0 < detail < math.inf:
        raise ValueError(f"detail must be above zero and finite, not {detail}")


def max_triangles(plant: PlantParameters, detail: float = 1.0) -> int:
    """An upper bound of the triangles of `mesh_plant`, without scans at most 1.3 times their number.

    Args:
        plant: parameters of all organs.
        detail: fineness of the mesh; below 1 the bound is that at detail 1, except for blades.

    Raises:
        ValueError: `detail` is not above zero and finite.
    """
    check_detail(detail)
    scale = max(detail, 1.0) ** 2
    kinds = [kind for kind in plant.organs.values() if len(kind)]
    blades = [kind for kind in kinds if kind.kind.form == "blade"]
    total = _blade_triangles(blades, detail) if blades else 0
    for kind in kinds:
        if kind.kind.form == "blade":
            continue
        each = scale * _AT_DETAIL_1[kind.kind.form]
        if kind.kind.scans is not None:
            # The triangles of a scan do not depend on the detail.
            each = _CLOSED_HOLES * MAX_TRIANGLES
        # A fruit with a calyx has its parameters.
        calyx = scale * _CALYX if "calyx_radius" in kind.values else 0.0
        total += int(len(kind) * (each + calyx))
    return total


def _blade_triangles(blades: list[KindParameters], detail: float) -> int:
    """All blades of a plant share one grid, fine enough for the lobes and teeth of each."""
    lobes, teeth = 0.0, None
    for kind in blades:
        palmate = kind.values["palmate"] > 0.0
        if palmate.any():
            teeth = max(teeth or 0.0, float(kind.values["teeth"][palmate].max()))
        if not palmate.all():
            lobes = max(lobes, float(kind.values["lobes"][~palmate].max()))
    return sum(map(len, blades)) * max_blade_triangles(detail, lobes, teeth)

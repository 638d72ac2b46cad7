"""Number of triangles of a recipe's scenes, before any is built."""

from __future__ import annotations

import math
from typing import Final

from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.recipe.resolve.resolved import ResolvedRecipe

_COARSE: Final = 0.09
"""Triangles of a plant of the far rows over those of a plant at detail 1, at most: those of stalks; of blades
they are .06, and of the shipped cultivars .030 to .048."""
_NEAR_PLANTS: Final = {"random": 30, "function": 30, "path": 12, "poses": 12}
"""Estimate of the plants of far rows that are grown in full, by the kind of views. Measured: 11 to 25 with
random views, up to 10 on a path. Other kinds have at most one, estimated as `_FEW_NEAR_PLANTS`."""
_FEW_NEAR_PLANTS: Final = 4


def scene_triangles(resolved: ResolvedRecipe, per_plant: int) -> int:
    """Triangles of one scene of a recipe whose plants have `per_plant` each at detail 1."""
    from pepperscene.scene.greenhouse import row_lines

    builder = SceneBuilder(resolved.recipe, resolved.cultivar, processes=1)
    row, greenhouse = builder.row, builder.greenhouse
    plants = row.front + row.back
    far_plants = 0
    if greenhouse.far_rows > 0:
        in_line = 2 * math.floor(greenhouse.far_reach_m / row.spacing_m) + 1
        far_plants = max(len(row_lines(row, greenhouse)) * in_line - plants, 0)
    near = min(_NEAR_PLANTS.get(resolved.recipe.views.kind, _FEW_NEAR_PLANTS), far_plants)
    return math.ceil(per_plant * (plants + near + _COARSE * (far_plants - near)))

"""Number of triangles of a recipe's scenes, before any is built."""

from __future__ import annotations

import math
from typing import Final

from pepperscene.dataset.recipe.resolved import ResolvedRecipe
from pepperscene.dataset.scenes.scene_builder import SceneBuilder

_COARSE: Final = 0.09
"""Triangles of a plant of the far rows over those of a plant at detail 1, at most: those of stalks; of blades
they are .06, and of the shipped cultivars .030 to .048."""


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
    return math.ceil(per_plant * (plants + _COARSE * far_plants))

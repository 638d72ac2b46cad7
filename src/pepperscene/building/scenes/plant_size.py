"""The size of plants, from their drawn parameters: plants that do not fit into memory are not grown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from pepperscene.errors import SetupError
from pepperscene.recipe.plan import Stream, random_generator

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.grammar import Plant

_LARGE: Final = 2_000_000
"""Chosen, as four tomatoes: triangles of a plant from which its memory is checked as it grows; and from which
one plant is enough to show the size of all plants of a set."""
_PER_TRIANGLE: Final = 400.0
"""Bytes per triangle of a plant: measured 215 while its mesh is built, 390 while contacts are resolved."""
_PER_ORGAN: Final = 6000.0
"""Bytes of an organ: its centreline and measures (measured 3,100), and its instance; chosen."""


def plant_triangles(cultivar: Cultivar, seed: int, plants: int = 1) -> int:
    """Triangles at detail 1 of the largest of the first plants of a data set, at most; nothing is built.

    Drawing the parameters of a plant takes 6 ms, building it 100 ms or more.
    """
    from pepperscene.geometry.triangle_counts import most_triangles
    from pepperscene.grammar import draw_parameters

    largest = 0
    for number in range(plants):
        rng = random_generator(seed, Stream.PLANT, 0, number)
        largest = max(largest, most_triangles(draw_parameters(cultivar, rng)))
        if largest > _LARGE:
            break
    return largest


def grow_in_memory(
    cultivar: Cultivar, rng: np.random.Generator, *, lean: float = 0.0, detail: float = 1.0
) -> Plant:
    """The plant of `pepperscene.grammar.grow`, if its mesh fits into memory.

    Args:
        cultivar: has the distributions.
        rng: gives one number, the plant's key.
        lean: radians, added to the drawn lean of the stem.
        detail: of the mesh.

    Raises:
        SetupError: it does not fit.
    """
    from pepperscene.geometry.triangle_counts import most_triangles
    from pepperscene.grammar import build_plant, draw_parameters

    parameters = draw_parameters(cultivar, rng, lean)
    triangles = most_triangles(parameters, detail)
    if triangles > _LARGE:
        organs = sum(map(len, parameters.organs.values()))
        _check_fits(cultivar.name, organs, triangles)
    return build_plant(parameters)


def _check_fits(name: str, organs: int, triangles: int) -> None:
    """Raise `SetupError` if a plant of this size does not fit into memory."""
    from pepperscene.building.execution.memory import MEMORY, memory_limits, shortage
    from pepperscene.render.memory import reserved_address_space

    needed = int(_PER_TRIANGLE * triangles + _PER_ORGAN * organs)
    figures = shortage(needed, reserved_address_space(), memory_limits())
    if figures is not None:
        raise SetupError(
            f"{name}: a plant of {organs:,} organs and up to {triangles:,} triangles needs {figures}; "
            f"let its organs bear fewer others, or set {MEMORY} if the estimate is wrong"
        )

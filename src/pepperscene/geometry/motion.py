"""Turns of parts of a plant about their joints, and a plant whose organs follow them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pepperscene.grammar.plant import Plant


@dataclass(frozen=True, eq=False)
class Motion:
    """One turn of a part of a plant.

    Attributes:
        instance: the organ that turns, with all that grows on it.
        rotation: `(3, 3)`.
        pivot: `(3,)` metres, the point that stays.
    """

    instance: int
    rotation: NDArray[np.float64]
    pivot: NDArray[np.float64]


def moved_plant(plant: Plant, motions: Sequence[Motion]) -> Plant:
    """The plant whose mesh was settled, with its organs' curves and upper sides turned likewise.

    Args:
        plant: whose organ i is instance i of the mesh.
        motions: of that mesh.

    Raises:
        ValueError: a motion's instance is no organ of the plant.
    """
    organs = plant.organs
    curves, ups = [organ.curve for organ in organs], [organ.up for organ in organs]
    moved = set()
    for motion in motions:
        if not 0 <= motion.instance < len(organs):
            raise ValueError(f"instance {motion.instance} is no organ of a plant of {len(organs)}")
        turned = {motion.instance}
        # A parent stands before its children.
        for index in range(motion.instance + 1, len(organs)):
            if organs[index].parent in turned:
                turned.add(index)
        for index in turned:
            curves[index] = (curves[index] - motion.pivot) @ motion.rotation.T + motion.pivot
            ups[index] = motion.rotation @ ups[index]
        moved |= turned
    return replace(
        plant,
        organs=tuple(
            replace(organ, curve=curves[index], up=ups[index]) if index in moved else organ
            for index, organ in enumerate(organs)
        ),
    )

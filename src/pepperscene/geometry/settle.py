"""No impossible plants: what runs into a fruit or through a stem is turned where it joins the plant.

Barth et al. 2018 (section 2.3) looked for such plants by hand and replaced them. Here fruit swings on its
stalk or goes around its node, leaves turn and tilt at their joints; every part stays rigid and keeps its
length, and of the turns that free it the smallest is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.contact import Bodies, Contacts, counted
from pepperscene.geometry.contact_turns import Search
from pepperscene.geometry.mesh import Mesh
from pepperscene.geometry.motion import Motion

_ROUNDS: Final = 18  # chosen: hardly anything is mended later


@dataclass(frozen=True, eq=False)
class Settled:
    """A mesh whose parts run into each other no longer.

    Attributes:
        mesh: the same triangles, some of them moved.
        motions: what was turned, in order; each pivot is told in the mesh as it stood before that turn.
        contacts: what still touches.
    """

    mesh: Mesh
    motions: tuple[Motion, ...]
    contacts: Contacts


def settle(
    mesh: Mesh, rng: np.random.Generator, *, between_plants: bool = False, rounds: int = _ROUNDS
) -> Settled:
    """Turn parts of plants so that fruit runs into nothing and blades do not run through stems.

    Works on classes and parents of the instances alone, so for any crop. Whatever collides is tried in a
    number of poses, and the least turn of either side that frees both is taken; leaves give way before fruit
    does. The same mesh and state of the generator give the same mesh, bit for bit.

    Args:
        mesh: one plant or several, z up, with the ground at z = 0.
        rng: for the poses that are tried.
        between_plants: mend only what stands between different plants (`Instance.plant`), taking each plant
            as settled in itself; nothing within a plant gets worse.
        rounds: how often all that still touches is tried again, at most.

    Raises:
        ValueError: two instances of the mesh share vertices.
    """
    search = Search(Bodies(mesh, between_plants=between_plants), rng)
    for number in range(rounds):
        if not search.round(number):
            break
    return Settled(search.organs.turned_mesh(), tuple(search.motions), counted(search.bodies))

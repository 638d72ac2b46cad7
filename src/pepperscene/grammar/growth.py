"""What all organs of a plant share: its key, its nodes, and how far each part has grown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import Cultivar, Distribution, Slot
from pepperscene.grammar.hashing import Addresses, FloatArray, descended, shares


@dataclass(frozen=True, eq=False)
class Growth:
    """A plant before anything is drawn.

    Attributes:
        key: `(1,)` what all addresses are hashed from.
        sections: `(parts,)` addresses of the internodes, from the ground up.
        nodes: `(parts,)` addresses of the nodes above them.
        sizes: `(parts,)` how large each phytomer has grown: 1 but for the young ones at the top, smaller one
            by one.
        places: `(parts,)` of each phytomer along the grown stem, 0 foot to 1 top; 1 where it is young.
        heights: `(parts,)` of each phytomer along the whole stem.
        grown: how many phytomers are grown.
    """

    key: Addresses
    sections: Addresses
    nodes: Addresses
    sizes: FloatArray
    places: FloatArray
    heights: FloatArray
    grown: int

    @property
    def parts(self) -> int:
        """How many phytomers the stem has."""
        return len(self.sizes)

    def bears(self, slot: Slot) -> NDArray[np.bool_]:
        """`(parts,)` which nodes a slot of theirs is at."""
        order = np.arange(self.parts)
        return np.asarray((order >= slot.first) & ((order - slot.first) % slot.every == 0))

    def descent(self, slot: Slot) -> FloatArray:
        """`(parts,)` a straight fall from 1 to -1 along the nodes that a slot is at, of mean 0."""
        here = self.bears(slot)
        return np.where(here, 1.0 - (2.0 * np.cumsum(here) - 1.0) / max(int(here.sum()), 1), 0.0)

    def once(self, law: Distribution, name: str) -> float:
        """A value that the plant has once; the law must not be a curve along the stem."""
        return float(law.quantiles(shares(self.key, name))[0])


def growth_of(cultivar: Cultivar, key: Addresses) -> Growth:
    """The phytomers of a plant of this key."""
    stem = cultivar.stem
    grown = max(stem.parts - stem.young_nodes, 0)
    order = np.arange(stem.parts)
    # The topmost has the smallest size, and below the young ones all are grown.
    from_top = order[::-1]
    young = from_top < stem.young_nodes
    sizes = np.ones(stem.parts)
    rise = (1.0 - stem.young_size) * from_top / max(stem.young_nodes, 1)
    sizes[young] = (stem.young_size + rise)[young]
    places = np.minimum((order + 0.5) / max(grown, 1), 1.0)
    return Growth(
        key=key,
        sections=descended(key, 2 * order),
        nodes=descended(key, 2 * order + 1),
        sizes=sizes,
        places=places,
        heights=(order + 0.5) / stem.parts,
        grown=grown,
    )

"""Detection of contacts: fruit that touch any other organ, blades that run through stems and twine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.organs import FRUIT, LEAF, STALK, STEM, WIRE, Organs, boxes_overlap
from pepperscene.geometry.contacts.shapes import FruitSurfaces, StemCapsules
from pepperscene.geometry.mesh import IndexArray, Mesh, SingleArray

NEAR: Final = 3e-3
"""Metres, chosen; depths are computed only for points and boxes closer to a fruit or stem than this."""


@dataclass(frozen=True)
class ContactCounts:
    """Numbers of organs of a mesh that touch others.

    Attributes:
        fruit: number of fruit.
        fruit_touching: fruit that touch any organ except their own calyx and stalk.
        blades: number of leaf blades.
        blades_touching: blades that run through an internode, a node or twine.
    """

    fruit: int
    fruit_touching: int
    blades: int
    blades_touching: int


@dataclass(frozen=True, eq=False)
class ContactPairs:
    """Pairs of organs whose boxes are close, ascending."""

    organ: IndexArray  # `(n,)` fruit or blades
    other: IndexArray  # `(n,)` any organ for a fruit, stems and twine for a blade
    depth: SingleArray  # `(n,)` metres of penetration; negative if apart, minus infinity if far apart

    def deeper_than(self, depth: float) -> IndexArray:
        """`(m, 2)` pairs deeper than some metres."""
        return np.stack([self.organ, self.other], axis=1)[self.depth > depth]


class ContactDetector:
    """Organs with the shapes that decide whether they touch.

    Args:
        mesh: one or more plants.
        between_plants: consider only contacts between organs of different plants.
    """

    def __init__(self, mesh: Mesh, *, between_plants: bool = False) -> None:
        self.organs = Organs(mesh)
        self.between_plants = between_plants
        self.fruit = self.organs.of_class(FRUIT)
        self.blades = self.organs.of_class(LEAF)
        self.is_stem = np.isin(self.organs.organ_class, [STEM, WIRE])
        self.surfaces = FruitSurfaces(self.organs, self.fruit)
        self.capsules = StemCapsules(self.organs)
        none = np.empty(0, dtype=np.intp)
        empty = ContactPairs(none, none, np.empty(0, dtype=np.float32))
        self._known, self._known_at = dict.fromkeys((FRUIT, LEAF), empty), dict.fromkeys((FRUIT, LEAF), -1)

    def leave_out(self, organs: IndexArray) -> None:
        """Ignore some organs from now on."""
        self.organs.solid[organs] = False
        self.blades = self.blades[self.organs.solid[self.blades]]
        for kind, known in self._known.items():
            kept = self.organs.solid[known.organ] & self.organs.solid[known.other]
            self._known[kind] = ContactPairs(known.organ[kept], known.other[kept], known.depth[kept])

    def are_joined(self, organs: IndexArray, others: IndexArray) -> NDArray[np.bool_]:
        """`(n,)` whether two organs belong together and may touch.

        A fruit may touch its calyx and the stalks that carry it, any other organ its parent.
        """
        organ_class, parent = self.organs.organ_class, self.organs.parent
        above = parent[organs]
        joined = (organs == others) | ((above == others) & (organ_class[organs] != FRUIT))
        # Follow the stalk of each fruit upwards.
        rows = np.flatnonzero(organ_class[organs] == FRUIT)
        above = above[rows]
        while len(rows):
            kept = (above >= 0) & (organ_class[above] == STALK)
            rows, above = rows[kept], above[kept]
            joined[rows] |= above == others[rows]
            above = parent[above]
        return np.asarray(joined)

    def fruit_pairs(self) -> ContactPairs:
        """Fruit and the organs close to them."""
        return self._update(FRUIT, self.fruit, np.flatnonzero(self.organs.solid))

    def blade_pairs(self) -> ContactPairs:
        """Blades and the stems and twine close to them."""
        return self._update(LEAF, self.blades, np.flatnonzero(self.is_stem & self.organs.solid))

    def depths(self, organs: IndexArray, others: IndexArray) -> SingleArray:
        """Compute `(n,)` metres of penetration of pairs, as in `ContactPairs`."""
        depth = np.empty(len(organs), dtype=np.float32)
        is_fruit = self.organs.organ_class[organs] == FRUIT
        depth[is_fruit] = self._fruit_depths(organs[is_fruit], others[is_fruit])
        depth[~is_fruit] = self._stem_depths(organs[~is_fruit], others[~is_fruit])
        return depth

    def _update(self, kind: int, rows: IndexArray, columns: IndexArray) -> ContactPairs:
        """Current pairs of one kind, recomputed only where one of two has moved since the last call."""
        moved = self.organs.moved_at > self._known_at[kind]
        # Moved rows with all columns, other rows with moved columns.
        pairs = [self._close_pairs(rows[moved[rows]], columns)]
        pairs.append(self._close_pairs(rows[~moved[rows]], columns[moved[columns]]))
        organ, other = (np.concatenate(column) for column in zip(*pairs, strict=True))
        known = self._known[kind]
        kept = ~moved[known.organ] & ~moved[known.other]
        depth = np.concatenate([known.depth[kept], self.depths(organ, other)])
        organ = np.concatenate([known.organ[kept], organ])
        other = np.concatenate([known.other[kept], other])
        order = np.lexsort([other, organ])
        self._known[kind] = ContactPairs(organ[order], other[order], depth[order])
        self._known_at[kind] = self.organs.moves
        return self._known[kind]

    def _close_pairs(self, organs: IndexArray, others: IndexArray) -> tuple[IndexArray, IndexArray]:
        """Pairs of organs whose boxes are close, without those that are joined."""
        row, column = self.organs.close_pairs(organs, others, NEAR)
        organ, other = organs[row], others[column]
        kept = organ != other
        if self.between_plants:
            kept &= self.organs.plant[organ] != self.organs.plant[other]
        organ, other = organ[kept], other[kept]
        apart = ~self.are_joined(organ, other)
        return organ[apart], other[apart]

    def _fruit_depths(self, fruit: IndexArray, others: IndexArray) -> SingleArray:
        """`(n,)` depth of each organ in a fruit."""
        result = np.full(len(fruit), -np.inf, dtype=np.float32)
        if not len(fruit):
            return result
        # Organs outside the bounding sphere of the fruit need no sample points.
        distinct, position = np.unique(fruit, return_inverse=True)
        spheres = self.surfaces.spheres(distinct)
        reach = spheres.radius + NEAR
        centre, limit = spheres.centre[position], reach[position]
        offset = centre - np.clip(centre, self.organs.low[others], self.organs.high[others])
        pair = np.flatnonzero(np.einsum("ni,ni->n", offset, offset) < limit**2)
        patches, patch, entry = self.organs.patches(others[pair])
        pair = pair[entry]
        offset = patches.centre[patch] - centre[pair]
        distance = limit[pair] + patches.radius[patch]
        kept = np.flatnonzero(np.einsum("ni,ni->n", offset, offset) < np.square(distance))
        pair, patch = pair[kept], patch[kept]
        inverse = spheres.rotation.transpose(0, 2, 1)
        shift = -np.einsum("fij,fj->fi", inverse, spheres.centre)
        motion = inverse.astype(np.float32), shift.astype(np.float32)
        depth = self.surfaces.patch_depths(
            spheres.row, *motion, reach.astype(np.float32), position[pair], patches, patch
        )
        np.maximum.at(result, pair, depth)
        return result

    def _stem_depths(self, blades: IndexArray, stems: IndexArray) -> SingleArray:
        """`(n,)` depth of each blade in a stem or twine."""
        result = np.full(len(blades), -np.inf, dtype=np.float32)
        if not len(blades):
            return result
        capsules, capsule, pair = self.capsules.of_tubes(stems)
        low, high = self.organs.low[blades] - NEAR, self.organs.high[blades] + NEAR
        kept = boxes_overlap(capsules.low[capsule], capsules.high[capsule], low[pair], high[pair])
        capsule, pair = capsule[kept], pair[kept]
        patches, patch, entry = self.organs.patches(blades[pair])
        capsule, pair = capsule[entry], pair[entry]
        # Points only of patches whose bounding spheres are near.
        centres = patches.centre.T[:, :, None]
        near = capsules.depths(capsule, centres, patch, 1) + patches.radius[patch] > -NEAR
        hit = np.flatnonzero(near)
        depth = capsules.depths(capsule[hit], patches.coordinates, patch[hit], 1)
        np.maximum.at(result, pair[hit], depth)
        return result

    def counts(self) -> ContactCounts:
        """Count the organs that touch others at their current poses."""
        touching = np.isin(self.fruit, self.fruit_pairs().deeper_than(0.0))
        through = np.unique(self.blade_pairs().deeper_than(0.0)[:, 0])
        return ContactCounts(len(self.fruit), int(touching.sum()), len(self.blades), len(through))

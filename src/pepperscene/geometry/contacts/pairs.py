"""Pairs of organs that may touch when one of them moves: depth and cost for many pairs and motions at once.

First bounding boxes are compared, then bounding spheres of patches, then points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.contacts.detect import NEAR, ContactDetector
from pepperscene.geometry.contacts.joints import RigidTransforms
from pepperscene.geometry.contacts.organs import FLOWER, FRUIT, LEAF, SHOOT, STALK, Organs, boxes_overlap
from pepperscene.geometry.contacts.shapes import Capsules
from pepperscene.geometry.mesh import FloatArray, IndexArray, SingleArray

CLEARANCE: Final = 0.8e-3
"""Metres between a moved organ and others, chosen: more than is missed between points, and invisible."""

CROWDED: Final = 24
"""Chosen: with more contacts, no rotation frees an organ, and trying all of them takes minutes. In rows of
shipped cultivars a fruit has at most 17, and a leaf crosses at most 9 others."""

# Chosen: a contact costs as much as a rotation that no unit can make, so that no avoidable contact remains;
# contact with what can give way costs a moderate rotation, and each millimetre of depth a little more.
_HARD: Final = 200.0
_SOFT: Final = 30.0
_FRUIT: Final = 90.0  # fruit and stalks give way as well, but less readily
PER_MM: Final = 0.1
_SAME_PLANT: Final = 1e4  # between plants: contacts that are resolved within a plant stay resolved
_OWN_STALK: Final = 1e-3  # m, chosen: additional depth allowed to a stalk in the fruit that swings on it


class FruitPairs:
    """Organs that move towards fruit: `(n,)` movers and the fruit of each."""

    def __init__(self, detector: ContactDetector, movers: IndexArray, fruit: IndexArray) -> None:
        self._detector, self._movers = detector, movers
        self._spheres = detector.surfaces.spheres(fruit)

    def depths(
        self, rows: IndexArray, transform: IndexArray, transforms: RigidTransforms, stride: int
    ) -> SingleArray:
        """Compute `(r, k)` metres by which some movers penetrate their fruit; minus infinity if far apart.

        Args:
            rows: `(r,)` indices of pairs, ascending.
            transform: `(r,)` row of `transforms` for each mover.
            transforms: `(t, k)`.
            stride: use every `stride`-th point.
        """
        result = np.full((len(rows), transforms.shift.shape[1]), -np.inf, dtype=np.float32)
        spheres, organs = self._spheres, self._detector.organs
        centre, limit = spheres.centre[rows], spheres.radius[rows] + NEAR
        inverse, movers = spheres.rotation.transpose(0, 2, 1)[rows], self._movers[rows]
        pair, step, hit, patch = _near_patches(organs, movers, centre, limit, transform, transforms)
        # Relative to the fruit's centre numbers are small, as single precision requires.
        to_fruit, row = inverse[pair], transform[pair]
        matrix = np.matmul(to_fruit, transforms.rotation[row, step])
        offset = np.matmul(to_fruit, (transforms.shift[row, step] - centre[pair])[:, :, None])[:, :, 0]
        depth = self._detector.surfaces.patch_depths(
            spheres.row[rows[pair]],
            matrix.astype(np.float32),
            offset.astype(np.float32),
            limit.astype(np.float32)[pair],
            hit,
            organs.all_patches,
            patch,
            stride,
        )
        np.maximum.at(result, (pair[hit], step[hit]), depth)
        return result


class StemPairs:
    """Blades that move within boxes towards stems and twine: `(n,)` blades, and the stem and box of each."""

    def __init__(
        self,
        detector: ContactDetector,
        blades: IndexArray,
        stems: IndexArray,
        low: FloatArray,
        high: FloatArray,
    ) -> None:
        self._organs, self._blades = detector.organs, blades
        capsules, capsule, pair = detector.capsules.of_tubes(stems)
        kept = boxes_overlap(capsules.low[capsule], capsules.high[capsule], low[pair], high[pair])
        self._capsules, self._pair = capsules.select(capsule[kept]), pair[kept]

    def depths(
        self, rows: IndexArray, transform: IndexArray, transforms: RigidTransforms, stride: int
    ) -> SingleArray:
        """Compute `(r, k)` metres by which some blades penetrate their stems; as `FruitPairs.depths`."""
        result = np.full((len(rows), transforms.shift.shape[1]), -np.inf, dtype=np.float32)
        row_of_blade = np.full(len(self._blades), -1)
        row_of_blade[rows] = np.arange(len(rows))
        kept = np.flatnonzero(row_of_blade[self._pair] >= 0)
        entry, capsules = row_of_blade[self._pair[kept]], self._capsules.select(kept)
        middle = capsules.start + 0.5 * capsules.span
        limit = capsules.radius + 0.5 * np.sqrt(np.einsum("ci,ci->c", capsules.span, capsules.span)) + NEAR
        blades, transform = self._blades[rows][entry], transform[entry]
        pair, step, hit, patch = _near_patches(self._organs, blades, middle, limit, transform, transforms)
        # Instead of moving blades to stems, move stems back to the blades.
        inverse = transforms.rotation[transform[pair], step]
        start = capsules.start[pair] - transforms.shift[transform[pair], step]
        moved = Capsules(
            np.matmul(start[:, None], inverse)[:, 0],
            np.matmul(capsules.span[pair][:, None], inverse)[:, 0],
            capsules.radius[pair],
        )
        depth = moved.depths(hit, self._organs.all_patches.coordinates, patch, stride)
        np.maximum.at(result, (entry[pair[hit]], step[hit]), depth)
        return result


def _near_patches(
    organs: Organs,
    movers: IndexArray,
    centre: FloatArray,
    radius: FloatArray,
    transform: IndexArray,
    transforms: RigidTransforms,
) -> tuple[IndexArray, IndexArray, IndexArray, IndexArray]:
    """Patches of moving organs that overlap spheres, one sphere for each mover.

    Returns:
        `(h,)` indices of movers and `(h,)` of the transforms with which they meet their spheres; `(m,)` index
        of each patch's pair among these, and `(m,)` the patches.
    """
    from pepperscene.geometry.contacts.depth_kernel import patches_near_spheres, spheres_near_boxes

    limit = radius.astype(np.float32)
    near, spheres = spheres_near_boxes(
        organs.low[movers].astype(np.float32),
        organs.high[movers].astype(np.float32),
        centre.astype(np.float32),
        limit,
        transform,
        transforms.rotation.astype(np.float32),
        transforms.shift.astype(np.float32),
    )
    pair, step = np.divmod(near, transforms.shift.shape[1])
    # Sample only organs that come near to something.
    organs.sample(movers[np.unique(pair)])
    near_organs, patches = movers[pair], organs.all_patches
    hit, patch = patches_near_spheres(
        organs.patch_first[near_organs],
        organs.patch_count[near_organs],
        patches.centre.T,
        patches.radius,
        spheres,
        limit[pair],
    )
    return pair, step, hit, patch


@dataclass(frozen=True, eq=False)
class PairCosts:
    """Organs of units, the organ that each may touch, and the cost of that."""

    table: FruitPairs | StemPairs  # of `n` pairs
    unit: IndexArray  # `(n,)` index of the unit of each
    inverse: bool  # move all else back instead of the unit
    weight: FloatArray  # `(n,)` cost of a contact
    slack: FloatArray  # `(n,)` additional depth in metres that is free; NaN where the clearance must be kept

    def cost(
        self, rows: IndexArray, unit: IndexArray, transforms: RigidTransforms, stride: int
    ) -> FloatArray:
        """Compute `(r, k)` costs of some pairs.

        Args:
            rows: `(r,)` ascending.
            unit: `(r,)` row of `transforms` for each.
            transforms: `(2 u, k)` with their inverses, the first of each the identity.
            stride: use every `stride`-th sample point: the cost is at most that with all points.
        """
        transform = unit + len(transforms.shift) // 2 if self.inverse else unit
        depth = self.table.depths(rows, transform, transforms, stride)
        slack = self.slack[rows]
        current = np.maximum(depth[:, 0], -CLEARANCE)
        excess = depth - np.where(np.isnan(slack), -CLEARANCE, current + slack)[:, None]
        graded = self.weight[rows, None] * (1.0 + 1e3 * PER_MM * np.maximum(excess, 0.0))
        return np.asarray(np.where(excess > 0.0, graded, 0.0))


class PairRules:
    """Costs of contacts between current organs, by their classes.

    With `hard` nothing gives way; otherwise leaves give way to fruit. Between plants, a unit may move as near
    to organs of its own plant as it is.
    """

    def __init__(self, detector: ContactDetector, *, hard: bool) -> None:
        self.detector, self._organ_class, self._hard = detector, detector.organs.organ_class, hard

    def fruit(self, unit: IndexArray, fruit: IndexArray, others: IndexArray, *, moves: bool) -> PairCosts:
        """Fruit and other organs, of which the units move the fruit or else the other.

        The stalk of a fruit that moves may penetrate it a little deeper.
        """
        joined = self.detector.are_joined(fruit, others) & moves
        weight = np.full(len(unit), _HARD)
        if moves and not self._hard:
            weight[np.isin(self._organ_class[others], [FRUIT, STALK]) & ~joined] = _FRUIT
            weight[np.isin(self._organ_class[others], [FLOWER, LEAF, SHOOT]) & ~joined] = _SOFT
        weight, slack = self._within_plants(weight, fruit, others)
        slack[joined] = _OWN_STALK
        return PairCosts(FruitPairs(self.detector, others, fruit), unit, moves, weight, slack)

    def stems(
        self, unit: IndexArray, blades: IndexArray, stems: IndexArray, low: FloatArray, high: FloatArray
    ) -> PairCosts:
        """Blades that the units move within boxes, and stems and twine."""
        weight, slack = self._within_plants(np.full(len(unit), _HARD), blades, stems)
        return PairCosts(StemPairs(self.detector, blades, stems, low, high), unit, False, weight, slack)

    def _within_plants(
        self, weight: FloatArray, organs: IndexArray, others: IndexArray
    ) -> tuple[FloatArray, FloatArray]:
        """Weight and slack: between plants, contacts within a plant must not get deeper."""
        slack = np.full(len(weight), np.nan)
        if self.detector.between_plants:
            plant = self.detector.organs.plant
            same = plant[organs] == plant[others]
            slack[same] = 1e-6
            weight = np.where(same, _SAME_PLANT, weight)
        return weight, slack

"""What cameras see of the fruit of a scene: fractions by pose and fruit, occluders, and the surface seen."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import ArgumentError

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


SAMPLES: Final = 4096
"""Default number of points on a fruit. Chosen: visible pixels are right to 0.5 % of the fruit's pixels, and
1,000 poses in front of a row take 17 s of CPU time. Four times as many give 0.2 %, and a quarter 1.1 %."""
_SAMPLE_STEP: Final = 64  # bits are counted in words of eight bytes


def check_samples(samples: int) -> None:
    """Raise `ArgumentError` if fruit cannot have this number of points."""
    if samples < _SAMPLE_STEP or samples % _SAMPLE_STEP:
        raise ArgumentError("samples", f"must be a multiple of {_SAMPLE_STEP} above 0, not {samples}")


@dataclass(frozen=True, eq=False)
class Occluders:
    """Organs and objects that hide fruit, the most important of a row first.

    Attributes:
        row: `(m,)` row of the `FruitVisibility`, ascending.
        instance: `(m,)` index among the scene's instances.
        fraction: `(m,)` of the pixels that the fruit would have alone, how many it hides. An occluder counts
            where it is the first surface, so the fractions of a row and its `visible_fraction` add up to 1.
    """

    row: IndexArray
    instance: IndexArray
    fraction: FloatArray


@dataclass(frozen=True, eq=False)
class FruitVisibility:
    """What cameras see of fruit: a row for each pose and each fruit that is in view, hidden or not.

    Three fractions describe a fruit. They differ in what they relate the seen surface to:

    - `visible_fraction`: of the pixels that the fruit would have in this image if nothing else were there. It
      is that of the output `harvest`.
    - `facing_fraction`: of the area of its surface that faces the camera, whose normal is less than 90
      degrees from the direction to the camera. What is outside the image counts as not seen.
    - `surface_fraction`: of the area of its whole surface. A free ball of radius R at a distance d from its
      centre has (1 - R / d) / 2.

    Attributes:
        poses: `(n, 4, 4)` camera to world, metres.
        fruit: `(f,)` index of each fruit among the scene's instances.
        peduncle: `(f,)` index of each one's peduncle, -1 for none.
        pose_index: `(r,)` number of the pose of each row, ascending.
        fruit_index: `(r,)` number of the fruit of each row in `fruit`, ascending for each pose.
        visible_fraction, facing_fraction, surface_fraction: `(r,)` of the fruit, see above; 0 of a fruit that
            is outside the image while its peduncle is inside.
        visible_pixels: `(r,)` area of its visible part in the image, pixels.
        peduncle_visible_fraction: `(r,)` as `visible_fraction`, of its peduncle; nan without a peduncle in
            the image.
        cut_visible_fraction: `(r,)` as `visible_fraction`, of the surface of the peduncle around its cut
            point, up to a radius of the peduncle to both sides; nan without one in the image.
        seen: `(r, samples / 8)` uint8, bits of the points of each fruit's surface that the camera sees
            (`numpy.unpackbits` order). Each point stands for an equal part of the fruit's area.
        occluders: of the fruit; None if they were not wanted.
    """

    poses: FloatArray
    fruit: IndexArray
    peduncle: IndexArray
    pose_index: IndexArray
    fruit_index: IndexArray
    visible_fraction: FloatArray
    facing_fraction: FloatArray
    surface_fraction: FloatArray
    visible_pixels: FloatArray
    peduncle_visible_fraction: FloatArray
    cut_visible_fraction: FloatArray
    seen: NDArray[np.uint8]
    occluders: Occluders | None = None

    def __len__(self) -> int:
        return len(self.pose_index)

    @property
    def samples(self) -> int:
        """Number of points on the surface of each fruit."""
        return 8 * self.seen.shape[1]

    def best_poses(self) -> IndexArray:
        """`(f,)` the pose that sees most of each fruit's surface, the first of equals; -1 if none does."""
        best = np.full(len(self.fruit), -1)
        # The last assignment of an index counts: the largest fraction, and the first pose of equal ones.
        order = np.lexsort([-self.pose_index, self.surface_fraction])
        order = order[self.surface_fraction[order] > 0.0]
        best[self.fruit_index[order]] = self.pose_index[order]
        return best

    def of_poses(self, chosen: NDArray[np.bool_]) -> FruitVisibility:
        """The rows of some poses; all poses keep their numbers.

        Args:
            chosen: `(n,)` whether a pose is kept.
        """
        kept = chosen[self.pose_index]
        number = np.cumsum(kept) - 1
        occluders = self.occluders
        if occluders is not None:
            used = kept[occluders.row]
            rows = number[occluders.row[used]]
            occluders = Occluders(rows, occluders.instance[used], occluders.fraction[used])
        columns = {name: getattr(self, name)[kept] for name in ROW_ARRAYS}
        return replace(self, **columns, occluders=occluders)


ROW_ARRAYS: Final = tuple(field.name for field in fields(FruitVisibility))[3:-1]
"""Arrays of `FruitVisibility` with an entry for each row."""

"""The side of a fruit that faces its stalk, where the calyx lies on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.fruit.pericarp import Pericarps
from pepperscene.geometry.organ_arrays import size
from pepperscene.grammar.plant import Organ

if TYPE_CHECKING:
    from pepperscene.geometry.fruit.scan import Scan


FloatArray = NDArray[np.float64]

CROWN_STEPS = 14  # chosen: heights of a crown are a few tenths of a millimetre right between them
CROWN_COLUMNS = 36  # chosen: as many as a fruit has columns
CROWN = 0.92  # chosen: part of the outline that a crown tells; beyond it the wall turns down too steeply
_STEEPEST = 1.2  # chosen: how steeply a sepal that is longer than its fruit is wide goes on downwards


@dataclass(frozen=True, eq=False)
class Crowns:
    """The sides of n fruit that face their stalks, as heights over the plane across each stalk's foot.

    Attributes:
        reach: `(n, c)` metres from the axis that the heights go, at c equal angles from the upper side.
        along: `(n, q, c)` metres towards the blossom end, at q equal steps of the radius from 0 to the reach.
    """

    reach: FloatArray
    along: FloatArray

    def height(self, which: NDArray[np.intp], radius: FloatArray, angle: FloatArray) -> FloatArray:
        """`(m, q, c)` metres along the axis of the fruit's surface; beyond the reach it goes straight on.

        Args:
            which: `(m,)` fruit.
            radius: `(m, q, c)` metres from the axis.
            angle: `(m, c)` radians from the upper side.
        """
        steps, columns = self.along.shape[1] - 1, self.along.shape[2]
        column = np.mod(angle / (2.0 * np.pi), 1.0) * columns
        left = np.floor(column).astype(np.intp) % columns
        share = (column - np.floor(column))[:, None]
        sides = []
        for side in (left, (left + 1) % columns):
            position = radius * (steps / self.reach[which[:, None], side])[:, None]
            index = np.clip(position.astype(np.intp), 0, steps - 1)
            low = self.along[which[:, None, None], index, side[:, None]]
            rise = self.along[which[:, None, None], index + 1, side[:, None]] - low
            limit = _STEEPEST * self.reach[which[:, None], side][:, None] / steps
            part = position - index
            beyond = np.clip(part - 1.0, 0.0, None)
            sides.append(low + np.minimum(part, 1.0) * rise + beyond * np.clip(rise, -limit, limit))
        return sides[0] + share * (sides[1] - sides[0])


def crowns(walls: Pericarps) -> Crowns:
    """The stalk sides of fruit, out of their walls."""
    n, _, columns = walls.radius.shape
    turn = np.arange(CROWN_COLUMNS) * columns / CROWN_COLUMNS
    left = np.floor(turn).astype(np.intp)
    share = turn - left
    radius, along = (
        np.pad(
            part[:, :, left] * (1.0 - share) + part[:, :, (left + 1) % columns] * share,
            ((0, 0), (1, 0), (0, 0)),
        )
        for part in (walls.radius, walls.along)
    )
    # Each column's wall rises outwards from the axis to the widest ring.
    rings = np.arange(radius.shape[1])[None, :, None]
    inner = rings <= 1 + walls.widest[:, None, None]
    reach = CROWN * np.max(np.where(inner, radius, 0.0), axis=1)
    at = reach[:, None] * (np.arange(CROWN_STEPS + 1) / CROWN_STEPS)[None, :, None]
    knots = np.where(inner, radius, np.inf)
    index = np.clip((knots[:, None] <= at[:, :, None]).sum(axis=2) - 1, 0, None)
    row, column = np.arange(n)[:, None, None], np.arange(CROWN_COLUMNS)
    start, stop = radius[row, index, column], radius[row, index + 1, column]
    part = (at - start) / (stop - start)
    low, high = along[row, index, column], along[row, index + 1, column]
    return Crowns(reach, low + part * (high - low))


def scanned_crowns(organs: Sequence[Organ], scan: Scan) -> Crowns:
    """The stalk sides of fruit that wear one scan."""
    length, diameter = size(organs, "length_m"), size(organs, "diameter_m")
    return Crowns(diameter[:, None] * scan.reach, length[:, None, None] * scan.crown)


def joined(parts: Sequence[Crowns], order: NDArray[np.intp]) -> Crowns:
    """One after the other, then in this order."""
    reach = np.concatenate([part.reach for part in parts])
    return Crowns(reach[order], np.concatenate([part.along for part in parts])[order])

"""Triangles of organs in one table, motions of organs, and pairs of organs that may cross."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepperscene.geometry.contacts.patches import expand_counts
from pepperscene.geometry.mesh import IndexArray, SingleArray


class Runs:
    """Items of organs, one organ after another."""

    def __init__(self, organs: int, chosen: IndexArray, count: IndexArray) -> None:
        self.first, self.count = np.zeros((2, organs), dtype=np.intp)
        self.first[chosen], self.count[chosen] = np.cumsum(count) - count, count

    def of(self, organs: IndexArray) -> tuple[IndexArray, IndexArray]:
        """Items of some organs, and the position of the organ of each."""
        position, number = expand_counts(self.count[organs])
        return self.first[organs].take(position) + number, position

    def starts(self, organs: IndexArray) -> IndexArray:
        """Where the items of each organ start in the items of these organs."""
        return np.asarray(np.cumsum(self.count[organs]) - self.count[organs])


@dataclass(frozen=True, eq=False)
class OrganTriangles:
    """Triangles that stand for organs, at the organs' current poses."""

    points: SingleArray  # `(3, v)` metres
    corners: IndexArray  # `(3, f)` indices of points
    vertices: Runs  # points of each organ
    faces: Runs  # triangles of each organ


@dataclass(frozen=True, eq=False)
class OrganMotions:
    """Motions of organs; an organ may occur several times."""

    organ: IndexArray  # `(e,)`
    rotation: SingleArray  # `(e, 3, 3)`
    shift: SingleArray  # `(e, 3)` metres


@dataclass(frozen=True, eq=False)
class OrganPairs:
    """Pairs of an organ that moves and one that stays."""

    motion: IndexArray  # `(n,)` index of the motion of the first organ
    other: IndexArray  # `(n,)` second organ
    low: SingleArray  # `(n, 3)` metres, lower corner of the bounding box of the second organ
    high: SingleArray  # `(n, 3)` metres, upper corner

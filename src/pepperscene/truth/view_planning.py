"""View planning: the views that together see most of the fruit's surface.

The coverage of a set of views is the mean over the fruit of the fraction of its surface that at least one of
the views sees. It is monotone and submodular, so greedy views reach at least 1 - 1/e = 63 % of the best
coverage with as many views (Nemhauser, Wolsey & Fisher, "An analysis of approximations for maximizing
submodular set functions", Mathematical Programming 14 (1978) 265).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.errors import ArgumentError
from pepperscene.truth.fruit_visibility import FruitVisibility

BitArray = NDArray[np.uint64]

_MOST_SETS: Final = 10_000_000
"""Chosen: sets of views that an exact search may have to compare; most are excluded by bounds."""


@dataclass(frozen=True, eq=False)
class ViewSequence:
    """Views in the order in which they are taken.

    Attributes:
        poses: `(k,)` their numbers.
        coverage: `(k,)` mean over the fruit of the fraction of its surface that the views up to each one see.
    """

    poses: NDArray[np.intp]
    coverage: NDArray[np.float64]


def greedy_views(
    visibility: FruitVisibility, count: int, *, fruit: ArrayLike | None = None, taken: Sequence[int] = ()
) -> ViewSequence:
    """The next best views: each sees most of the surface that those before it have not seen.

    Of equal views the first in the list is taken. The sequence ends early when no view adds anything.

    Args:
        visibility: of all candidates.
        count: number of views, without those taken.
        fruit: numbers of the fruit that count, in `visibility.fruit`; None for all.
        taken: views that were taken before; their surface counts as seen.

    Raises:
        ArgumentError: the count is below 1, or there is no such fruit or pose.
    """
    search = _Search(visibility, fruit)
    if count < 1:
        raise ArgumentError("count", f"must be at least 1, not {count}")
    covered = search.covered_by(_pose_numbers(taken))
    poses, points = [], []
    for _ in range(count):
        gains = search.gains(covered)
        best = int(gains.argmax())
        if gains[best] == 0:
            break
        covered = search.joined(covered, best)
        poses.append(best)
        points.append(search.points(covered))
    return ViewSequence(np.array(poses, dtype=np.intp), np.array(points, dtype=float) / search.total)


def exact_views(visibility: FruitVisibility, count: int, *, fruit: ArrayLike | None = None) -> ViewSequence:
    """The set of views with the largest coverage of all sets of their number, ascending; for small lists.

    Branch and bound: the rest of a set adds at most the sum of its largest single gains.

    Args:
        visibility: of all candidates.
        count: number of views.
        fruit: as of `greedy_views`.

    Raises:
        ArgumentError: as `greedy_views`; or there are fewer poses than views, or too many sets of them.
    """
    search = _Search(visibility, fruit)
    candidates = len(visibility.poses)
    if not 1 <= count <= candidates:
        raise ArgumentError("count", f"must be from 1 to the {candidates} poses, not {count}")
    if math.comb(candidates, count) > _MOST_SETS:
        problem = (
            f"{count} of {candidates} poses gives more than {_MOST_SETS:,} sets of views; use greedy_views"
        )
        raise ArgumentError("count", problem)
    # Greedy views first, so that most sets are excluded at once.
    first = [int(pose) for pose in greedy_views(visibility, count, fruit=fruit).poses]
    first += [pose for pose in range(candidates) if pose not in first][: count - len(first)]
    best = search.points(search.covered_by(first)), sorted(first)

    def extend(chosen: list[int], covered: BitArray) -> None:
        nonlocal best
        points, missing = search.points(covered), count - len(chosen)
        if missing == 0:
            if points > best[0]:
                best = points, chosen
            return
        start = chosen[-1] + 1 if chosen else 0
        gains = search.gains(covered)
        for pose in range(start, candidates - missing + 1):
            if points + gains[pose] + np.sort(gains[pose + 1 :])[::-1][: missing - 1].sum() > best[0]:
                extend([*chosen, pose], search.joined(covered, pose))

    extend([], search.covered_by(()))
    return ViewSequence(np.array(best[1]), view_coverage(visibility, best[1], fruit=fruit))


def view_coverage(
    visibility: FruitVisibility, poses: Sequence[int] | NDArray[np.intp], *, fruit: ArrayLike | None = None
) -> NDArray[np.float64]:
    """`(k,)` coverage after each of `k` views in this order: the measure of a view planner.

    Args:
        visibility: of all candidates.
        poses: numbers of the views.
        fruit: as of `greedy_views`.

    Raises:
        ArgumentError: there is no such fruit or pose.
    """
    search = _Search(visibility, fruit)
    covered, points = search.covered_by(()), []
    for pose in _pose_numbers(poses):
        covered = search.joined(covered, pose)
        points.append(search.points(covered))
    return np.array(points, dtype=float) / search.total


def _pose_numbers(poses: Sequence[int] | NDArray[np.intp]) -> list[int]:
    """Numbers of poses; the poses themselves are rejected."""
    numbers = np.asarray(poses)
    if numbers.ndim != 1 or (numbers.size and not np.issubdtype(numbers.dtype, np.integer)):
        raise ArgumentError("poses", f"must be numbers of poses, not {numbers.dtype} {numbers.shape}")
    return [int(number) for number in numbers]


class _Search:
    """Seen points of fruit as bits, by pose."""

    def __init__(self, visibility: FruitVisibility, fruit: ArrayLike | None) -> None:
        count = len(visibility.fruit)
        chosen = np.unique(np.arange(count) if fruit is None else np.asarray(fruit, dtype=np.intp))
        if not len(chosen) or chosen[0] < 0 or chosen[-1] >= count:
            raise ArgumentError("fruit", f"must be numbers of the {count} fruit, not {chosen.tolist()}")
        number = np.full(count, -1)
        number[chosen] = np.arange(len(chosen))
        rows = number[visibility.fruit_index] >= 0
        self._poses = len(visibility.poses)
        self._pose, self._fruit = visibility.pose_index[rows], number[visibility.fruit_index[rows]]
        self._seen = np.ascontiguousarray(visibility.seen[rows]).view(np.uint64)
        self._begins = np.searchsorted(self._pose, np.arange(self._poses + 1))
        self._shape = len(chosen), self._seen.shape[1]
        self.total = len(chosen) * visibility.samples

    def covered_by(self, poses: Sequence[int]) -> BitArray:
        """`(f, samples / 64)` the points that some views see."""
        covered = np.zeros(self._shape, np.uint64)
        for pose in poses:
            covered = self.joined(covered, pose)
        return covered

    def joined(self, covered: BitArray, pose: int) -> BitArray:
        """The covered points and those of a further view."""
        if not 0 <= pose < self._poses:
            raise ArgumentError("poses", f"must be numbers of the {self._poses} poses, not {pose}")
        rows = slice(self._begins[pose], self._begins[pose + 1])
        joined = covered.copy()
        joined[self._fruit[rows]] |= self._seen[rows]
        return joined

    def gains(self, covered: BitArray) -> NDArray[np.int64]:
        """`(n,)` number of points that each view adds to the covered ones."""
        new = np.bitwise_count(self._seen & ~covered[self._fruit]).sum(axis=1, dtype=np.int64)
        return np.bincount(self._pose, weights=new, minlength=self._poses).astype(np.int64)

    def points(self, covered: BitArray) -> int:
        """Number of covered points."""
        return int(np.bitwise_count(covered).sum(dtype=np.int64))

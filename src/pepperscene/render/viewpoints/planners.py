"""A benchmark of view planners: coverage of the fruit's surface after each view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.poses.generators import as_poses
from pepperscene.errors import ArgumentError
from pepperscene.truth.view_planning import ViewSequence, greedy_views, view_coverage

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.render.viewpoints.observer import FruitObserver

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlannerComparison:
    """Coverage after each of k views: the mean over the fruit of the fraction of their surface that was seen.

    Attributes:
        random: `(d, k)` of `d` sequences of candidates in random order.
        arc: `(k,)` of a fixed arc.
        oracle: `(k,)` of the next best views by what the candidates really see: a bound that a planner, which
            does not know the plants, can approach.
        most: coverage of all candidates together.
        views: the candidates that the oracle takes.
    """

    random: FloatArray
    arc: FloatArray
    oracle: FloatArray
    most: float
    views: ViewSequence


def compare_planners(
    observer: FruitObserver,
    camera: Camera,
    candidates: ArrayLike,
    arc: ArrayLike,
    rng: np.random.Generator,
    *,
    fruit: ArrayLike | None = None,
    draws: int = 100,
) -> PlannerComparison:
    """Compare random views, a fixed arc and an oracle by the coverage after each of k views.

    `view_coverage` is the same measure for the views of any other planner.

    Args:
        observer: of the scene.
        camera: lens and sensor.
        candidates: `(n, 4, 4)` poses that random views and the oracle choose from, at least k.
        arc: `(k, 4, 4)` poses in their order; their number is that of the views.
        rng: draws the random views.
        fruit: numbers of the fruit that count, in `FruitVisibility.fruit`; None for all.
        draws: number of random sequences.

    Raises:
        ArgumentError: poses have another shape, there are fewer candidates than poses of the arc, there is
            no such fruit, or the draws are less than 1.
    """
    of_arc = as_poses(arc, "arc")
    poses = as_poses(candidates, "candidates")
    count = len(of_arc)
    if not 1 <= count <= len(poses):
        raise ArgumentError("arc", f"must have from 1 to {len(poses)} poses, not {count}")
    if draws < 1:
        raise ArgumentError("draws", f"must be at least 1, not {draws}")
    visibility = observer.observe(camera, poses)
    arc_visibility = observer.observe(camera, of_arc)
    views = greedy_views(visibility, count, fruit=fruit)
    # Where no candidate adds anything, further views change nothing.
    oracle = np.concatenate([views.coverage, np.full(count - len(views.poses), _last(views.coverage))])
    return PlannerComparison(
        random=np.array(
            [
                view_coverage(visibility, rng.permutation(len(poses))[:count], fruit=fruit)
                for _ in range(draws)
            ]
        ),
        arc=view_coverage(arc_visibility, range(count), fruit=fruit),
        oracle=oracle,
        most=_last(view_coverage(visibility, range(len(poses)), fruit=fruit)),
        views=views,
    )


def _last(values: FloatArray) -> float:
    return float(values[-1]) if len(values) else 0.0

"""Planners of views: what they get, and simple ones to compare with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.viewpoints.workspace import BoxWorkspace

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.frame import Frame
    from pepperscene.learning.tasks.view_scenes import ViewScene


@dataclass(frozen=True, eq=False)
class PlanningState:
    """What a planner knows when it chooses the next view.

    Attributes:
        candidates: `(n, 4, 4)` the views to choose from, camera to world, metres.
        camera: lens and sensor, which project points and give the directions of pixels.
        target: the box with the fruit.
        taken: numbers of the views so far; the first one is the start, which is the same for all planners.
        views: number of views in all.
        arc: numbers of the candidates on an arc, from one end to the other.
        rng: random numbers of this run.
    """

    candidates: NDArray[np.float64]
    camera: Camera
    target: BoxWorkspace
    taken: tuple[int, ...]
    views: int
    arc: tuple[int, ...]
    rng: np.random.Generator
    _observe: Callable[[int], Frame] = field(repr=False)

    def frame(self, number: int = -1) -> Frame:
        """The outputs `class` and `depth_z` as seen from `taken[number]`, by default from the last view.

        They are rendered when they are asked for.
        """
        return self._observe(self.taken[number])


Planner = Callable[[PlanningState], int]
"""A planner: from a state to the number of the next view among the candidates. In each scene, its first call
has one view in `taken`."""


def random_planner(state: PlanningState) -> int:
    """A random view that was not taken yet."""
    others = np.setdiff1d(np.arange(len(state.candidates)), state.taken)
    return int(state.rng.choice(others)) if len(others) else state.taken[-1]


def arc_planner(state: PlanningState) -> int:
    """The next view on the arc, from one end to the other; the last one again when all were taken."""
    return next((number for number in state.arc if number not in state.taken), state.taken[-1])


def oracle_views(scene: ViewScene) -> list[int]:
    """The start, then views that each see most of the surface that was not seen before.

    They are chosen by what the candidates really see, which no planner knows.
    """
    from pepperscene.truth.view_planning import greedy_views

    count = scene.task.views - 1
    best = greedy_views(scene.visibility, count, fruit=scene.fruit, taken=[scene.start]).poses.tolist()
    # Where no candidate adds anything, further views change nothing.
    return [scene.start, *best, *[scene.start] * (count - len(best))]

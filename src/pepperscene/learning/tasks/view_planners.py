"""Planners of views: what they get, and some to compare with.

The one with a map of voxels looks at what is unknown beside the fruit that it has seen. Its idea is that of
Zaenker et al. 2021, "Viewpoint planning for fruit size and position estimation", IROS, for sweet pepper: a
map of free, occupied and unknown voxels, and views of many unknown voxels close to fruit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.recipe.views.workspace import BoxWorkspace

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.frame import Frame
    from pepperscene.learning.tasks.view_scenes import ViewScene


FloatArray = NDArray[np.float64]

VOXEL_M: Final = 0.02  # chosen: a quarter of a fruit's diameter
_NEAR_FRUIT_M: Final = 0.06  # chosen: unknown voxels up to here may belong to a fruit that is seen in part
_ELSEWHERE: Final = 0.05  # chosen: weight of other unknown voxels, so that hidden fruit is found as well
_MOST_VOXELS: Final = 1500  # chosen: unknown voxels that a view is judged by, in milliseconds
_STEPS: Final = 40  # chosen: along a ray through the box, less than a voxel each
_COLUMNS: Final = 200  # chosen: columns of pixels that mark voxels; at arm's length they are 5 mm apart


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


class VoxelPlanner:
    """Chooses the view from which most unknown voxels, weighted by their closeness to fruit, can be seen."""

    def __init__(self) -> None:
        self._map: VoxelMap | None = None

    def __call__(self, state: PlanningState) -> int:
        """The number of the next view."""
        if len(state.taken) == 1 or self._map is None:
            self._map = VoxelMap(*state.target.bounds_m)
        self._map.add(state)
        centres, weight = self._map.unknown()
        gains = np.full(len(state.candidates), -1.0)
        for number in np.setdiff1d(np.arange(len(gains)), state.taken):
            gains[number] = self._map.gain(state, int(number), centres, weight)
        return int(gains.argmax())


class VoxelMap:
    """Voxels of a box that are unknown, free or occupied, and those with fruit.

    Args:
        low: lower corner `(3,)`, metres.
        high: upper corner.
    """

    def __init__(self, low: FloatArray, high: FloatArray) -> None:
        self.low = np.asarray(low, float)
        self.shape = tuple(np.ceil((np.asarray(high) - self.low) / VOXEL_M - 1e-9).astype(int).tolist())
        self.free, self.occupied, self.fruit = (np.zeros(self.shape, bool) for _ in range(3))
        grid = np.stack(np.meshgrid(*map(np.arange, self.shape), indexing="ij"), axis=-1).reshape(-1, 3)
        self.centres = self.low + VOXEL_M * (grid + 0.5)

    def add(self, state: PlanningState) -> None:
        """Add what was seen from the last view."""
        camera = state.camera.at_pose(state.candidates[state.taken[-1]])
        frame = state.frame()
        depth, classes = frame["depth_z"].astype(float), frame["class"]

        # Voxels with a surface: the points of every few pixels.
        every = max(1, camera.width // _COLUMNS)
        step = np.s_[::every, ::every]
        directions = camera.pixel_directions()[step]
        seen = np.isfinite(depth[step])
        rays = directions[seen] / directions[seen][:, 2:]
        points = (rays * depth[step][seen][:, None]) @ camera.pose[:3, :3].T + camera.pose[:3, 3]
        self._mark(self.occupied, points)
        self._mark(self.fruit, points[classes[step][seen] == OrganClass.PEPPER])

        # Free voxels: their centres are in front of what their pixel shows.
        pixels = camera.project(self.centres)
        in_image = np.isfinite(pixels[:, 0]) & (pixels >= 0).all(axis=1)
        in_image &= (pixels[:, 0] < camera.width) & (pixels[:, 1] < camera.height)
        columns, rows = pixels[in_image].astype(int).T
        forward = (self.centres[in_image] - camera.pose[:3, 3]) @ camera.pose[:3, 2]
        free = self.free.reshape(-1)
        free[np.flatnonzero(in_image)[forward < depth[rows, columns] - 0.5 * VOXEL_M]] = True

    def unknown(self) -> tuple[FloatArray, FloatArray]:
        """Centres `(m, 3)` of unknown voxels and their weights `(m,)`; some of them if there are many."""
        from scipy import ndimage

        unknown = ~(self.free | self.occupied)
        near = np.zeros(self.shape, bool)
        if self.fruit.any():
            near = ndimage.distance_transform_edt(~self.fruit, sampling=VOXEL_M) <= _NEAR_FRUIT_M
        chosen, weights = [], []
        for group, weight in ((unknown & near, 1.0), (unknown & ~near, _ELSEWHERE)):
            numbers = np.flatnonzero(group)
            kept = numbers[:: max(1, -(-len(numbers) // _MOST_VOXELS))]
            chosen.append(kept)
            weights.append(np.full(len(kept), weight * len(numbers) / max(1, len(kept))))
        return self.centres[np.concatenate(chosen)], np.concatenate(weights)

    def gain(self, state: PlanningState, number: int, centres: FloatArray, weights: FloatArray) -> float:
        """Sum of the weights of the voxels that a candidate sees past the occupied ones."""
        camera = state.camera.at_pose(state.candidates[number])
        pixels = camera.project(centres)
        inside = np.isfinite(pixels[:, 0]) & (pixels >= 0).all(axis=1)
        inside &= (pixels[:, 0] < camera.width) & (pixels[:, 1] < camera.height)
        origin, ends = camera.pose[:3, 3], centres[inside]
        if not len(ends):
            return 0.0
        # Sample each ray in the box, up to a voxel and a half before its end.
        length = np.linalg.norm(ends - origin, axis=1)
        last = np.clip(1.0 - 1.5 * VOXEL_M / length, 0.0, 1.0)
        first = np.maximum(last - _STEPS * VOXEL_M / length, 0.0)
        parts = first[:, None] + (last - first)[:, None] * np.linspace(0.0, 1.0, _STEPS)
        blocked = self._at(self.occupied, origin + parts[..., None] * (ends - origin)[:, None])
        return float(weights[inside][~blocked.any(axis=1)].sum())

    def _mark(self, grid: NDArray[np.bool_], points: FloatArray) -> None:
        index = self._index(points)
        grid[tuple(index[self._within(index)].T)] = True

    def _at(self, grid: NDArray[np.bool_], points: FloatArray) -> NDArray[np.bool_]:
        """Values `(...)` at points `(..., 3)`; False outside the box."""
        index = self._index(points)
        within = self._within(index)
        found = np.zeros(points.shape[:-1], bool)
        found[within] = grid[tuple(index[within].T)]
        return found

    def _index(self, points: FloatArray) -> NDArray[np.intp]:
        return np.floor((points - self.low) / VOXEL_M).astype(np.intp)

    def _within(self, index: NDArray[np.intp]) -> NDArray[np.bool_]:
        return np.asarray(((index >= 0) & (index < self.shape)).all(axis=-1))

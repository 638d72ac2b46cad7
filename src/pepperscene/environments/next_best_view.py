"""Next best view: see the surface of all ripe fruit in few views."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
from gymnasium.spaces import Box, Dict
from numpy.typing import NDArray

from pepperscene.camera.poses.generators import pose_along
from pepperscene.environments import crop
from pepperscene.environments.crop import FloatArray, SceneKey, unit_space, unit_values
from pepperscene.errors import ArgumentError
from pepperscene.learning.tasks.view_scenes import ViewTask, arc_poses, random_views
from pepperscene.live import SceneFruit
from pepperscene.recipe.views.workspace import ReachTest
from pepperscene.render.viewpoints import FruitObserver
from pepperscene.truth.view_planning import greedy_views

_TASK: Final = ViewTask(candidates=100, samples=256)
"""Chosen: rewards are right to 2 %, and the greedy baseline takes 0.2 s for a view."""
_MOST_FRUIT: Final = 32  # chosen: rows of found fruit; a workspace of 0.8 m height has up to 20 ripe ones
_TURN_RAD: Final = np.array([0.5, 1.0 / 3.0]) * np.pi  # chosen: largest yaw and pitch; beyond is no crop


@lru_cache(maxsize=2)
def view_space(key: SceneKey, task: ViewTask) -> tuple[FruitObserver, ReachTest]:
    """What the camera sees in a scene as it was grown, and where it may be; the last ones are held."""
    scene = crop.grown_scene(key)[0].scene
    return FruitObserver(scene, task.samples), ReachTest(task.box, scene.mesh, task.clearance_m)


class NextBestView(crop.CropEnv):
    """Move a camera so that it sees as much as possible of the surface of the ripe fruit.

    The reward is what a view adds to the coverage: the mean, over the ripe fruit opposite the workspace, of
    the fraction of their surface that was seen. An episode ends after the views of the task, the start
    included.

    Action: the next pose, five numbers from -1 to 1: x, y and z in the workspace, yaw in parts of 90 degrees,
    pitch in parts of 60. A camera that would be in an organ or too near to one stays in place and turns only.

    Observation: `class` and `depth` images of the last view; `pose`, as an action; `fruit`, a row for each
    ripe fruit that was seen, the first one first: centre in the target box from -1 to 1, seen fraction of its
    surface, ripeness, and zeros in other rows; `views_left`, a fraction.

    Args:
        task: workspace, number of views and accuracy; None for 10 views from an arm's reach in the aisle.
        others: as of `CropEnv`, with its errors.
    """

    def __init__(self, task: ViewTask | None = None, **others: Any) -> None:
        super().__init__(**others)
        if task is not None and not isinstance(task, ViewTask):
            raise ArgumentError("task", f"must be a ViewTask, not {type(task).__name__}")
        self._task = task or _TASK
        left = Box(0.0, 1.0, (1,), np.float32)
        state = {"pose": unit_space(5), "fruit": unit_space(_MOST_FRUIT, 5), "views_left": left}
        self.action_space, self.observation_space = unit_space(5), Dict({**self._image_spaces(), **state})

    def _begin(self, ripe: list[SceneFruit]) -> None:
        self._observer, self._reach = view_space(self._key, self._task)
        points, ripeness = self._observer.points, {one.instance - 1: one.ripeness for one in ripe}
        is_ripe = np.isin(points.fruit, list(ripeness)) & self._task.target.contains(points.skin_centres)
        self._rows = np.flatnonzero(is_ripe)
        if not len(self._rows):
            raise self._missing("ripe fruit opposite the workspace")
        self._degrees = np.array([ripeness[index] for index in points.fruit[self._rows].tolist()])
        self._seen = np.zeros((len(points.fruit), self._task.samples // 8), np.uint8)
        self._found: list[int] = []
        self._poses: list[FloatArray] = []
        self._take(self._random_poses(1, self.np_random)[0])

    def step(self, action: Any) -> tuple[crop.Observation, float, bool, bool, crop.Info]:
        """Take the next view; raises `ArgumentError` if the action is not five finite numbers."""
        before = self._shares().mean()
        self._take(self._pose(crop.checked_action(action)))
        observation, info = self._state()
        is_over = len(self._poses) >= self._task.views
        return observation, float(info["coverage"] - before), is_over, False, info

    def arc_action(self) -> NDArray[np.float32]:
        """The next pose of an arc, the last one again at its end: a baseline."""
        arc = arc_poses(self._task, self._reach)
        return self._action([*self._poses[-1:], *arc][min(len(self._poses), len(arc))])

    def greedy_action(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Of the arc and random poses, the one that sees most of what no view has seen: a baseline.

        It knows what each would see, which no planner on a robot does.
        """
        others, arc = self._random_poses(self._task.candidates, rng), arc_poses(self._task, self._reach)
        actions = [self._action(pose) for pose in (*arc, *others)]
        poses = [*self._poses, *(self._pose(action.astype(float)) for action in actions)]
        visibility, taken = self._observer.observe(self.scene.camera, poses), len(self._poses)
        best = greedy_views(visibility, 1, fruit=self._rows, taken=range(taken)).poses
        return actions[int(best[0]) - taken if len(best) else 0]

    def _random_poses(self, count: int, rng: np.random.Generator) -> FloatArray:
        return random_views(replace(self._task, candidates=count), self._reach, rng)

    def _pose(self, action: FloatArray) -> FloatArray:
        low, high = self._task.box.bounds_m
        place = np.clip(low + 0.5 * (action[:3] + 1.0) * (high - low), low, high)
        if not self._reach(place)[0]:
            place = self._poses[-1][:3, 3]
        return pose_along(place, crop.direction(_TURN_RAD * action[3:]), np.array([0.0, 0.0, 1.0]))

    def _action(self, pose: FloatArray) -> NDArray[np.float32]:
        place = _within(pose[:3, 3], self._task.box.bounds_m)
        return unit_values(np.concatenate([place, crop.angles(pose[:3, 2]) / _TURN_RAD]))

    def _take(self, pose: FloatArray) -> None:
        """Add what a view sees."""
        self._poses.append(pose)
        visibility = self._observer.observe(self.scene.camera, pose)
        self._seen[visibility.fruit_index] |= visibility.seen
        self._found += np.setdiff1d(np.flatnonzero(self._shares()), self._found).tolist()

    def _shares(self) -> FloatArray:
        """`(r,)` seen fraction of the surface of each ripe fruit."""
        return np.bitwise_count(self._seen[self._rows]).sum(axis=1) / self._task.samples

    def _state(self) -> tuple[crop.Observation, crop.Info]:
        fruit, found, shares = np.zeros((_MOST_FRUIT, 5)), self._found[:_MOST_FRUIT], self._shares()
        centres = self._observer.points.skin_centres[self._rows[found]]
        fruit[: len(found), :3] = _within(centres, self._task.target.bounds_m)
        fruit[: len(found), 3:] = np.column_stack([shares[found], self._degrees[found]])
        left = max(0.0, 1.0 - len(self._poses) / self._task.views)
        state = {"fruit": unit_values(fruit), "views_left": np.array([left], np.float32)}
        info = {"coverage": float(shares.mean()), "found": len(self._found), "ripe": len(self._rows)}
        pose = self._poses[-1]
        return {**self._images(pose), "pose": self._action(pose), **state}, info


def _within(points: FloatArray, bounds: FloatArray) -> FloatArray:
    """Coordinates `(..., 3)` in a box `(2, 3)`, from -1 to 1."""
    return np.asarray(2.0 * (points - bounds[0]) / np.maximum(bounds[1] - bounds[0], 1e-9) - 1.0)

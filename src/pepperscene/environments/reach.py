"""Reach: bring a tool to the cut point of a ripe fruit without touching stems and other fruit."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from gymnasium.spaces import Dict
from numpy.typing import NDArray

from pepperscene.camera.poses.generators import pose_along
from pepperscene.classes import OrganClass
from pepperscene.environments import crop
from pepperscene.environments.crop import FloatArray, unit_space, unit_values
from pepperscene.live import SceneFruit

# The tool and its task; all of these values are chosen.
_RADIUS_M: Final = 0.006  # a slender cutter
_LENGTH_M: Final = 0.2
_CLOSE_M: Final = 0.02  # a tool whose tip is this near has the stalk between its blades,
_ALIGNED_RAD: Final = float(np.radians(20.0))  # which close around it at this angle to the approach
_STEP_M: Final = 0.012  # the tool's thickness, so that a motion skips nothing as thick
_TURN_RAD: Final = float(np.radians(4.0))  # the end of the tool then moves as far as its tip
_LIMIT_RAD: Final = np.array([2.0, 1.0])  # of yaw and pitch
_REACH_M: Final = 0.5  # the tip stays within this distance of the cut along each axis
_SEEN_M: Final = 0.3  # distances to surfaces are cut there
_START_M: Final = (0.25, 0.4)  # distance of the start from the cut, in front of most leaves
_START_RAD: Final = 0.3  # of the start to the approach, and of the tool to the start
_FACING: Final = 0.5  # the approach is at most 60 degrees from the aisle's normal
_TRIES: Final = 200  # starts that are drawn for one that touches nothing
_TOUCHED: Final = 0.05  # the touches that end an episode cost half of what the whole way gives
_MOST_TOUCHES: Final = 10
_ANGLE_M: Final = 0.05  # a radian counts as much as 5 cm
_CAMERA_M: Final = np.array([0.0, 0.05, 0.25])  # the tip from the camera on the tool: right, down, forward


class Reach(crop.CropEnv):
    """Bring the tip of a tool, a capsule, to the cut point of a ripe fruit, along its approach.

    Action: five numbers from -1 to 1: the motion to the right, down and forward in parts of 12 mm, yaw and
    pitch in parts of 4 degrees. One that would touch something is not carried out and costs 0.05. Leaves give
    way and do not count, nor does the stalk that is to be cut; everything else does.

    The reward is the progress, distance to the cut and 5 cm for each radian to the approach, as a part of the
    whole way, so that it adds up to 1. A successful end adds 1: the tip is within 20 mm of the cut, and the
    tool within 20 degrees of the approach. Ten touches end an episode, too.

    Observation: `state`, 17 numbers from -1 to 1: the cut relative to the tip, metres, the approach and the
    tangent of the stalk, all in the tool's axes (right, down, forward); the direction of the tool in the
    world; distances of tip, middle and end to the nearest surface, in parts of 0.3 m; whether the last action
    touched something; the steps that are left, a fraction. With `image`, also `class` and `depth` images of
    a camera on the tool.

    Args:
        steps: of an episode.
        image: whether there are images.
        others: as of `CropEnv`, with its errors.
    """

    def __init__(self, steps: int = 100, image: bool = False, **others: Any) -> None:
        super().__init__(**others)
        self._steps, self._image = crop.whole_number("steps", steps, 2, 1_000_000), image
        images = self._image_spaces() if image else {}
        self.action_space, self.observation_space = unit_space(5), Dict({"state": unit_space(17), **images})

    def _begin(self, ripe: list[SceneFruit]) -> None:
        facing = [one for one in ripe if one.approach is not None and one.approach[1] >= _FACING]
        if not facing:
            raise self._missing("ripe fruit with an approach from the aisle")
        self._leaves = {one.instance for one in self.scene.organs if one.organ_class == OrganClass.LEAF}
        if not any(self._draw(facing) for _ in range(_TRIES)):
            raise self._missing("place for the tool in front of ripe fruit")
        self._way, self._count, self._touched, self._touches_so_far = self._left(), 0, False, 0

    def _draw(self, fruit: list[SceneFruit]) -> bool:
        """Draw a fruit and the pose of the tool before it; returns whether the tool touches nothing there."""
        rng = self.np_random
        self._target = one = fruit[int(rng.integers(len(fruit)))]
        self._cut, self._tangent, self._approach = map(np.asarray, (one.cut, one.cut_tangent, one.approach))
        side = crop.angles(self._approach) + rng.uniform(-_START_RAD, _START_RAD, 2)
        self._tip: FloatArray = self._cut - rng.uniform(*_START_M) * crop.direction(side)
        self._turn = side + rng.uniform(-_START_RAD, _START_RAD, 2)
        return not self._touches(self._tip, self._turn)

    def step(self, action: Any) -> tuple[crop.Observation, float, bool, bool, crop.Info]:
        """Move the tool; raises `ArgumentError` if the action is not five finite numbers."""
        values, before = crop.checked_action(action), self._left()
        tip = self._tip + _STEP_M * self._axes() @ values[:3]
        tip = np.clip(tip, self._cut - _REACH_M, self._cut + _REACH_M)
        turn = np.clip(self._turn + _TURN_RAD * values[3:], -_LIMIT_RAD, _LIMIT_RAD)
        self._touched, self._count = bool(self._touches(tip, turn)), self._count + 1
        self._touches_so_far += self._touched
        if not self._touched:
            self._tip, self._turn = tip, turn
        observation, info = self._state()
        is_success, touches = info["is_success"], info["touches"]
        reward = (before - self._left()) / self._way - _TOUCHED * self._touched + is_success
        is_over = is_success or touches >= _MOST_TOUCHES
        return observation, float(reward), is_over, self._count >= self._steps and not is_over, info

    def straight_action(self) -> NDArray[np.float32]:
        """Straight to the cut point, turning to the approach on the way: a baseline."""
        way = self._axes().T @ (self._cut - self._tip) / _STEP_M
        turn = (crop.angles(self._approach) - self._turn) / _TURN_RAD
        return unit_values(np.concatenate([way / max(1.0, np.abs(way).max()), turn]))

    def _gap(self) -> tuple[float, float]:
        """Distance of the tip to the cut, metres, and angle of the tool to the approach, radians."""
        cosine = np.clip(crop.direction(self._turn) @ self._approach, -1.0, 1.0)
        return float(np.linalg.norm(self._cut - self._tip)), float(np.arccos(cosine))

    def _left(self) -> float:
        """The way that is left, metres."""
        return float(np.array([1.0, _ANGLE_M]) @ self._gap())

    def _axes(self) -> FloatArray:
        """`(3, 3)` right, down and forward of the tool, as columns."""
        return pose_along(self._tip, crop.direction(self._turn), np.array([0.0, 0.0, 1.0]))[:3, :3]

    def _touches(self, tip: FloatArray, turn: FloatArray) -> tuple[int, ...]:
        """The instances that the tool touches at a pose."""
        axis = crop.direction(turn)
        ends = tip - _RADIUS_M * axis, tip - (_LENGTH_M - _RADIUS_M) * axis
        return self.scene.collides(
            [[*ends[0], *ends[1], _RADIUS_M]], ignore={*self._leaves, self._target.stalk}
        )

    def _state(self) -> tuple[crop.Observation, crop.Info]:
        axes, vectors = self._axes(), [self._cut - self._tip, self._approach, self._tangent]
        places = self._tip - np.outer([0.0, 0.5 * _LENGTH_M, _LENGTH_M], axes[:, 2])
        near = self.scene.nearest(places)[0] / _SEEN_M
        rest = [self._touched, 1.0 - self._count / self._steps]
        state = np.concatenate([*(axes.T @ one for one in vectors), axes[:, 2], near, rest])
        images = {}
        if self._image:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = axes, self._tip - axes @ _CAMERA_M
            images = self._images(pose)
        distance, angle = self._gap()
        info = {"distance_m": distance, "angle_rad": angle, "touches": self._touches_so_far}
        info["is_success"] = distance <= _CLOSE_M and angle <= _ALIGNED_RAD
        info["target"] = self._target.instance
        return {"state": unit_values(state), **images}, info

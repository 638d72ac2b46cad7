"""What the environments share: the scenes of a recipe, how one is drawn, and images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Space
from numpy.typing import ArrayLike, NDArray

from pepperscene.errors import ArgumentError, InputError
from pepperscene.live import LiveScene, SceneFruit, open_scene
from pepperscene.recipe.recipe import digest
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe

FloatArray = NDArray[np.float64]
Observation = dict[str, Any]
Info = dict[str, Any]

_FARTHEST_M: Final = 3.0  # chosen: of depth images; nothing that an arm can reach is farther away
_IMAGE: Final = {"camera.width": 64, "camera.height": 48}  # chosen: a fruit at 0.5 m is 10 pixels wide


@dataclass(frozen=True)
class SceneKey:
    """A scene: the digest of all that decides the scenes of a recipe, its number, and the recipe."""

    digest: str
    number: int
    recipe: ResolvedRecipe = field(compare=False)


@lru_cache(maxsize=2)
def grown_scene(key: SceneKey) -> tuple[LiveScene, tuple[SceneFruit, ...]]:
    """A scene, which no episode changes, and its fruit; the last ones are shared in the process."""
    scene = open_scene(key.recipe, key.number * key.recipe.recipe.plan.scene_frames)
    return scene, scene.fruit


class CropEnv(gymnasium.Env[Observation, Any]):
    """An environment in a scene of a recipe.

    Args:
        recipe: name of a shipped one, or path.
        changes: values of the recipe to replace, by dotted key; `camera.width` and `camera.height`, by
            default 64 and 48, are the size of the images.
        scenes: number of scenes that `reset` draws from; one that the process does not hold takes seconds.
        ripeness: least one of ripe fruit, 0 to 1.

    Raises:
        InputError: the recipe or a change is not valid.
        ArgumentError: another argument is not allowed.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - as gymnasium declares it
    scene: LiveScene
    _key: SceneKey

    def __init__(
        self,
        recipe: str | Path = "barth2018",
        changes: Mapping[str, Any] | None = None,
        scenes: int = 1,
        ripeness: float = 0.5,
    ) -> None:
        self._recipe = resolve_recipe(recipe, {**_IMAGE, **(changes or {})})
        self._digest = digest(dict(self._recipe.identity))
        plan = self._recipe.recipe.plan
        self._scenes = whole_number("scenes", scenes, 1, plan.sets * plan.rotations)
        if not 0.0 <= ripeness <= 1.0:
            raise ArgumentError("ripeness", f"must be from 0 to 1, not {ripeness}")
        self._ripeness = ripeness

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin an episode; the generator draws the scene, the target and the start.

        Raises:
            ArgumentError: there are options.
            InputError: the scene has no suitable fruit.
        """
        if options:
            raise ArgumentError("options", "must be empty", value=options)
        super().reset(seed=seed)
        self._key = SceneKey(self._digest, int(self.np_random.integers(self._scenes)), self._recipe)
        scene, fruit = grown_scene(self._key)
        # Views grow plants of far rows in full, which other episodes are not to see.
        self.scene = scene.copy()
        self._begin([one for one in fruit if one.ripeness >= self._ripeness])
        observation, info = self._state()
        return observation, {**info, "scene": self._key.number}

    def _begin(self, ripe: list[SceneFruit]) -> None:
        raise NotImplementedError

    def _state(self) -> tuple[Observation, Info]:
        raise NotImplementedError

    def _missing(self, what: str) -> InputError:
        """The error of a scene without suitable fruit."""
        return InputError(self._recipe.recipe.name, f"has no {what} in scene {self._key.number}")

    def _image_spaces(self) -> dict[str, Space[Any]]:
        shape = (self._recipe.camera.height, self._recipe.camera.width)
        return {"class": Box(0, 255, shape, np.uint8), "depth": Box(0.0, _FARTHEST_M, shape, np.float32)}

    def _images(self, pose: FloatArray) -> Observation:
        """Classes, and depth along the optical axis in metres."""
        frame = self.scene.render(pose, ("class", "depth_z"))
        return {"class": frame["class"], "depth": np.minimum(frame["depth_z"], np.float32(_FARTHEST_M))}


def whole_number(name: str, value: Any, low: int, high: int) -> int:
    """The value; raises `ArgumentError` unless it is a whole number in a range."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ArgumentError(name, f"must be a whole number from {low} to {high:,}, not {value!r}")
    return value


def unit_space(*shape: int) -> Box:
    """Single precision numbers from -1 to 1."""
    return Box(-1.0, 1.0, shape, np.float32)


def unit_values(values: ArrayLike) -> NDArray[np.float32]:
    """Numbers of a `unit_space`; rounding does not lead out of it."""
    return np.clip(np.asarray(values, np.float32), -1.0, 1.0)


def checked_action(action: Any) -> FloatArray:
    """`(5,)` numbers, cut to -1 to 1; raises `ArgumentError` if they are others or not finite."""
    values = np.asarray(action)
    if values.shape != (5,) or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise ArgumentError("action", "must be 5 finite numbers from -1 to 1")
    return np.clip(values.astype(float), -1.0, 1.0)


def direction(angles_rad: FloatArray) -> FloatArray:
    """`(3,)` unit vector of yaw and pitch `(2,)`: along y for 0, yaw turns it to +x, pitch upwards."""
    (sin_yaw, sin_pitch), (cos_yaw, cos_pitch) = np.sin(angles_rad), np.cos(angles_rad)
    return np.array([sin_yaw * cos_pitch, cos_yaw * cos_pitch, sin_pitch])


def angles(vector: FloatArray) -> FloatArray:
    """`(2,)` yaw and pitch of a unit vector, as of `direction`."""
    return np.array([np.arctan2(vector[0], vector[1]), np.arcsin(np.clip(vector[2], -1.0, 1.0))])

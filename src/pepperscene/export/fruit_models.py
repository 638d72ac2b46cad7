"""Meshes of the fruit of a data set: its plants are grown again, and compared with the recorded truth."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import MARK, Dataset
from pepperscene.errors import InputError
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.variation.recorded import read_variation
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.geometry import Mesh

MODEL_AXES: Final = np.diag([1.0, -1.0, -1.0])
"""From fruit to model axes, a half turn about x: the model's z points to the stalk, up as the fruit hangs."""

_TOLERANCE_M: Final = 1e-5
"""Of the side lengths of a fruit's box. Chosen: ten times the rounding of the harvest truth."""


@dataclass(frozen=True, eq=False)
class FruitModel:
    """The mesh of a fruit; the origin is the centre of its bounding box.

    Attributes:
        vertices: `(n, 3)` metres, in model axes.
        normals: `(n, 3)` unit vectors, in model axes.
        faces: `(m, 3)` indices of vertices.
        centre: `(3,)` the origin in the axes of the fruit, metres.
    """

    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.int64]
    centre: NDArray[np.float64]

    def model_to_camera(self, pose: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation `(3, 3)` and translation `(3,)` in metres of the model at a fruit's pose `(4, 4)`."""
        rotation = pose[:3, :3]
        return rotation @ MODEL_AXES.T, rotation @ self.centre + pose[:3, 3]


class FruitMeshes:
    """Grows the plants of a data set again, one scene at a time.

    Raises:
        InputError: the recipe in `dataset.json` cannot be restored, because its files differ or are not
            shipped, or because another version of this program built the data set.
    """

    def __init__(self, dataset: Dataset) -> None:
        self._where = dataset.folder / MARK
        self._frames = FrameRenderer(restore_recipe(dataset))
        self._scene: tuple[tuple[int, int], Mesh] | None = None

    def model(
        self, spec: FrameSpec, camera_pose: NDArray[np.float64], fruit: Mapping[str, Any]
    ) -> FruitModel:
        """The model of a fruit.

        Args:
            spec: a frame that shows it.
            camera_pose: of that frame, `(4, 4)` camera to world.
            fruit: its entry in the harvest truth of that frame.

        Raises:
            InputError: the plants that were grown again have no such fruit.
        """
        mesh, number = self._mesh(spec), fruit["instance"] - 1
        is_fruit = number < len(mesh.instances) and mesh.instances[number].organ_class == OrganClass.PEPPER
        faces = mesh.faces[mesh.face_instance == number] if is_fruit else np.empty((0, 3), np.int64)
        if not len(faces):
            raise self._other_plants(fruit)
        used, numbers = np.unique(faces, return_inverse=True)
        to_world = camera_pose @ np.asarray(fruit["pose"], dtype=float)
        vertices = (mesh.vertices[used] - to_world[:3, 3]) @ to_world[:3, :3]
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        if not np.abs(high - low - _box_size(fruit)).max() <= _TOLERANCE_M:
            raise self._other_plants(fruit)
        centre = (low + high) / 2
        normals = mesh.normals[used] @ to_world[:3, :3]
        return FruitModel(
            (vertices - centre) @ MODEL_AXES.T, normals @ MODEL_AXES.T, numbers.reshape(-1, 3), centre
        )

    def _mesh(self, spec: FrameSpec) -> Mesh:
        key = spec.scene, spec.twin
        if self._scene is None or self._scene[0] != key:
            # Release the old scene before making the new one.
            self._scene = None
            self._scene = key, self._frames.scene(spec, traced=False).mesh
        return self._scene[1]

    def _other_plants(self, fruit: Mapping[str, Any]) -> InputError:
        problem = f"the plants that its recipe grows have no fruit like instance {fruit['instance']}"
        return InputError(self._where, problem)


def _box_size(fruit: Mapping[str, Any]) -> NDArray[np.float64]:
    """The recorded side lengths `(3,)` of a fruit's box, in its axes; nan if there are none."""
    box = fruit.get("box_3d") or {"size": [np.nan] * 3}
    return np.asarray(box["size"], dtype=float)


def restore_recipe(dataset: Dataset) -> Recipe:
    """The recipe that a `dataset.json` records, with all its values and the same files.

    Raises:
        InputError: a file of the recipe differs or is not shipped, or another version built the data set.
    """
    where, info = dataset.folder / MARK, dataset.info
    if info["version"] != __version__:
        problem = f"the plants cannot be grown again: version {__version__} may grow others"
        raise InputError(where, problem, key="version", value=info["version"])
    content = {key: value for key, value in info["recipe"].items() if key != "variation"}
    try:
        recipe = Recipe.model_validate_json(json.dumps(content))
        recipe = recipe.with_variation(read_variation(info["recipe"]))
        identity = resolve_recipe(recipe).identity
    except (InputError, ValidationError, ValueError) as error:
        detail = error.detail if isinstance(error, InputError) else "its values are not valid"
        problem = f"the plants cannot be grown again: {detail}"
        raise InputError(where, problem, key="recipe") from None
    if json.loads(json.dumps(identity)) != {key: info.get(key) for key in ("recipe", "files")}:
        raise InputError(where, "the plants cannot be grown again: the recipe's files have changed")
    return recipe

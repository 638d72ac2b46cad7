"""Views from a Python function of the user's."""

from __future__ import annotations

import ast
import copy
import dataclasses
import runpy
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pepperscene import atomic
from pepperscene.camera.poses.pose_list import check_positions
from pepperscene.document import read_text
from pepperscene.errors import InputError
from pepperscene.recipe.views_tables import FunctionViews
from pepperscene.shipped import is_file
from pepperscene.user_code import user_errors

if TYPE_CHECKING:
    from pepperscene.scene import Scene


def function_poses(
    table: FunctionViews, scene: Scene, rng: np.random.Generator, frames: int
) -> NDArray[np.float64]:
    """Call a function `poses(scene, rng)` of a file; it returns `(frames, 4, 4)` camera-to-world poses.

    Raises:
        InputError: the file has no such function, or it fails or returns something else.
    """
    function = _load(table.file, table.function, atomic.digest(Path(table.file), "text"))
    with user_errors(table.file, key=table.function):
        poses = np.array(function(read_only(scene), rng), dtype=float)
    if poses.shape != (frames, 4, 4) or not np.isfinite(poses).all():
        problem = f"must return finite poses of the shape ({frames}, 4, 4), not {poses.shape}"
        if poses.shape == (frames, 4, 4):
            problem = "must return finite poses, not infinite or missing numbers"
        raise InputError(table.file, problem, key=table.function)
    rotation = poses[:, :3, :3]
    identity = np.einsum("nij,nkj->nik", rotation, rotation)
    is_rigid = np.allclose(identity, np.eye(3), atol=1e-6) and (np.linalg.det(rotation) > 0).all()
    if not is_rigid or not np.allclose(poses[:, 3], [0, 0, 0, 1]):
        problem = "must return rotations and translations, without scale or reflection"
        raise InputError(table.file, problem, key=table.function)
    check_positions(poses[:, :3, 3], Path(table.file), lambda number: f"{table.function}, pose {number}")
    return poses


def read_only(value: Any) -> Any:
    """A copy of nested data classes whose arrays and mappings cannot be changed; it shares their memory."""
    if isinstance(value, np.ndarray):
        view = value.view()
        view.setflags(write=False)
        return view
    if type(value) is tuple:
        return tuple(map(read_only, value))
    if isinstance(value, dict):
        return MappingProxyType({key: read_only(item) for key, item in value.items()})
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return value
    result = copy.copy(value)
    # Cached properties are among the attributes, which the fields of a class with slots are not.
    names = [field.name for field in dataclasses.fields(value)]
    attributes: Mapping[str, Any] = {name: getattr(value, name) for name in names} | getattr(
        value, "__dict__", {}
    )
    for name, item in attributes.items():
        object.__setattr__(result, name, read_only(item))
    return result


def check_definition(table: FunctionViews, where: str | Path) -> None:
    """Check that the file of a function exists, is valid Python and mentions the function; it is not run.

    Raises:
        InputError: one of these is not so.
    """
    if not is_file(Path(table.file)):
        raise InputError(where, "is not a file", key="views.file", value=table.file)
    try:
        tree = ast.parse(read_text(Path(table.file)), table.file)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(table.file, f"is not valid Python: {' '.join(str(error).split())}") from None
    names = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    names |= {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    names |= {
        name.asname or name.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    if not {table.function, "*"} & names:
        raise InputError(where, "must be a function of the file", key="views.function", value=table.function)


@lru_cache(maxsize=8)
def _load(file: str, name: str, _content: str) -> Any:
    """The function of a file with this content."""
    with user_errors(file):
        function = runpy.run_path(file).get(name)
    if not callable(function):
        raise InputError(file, "must define this function", key=name)
    return function

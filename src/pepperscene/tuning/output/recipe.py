"""The TOML file of a tuned recipe: it extends the original and states what changed."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pepperscene.camera import Camera, Flash, colour_transform
from pepperscene.recipe.recipe import FILE_FOLDERS, Recipe
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.shipped import shipped_folder
from pepperscene.tuning.output.provenance import RunInfo, describe_colours, describe_values, toml_text

if TYPE_CHECKING:
    from pepperscene.tuning.fit.least_squares import FitResult
    from pepperscene.tuning.parameters.tuned import TunedParts

_SAME: Final = 1e-9
"""Chosen: difference of gains and matrix entries that does not change a single code of an image."""
_PARAMETERS: Final[Mapping[str, tuple[str, ...]]] = {
    "camera.exposure_us": ("exposure",),
    "camera.gain": ("exposure",),
    "camera.flash": ("flash.power", "flash.colour", "flash.spectrum"),
    "developing.white_balance": ("white_balance",),
    "developing.colour_matrix": ("colour_matrix",),
}
"""Recipe key -> parameters that it depends on."""

Changes = dict[str, Any]


def recipe_text(
    recipe: Recipe,
    extends: str | Path | None,
    folder: Path,
    changes: Mapping[str, Any],
    fit: FitResult,
    run: RunInfo,
) -> str:
    """Return the TOML of a recipe with changed values by dotted key.

    It extends the file of the recipe, or has all values if `extends` is None; `folder` is its folder.
    """
    content = _recipe_content(recipe, folder)
    content["name"] = f"{recipe.name}_tuned"
    for key, value in changes.items():
        _set_value(content, key, value)
    if extends is not None:
        base = _recipe_content(load_recipe(extends), folder)
        if _can_extend(base, content):
            content = {"extends": reference(extends, "recipes", folder), **_difference(base, content)}
    comments = {}
    for key, names in _PARAMETERS.items():
        fitted = [describe_values(fit, parameter) for parameter in fit.parameters if parameter.name in names]
        if key in changes:
            comments[key] = (
                f"tuned: {'; '.join(fitted)}"
                if fitted
                else "not fitted: the value that was used during tuning"
            )
    if "cultivar" in changes:
        comments["cultivar"] = "tuned"
    values = "\n".join(f"  {describe_values(fit, parameter)}" for parameter in fit.parameters)
    head = f"{recipe.name}, tuned to measured colour.\n{run.summary()}:\n{values}\n{describe_colours(fit)}."
    return toml_text(content, head, comments)


def camera_changes(camera: Camera, flash: Flash | None, tuned: TunedParts) -> Changes:
    """Return the recipe values, by dotted key, with which a camera with a new flash is like the tuned one."""
    changes: Changes = {}
    if abs(tuned.exposure - 1.0) > 1e-12:
        # The light of a flash does not depend on the exposure time, so the gain is changed instead.
        if camera.flash is None:
            changes["camera.exposure_us"] = 1e6 * camera.exposure_s * tuned.exposure
        else:
            changes["camera.gain"] = camera.sensor.gain * tuned.exposure
    if camera.sensor.channels == 1:
        return changes
    # Gains and matrix that the written recipe would have for its light without further settings.
    gains, matrix = colour_transform(dataclasses.replace(camera, flash=flash))
    same_gains = np.allclose(gains, tuned.gains, rtol=_SAME, atol=_SAME)
    if not (same_gains and np.allclose(matrix, tuned.matrix, rtol=_SAME, atol=_SAME)):
        developing = camera.developing
        if developing.white_balance is not None or not np.allclose(tuned.gains, 1.0, rtol=_SAME):
            changes["developing.white_balance"] = tuned.gains.tolist()
        if developing.colour_matrix is not False or not np.allclose(tuned.matrix, np.eye(3), atol=_SAME):
            changes["developing.colour_matrix"] = tuned.matrix.tolist()
    return changes


def reference(name: str | Path, kind: Any, folder: Path) -> str:
    """Return how a file in `folder` refers to another: shipped ones by name, a user's by relative path."""
    path = Path(name)
    if path.parent == Path(".") and path.suffix != ".toml":
        return str(name)
    if path.resolve().parent == shipped_folder(kind).resolve():
        return path.stem
    # Recipes resolve ".." in the path as written, cultivars in the folder on the disk.
    if kind == "plants":
        return _relative_path(path.resolve(), folder.resolve())
    return _relative_path(path, folder)


def _relative_path(path: Path, folder: Path) -> str:
    """Relative path with slashes; the absolute path if there is none (another drive)."""
    try:
        return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()
    except ValueError:
        return path.absolute().as_posix()


def _recipe_content(recipe: Recipe, folder: Path) -> Changes:
    """Values of a recipe as in its file, without `expect`, which was measured with other colours."""
    content = recipe.model_dump(mode="python", exclude_none=True, exclude={"expect"})
    for *tables, last in FILE_FOLDERS:
        table: Any = content
        for name in tables:
            table = table.get(name, {})
        value = table.get(last)
        if isinstance(value, str) and (
            value.endswith((".toml", ".yaml", ".yml")) or Path(value).parent != Path(".")
        ):
            table[last] = _relative_path(Path(value), folder)
    return content


def _can_extend(base: Mapping[str, Any], content: Mapping[str, Any]) -> bool:
    """Whether a file that extends the base can have this content: keys can be added but not removed."""
    return all(
        key in content
        and (
            not isinstance(value, Mapping)
            or (isinstance(content[key], Mapping) and _can_extend(value, content[key]))
        )
        for key, value in base.items()
    )


def _difference(base: Mapping[str, Any], content: Mapping[str, Any]) -> Changes:
    changes: Changes = {}
    for key, value in content.items():
        original = base.get(key)
        if isinstance(value, Mapping) and isinstance(original, Mapping):
            if inner := _difference(original, value):
                changes[key] = inner
        elif key not in base or value != original:
            changes[key] = value
    return changes


def _set_value(tables: Changes, key: str, value: Any) -> None:
    *above, last = key.split(".")
    for name in above:
        tables = tables.setdefault(name, {})
    tables[last] = value

"""The file of a tuned recipe: it extends the one that was tuned and states what is different now."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pepperscene.camera import Camera, Flash, colour_transform
from pepperscene.dataset import Recipe, load_recipe
from pepperscene.shipped import shipped_folder
from pepperscene.tuning.output.provenance import RunInfo, colours_told, values_told
from pepperscene.tuning.output.toml_text import document, rounded

if TYPE_CHECKING:
    from pepperscene.tuning.fit.result import FitResult
    from pepperscene.tuning.parameters.tuned import TunedParts


_FILE_KEYS: Final = (
    "cultivar", "camera.sensor", "camera.lens", "camera.flash", "camera.filter", "daylight.cover",
    "growth.until",
)  # fmt: skip
"""Keys whose value may be a path."""
_SAME: Final = 1e-9
"""Chosen: gains and entries of matrices that are closer give the same picture to the last code."""
_COMMENTED: Final[Mapping[str, tuple[str, ...]]] = {
    "camera.exposure_us": ("exposure",),
    "camera.gain": ("exposure",),
    "camera.flash": ("flash.power", "flash.colour", "flash.spectrum"),
    "developing.white_balance": ("white_balance",),
    "developing.colour_matrix": ("colour_matrix",),
}
"""Keys and the parameters that they follow from."""

Changes = dict[str, Any]


def recipe_text(
    recipe: Recipe,
    extends: str | Path | None,
    folder: Path,
    changes: Mapping[str, Any],
    fit: FitResult,
    occasion: RunInfo,
) -> str:
    """The TOML of a recipe with some values changed.

    Args:
        recipe: that was tuned, with all that was changed about it by hand.
        extends: name or path of the recipe file that it came from; None writes out everything.
        folder: where the file is to lie.
        changes: tuned values by dotted key; files by their names in `folder`.
        fit: that changed them.
        occasion: when and to what.
    """
    told = _told(recipe, folder)
    # What was said of the old colours is not expected of the new ones.
    told.pop("expect", None)
    told["name"] = f"{recipe.name}_tuned"
    for key, value in changes.items():
        _put(told, key, value)
    if extends is not None:
        base = _told(load_recipe(extends), folder)
        base.pop("expect", None)
        if _reachable(base, told):
            told = {"extends": reference(extends, "recipes", folder), **_difference(base, told)}
    comments = {}
    for key, names in _COMMENTED.items():
        fitted = [values_told(fit, one) for one in fit.parameters if one.name in names]
        if key in changes and fitted:
            comments[key] = f"tuned: {'; '.join(fitted)}"
        elif key in changes:
            comments[key] = "as it was while the rest was tuned"
    if "cultivar" in changes:
        comments["cultivar"] = "tuned"
    values = "\n".join(f"  {values_told(fit, one)}" for one in fit.parameters)
    head = f"{recipe.name}, tuned to measured colour.\n{occasion.told()}:\n{values}\n{colours_told(fit)}."
    return document(told, comments, head)


def camera_changes(camera: Camera, flash: Flash | None, tuned: TunedParts) -> Changes:
    """The recipe's values, by dotted key, that let a camera develop as the tuned one did.

    Args:
        camera: of the recipe before.
        flash: that the written recipe has.
        tuned: exposure, gains and matrix in use.
    """
    found: Changes = {}
    if abs(tuned.exposure - 1.0) > 1e-12:
        # A flash is over before the shutter closes: more of its light is more gain.
        if camera.flash is None:
            found["camera.exposure_us"] = rounded(1e6 * camera.exposure_s * tuned.exposure)
        else:
            found["camera.gain"] = rounded(camera.sensor.gain * tuned.exposure)
    if camera.sensor.channels == 1:
        return found
    # What the written recipe would make of its own light, if that is not told otherwise.
    gains, matrix = colour_transform(dataclasses.replace(camera, flash=flash))
    same = np.allclose(gains, tuned.gains, rtol=_SAME, atol=_SAME)
    if not (same and np.allclose(matrix, tuned.matrix, rtol=_SAME, atol=_SAME)):
        if camera.developing.white_balance is not None or not np.allclose(tuned.gains, 1.0, rtol=_SAME):
            found["developing.white_balance"] = [rounded(gain) for gain in tuned.gains]
        if camera.developing.colour_matrix is not False or not np.allclose(
            tuned.matrix, np.eye(3), atol=_SAME
        ):
            found["developing.colour_matrix"] = [[rounded(entry) for entry in row] for row in tuned.matrix]
    return found


def reference(wanted: str | Path, which: Any, folder: Path) -> str:
    """How a file in `folder` names another one: a shipped one by name, a user's by the way to it.

    Args:
        wanted: shipped name or path, as seen from the current folder.
        which: shelf of the shipped ones.
        folder: of the file that names it.
    """
    path = Path(wanted)
    if path.parent == Path(".") and path.suffix != ".toml":
        return str(wanted)
    if path.resolve().parent == shipped_folder(which).resolve():
        return path.stem
    # Recipes take a step upwards out of the path as it is written, cultivars out of the folder on the disk.
    return _way(path.resolve(), folder.resolve()) if which == "plants" else _way(path, folder)


def _way(path: Path, folder: Path) -> str:
    """The way from a folder to a file, with slashes; the whole path where there is none (another drive)."""
    try:
        return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()
    except ValueError:
        return path.absolute().as_posix()


def _told(recipe: Recipe, folder: Path) -> Changes:
    """A recipe's values as its file would say them, without those that it does not have."""
    told = _without_none(recipe.model_dump(mode="python"))
    for key in _FILE_KEYS:
        value = _at(told, key)
        if isinstance(value, str) and (value.endswith(".toml") or Path(value).parent != Path(".")):
            _put(told, key, _way(Path(value), folder))
    return told


def _without_none(table: Mapping[str, Any]) -> Changes:
    return {
        key: _without_none(value) if isinstance(value, Mapping) else value
        for key, value in table.items()
        if value is not None
    }


def _reachable(base: Mapping[str, Any], wanted: Mapping[str, Any]) -> bool:
    """Whether adding and replacing lead from one to the other; nothing can be taken away."""
    return all(
        key in wanted
        and (
            not isinstance(value, Mapping)
            or (isinstance(wanted[key], Mapping) and _reachable(value, wanted[key]))
        )
        for key, value in base.items()
    )


def _difference(base: Mapping[str, Any], wanted: Mapping[str, Any]) -> Changes:
    found: Changes = {}
    for key, value in wanted.items():
        below = base.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping):
            if inner := _difference(below, value):
                found[key] = inner
        elif key not in base or value != below:
            found[key] = value
    return found


def _at(tables: Mapping[str, Any], key: str) -> Any:
    value: Any = tables
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _put(tables: Changes, key: str, value: Any) -> None:
    *above, last = key.split(".")
    for part in above:
        tables = tables.setdefault(part, {})
    tables[last] = value

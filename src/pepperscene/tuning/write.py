"""The files of a fit: tuned recipe, which extends the original, cultivar and flash, record, and figure."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.atomic import (
    canonical_json,
    check_can_create,
    remove,
    visible_names,
    write_files,
)
from pepperscene.camera import Camera, Flash, colour_transform, load_flash
from pepperscene.cultivar import load_cultivar
from pepperscene.errors import OutputError
from pepperscene.recipe.recipe import FILE_FOLDERS, Recipe
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
from pepperscene.shipped import shipped_folder
from pepperscene.tuning.figure import BeforeAfter, before_after_png
from pepperscene.tuning.least_squares import FitResult
from pepperscene.tuning.part_files import changed_paths, cultivar_text, flash_changed, flash_files
from pepperscene.tuning.report import RunInfo, describe_colours, describe_values, fit_record, toml_text
from pepperscene.tuning.tuned import TunedParts
from pepperscene.units import NONE

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
RECORD: Final = "tuning.json"
PICTURE: Final = "before_after.png"


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
    # The file has a name for no white balance, so missing values are left out only afterwards.
    content = _without_none(recipe.model_dump(exclude={"expect"}))
    for *tables, last in FILE_FOLDERS:
        found: list[Any] = [content]
        for name in tables:
            # A table, or several of one name.
            below = [table.get(name, {}) for table in found]
            found = [table for one in below for table in ([one] if isinstance(one, dict) else one)]
        for table in found:
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


def write_tuned(
    recipe: Recipe,
    fit: FitResult,
    out: str | Path,
    run: RunInfo,
    *,
    extends: str | Path | None = None,
    frames: BeforeAfter | None = None,
    verification: Mapping[str, Any] | None = None,
) -> tuple[Path, ...]:
    """Write the files of a fit into a new or an empty folder: all of them, or none.

    `<recipe>_tuned.toml` extends the recipe. `<cultivar>_tuned.toml` is written if pigments changed (two, if
    the recipe mixes two growth stages), `<flash>_tuned.toml` with its spectrum if the flash changed.
    `tuning.json` records the result, and `before_after.png` shows it. Files in the folder refer to each other
    by name, so the folder can be moved; they refer to a user's other files by relative paths.

    Args:
        recipe: The recipe that was tuned.
        fit: The fit.
        out: The folder.
        run: Patches, date and options to record, by `RunInfo.of`.
        extends: Name or path of the file that the recipe was read from; differences from it are written. None
            writes the whole recipe.
        frames: The same frame of the whole scene before and after, or None.
        verification: Agreement in the whole scene, serialisable as JSON except for NaN, or None.

    Returns:
        The files, the recipe first.

    Raises:
        OutputError: The folder is not empty, or cannot be written to.
        InputError: A file that the recipe refers to is missing, or a tuned value is not valid in a file.
    """
    folder = Path(out)
    check_folder(folder)
    texts = _file_texts(recipe, fit, folder, extends, run)
    files = {name: text.encode() for name, text in texts.items()}
    files[PICTURE] = before_after_png(fit, recipe.name, frames)
    files[RECORD] = canonical_json(fit_record(fit, run, verification))
    return _write_and_load(folder, files)


def check_folder(folder: Path) -> None:
    """Raise an OutputError if a folder is not empty, or cannot be written to."""
    check_can_create(folder)
    try:
        names = visible_names(folder) if folder.exists() else []
    except OSError as error:
        raise OutputError(f"{folder}: cannot be used ({error.strerror})") from None
    if names:
        raise OutputError(f"{folder}: contains {names[0]!r}; choose an empty or a new folder")


def _file_texts(
    recipe: Recipe, fit: FitResult, folder: Path, extends: str | Path | None, run: RunInfo
) -> dict[str, str]:
    """The TOML and CSV files by name, the recipe first."""
    used = {Path(RECORD).stem, Path(PICTURE).stem}
    stem = _file_stem(f"{recipe.name}_tuned", "recipe", used)
    changes: dict[str, Any] = {}
    others: dict[str, str] = {}

    # Pigments. If two growth stages are mixed, both get the same path, so that the mix has it as well.
    pigments = changed_paths(load_recipe_cultivar(recipe), fit.tuned_parts.pigments)
    stages = {"cultivar": recipe.cultivar}
    if recipe.growth is not None:
        stages["growth.until"] = recipe.growth.until
    for key, name in stages.items() if pigments else ():
        file = f"{_file_stem(f'{Path(name).stem}_tuned', 'cultivar', used)}.toml"
        original = reference(name, "plants", folder)
        others[file] = cultivar_text(load_cultivar(name), original, pigments, fit, run)
        changes[key] = file

    # Light.
    camera = load_camera(recipe)
    flash, flash_name = camera.flash, recipe.camera.flash
    if flash_name != NONE and flash_changed(fit):
        flash_stem = _file_stem(f"{Path(flash_name).stem}_tuned", "flash", used)
        flash, texts = flash_files(flash_name, fit, run, flash_stem)
        others |= texts
        changes["camera.flash"] = f"{flash_stem}.toml"

    # Camera. It comes last, because its white balance depends on the light.
    changes |= camera_changes(camera, flash, fit.tuned_parts)
    return {f"{stem}.toml": recipe_text(recipe, extends, folder, changes, fit, run), **others}


def _file_stem(name: str, suffix: str, used: set[str]) -> str:
    """The name as a valid file name, with the suffix if it is in use in any case; adds it to `used`."""
    stem = re.sub(r"[^\w.-]+", "_", name).strip(".") or suffix
    while stem.lower() in used:
        stem = f"{stem}_{suffix}"
    used.add(stem.lower())
    return stem


def _write_and_load(folder: Path, files: Mapping[str, bytes]) -> tuple[Path, ...]:
    """Write all files or none, the recipe last; files that cannot be loaded are removed again."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    paths = write_files(folder, {name: files[name] for name in reversed(list(files))})[::-1]
    try:
        loaded = load_recipe(paths[0])
        load_recipe_cultivar(loaded)
        if loaded.camera.flash != NONE:
            load_flash(loaded.camera.flash)
    except BaseException:
        remove([*reversed(missing), *paths])
        raise
    return paths


def _without_none(values: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _without_none(value) if isinstance(value, dict) else value
        for key, value in values.items()
        if value is not None
    }

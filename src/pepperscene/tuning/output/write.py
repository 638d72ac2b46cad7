"""Write the files of a fit: tuned recipe, cultivar and flash, record, and figure."""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.atomic import (
    canonical_json,
    check_can_create,
    remove,
    visible_names,
    write_files,
)
from pepperscene.camera import load_flash
from pepperscene.cultivar import load_cultivar
from pepperscene.errors import OutputError
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
from pepperscene.recipe.tables import NONE
from pepperscene.tuning.output.figure import BeforeAfter, before_after_png
from pepperscene.tuning.output.parts import changed_paths, cultivar_text, flash_changed, flash_files
from pepperscene.tuning.output.provenance import RunInfo
from pepperscene.tuning.output.recipe import camera_changes, recipe_text, reference
from pepperscene.tuning.output.report import fit_record

if TYPE_CHECKING:
    from pepperscene.colour import PatchSet
    from pepperscene.tuning.fit.least_squares import FitResult

RECORD: Final = "tuning.json"
PICTURE: Final = "before_after.png"


def write_tuned(
    recipe: Recipe,
    fit: FitResult,
    out: str | Path,
    *,
    patches: PatchSet,
    when: datetime.date,
    extends: str | Path | None = None,
    options: Mapping[str, Any] | None = None,
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
        patches: The patches of the fit.
        when: Date to write.
        extends: Name or path of the file that the recipe was read from; differences from it are written. None
            writes the whole recipe.
        options: Options to record, serialisable as JSON.
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
    run = RunInfo.of(patches, when, options)
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

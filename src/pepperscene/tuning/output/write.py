"""What a fit leaves behind: a tuned recipe with its files, that loads like any other, a record, a picture."""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.camera import load_flash
from pepperscene.cultivar import load_cultivar
from pepperscene.dataset import Recipe, load_recipe
from pepperscene.dataset.recipe.resolved import load_camera, load_recipe_cultivar
from pepperscene.dataset.recipe.tables import NONE
from pepperscene.dataset.store.atomic import atomic_write, canonical_json, is_temporary
from pepperscene.dataset.store.folder import LITTER, check_can_create, make_folder, remove
from pepperscene.errors import OutputError
from pepperscene.tuning.output.cultivar import changed, cultivar_text
from pepperscene.tuning.output.figure import BeforeAfter, sheet
from pepperscene.tuning.output.flash import flash_files, is_tuned
from pepperscene.tuning.output.provenance import RunInfo, as_json
from pepperscene.tuning.output.recipe import camera_changes, recipe_text, reference

if TYPE_CHECKING:
    from pepperscene.colour import PatchSet
    from pepperscene.tuning.fit.result import FitResult


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
    """Write what a fit found into a new or an empty folder; all of it or nothing.

    The folder gets `<recipe>_tuned.toml`, which extends the recipe; `<cultivar>_tuned.toml` where pigments
    changed, and where a recipe mixes two growth stages one for each; `<flash>_tuned.toml` with its spectrum
    where the flash changed; `tuning.json` with all that was found; and the picture `before_after.png`. Files
    name each other as neighbours, so that the folder can be moved; a user's own files are found by the way to
    them from the folder.

    Args:
        recipe: that was tuned.
        fit: what was found.
        out: the folder.
        patches: to which it was tuned.
        when: the date to write down.
        extends: name or path of the file that the recipe was read from; what differs from it is written.
            None writes the whole recipe.
        options: what else was asked for, ready for JSON.
        frames: the same frame of the whole scene before and after, or None.
        verification: what the whole scene showed, ready for JSON but for NaN, or None.

    Returns:
        The files, the recipe first.

    Raises:
        OutputError: the folder holds something, or cannot be written to.
        InputError: a file that the recipe names is gone, or a tuned value is none that a file may say.
    """
    folder = Path(out)
    check_folder(folder)
    occasion = RunInfo.of(patches, when, options)
    texts = _texts(recipe, fit, folder, extends, occasion)
    files = {name: text.encode() for name, text in texts.items()}
    picture = BytesIO()
    sheet(fit, recipe.name, frames).save(picture, "PNG")
    files[PICTURE] = picture.getvalue()
    files[RECORD] = canonical_json(as_json(fit, occasion, verification))
    try:
        return _write(folder, files)
    except OSError as fault:
        where = fault.filename or folder
        raise OutputError(f"{where}: cannot be written ({fault.strerror or fault})") from None


def _texts(
    recipe: Recipe,
    fit: FitResult,
    folder: Path,
    extends: str | Path | None,
    occasion: RunInfo,
) -> dict[str, str]:
    """The TOML and CSV files by name, the recipe first."""
    names = _Names(f"{recipe.name}_tuned")
    changes: dict[str, Any] = {}
    others: dict[str, str] = {}

    # Pigments: where two stages are mixed both get the same path, whose mix is that path.
    pigments = changed(load_recipe_cultivar(recipe), fit.tuned.pigments)
    stages = {"cultivar": recipe.cultivar}
    if recipe.growth is not None:
        stages["growth.until"] = recipe.growth.until
    for key, wanted in stages.items() if pigments else ():
        stem = names.free(f"{Path(wanted).stem}_tuned", "cultivar")
        said = reference(wanted, "plants", folder)
        others[f"{stem}.toml"] = cultivar_text(load_cultivar(wanted), said, pigments, fit, occasion)
        changes[key] = f"{stem}.toml"

    # Light.
    camera = load_camera(recipe)
    flash = camera.flash
    if recipe.camera.flash != NONE and is_tuned(fit):
        stem = names.free(f"{Path(recipe.camera.flash).stem}_tuned", "flash")
        found = flash_files(recipe.camera.flash, fit, occasion, stem)
        flash = found.flash
        others |= found.texts
        changes["camera.flash"] = f"{stem}.toml"

    # Camera, behind the light that it is balanced to.
    changes |= camera_changes(camera, flash, fit.tuned)
    text = recipe_text(recipe, extends, folder, changes, fit, occasion)
    return {f"{names.recipe}.toml": text, **others}


class _Names:
    """File names without an ending, each given once whatever the case.

    Args:
        recipe: wanted for the recipe's file.
    """

    def __init__(self, recipe: str) -> None:
        self._taken = {Path(RECORD).stem, Path(PICTURE).stem}
        self.recipe = self.free(recipe, "recipe")

    def free(self, wanted: str, what: str) -> str:
        """The wanted name as files may have it, with `what` behind it where it is taken."""
        name = re.sub(r"[^\w.-]+", "_", wanted).strip(".") or what
        while name.lower() in self._taken:
            name = f"{name}_{what}"
        self._taken.add(name.lower())
        return name


def check_folder(folder: Path) -> None:
    """Raise the `OutputError` that tells why nothing can be written there, if there is a reason."""
    check_can_create(folder)
    try:
        held = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    except OSError as fault:
        raise OutputError(f"{folder}: cannot be used ({fault.strerror})") from None
    held = [name for name in held if name not in LITTER and not is_temporary(folder / name)]
    if held:
        raise OutputError(f"{folder}: holds {held[0]!r}; choose an empty or a new folder")


def _write(folder: Path, files: Mapping[str, bytes]) -> tuple[Path, ...]:
    """Write all files under other names, and only when all are whole let them take their places."""
    made: list[Path] = []
    paths = [folder / name for name in files]
    try:
        make_folder(folder, made)
        with ExitStack() as stack:
            # The stack unwinds from its end: the recipe comes last, and stands beside whole files only.
            for path in paths:
                stack.enter_context(atomic_write(path)).write_bytes(files[path.name])
            made += paths
        # What cannot be loaded is not left there.
        loaded = load_recipe(paths[0])
        load_recipe_cultivar(loaded)
        if loaded.camera.flash != NONE:
            load_flash(loaded.camera.flash)
    except BaseException:
        remove(made)
        raise
    return tuple(paths)

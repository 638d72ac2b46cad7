"""Opening the image or patch sets that are compared, with the options of the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pepperscene.colour.patches.extraction import reflectance_file
from pepperscene.colour.patches.open import open_patches
from pepperscene.colour.patches.patch import PatchSet
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.several import half_targets, label_targets
from pepperscene.errors import ArgumentError, InputError


def open_set(path: str | Path, *, labels: Any = None, half: str | None = None) -> ImageSet | PatchSet:
    """Open a folder as an image set; a file, or the name of shipped reflectances, as patches.

    Raises:
        InputError: it is neither, or an argument does not apply to it.
    """
    if Path(path).is_dir():
        return open_images(path, labels=labels, half=half)
    if not Path(path).exists():
        try:
            reflectance_file(path)
        except InputError:
            allowed = "must be a folder of images, or a file of patches or of measured reflectances"
            raise InputError(path, allowed) from None
    for name, value in (("labels", labels), ("half", half)):
        if value is not None:
            raise InputError(path, "applies only to a folder of images", key=name)
    return open_patches(path)


def open_two_sets(
    first: str | Path, second: str | Path, labels: str | None, half: str | None
) -> tuple[ImageSet | PatchSet, ImageSet | PatchSet]:
    """Open both sets, with the options of the command line.

    Args:
        first: path of the first set.
        second: path of the second set.
        labels: meaning of the masks: one name for each folder of images without a `classes.toml` (if both
            have one, for both, overriding it), or two names for first and second, separated by a comma.
        half: of the published data set: one name for each set that is the published one, or two likewise.

    Raises:
        InputError: see `open_set`; or an option applies to neither set.
    """
    paths = (Path(first), Path(second))
    all_labels = _split_option("labels", labels, label_targets(paths), "a folder of images with masks")
    all_halves = _split_option("half", half, half_targets(paths), "the published data set")
    return (
        open_set(paths[0], labels=all_labels[0], half=all_halves[0]),
        open_set(paths[1], labels=all_labels[1], half=all_halves[1]),
    )


def _split_option(
    option: str, value: str | None, targets: list[bool], what: str
) -> tuple[str | None, str | None]:
    """Value of an option for each set: one name for all sets that it applies to, or one name for each."""
    if value is None:
        return None, None
    first, comma, second = (part.strip() or None for part in value.partition(","))
    if comma:
        return first, second
    if not any(targets):
        raise ArgumentError(option, f"applies only to {what}; neither set is one")
    return (first if targets[0] else None), (first if targets[1] else None)

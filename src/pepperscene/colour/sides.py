"""The two sides of a comparison: opening them, and going through them picture by picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from pepperscene.colour.measuring import Measured
from pepperscene.colour.opening import open_patches
from pepperscene.colour.patch import PatchSet
from pepperscene.colour.reflectances import reflectance_file
from pepperscene.colour.stages import regions
from pepperscene.dataset import ImageSet
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.labels import LABEL_FILE
from pepperscene.dataset.readers.published import halves_in
from pepperscene.dataset.report.gathering import ahead, spread
from pepperscene.dataset.store import MARK
from pepperscene.errors import InputError

Told = Callable[[int, int], None]
"""Called with how many pictures are measured, and out of how many."""

MOST: Final = 1000
"""Chosen: a mean over 1,000 pictures is known to 3 % of the spread between them."""


def open_side(path: str | Path, *, labels: Any = None, half: str | None = None) -> ImageSet | PatchSet:
    """A folder as a set of images; a file, or the name of shipped reflectances, as patches.

    Raises:
        InputError: it is neither, or an argument does not go with it.
    """
    if Path(path).is_dir():
        return open_images(path, labels=labels, half=half)
    if not Path(path).exists():
        try:
            reflectance_file(path)
        except InputError:
            allowed = "must be a folder of images, or a file of patches or of measured reflectances"
            raise InputError(path, "", None, allowed) from None
    for name, value in (("labels", labels), ("half", half)):
        if value is not None:
            raise InputError(path, name, None, "goes only with a folder of images")
    return open_patches(path)


def open_sides(
    one: str | Path, other: str | Path, labels: str | None, half: str | None
) -> tuple[ImageSet | PatchSet, ImageSet | PatchSet]:
    """Both sides, with what the command line says of them.

    Args:
        one: the first side's path.
        other: the second side's.
        labels: what masks mean; one name for every side that is a folder of images without a `classes.toml`
            (if all have one, instead of it), or two with a comma between, for one and other.
        half: of the published data set; one name for every side that is one, or two likewise.

    Raises:
        InputError: see `open_side`; or an option goes with neither side.
    """
    paths = (Path(one), Path(other))
    halves = [len(halves_in(path)) if path.is_dir() else 0 for path in paths]
    published = [count > 0 for count in halves]
    plain = [
        path.is_dir() and not found and not (path / MARK).exists()
        for path, found in zip(paths, published, strict=True)
    ]
    # A folder that explains its own masks keeps that, as long as the other one needs what is told.
    silent = [found and not (path / LABEL_FILE).exists() for path, found in zip(paths, plain, strict=True)]
    all_labels = _each("--labels", labels, silent if any(silent) else plain, "a folder of images with masks")
    both = [count > 1 for count in halves]
    all_halves = _each("--half", half, both if any(both) else published, "the published data set")
    first, second = (
        open_side(path, labels=labels_told, half=half_told)
        for path, labels_told, half_told in zip(paths, all_labels, all_halves, strict=True)
    )
    return first, second


def measured(side: ImageSet | PatchSet, limit: int | None, told: Told | None = None) -> Measured:
    """The sums of one side, of at most `limit` of its pictures, evenly over the set.

    Raises:
        InputError: a file is damaged, or nothing is there to measure.
    """
    if isinstance(side, PatchSet):
        return _of_patches(side, limit)
    sums = Measured(side.name, len(side), pictured=True)
    places = spread(len(side), len(side) if limit is None else limit)
    images = side.select("colour", "classes", "instances", "facts")
    for picture in ahead(images, places):
        staged = {} if picture.colour is None else {k: m for k, m in regions(images, picture) if "." in k}
        sums.add_picture(picture.colour, picture.classes, staged)
        if told is not None:
            told(sums.units, len(places))
    return sums


def _of_patches(patches: PatchSet, limit: int | None) -> Measured:
    """Patches count by the picture they are from, spectra one by one."""
    if not patches.patches and not patches.spectra:
        raise InputError(patches.name, "", None, "holds no patches")
    pictures = patches.pictures
    sums = Measured(patches.name, len(pictures) + len(patches.spectra), pictured=False)
    for place in spread(len(pictures), len(pictures) if limit is None else limit):
        sums.add_patches(patch for patch in patches.patches if patch.picture == pictures[place])
    for spectrum in patches.spectra:
        sums.add_spectrum(spectrum)
    return sums


def _each(option: str, told: str | None, concerned: list[bool], what: str) -> tuple[str | None, str | None]:
    """An option's value for each side: one for all that it concerns, or one for each by its place."""
    if told is None:
        return None, None
    first, comma, second = (part.strip() or None for part in told.partition(","))
    if comma:
        return first, second
    if not any(concerned):
        raise InputError(option, "", None, f"goes only with {what}, and neither side is one")
    return (first if concerned[0] else None), (first if concerned[1] else None)

"""Opening several image sets, with options that apply to some of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pepperscene.dataset.readers.coco import coco_files
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.labels import LABEL_FILE
from pepperscene.dataset.readers.open import open_images
from pepperscene.dataset.readers.published import published_halves
from pepperscene.dataset.store.dataset import MARK
from pepperscene.errors import ArgumentError, InputError


def open_image_sets(
    paths: Sequence[str | Path], *, labels: str | None = None, half: str | None = None
) -> tuple[ImageSet, ...]:
    """Open one or more image sets in any layout.

    Args:
        paths: as for `open_images`.
        labels: name of a table of labels, for each folder of images with masks that has no `classes.toml`;
            if all have one, for all, overriding it.
        half: of the published data set, for each path that holds both; if none does, for each that holds one.

    Raises:
        InputError: see `open_images`; or an option applies to none of the sets.
    """
    places = [Path(path) for path in paths]
    for place in places:
        if not place.exists():
            raise InputError(place, "must be a folder of images")
    tables, halves = label_targets(places), half_targets(places)
    if labels is not None and not any(tables):
        raise ArgumentError("labels", "applies only to a folder of images with masks; no set is one")
    if half is not None and not any(halves):
        raise ArgumentError("half", "applies only to the published data set; no set is one")
    return tuple(
        open_images(path, labels=labels if table else None, half=half if is_published else None)
        for path, table, is_published in zip(places, tables, halves, strict=True)
    )


def label_targets(paths: Sequence[Path]) -> list[bool]:
    """Which of these paths one table of labels applies to.

    Folders of images without a `classes.toml`, or all folders of images if each has one.
    """
    folders = [_is_plain_folder(path) for path in paths]
    without = [plain and not (path / LABEL_FILE).exists() for path, plain in zip(paths, folders, strict=True)]
    return without if any(without) else folders


def half_targets(paths: Sequence[Path]) -> list[bool]:
    """Which of these paths the name of one half of the published data set applies to.

    Those that hold both halves, or those that hold one if none holds both.
    """
    counts = [len(published_halves(path)) for path in paths]
    both = [count > 1 for count in counts]
    return both if any(both) else [count > 0 for count in counts]


def _is_plain_folder(path: Path) -> bool:
    """Whether a path is a folder of images with masks, in no other layout."""
    is_other = (path / MARK).exists() or bool(published_halves(path)) or bool(coco_files(path))
    return path.is_dir() and not is_other

"""Opening a set of labelled pictures, whatever its layout."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pepperscene.dataset.labelled import ImageSet
from pepperscene.dataset.readers.folder import FolderSet
from pepperscene.dataset.readers.labels import Labels
from pepperscene.dataset.readers.published import PublishedSet, halves_in
from pepperscene.dataset.readers.rendered import RenderedSet
from pepperscene.dataset.store import MARK, open_dataset
from pepperscene.errors import InputError


def open_images(
    path: str | Path, *, half: str | None = None, labels: str | Labels | Mapping[Any, Any] | None = None
) -> ImageSet:
    """The pictures of a folder with their labels; nothing is read before a picture is asked for.

    Args:
        path: a data set of this package, the published data set or an export to its layout, or any folder of
            images with masks.
        half: "synthetic" or "empirical" of the published data set, where both are there.
        labels: what the masks of a folder mean: a name ("published", "montoya2021"), or a table from mask
            values or colours to classes; None reads the folder's `classes.toml`. See `labels_of`.

    Raises:
        InputError: the folder is missing, holds no images, or an argument does not go with its layout.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise InputError(folder, "", None, "must be a folder of images")
    rendered, published = (folder / MARK).exists(), bool(halves_in(folder))
    if half is not None and not published:
        raise InputError(folder, "half", half, "goes only with the layout of the published data set")
    if labels is not None and (rendered or published):
        raise InputError(folder, "labels", None, "go only with a folder of images: these classes are known")
    if rendered:
        return RenderedSet.of(open_dataset(folder))
    return PublishedSet.of(folder, half) if published else FolderSet.of(folder, labels)

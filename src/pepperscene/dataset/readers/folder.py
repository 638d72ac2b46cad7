"""Reading any folder of images with masks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.labelled import VOID, ImageSet, Labelled
from pepperscene.dataset.readers.labels import (
    KNOWN_LABELS,
    LABEL_FILE,
    PALETTE,
    Labels,
    labels_in,
    labels_of,
)
from pepperscene.dataset.readers.pairing import Pair, pairs
from pepperscene.dataset.readers.pictures import MaskPicture, photo_shape, read_mask, read_photo
from pepperscene.errors import InputError


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class FolderSet(ImageSet):
    """Images of a folder, with masks where there are any.

    Attributes:
        folder: where they lie.
        items: images and masks, paired by name.
        labels: what the masks mean; None when nobody says, so that only the published colours are understood.
    """

    folder: Path
    items: tuple[Pair, ...]
    labels: Labels | None = None

    @classmethod
    def of(cls, folder: Path, labels: str | Labels | Mapping[Any, Any] | None = None) -> Self:
        """The images of a folder.

        Args:
            folder: holds images and masks side by side, or in folders such as `images` and `masks`.
            labels: what the masks mean: a name out of `KNOWN_LABELS`, or a table as `labels_of` takes it;
                None reads the folder's `classes.toml`.

        Raises:
            InputError: there are no images, or they cannot be paired with the masks; the table is not valid.
        """
        return cls(
            name=folder.resolve().name, folder=folder, items=pairs(folder), labels=_told(labels, folder)
        )

    def names(self) -> tuple[str, ...]:
        """The image files' names below their folder, without suffix."""
        return tuple(pair.name for pair in self.items)

    def read(self, item: Pair) -> Labelled:
        """One image; its classes are None when it has no mask.

        Raises:
            InputError: a file is damaged, the mask has another size, or a value of it has no meaning.
        """
        colour = read_photo(item.image) if "colour" in self.fields else None
        classes = self._classes(item) if "classes" in self.fields else None
        files = {"image": str(item.image), "mask": None if item.mask is None else str(item.mask)}
        return Labelled(item.name, colour, classes, facts=files if "facts" in self.fields else {})

    def _classes(self, pair: Pair) -> NDArray[np.uint8] | None:
        if pair.mask is None:
            return None
        mask = read_mask(pair.mask)
        if mask.shape != (shape := photo_shape(pair.image)):
            raise InputError(
                pair.mask,
                "",
                None,
                f"is {_size(mask.shape)} pixels large, but its image {pair.image.name} {_size(shape)};"
                " labels are never resized",
            )
        ids = _meant(mask, self.labels, pair.mask)
        return ids if mask.seen is None else np.where(mask.seen, ids, np.uint8(VOID))


def _told(labels: str | Labels | Mapping[Any, Any] | None, folder: Path) -> Labels | None:
    if labels is None:
        return labels_in(folder)
    if isinstance(labels, Labels):
        return labels
    if isinstance(labels, Mapping):
        return labels_of(labels, "labels")
    if labels not in KNOWN_LABELS:
        raise InputError(
            "labels", "", None, f"must be a table or one of {', '.join(KNOWN_LABELS)}, not {labels!r}"
        )
    return KNOWN_LABELS[labels]


def _meant(mask: MaskPicture, labels: Labels | None, where: Path) -> NDArray[np.uint8]:
    """Class ids of a mask: by its values where the table knows them all, by its colours otherwise."""
    if labels is None:
        return _by_palette(mask, where)
    values = None if mask.values is None else _shown(mask.values, mask, next(iter(labels.values), 0))
    by_colour = mask.rgb is not None and bool(labels.colours)
    if values is not None and labels.values and (not by_colour or labels.knows(values)):
        return labels.of_values(values, where)
    if mask.rgb is not None and labels.colours:
        return labels.of_colours(_shown(mask.rgb, mask, next(iter(labels.colours))), where)
    kind = "colours" if mask.values is None else "values"
    raise InputError(where, "", None, f"has {kind}, but {labels.where} tells nothing of {kind}")


def _by_palette(mask: MaskPicture, where: Path) -> NDArray[np.uint8]:
    """Class ids by the published colours.

    Grey says nothing by itself: the same 1 is a leaf to one author and a green fruit to the next, and white
    is the one class of a binary mask, whichever that is. An image all in black is all background.
    """
    if mask.rgb is not None and not (mask.grey and mask.rgb.any()):
        return PALETTE.of_colours(_shown(mask.rgb, mask, (0, 0, 0)), where)
    found = "" if mask.values is None else ", ".join(str(value) for value in np.unique(mask.values)[:8])
    raise InputError(
        where,
        "",
        None,
        f"has values ({found}) whose classes nobody tells: put a {LABEL_FILE} into the folder,"
        f" or pass labels= (a table, or one of {', '.join(KNOWN_LABELS)})",
    )


def _shown(pixels: NDArray[Any], mask: MaskPicture, known: Any) -> NDArray[Any]:
    """Pixels, where transparent ones, which become void in any case, have a value that is known."""
    if mask.seen is None:
        return pixels
    seen = mask.seen if pixels.ndim == 2 else mask.seen[..., None]
    return np.where(seen, pixels, np.asarray(known, pixels.dtype))


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]}x{shape[0]}"

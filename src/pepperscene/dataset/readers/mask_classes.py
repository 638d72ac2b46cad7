"""Semantic targets by a choice of classes, as the export `semantic` writes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.class_masks import class_mask, mask_selection, numbers_by_class
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.open import RenderedSet
from pepperscene.dataset.selection import RIPE_FROM, Selection, parse_categories
from pepperscene.dataset.store.crop import fruit_name
from pepperscene.errors import ArgumentError, InputError


@dataclass(frozen=True, eq=False)
class MaskClasses:
    """The classes of masks, in the order of their values."""

    selection: Selection  # from `mask_selection`

    @classmethod
    def parse(cls, images: ImageSet, classes: str | None, ripe_from: float | None) -> MaskClasses:
        """Read a mapping of classes for a set of images.

        Args:
            images: a set; only data sets of this package know the ripeness of fruit.
            classes: as `--classes` of `pepperscene export --format semantic`; see `parse_categories`.
                None for all organ classes.
            ripe_from: least ripeness of ripe fruit, as of `export_dataset`.

        Raises:
            ArgumentError: the mapping or the ripeness is not valid, or the set knows no ripeness.
        """
        if ripe_from is not None and not 0 <= ripe_from <= 1:
            raise ArgumentError("ripe_from", f"{ripe_from:g} must be 0 to 1")
        is_rendered = isinstance(images, RenderedSet)
        crop = fruit_name(images.dataset.info) if isinstance(images, RenderedSet) else "pepper"
        categories = parse_categories(classes, ripe_from, crop, background=True)
        chosen = Selection(categories, ripe_from=RIPE_FROM if ripe_from is None else ripe_from)
        if chosen.is_divided and not is_rendered:
            problem = f"{images.name} does not know the ripeness of fruit, only data sets of this package do"
            raise ArgumentError("classes", problem)
        return cls(mask_selection(chosen))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the classes, by mask value."""
        return tuple(category.name for category in self.selection.categories)

    def mask(self, images: ImageSet, position: int, class_ids: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """`(h, w)` the class values of an image, 255 for pixels to ignore.

        Args:
            images: the set.
            position: of the image in the set.
            class_ids: `(h, w)` its class image.

        Raises:
            InputError: a frame lacks an output that its ripe and unripe fruit need.
        """
        if not self.selection.is_divided:
            return numbers_by_class(self.selection)[class_ids]
        return class_mask(_frame_with_ripeness(images, images.items[position]), self.selection)


def _frame_with_ripeness(images: Any, index: int) -> DatasetFrame:
    frame = DatasetFrame(images.dataset, index)
    for output in ("instance", "harvest"):
        if output not in frame.metadata["outputs"]:
            problem = f"has no output {output!r}, which ripe and unripe fruit need"
            raise InputError(images.dataset.frame_path(index), problem)
    return frame

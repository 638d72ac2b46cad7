"""Class masks: a number for each pixel, by a choice of classes that are merged and renamed.

255 marks pixels to ignore, as in Cityscapes and PASCAL VOC.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.selection import FRUIT, Category, Selection

BACKGROUND: Final = int(OrganClass.BACKGROUND)


def mask_selection(selection: Selection) -> Selection:
    """The selection whose categories are all classes of masks, in the order of their numbers.

    If no category contains the background, class 0 is the background with all organs that are not selected,
    and the categories follow; otherwise the classes are the categories, and other organs are ignored.
    """
    selected = frozenset[int]().union(*(category.parts for category in selection.categories))
    if BACKGROUND in selected:
        return selection
    rest = frozenset({*map(int, OrganClass), *FRUIT}) - selected
    return replace(selection, categories=(Category("background", rest), *selection.categories))


def numbers_by_class(selection: Selection) -> NDArray[np.uint8]:
    """`(256,)` the number of each class id of a class image, or `IGNORE_CLASS`.

    Args:
        selection: from `mask_selection`, whose categories do not depend on organs.
    """
    numbers = np.full(256, IGNORE_CLASS, np.uint8)
    numbers[: len(OrganClass)] = [_number(selection, selection.category(organ)) for organ in OrganClass]
    return numbers


def class_mask(frame: DatasetFrame, selection: Selection) -> NDArray[np.uint8]:
    """`(h, w)` the number of each pixel's class, or `IGNORE_CLASS`.

    Organs that are not separate objects, and fruit of unknown ripeness, are ignored where the categories
    depend on them.

    Args:
        frame: with the outputs that the selection needs.
        selection: from `mask_selection`.
    """
    if not selection.needs_organs:
        return numbers_by_class(selection)[frame.image("class")]
    instance: NDArray[np.uint16] = frame.image("instance")
    fruit, objects = frame.fruit_for(selection), frame.objects(selection, instance)
    by_instance = np.full(1 << 16, IGNORE_CLASS, np.uint8)
    by_instance[0] = _number(selection, selection.category(OrganClass.BACKGROUND))
    for key, entry in frame.metadata["instances"].items():
        value = int(key)
        if entry["class"] == IGNORE_CLASS:
            continue
        category = selection.category(OrganClass(entry["class"]), fruit.get(value))
        # The background has no objects, so nothing of it is ignored.
        is_background = category is not None and BACKGROUND in category.parts
        if value in objects or entry["plant"] < 0 or is_background:
            by_instance[value] = _number(selection, category)
    return by_instance[instance]


def _number(selection: Selection, category: Category | None) -> int:
    """The mask value of a class."""
    return IGNORE_CLASS if category is None else selection.categories.index(category)

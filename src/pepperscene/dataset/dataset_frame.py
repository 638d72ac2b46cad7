"""One frame of a data set: its JSON, checked outputs, objects, segments and class mask."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.dataset.selection import FRUIT, Category, Selection
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.fields import read_frame, read_output
from pepperscene.errors import InputError
from pepperscene.outputs import OUTPUTS
from pepperscene.user_files import read_file

REST: Final = 1 << 16
"""Segment id of the rest of class 0; instances are 16-bit numbers."""

IGNORED: Final = REST + IGNORE_CLASS
"""Segment id of all pixels of a frame that are ignored."""


@dataclass(frozen=True, eq=False)
class DatasetFrame:
    """One frame of a data set."""

    dataset: Dataset
    index: int

    @cached_property
    def metadata(self) -> dict[str, Any]:
        """The content of its JSON, of valid types."""
        return read_frame(self.dataset, self.index)

    @property
    def name(self) -> str:
        """Name of its files without suffix."""
        return self.dataset.frame_path(self.index).stem

    def content(self, output: str) -> bytes:
        """The bytes of an output's file, checked against its checksum."""
        path = self.dataset.path(self.index, output)
        content = read_file(path, OUTPUTS[output].file_kind, within=self.dataset.folder)
        if hashlib.sha256(content).hexdigest() != self.metadata["outputs"].get(output, {}).get("sha256"):
            problem = "is not what the build wrote; run the same build command again to repair it"
            raise InputError(path, problem)
        return content

    def image(self, output: str) -> Any:
        """An output as `Frame` holds it, checked against its checksum."""
        self.content(output)
        return read_output(self.dataset, self.index, output)

    @cached_property
    def fruit(self) -> dict[int, dict[str, Any]]:
        """The entries of its harvest truth by instance; empty without that output."""
        return self._entries("harvest", "fruit")

    @cached_property
    def whole_organs(self) -> dict[int, dict[str, Any]]:
        """The entries of its output `amodal` by instance; empty without that output."""
        return self._entries("amodal", "organs")

    def _entries(self, output: str, key: str) -> dict[int, dict[str, Any]]:
        entries = self.image(output)[key] if output in self.metadata["outputs"] else ()
        return {entry["instance"]: entry for entry in entries}

    def fruit_for(self, selection: Selection) -> dict[int, dict[str, Any]]:
        """`fruit` if the objects of a selection depend on it, else nothing: the harvest truth is not read."""
        return self.fruit if selection.needs_harvest or not selection.keep_truncated else {}

    def objects(self, selection: Selection, instance: NDArray[np.uint16]) -> set[int]:
        """The values of the instance image that are separate objects of a selection."""
        fruit = self.fruit_for(selection)
        at_border = set[int]() if selection.keep_truncated else self._organs_at_border(instance)
        entries = {int(value): entry for value, entry in self.metadata["instances"].items()}
        return {
            value
            for value, entry in entries.items()
            if entry["class"] not in (OrganClass.BACKGROUND, IGNORE_CLASS)
            and selection.is_object(entry, fruit.get(value), value in at_border)
        }

    def _organs_at_border(self, instance: NDArray[np.uint16]) -> set[int]:
        """The organs that the image border may cut: with their hidden parts if these are known."""
        border = (instance[0], instance[-1], instance[:, 0], instance[:, -1])
        visible = set(np.unique(np.concatenate(border)).tolist())
        return visible | {value for value, entry in self.whole_organs.items() if entry["truncated"]}

    def segment_ids(self, selection: Selection) -> NDArray[np.uint32]:
        """Segment of every pixel, `(h, w)`, above 0.

        An organ of a plant that is an object of the selection is one segment, whose id is its value in the
        instance image. The rest of each class is the segment `REST` + class: what has an organ's class but
        belongs to no plant (a wire of the whole row), and organs that are not separate objects. The rests of
        classes with the same categories are one segment, with the first of these classes. Organs that are not
        selected are part of the background. Ignored pixels are the segment `IGNORED`.
        """
        fruit, instance = self.fruit_for(selection), self.image("instance")
        objects = self.objects(selection, instance)
        table = np.zeros(REST, dtype=np.uint32)
        table[0] = REST
        for key, entry in self.metadata["instances"].items():
            value, class_id = int(key), entry["class"]
            if value in objects:
                table[value] = value
            elif class_id == IGNORE_CLASS:
                table[value] = IGNORED
            elif selection.possible(OrganClass(class_id), fruit.get(value)):
                table[value] = REST + selection.rest_class[class_id]
            else:
                table[value] = REST
        ids = np.take(table, instance)
        if not ids.all():
            unknown = int(instance[ids == 0][0])
            problem = f"instance {unknown} is not in the frame's JSON"
            raise InputError(self.dataset.path(self.index, "instance"), problem, value=unknown)
        return ids


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

    The selection is from `mask_selection`; its categories do not depend on organs.
    """
    numbers = np.full(256, IGNORE_CLASS, np.uint8)
    numbers[: len(OrganClass)] = [_number(selection, selection.category(organ)) for organ in OrganClass]
    return numbers


def class_mask(frame: DatasetFrame, selection: Selection) -> NDArray[np.uint8]:
    """`(h, w)` the number of each pixel's class in a selection from `mask_selection`, or `IGNORE_CLASS`.

    Organs that are not separate objects, and fruit of unknown ripeness, are ignored where the categories
    depend on them.
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

"""Reading a data set of this package."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Self, final

from numpy.typing import NDArray

from pepperscene.dataset.labelled import ImageSet, Labelled
from pepperscene.dataset.store import DIGITS, Dataset
from pepperscene.errors import InputError
from pepperscene.truth import class_from_colour, distance_from_code

_SOURCES: Final[Mapping[str, tuple[tuple[str, Any], ...]]] = {
    "colour": (("colour", None),),
    "classes": (("class", None), ("class_colour", class_from_colour)),
    "instances": (("instance", None),),
    "distance_m": (("distance", None), ("distance_code", distance_from_code)),
}
"""Outputs that a field can be read from, the best first, and how to decode them."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class RenderedSet(ImageSet):
    """The frames of a data set; their JSON are the facts, with the harvest under the key `harvest`.

    Attributes:
        dataset: the data set.
        items: indices of the frames.
    """

    dataset: Dataset
    items: tuple[int, ...]

    @classmethod
    def of(cls, dataset: Dataset, indices: Iterable[int] | None = None) -> Self:
        """The frames of a data set that are there, or some of them.

        Raises:
            InputError: there is none.
        """
        items = dataset.indices() if indices is None else tuple(indices)
        if not items:
            raise InputError(dataset.folder, "", None, "holds no frames")
        return cls(name=dataset.folder.resolve().name, dataset=dataset, items=items)

    def names(self) -> tuple[str, ...]:
        """The indices with six digits, as the files are called."""
        return tuple(_name(index) for index in self.items)

    def read(self, item: int) -> Labelled:
        """One frame; a field whose output the frame lacks is None.

        Raises:
            InputError: there is no such frame, or a file of it is missing or damaged.
        """
        facts = self.dataset.facts(item)
        there = facts.get("outputs", {})
        images = {name: self._image(item, name, there) for name in _SOURCES}
        if "facts" not in self.fields:
            facts = {}
        elif "harvest" in there:
            facts["harvest"] = self.dataset.image(item, "harvest")
        return Labelled(_name(item), facts=facts, **images)

    def _image(self, index: int, name: str, there: Mapping[str, Any]) -> NDArray[Any] | None:
        if name not in self.fields:
            return None
        for output, decode in _SOURCES[name]:
            if output in there:
                image = self.dataset.image(index, output)
                return image if decode is None else decode(image)
        return None


def _name(index: int) -> str:
    return f"{index:0{DIGITS}d}"

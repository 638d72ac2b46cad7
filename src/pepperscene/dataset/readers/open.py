"""Reading a data set of this package."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, final

from numpy.typing import NDArray

from pepperscene.dataset.readers.folder import FolderSet
from pepperscene.dataset.readers.image_set import ImageSet, LabelledImage
from pepperscene.dataset.readers.labels import LabelMap
from pepperscene.dataset.readers.published import PublishedSet, published_halves
from pepperscene.dataset.store.dataset import DIGITS, MARK, Dataset, open_dataset
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
            raise InputError(dataset.folder, "holds no frames")
        return cls(name=dataset.folder.resolve().name, dataset=dataset, items=items)

    def names(self) -> tuple[str, ...]:
        """The indices with six digits, as the files are called."""
        return tuple(_name(index) for index in self.items)

    def read(self, item: int) -> LabelledImage:
        """One frame; a field whose output the frame lacks is None.

        Raises:
            InputError: there is no such frame, or a file of it is missing or damaged.
        """
        facts = self.dataset.metadata(item)
        there = facts.get("outputs", {})
        images = {name: self._image(item, name, there) for name in _SOURCES}
        if "facts" not in self.fields:
            facts = {}
        elif "harvest" in there:
            facts["harvest"] = self.dataset.image(item, "harvest")
        return LabelledImage(_name(item), facts=facts, **images)

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


def open_images(
    path: str | Path, *, half: str | None = None, labels: str | LabelMap | Mapping[Any, Any] | None = None
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
        raise InputError(folder, "must be a folder of images")
    rendered, published = (folder / MARK).exists(), bool(published_halves(folder))
    if half is not None and not published:
        raise InputError(
            folder, "goes only with the layout of the published data set", key="half", value=half
        )
    if labels is not None and (rendered or published):
        raise InputError(folder, "go only with a folder of images: these classes are known", key="labels")
    if rendered:
        return RenderedSet.of(open_dataset(folder))
    return PublishedSet.of(folder, half) if published else FolderSet.of(folder, labels)

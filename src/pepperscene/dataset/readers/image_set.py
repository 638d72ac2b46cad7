"""Pictures with their labels in memory, wherever they come from: rendered, published, a folder of masks."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Self, overload

import numpy as np
from numpy.typing import NDArray

VOID: Final = 255
"""Class id of a pixel of which nobody says what it shows: neither background nor anything else.

The value that Cityscapes and PASCAL VOC write for it; losses and measures leave it out (`ignore_index=255`).
"""

FIELDS: Final = ("colour", "classes", "instances", "distance_m", "facts")
"""What a reader can be told to read, or to leave on the disk."""


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """One picture with what is known of it; None stands for what is not known, or was not read.

    Attributes:
        name: unique within its set; names sort naturally.
        colour: `(h, w, 3)` uint8, sRGB.
        classes: `(h, w)` uint8, ids of `OrganClass`, or `VOID`.
        instances: `(h, w)` uint16, 0 where there is none.
        distance_m: `(h, w)` float32, metres along the ray from the projection centre, inf for none.
        facts: whatever else its set tells: the JSON of a rendered frame, the files of a found one.
    """

    name: str
    colour: NDArray[np.uint8] | None
    classes: NDArray[np.uint8] | None
    instances: NDArray[np.uint16] | None = None
    distance_m: NDArray[np.float32] | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        sizes = {image.shape[:2] for image in self._images() if image is not None}
        if len(sizes) > 1:
            raise ValueError(f"{self.name}: its images differ in size, {sorted(sizes)}")

    def _images(self) -> tuple[NDArray[Any] | None, ...]:
        return self.colour, self.classes, self.instances, self.distance_m

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels.

        Raises:
            ValueError: no image was read.
        """
        for image in self._images():
            if image is not None:
                return int(image.shape[0]), int(image.shape[1])
        raise ValueError(f"{self.name} holds no image")


@dataclass(frozen=True, eq=False, kw_only=True)
class ImageSet(Sequence[LabelledImage]):
    """Labelled pictures in the natural order of their names; each is read when it is asked for.

    `images[3]` reads a picture, `images[3:9]` is a smaller set of which nothing is read yet.

    Attributes:
        name: of the set, for people.
        items: what each picture is read from, in order.
        fields: what is read of it, out of `FIELDS`; the rest stays None.
    """

    name: str
    items: tuple[Any, ...]
    fields: tuple[str, ...] = FIELDS

    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """The pictures' names, in order; nothing is read."""

    @abstractmethod
    def read(self, item: Any) -> LabelledImage:
        """The picture of one of `items`.

        Raises:
            InputError: a file is missing, damaged, or does not fit to its picture.
        """

    def select(self, *fields: str) -> Self:
        """The same pictures, of which only these fields are read.

        Raises:
            ValueError: a name is none of `FIELDS`.
        """
        unknown = sorted(set(fields) - set(FIELDS))
        if unknown:
            raise ValueError(f"unknown fields {', '.join(unknown)}; allowed are {', '.join(FIELDS)}")
        return replace(self, fields=tuple(name for name in FIELDS if name in fields))

    def take(self, places: Sequence[int]) -> Self:
        """The pictures at these places, in this order."""
        return replace(self, items=tuple(self.items[place] for place in places))

    def __len__(self) -> int:
        return len(self.items)

    @overload
    def __getitem__(self, place: int) -> LabelledImage: ...

    @overload
    def __getitem__(self, place: slice) -> Self: ...

    def __getitem__(self, place: int | slice) -> LabelledImage | Self:
        if isinstance(place, slice):
            return replace(self, items=self.items[place])
        return self.read(self.items[place])

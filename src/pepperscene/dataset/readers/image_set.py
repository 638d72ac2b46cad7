"""Labelled images in memory, whether rendered, published or from a folder of images with masks."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self, overload

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS
from pepperscene.errors import InputError
from pepperscene.outputs import OUTPUTS

VOID: Final = IGNORE_CLASS
"""Class id of unlabelled pixels, as in Cityscapes and PASCAL VOC; losses and metrics ignore it
(`ignore_index=255`). It is not the background."""

SOURCES: Final = {
    field: tuple(name for name, output in OUTPUTS.items() if output.field == field)
    for field in dict.fromkeys(output.field for output in OUTPUTS.values() if output.field)
}
"""Outputs that a field of `LabelledImage` can be read from, the best first."""

BAND_ARRAYS: Final = ("reflectance", "radiance", "bands")
"""Fields of `LabelledImage` that are arrays of sensors with bands."""

ARRAYS: Final = tuple(field for field in SOURCES if field not in BAND_ARRAYS)
"""Fields of `LabelledImage` that are other arrays of the image's size."""

LABELLED_OUTPUTS: Final = tuple(SOURCES[field][0] for field in ARRAYS)
"""The outputs with the same content, in this order."""

FIELDS: Final = (*ARRAYS, *BAND_ARRAYS, "metadata")
"""Fields of `LabelledImage` that a reader reads or skips."""


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """One image with its labels; a field is None if it is not known or was not read.

    Attributes:
        name: unique within its set.
        colour: `(h, w, 3)` uint8, sRGB.
        classes: `(h, w)` uint8, ids of `OrganClass`, or `VOID`.
        instances: `(h, w)` uint16, 0 where there is none.
        distance_m: `(h, w)` float32, metres along the ray from the projection centre, inf for none.
        depth_z_m: `(h, w)` float32, metres along the optical axis, inf for none.
        depth_sensor_m: `(h, w)` float32, metres along the optical axis as a depth camera measured them, nan
            for holes.
        chlorophyll_ug_cm2: `(h, w)` float32, ug per cm2 of leaf or skin, nan where none is known; likewise:
        carotenoids_ug_cm2: `(h, w)` float32.
        water_cm: `(h, w)` float32, equivalent thickness of the water in blades and petals, or g per cm2.
        ripeness: `(h, w)` float32, 0 unripe to 1 ripe, of fruit.
        leaf_age: `(h, w)` float32, 0 healthy to 1 dried up, of leaf blades.
        reflectance: `(h, w, c)` float32, of each band relative to a white reference.
        radiance: `(h, w, c)` float32, W m-2 sr-1 nm-1 in each band.
        bands: `(h, w, c)` float32, measured electrons of each band, which the metadata describe.
        metadata: further metadata: the JSON of a rendered frame, the files of an image in a folder.
    """

    name: str
    colour: NDArray[np.uint8] | None
    classes: NDArray[np.uint8] | None
    instances: NDArray[np.uint16] | None = None
    distance_m: NDArray[np.float32] | None = None
    depth_z_m: NDArray[np.float32] | None = None
    depth_sensor_m: NDArray[np.float32] | None = None
    chlorophyll_ug_cm2: NDArray[np.float32] | None = None
    carotenoids_ug_cm2: NDArray[np.float32] | None = None
    water_cm: NDArray[np.float32] | None = None
    ripeness: NDArray[np.float32] | None = None
    leaf_age: NDArray[np.float32] | None = None
    reflectance: NDArray[np.float32] | None = None
    radiance: NDArray[np.float32] | None = None
    bands: NDArray[np.float32] | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        sizes = self._sizes()
        if len(sizes) > 1:
            raise ValueError(f"{self.name}: its images differ in size, {sorted(sizes)}")

    def _sizes(self) -> set[tuple[int, int]]:
        arrays = [getattr(self, name) for name in (*ARRAYS, *BAND_ARRAYS)]
        return {(array.shape[0], array.shape[1]) for array in arrays if array is not None}

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels.

        Raises:
            ValueError: no array was read.
        """
        for size in self._sizes():
            return size
        raise ValueError(f"{self.name} holds no image")


def image_of_files(file: Path, name: str, **fields: Any) -> LabelledImage:
    """The image with these fields; raises `InputError`, which names `file`, if they differ in size."""
    try:
        return LabelledImage(name, **fields)
    except ValueError as error:
        raise InputError(file, str(error)) from None


@dataclass(frozen=True, eq=False, kw_only=True)
class ImageSet(Sequence[LabelledImage]):
    """Labelled images in natural order of their names, read on access.

    `images[3]` reads an image; `images[3:9]` is a smaller set, of which nothing is read yet.

    Attributes:
        name: of the set, for display.
        items: sources of the images, in order.
        fields: the fields of `FIELDS` that are read; the others stay None.
    """

    name: str
    items: tuple[Any, ...]
    fields: tuple[str, ...] = FIELDS

    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the images, in order; nothing is read."""

    @abstractmethod
    def read(self, item: Any) -> LabelledImage:
        """Read the image of one of `items`.

        Raises:
            InputError: a file is missing, damaged, or does not match its image.
        """

    def select(self, *fields: str) -> Self:
        """The same images, of which only these fields are read.

        Raises:
            ValueError: a name is not in `FIELDS`.
        """
        unknown = sorted(set(fields) - set(FIELDS))
        if unknown:
            raise ValueError(f"unknown fields {', '.join(unknown)}; allowed are {', '.join(FIELDS)}")
        return replace(self, fields=tuple(name for name in FIELDS if name in fields))

    def take(self, positions: Sequence[int]) -> Self:
        """The images at these positions, in this order."""
        return replace(self, items=tuple(self.items[position] for position in positions))

    def __len__(self) -> int:
        return len(self.items)

    @overload
    def __getitem__(self, position: int) -> LabelledImage: ...

    @overload
    def __getitem__(self, position: slice) -> Self: ...

    def __getitem__(self, position: int | slice) -> LabelledImage | Self:
        if isinstance(position, slice):
            return replace(self, items=self.items[position])
        return self.read(self.items[position])

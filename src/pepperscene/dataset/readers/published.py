"""Reading the layout of the published data set, doi 10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import VOID, ImageSet, LabelledImage
from pepperscene.dataset.readers.pictures import read_mask, read_photo
from pepperscene.errors import InputError
from pepperscene.truth import class_from_colour, distance_from_code

HALVES: Final = ("synthetic", "empirical")

_NUMBER: Final = re.compile(r"(\d+)$")


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class PublishedSet(ImageSet):
    """One half of the published data set, or of a data set exported to its layout.

    Attributes:
        folder: that holds `synthetic_image_color` and so on.
        half: "synthetic" or "empirical".
        items: the numbers in the file names, ascending; the first is 1.
        files: by kind of image ("colour", "grey", "scale", "depth"), the file of every number; a kind whose
            folder is not there is left out.
    """

    folder: Path
    half: str
    items: tuple[int, ...]
    files: Mapping[str, Mapping[int, Path]]

    @classmethod
    def of(cls, folder: Path, half: str | None = None) -> Self:
        """A half of the data set in a folder.

        Args:
            folder: that holds `synthetic_image_color` and so on.
            half: "synthetic" or "empirical"; None where only one of them is there.

        Raises:
            InputError: there are both and none is told, or the one told is not there.
        """
        there = published_halves(folder)
        if half is None and len(there) > 1:
            raise InputError(folder, f"holds {' and '.join(there)}: say which, half={there[0]!r}")
        chosen = there[0] if half is None and there else half
        if chosen not in there:
            raise InputError(folder, f"must be one of {', '.join(there) or 'none'}", key="half", value=chosen)
        folders = {
            "colour": f"{chosen}_image_color",
            "grey": f"{chosen}_label_class_grayscale/{chosen}_label_class_all_grayscale",
            "scale": f"{chosen}_label_class_colorscale",
            "depth": f"{chosen}_label_depth_grayscale",
        }
        files = {kind: _numbered(folder / name) for kind, name in folders.items() if (folder / name).is_dir()}
        if not files["colour"]:
            raise InputError(folder / folders["colour"], "holds no images")
        items = tuple(sorted(files["colour"]))
        return cls(
            name=f"{folder.resolve().name} {chosen}", folder=folder, half=chosen, items=items, files=files
        )

    def names(self) -> tuple[str, ...]:
        """The numbers, as they stand in the file names."""
        return tuple(str(number) for number in self.items)

    def read(self, item: int) -> LabelledImage:
        """One picture: classes from the grey labels, or else the nearest colour; distances from their code.

        Raises:
            InputError: a file is missing or damaged, or a grey label is no class id.
        """
        wanted = self.fields
        return LabelledImage(
            str(item),
            read_photo(self._file("colour", item)) if "colour" in wanted else None,
            self._classes(item) if "classes" in wanted else None,
            distance_m=self._distance(item) if "distance_m" in wanted and "depth" in self.files else None,
            facts={"half": self.half, "number": item} if "facts" in wanted else {},
        )

    def _classes(self, number: int) -> NDArray[np.uint8] | None:
        if "grey" in self.files:
            path = self._file("grey", number)
            ids = _grey(path)
            known = (ids < len(OrganClass)) | (ids == VOID)
            if not known.all():
                found = int(ids[~known][0])
                raise InputError(path, f"has the class id {found}; allowed are 0 to {len(OrganClass) - 1}")
            return ids
        if "scale" in self.files:
            path = self._file("scale", number)
            rgb = read_mask(path).rgb
            if rgb is None:
                raise InputError(path, "must hold the colour of each class")
            return class_from_colour(rgb)
        return None

    def _distance(self, number: int) -> NDArray[np.float32]:
        return distance_from_code(_grey(self._file("depth", number)))

    def _file(self, kind: str, number: int) -> Path:
        files = self.files[kind]
        if number not in files:
            folder = next(iter(files.values())).parent if files else self.folder
            raise InputError(folder, f"has no file of the number {number}, which its image has")
        return files[number]


def published_halves(folder: Path) -> tuple[str, ...]:
    """Which halves of the published data set a folder holds."""
    return tuple(half for half in HALVES if (folder / f"{half}_image_color").is_dir())


def _numbered(folder: Path) -> dict[int, Path]:
    """The PNG files of a folder by the number at the end of their names, whatever stands before it.

    Raises:
        InputError: a name has no number, or two have the same.
    """
    found: dict[int, Path] = {}
    for path in sorted(folder.glob("*.png")):
        if path.name.startswith("."):
            continue
        match = _NUMBER.search(path.stem)
        if match is None:
            raise InputError(path, "must end in the number of its picture")
        number = int(match[1])
        if number in found:
            raise InputError(path, f"has the same number as {found[number].name}")
        found[number] = path
    return found


def _grey(path: Path) -> NDArray[np.uint8]:
    """8-bit values, however the file holds them."""
    values = read_mask(path).values
    if values is None or values.max(initial=0) > np.iinfo(np.uint8).max:
        raise InputError(path, "must hold 8-bit grey values")
    return values.astype(np.uint8)

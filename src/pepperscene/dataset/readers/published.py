"""Reading the published data set, doi 10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import VOID, ImageSet, LabelledImage, image_of_files
from pepperscene.dataset.readers.pictures import read_mask, read_photo
from pepperscene.errors import InputError
from pepperscene.truth import class_from_colour, distance_from_code

HALVES: Final = ("synthetic", "empirical")

_FOLDERS: Final = {
    "colour": "{0}_image_color",
    "grey": "{0}_label_class_grayscale/{0}_label_class_all_grayscale",
    "scale": "{0}_label_class_colorscale",
    "depth": "{0}_label_depth_grayscale",
}
"""Folder of each kind of image, with the half of the data set as placeholder."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class PublishedSet(ImageSet):
    """One half of the published data set, or of an export in its layout."""

    folder: Path  # that holds `synthetic_image_color` etc.
    half: str  # "synthetic" or "empirical"
    items: tuple[int, ...]  # numbers in the file names, ascending; the first is 1
    files: Mapping[str, Mapping[int, Path]]  # by kind in `_FOLDERS` and number, if the kind's folder exists

    @classmethod
    def from_folder(cls, folder: Path, half: str | None = None) -> Self:
        """One half of the data set in a folder; `half` is optional if the folder holds only one."""
        halves = published_halves(folder)
        if half is None and len(halves) > 1:
            raise InputError(folder, f"holds {' and '.join(halves)}; choose one, e.g. half={halves[0]!r}")
        selected = halves[0] if half is None and halves else half
        if selected not in halves:
            allowed = f"must be one of {', '.join(halves) or 'none'}"
            raise InputError(folder, allowed, key="half", value=selected)
        paths = {kind: folder / name.format(selected) for kind, name in _FOLDERS.items()}
        files = {kind: _numbered_files(path) for kind, path in paths.items() if path.is_dir()}
        if not files["colour"]:
            raise InputError(paths["colour"], "holds no images")
        items = tuple(sorted(files["colour"]))
        name = f"{folder.resolve().name} {selected}"
        return cls(name=name, folder=folder, half=selected, items=items, files=files)

    def names(self) -> tuple[str, ...]:
        """The numbers in the file names."""
        return tuple(str(number) for number in self.items)

    def read(self, item: int) -> LabelledImage:
        """Read one image: classes from grey labels, or else the nearest colour; distances from their code."""
        distance_m = None
        if "distance_m" in self.fields and "depth" in self.files:
            distance_m = distance_from_code(_read_grey(self._find_file("depth", item)))
        return image_of_files(
            self._find_file("colour", item),
            str(item),
            colour=read_photo(self._find_file("colour", item)) if "colour" in self.fields else None,
            classes=self._classes(item) if "classes" in self.fields else None,
            distance_m=distance_m,
            metadata={"half": self.half, "number": item} if "metadata" in self.fields else {},
        )

    def _classes(self, number: int) -> NDArray[np.uint8] | None:
        if "grey" in self.files:
            path = self._find_file("grey", number)
            ids = _read_grey(path)
            known = (ids < len(OrganClass)) | (ids == VOID)
            if not known.all():
                allowed = f"allowed are 0 to {len(OrganClass) - 1}"
                raise InputError(path, f"has the class id {int(ids[~known][0])}; {allowed}")
            return ids
        if "scale" in self.files:
            path = self._find_file("scale", number)
            rgb = read_mask(path).rgb
            if rgb is None:
                raise InputError(path, "must hold the colour of each class")
            return class_from_colour(rgb)
        return None

    def _find_file(self, kind: str, number: int) -> Path:
        files = self.files[kind]
        if number not in files:
            folder = next(iter(files.values())).parent if files else self.folder
            raise InputError(folder, f"has no file for image number {number}")
        return files[number]


def published_halves(folder: Path) -> tuple[str, ...]:
    """Halves of the published data set that a folder holds."""
    return tuple(half for half in HALVES if (folder / f"{half}_image_color").is_dir())


def _numbered_files(folder: Path) -> dict[int, Path]:
    """The PNG files of a folder by the number at the end of their names."""
    files: dict[int, Path] = {}
    for path in sorted(folder.glob("*.png")):
        if path.name.startswith("."):
            continue
        match = re.search(r"(\d+)$", path.stem)
        if match is None:
            raise InputError(path, "must have a name that ends in the image number")
        number = int(match[1])
        if number in files:
            raise InputError(path, f"has the same number as {files[number].name}")
        files[number] = path
    return files


def _read_grey(path: Path) -> NDArray[np.uint8]:
    values = read_mask(path).values
    if values is None or values.max(initial=0) > np.iinfo(np.uint8).max:
        raise InputError(path, "must hold 8-bit grey values")
    return values.astype(np.uint8)

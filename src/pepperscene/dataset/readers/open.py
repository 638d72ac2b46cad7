"""Opening images of any layout; reading a data set of this package, and the published one.

The published data set: doi 10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.coco import coco_files, open_coco
from pepperscene.dataset.readers.folder import FolderSet
from pepperscene.dataset.readers.image_set import SOURCES, VOID, ImageSet, LabelledImage, image_of_files
from pepperscene.dataset.readers.labels import LABEL_FILE, LabelMap
from pepperscene.dataset.readers.pictures import read_mask, read_photo
from pepperscene.dataset.store.dataset import MARK, Dataset, open_dataset
from pepperscene.dataset.store.fields import frame_indices, read_frame, read_output, read_outputs
from pepperscene.dataset.store.frame_json import DIGITS
from pepperscene.errors import ArgumentError, InputError
from pepperscene.outputs import OUTPUTS
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


_DECODERS: Final[Mapping[str, Callable[[Any], NDArray[Any]]]] = {
    "class_colour": class_from_colour,
    "distance_code": distance_from_code,
}
_OBJECTS: Final = tuple(name for name, output in OUTPUTS.items() if not output.is_image)
"""Outputs that become part of the metadata."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class RenderedSet(ImageSet):
    """Frames of a data set, with the frame's JSON as metadata.

    The outputs `harvest` and `amodal` are in the metadata, too, under these keys.
    """

    dataset: Dataset
    items: tuple[int, ...]  # indices of the frames

    @classmethod
    def from_dataset(cls, dataset: Dataset) -> Self:
        """All frames of a data set; raises `InputError` if there are none."""
        items = frame_indices(dataset)
        return cls(name=dataset.folder.resolve().name, dataset=dataset, items=items)

    def names(self) -> tuple[str, ...]:
        """The indices with six digits, as in the file names."""
        return tuple(_frame_name(index) for index in self.items)

    def read(self, item: int) -> LabelledImage:
        """Read one frame; a field is None if the frame lacks its outputs."""
        metadata = self._read_metadata(item) if "metadata" in self.fields else {}
        outputs = metadata["outputs"] if metadata else read_outputs(self.dataset, item)
        arrays = {field: self._read_field(item, field, outputs) for field in SOURCES}
        return image_of_files(self.dataset.frame_path(item), _frame_name(item), metadata=metadata, **arrays)

    def _read_metadata(self, index: int) -> dict[str, Any]:
        metadata = read_frame(self.dataset, index)
        for output in _OBJECTS:
            # A key of this name in the frame's JSON is no checked output.
            metadata.pop(output, None)
            if output in metadata["outputs"]:
                metadata[output] = read_output(self.dataset, index, output)
        return metadata

    def _read_field(self, index: int, field: str, outputs: Collection[str]) -> NDArray[Any] | None:
        if field not in self.fields:
            return None
        for output in SOURCES[field]:
            if output in outputs:
                image = read_output(self.dataset, index, output)
                return _DECODERS[output](image) if output in _DECODERS else image
        return None


def _frame_name(index: int) -> str:
    return f"{index:0{DIGITS}d}"


def open_images(
    path: str | Path, *, half: str | None = None, labels: str | LabelMap | Mapping[Any, Any] | None = None
) -> ImageSet:
    """Open the labelled images of a folder; each is read on access.

    Args:
        path: a data set of this package; the published data set or an export in its layout; a file of COCO
            instances, or a folder with `annotations.json` or one such file in `annotations/`; or any folder
            of images with masks.
        half: "synthetic" or "empirical", if the published data set holds both.
        labels: meaning of the masks of a folder: a name of `KNOWN_LABELS`, or a table from mask values or
            colours to classes (see `parse_labels`); for COCO, a table from names of categories to classes,
            with `otherwise` for pixels without an annotation (see `CocoSet`). None reads the folder's
            `classes.toml`.

    Raises:
        InputError: the folder is missing, holds no images, or an argument does not apply to its layout.
    """
    folder = Path(path)
    is_coco_file = folder.suffix == ".json" and folder.is_file()
    if not folder.is_dir() and not is_coco_file:
        raise InputError(folder, "must be a folder of images")
    rendered, published = (folder / MARK).exists(), bool(published_halves(folder))
    if half is not None and not published:
        raise InputError(folder, "applies only to the published data set", key="half", value=half)
    if labels is not None and (rendered or published):
        problem = "apply only to a folder of images with masks; the classes of this layout are known"
        raise InputError(folder, problem, key="labels")
    if rendered:
        return RenderedSet.from_dataset(open_dataset(folder))
    if published:
        return PublishedSet.from_folder(folder, half)
    if is_coco_file or coco_files(folder):
        return open_coco(folder, labels)
    return FolderSet.from_folder(folder, labels)


def open_image_sets(
    paths: Sequence[str | Path], *, labels: str | None = None, half: str | None = None
) -> tuple[ImageSet, ...]:
    """Open one or more image sets in any layout.

    Args:
        paths: as for `open_images`.
        labels: name of a table of labels, for each folder of images with masks that has no `classes.toml`;
            if all have one, for all, overriding it.
        half: of the published data set, for each path that holds both; if none does, for each that holds one.

    Raises:
        InputError: see `open_images`; or an option applies to none of the sets.
    """
    places = [Path(path) for path in paths]
    for place in places:
        if not place.exists():
            raise InputError(place, "must be a folder of images")
    tables, halves = label_targets(places), half_targets(places)
    if labels is not None and not any(tables):
        raise ArgumentError("labels", "applies only to a folder of images with masks; no set is one")
    if half is not None and not any(halves):
        raise ArgumentError("half", "applies only to the published data set; no set is one")
    return tuple(
        open_images(path, labels=labels if table else None, half=half if is_published else None)
        for path, table, is_published in zip(places, tables, halves, strict=True)
    )


def label_targets(paths: Sequence[Path]) -> list[bool]:
    """Which of these paths one table of labels applies to.

    Folders of images without a `classes.toml`, or all folders of images if each has one.
    """
    folders = [_is_plain_folder(path) for path in paths]
    without = [plain and not (path / LABEL_FILE).exists() for path, plain in zip(paths, folders, strict=True)]
    return without if any(without) else folders


def half_targets(paths: Sequence[Path]) -> list[bool]:
    """Which of these paths the name of one half of the published data set applies to.

    Those that hold both halves, or those that hold one if none holds both.
    """
    counts = [len(published_halves(path)) for path in paths]
    both = [count > 1 for count in counts]
    return both if any(both) else [count > 0 for count in counts]


def _is_plain_folder(path: Path) -> bool:
    """Whether a path is a folder of images with masks, in no other layout."""
    is_other = (path / MARK).exists() or bool(published_halves(path)) or bool(coco_files(path))
    return path.is_dir() and not is_other

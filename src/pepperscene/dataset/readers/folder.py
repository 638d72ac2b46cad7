"""Reading any folder of images with masks."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.readers.image_set import VOID, ImageSet, LabelledImage
from pepperscene.dataset.readers.labels import (
    KNOWN_LABELS,
    LABEL_FILE,
    PALETTE,
    LabelMap,
    parse_labels,
    read_labels,
)
from pepperscene.dataset.readers.pictures import MaskImage, mask_shape, photo_shape, read_mask_of, read_photo
from pepperscene.errors import ArgumentError, InputError

# Words of file and folder names that mark images, class masks, and neither of the two.
IMAGE_WORDS: Final = frozenset(
    {"img", "imgs", "image", "images", "rgb", "color", "colour", "photo", "photos", "jpegimages"}
)
MASK_WORDS: Final = frozenset(
    {
        "mask", "masks", "label", "labels", "lbl", "class", "classes", "annotation", "annotations", "ann",
        "seg", "segmentation", "segmentationclass", "semantic", "gt", "groundtruth",
    }
)  # fmt: skip
OTHER_WORDS: Final = frozenset(
    {"instance", "instances", "depth", "distance", "normal", "normals", "raw", "electrons"}
)

SUFFIXES: Final = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})

_NUMBER_OR_WORD: Final = re.compile(r"\d+|[^\W\d_]+")


@dataclass(frozen=True)
class ImagePair:
    """Files of an image and its mask."""

    name: str  # path of the image below its folder, without suffix
    image: Path
    mask: Path | None


def natural_sort_key(text: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key that compares numbers by value, so that "img2" comes before "img10"."""
    pieces = re.findall(r"\d+|\D+", text)
    return tuple((0, int(piece), piece) if piece.isdecimal() else (1, 0, piece) for piece in pieces)


def pair_images(folder: Path) -> tuple[ImagePair, ...]:
    """Pair the images of a folder with their masks, in natural order of their names.

    Images and masks are either in two folders (`images/` and `masks/`), where the paths below them match, or
    in one, where the names match once words such as "img" and "mask" are removed. Numbers match by value:
    `img001` and `mask1` are a pair.
    """
    images, masks = _find_files(folder)
    if not images:
        raise InputError(folder, f"holds no images ({', '.join(sorted(SUFFIXES))})")
    images_by_key, masks_by_key = _index_by_key(images), _index_by_key(masks)
    for key, (_, mask) in masks_by_key.items():
        if key not in images_by_key:
            raise InputError(mask, f"is a mask without an image of the same name in {folder}")
    pairs = [
        ImagePair(name, image, masks_by_key[key][1] if key in masks_by_key else None)
        for key, (name, image) in images_by_key.items()
    ]
    return tuple(sorted(pairs, key=lambda pair: natural_sort_key(pair.name)))


def _find_files(folder: Path) -> tuple[list[tuple[Path, Path]], list[tuple[Path, Path]]]:
    """Images and masks, each as the folder that its name is relative to and its file."""
    subfolders = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    image_roots = [path for path in subfolders if path.name.lower() in IMAGE_WORDS]
    mask_roots = [path for path in subfolders if path.name.lower() in MASK_WORDS]
    for kind, roots in (("images", image_roots), ("masks", mask_roots)):
        if len(roots) > 1:
            names = ", ".join(path.name for path in roots)
            raise InputError(folder, f"has several folders for {kind}: {names}; keep one of them")
    masks = [(root, path) for root in mask_roots for path in _image_files(root.rglob("*"))]
    if image_roots:
        return [(image_roots[0], path) for path in _image_files(image_roots[0].rglob("*"))], masks
    images = [(folder, path) for path in _image_files(folder.iterdir()) if not _words(path) & OTHER_WORDS]
    if mask_roots:
        return images, masks
    masks = [file for file in images if _words(file[1]) & MASK_WORDS]
    return [file for file in images if file not in masks], masks


def _image_files(paths: Iterable[Path]) -> Iterator[Path]:
    for path in paths:
        if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file():
            yield path


def _words(path: Path) -> set[str]:
    return set(_NUMBER_OR_WORD.findall(path.stem.lower()))


def _index_by_key(files: Iterable[tuple[Path, Path]]) -> dict[tuple[str, ...], tuple[str, Path]]:
    """Name and file by the key that an image and its mask have in common."""
    index: dict[tuple[str, ...], tuple[str, Path]] = {}
    for root, path in files:
        name = path.relative_to(root).with_suffix("").as_posix()
        key = _pairing_key(name)
        if key in index:
            existing = index[key][1].name
            raise InputError(path, f"has a name too similar to {existing}: rename one of them")
        index[key] = (name, path)
    return index


def _pairing_key(name: str) -> tuple[str, ...]:
    """A name without the words that mark images and masks, and with numbers by value."""
    *parents, stem = name.lower().split("/")
    pieces = [piece for piece in _NUMBER_OR_WORD.findall(stem) if piece not in IMAGE_WORDS | MASK_WORDS]
    return (*parents, "", *(str(int(piece)) if piece.isdecimal() else piece for piece in pieces))


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class FolderSet(ImageSet):
    """Images of a folder, some or all of them with masks."""

    folder: Path
    items: tuple[ImagePair, ...]
    labels: LabelMap | None = None  # meaning of the masks; None to accept only the published colours

    @classmethod
    def from_folder(cls, folder: Path, labels: str | LabelMap | Mapping[Any, Any] | None = None) -> Self:
        """The images of a folder; `labels` as in `open_images`."""
        if labels is None:
            labels = read_labels(folder)
        elif isinstance(labels, Mapping):
            labels = parse_labels(labels, "labels")
        elif isinstance(labels, str):
            if labels not in KNOWN_LABELS:
                known = ", ".join(KNOWN_LABELS)
                raise ArgumentError("labels", f"must be a table or one of {known}, not {labels!r}")
            labels = KNOWN_LABELS[labels]
        items = pair_images(folder)
        return cls(name=folder.resolve().name, folder=folder, items=items, labels=labels)

    def names(self) -> tuple[str, ...]:
        """Paths of the images below their folder, without suffix."""
        return tuple(pair.name for pair in self.items)

    def read(self, item: ImagePair) -> LabelledImage:
        """Read one image; its classes are None if it has no mask."""
        colour = read_photo(item.image) if "colour" in self.fields else None
        classes = self._classes(item) if "classes" in self.fields else None
        files = {"image": str(item.image), "mask": None if item.mask is None else str(item.mask)}
        return LabelledImage(item.name, colour, classes, metadata=files if "metadata" in self.fields else {})

    def _classes(self, pair: ImagePair) -> NDArray[np.uint8] | None:
        if pair.mask is None:
            return None
        mask = read_mask_of(pair.image, pair.mask, None if self.labels is None else self.labels.exif)
        if mask is None:
            sizes = f"has {_format_size(mask_shape(pair.mask))} pixels, but its image"
            sizes += f" {pair.image.name} has {_format_size(photo_shape(pair.image))}"
            raise InputError(pair.mask, f"{sizes}; masks are never resized")
        ids = _class_ids(mask, self.labels, pair.mask)
        return ids if mask.opaque is None else np.where(mask.opaque, ids, np.uint8(VOID))


def _class_ids(mask: MaskImage, labels: LabelMap | None, file: Path) -> NDArray[np.uint8]:
    """Class ids of a mask: by its values if the table covers all of them, otherwise by its colours."""
    if labels is None:
        return _published_class_ids(mask, file)
    values = mask.values
    if values is not None:
        values = _fill_transparent(values, mask, next(iter(labels.values), 0))
    use_colours = mask.rgb is not None and bool(labels.colours)
    if values is not None and labels.values and (not use_colours or labels.covers(values)):
        return labels.map_values(values, file)
    if mask.rgb is not None and labels.colours:
        return labels.map_colours(_fill_transparent(mask.rgb, mask, next(iter(labels.colours))), file)
    kind = "colours" if mask.values is None else "values"
    raise InputError(file, f"has {kind}, but {labels.source} defines no classes for {kind}")


def _published_class_ids(mask: MaskImage, file: Path) -> NDArray[np.uint8]:
    """Class ids by the published colours.

    Grey values are ambiguous: 1 is a leaf to one author and a green fruit to another, and white is the one
    class of a binary mask, whichever that is. An image all in black is all background.
    """
    if mask.rgb is not None and not (mask.is_grey and mask.rgb.any()):
        return PALETTE.map_colours(_fill_transparent(mask.rgb, mask, (0, 0, 0)), file)
    examples = "" if mask.values is None else ", ".join(str(value) for value in np.unique(mask.values)[:8])
    raise InputError(
        file,
        f"has values ({examples}) without defined classes: put a {LABEL_FILE} into the folder,"
        f" or pass labels= (a table, or one of {', '.join(KNOWN_LABELS)})",
    )


def _fill_transparent(pixels: NDArray[Any], mask: MaskImage, value: Any) -> NDArray[Any]:
    """Replace transparent pixels, which become void in any case, by a value that has a class."""
    if mask.opaque is None:
        return pixels
    opaque = mask.opaque if pixels.ndim == 2 else mask.opaque[..., None]
    return np.where(opaque, pixels, np.asarray(value, pixels.dtype))


def _format_size(shape: tuple[int, int]) -> str:
    return f"{shape[1]}x{shape[0]}"

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
    labels_in,
    labels_of,
)
from pepperscene.dataset.readers.pictures import MaskPicture, photo_shape, read_mask, read_photo
from pepperscene.errors import InputError

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
"""Words of file and folder names that tell images, class masks, and what is neither."""

SUFFIXES: Final = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})

_PIECES: Final = re.compile(r"\d+|[^\W\d_]+")


@dataclass(frozen=True)
class Pair:
    """An image and its mask.

    Attributes:
        name: path of the image below its folder, without suffix.
        image: its file.
        mask: its mask's, or None when it has none.
    """

    name: str
    image: Path
    mask: Path | None


def natural_sort_key(text: str) -> tuple[tuple[int, int, str], ...]:
    """A key that sorts "img2" before "img10": numbers by value, all else as text."""
    pieces = re.findall(r"\d+|\D+", text)
    found = ((0, int(piece), piece) if piece.isdecimal() else (1, 0, piece) for piece in pieces)
    return tuple(found)


def pairs(folder: Path) -> tuple[Pair, ...]:
    """The images of a folder with their masks, in natural order.

    Either a folder of images beside one of masks (`images/` and `masks/`), where a file's path below them
    tells the pair; or all in one, where the names do once words such as "img" and "mask" are taken out.
    Numbers count by value: `img001` and `mask1` belong together.

    Raises:
        InputError: there is no image, two files claim the same place, or a mask has no image.
    """
    images, masks = _sorted_out(folder)
    if not images:
        raise InputError(folder, f"holds no images ({', '.join(sorted(SUFFIXES))})")
    found_images, found_masks = _by_key(images), _by_key(masks)
    for key, (_, mask) in found_masks.items():
        if key not in found_images:
            raise InputError(mask, f"is a mask without an image of the same name in {folder}")
    made = [
        Pair(name, image, found_masks[key][1] if key in found_masks else None)
        for key, (name, image) in found_images.items()
    ]
    return tuple(sorted(made, key=lambda pair: natural_sort_key(pair.name)))


def _sorted_out(folder: Path) -> tuple[list[tuple[Path, Path]], list[tuple[Path, Path]]]:
    """Images and masks, each as the folder its name starts from and the file."""
    below = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    image_roots = [path for path in below if path.name.lower() in IMAGE_WORDS]
    mask_roots = [path for path in below if path.name.lower() in MASK_WORDS]
    if len(image_roots) > 1 or len(mask_roots) > 1:
        names = ", ".join(path.name for path in (image_roots if len(image_roots) > 1 else mask_roots))
        raise InputError(folder, f"has several folders for the same: {names}; keep one of them")
    if image_roots:
        images = [(image_roots[0], path) for path in _pictures(image_roots[0].rglob("*"))]
        return images, [(root, path) for root in mask_roots for path in _pictures(root.rglob("*"))]
    files = [(folder, path) for path in _pictures(folder.iterdir()) if not _words(path) & OTHER_WORDS]
    if mask_roots:
        return files, [(mask_roots[0], path) for path in _pictures(mask_roots[0].rglob("*"))]
    masks = [file for file in files if _words(file[1]) & MASK_WORDS]
    return [file for file in files if file not in masks], masks


def _pictures(paths: Iterable[Path]) -> Iterator[Path]:
    """Files by their suffix, without hidden ones."""
    for path in paths:
        if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file():
            yield path


def _words(path: Path) -> set[str]:
    return set(_PIECES.findall(path.stem.lower()))


def _by_key(files: Iterable[tuple[Path, Path]]) -> dict[tuple[str, ...], tuple[str, Path]]:
    """Name and file by what is left of the name."""
    found: dict[tuple[str, ...], tuple[str, Path]] = {}
    for root, path in files:
        name = path.relative_to(root).with_suffix("").as_posix()
        key = _key(name)
        if key in found:
            other = found[key][1].name
            raise InputError(path, f"cannot be told from {other} by name: rename one of them")
        found[key] = (name, path)
    return found


def _key(name: str) -> tuple[str, ...]:
    """What is left of a name without the words that tell images from masks, numbers by their value."""
    *parents, stem = name.lower().split("/")
    pieces = [piece for piece in _PIECES.findall(stem) if piece not in IMAGE_WORDS | MASK_WORDS]
    return (*parents, "", *(str(int(piece)) if piece.isdecimal() else piece for piece in pieces))


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class FolderSet(ImageSet):
    """Images of a folder, with masks where there are any.

    Attributes:
        folder: where they lie.
        items: images and masks, paired by name.
        labels: what the masks mean; None when nobody says, so that only the published colours are understood.
    """

    folder: Path
    items: tuple[Pair, ...]
    labels: LabelMap | None = None

    @classmethod
    def of(cls, folder: Path, labels: str | LabelMap | Mapping[Any, Any] | None = None) -> Self:
        """The images of a folder.

        Args:
            folder: holds images and masks side by side, or in folders such as `images` and `masks`.
            labels: what the masks mean: a name out of `KNOWN_LABELS`, or a table as `labels_of` takes it;
                None reads the folder's `classes.toml`.

        Raises:
            InputError: there are no images, or they cannot be paired with the masks; the table is not valid.
        """
        return cls(
            name=folder.resolve().name, folder=folder, items=pairs(folder), labels=_told(labels, folder)
        )

    def names(self) -> tuple[str, ...]:
        """The image files' names below their folder, without suffix."""
        return tuple(pair.name for pair in self.items)

    def read(self, item: Pair) -> LabelledImage:
        """One image; its classes are None when it has no mask.

        Raises:
            InputError: a file is damaged, the mask has another size, or a value of it has no meaning.
        """
        colour = read_photo(item.image) if "colour" in self.fields else None
        classes = self._classes(item) if "classes" in self.fields else None
        files = {"image": str(item.image), "mask": None if item.mask is None else str(item.mask)}
        return LabelledImage(item.name, colour, classes, facts=files if "facts" in self.fields else {})

    def _classes(self, pair: Pair) -> NDArray[np.uint8] | None:
        if pair.mask is None:
            return None
        mask = read_mask(pair.mask)
        if mask.shape != (shape := photo_shape(pair.image)):
            raise InputError(
                pair.mask,
                f"is {_size(mask.shape)} pixels large, but its image {pair.image.name} {_size(shape)};"
                " labels are never resized",
            )
        ids = _meant(mask, self.labels, pair.mask)
        return ids if mask.seen is None else np.where(mask.seen, ids, np.uint8(VOID))


def _told(labels: str | LabelMap | Mapping[Any, Any] | None, folder: Path) -> LabelMap | None:
    if labels is None:
        return labels_in(folder)
    if isinstance(labels, LabelMap):
        return labels
    if isinstance(labels, Mapping):
        return labels_of(labels, "labels")
    if labels not in KNOWN_LABELS:
        raise InputError("labels", f"must be a table or one of {', '.join(KNOWN_LABELS)}, not {labels!r}")
    return KNOWN_LABELS[labels]


def _meant(mask: MaskPicture, labels: LabelMap | None, where: Path) -> NDArray[np.uint8]:
    """Class ids of a mask: by its values where the table knows them all, by its colours otherwise."""
    if labels is None:
        return _by_palette(mask, where)
    values = None if mask.values is None else _shown(mask.values, mask, next(iter(labels.values), 0))
    by_colour = mask.rgb is not None and bool(labels.colours)
    if values is not None and labels.values and (not by_colour or labels.knows(values)):
        return labels.of_values(values, where)
    if mask.rgb is not None and labels.colours:
        return labels.of_colours(_shown(mask.rgb, mask, next(iter(labels.colours))), where)
    kind = "colours" if mask.values is None else "values"
    raise InputError(where, f"has {kind}, but {labels.where} tells nothing of {kind}")


def _by_palette(mask: MaskPicture, where: Path) -> NDArray[np.uint8]:
    """Class ids by the published colours.

    Grey says nothing by itself: the same 1 is a leaf to one author and a green fruit to the next, and white
    is the one class of a binary mask, whichever that is. An image all in black is all background.
    """
    if mask.rgb is not None and not (mask.grey and mask.rgb.any()):
        return PALETTE.of_colours(_shown(mask.rgb, mask, (0, 0, 0)), where)
    found = "" if mask.values is None else ", ".join(str(value) for value in np.unique(mask.values)[:8])
    raise InputError(
        where,
        f"has values ({found}) whose classes nobody tells: put a {LABEL_FILE} into the folder,"
        f" or pass labels= (a table, or one of {', '.join(KNOWN_LABELS)})",
    )


def _shown(pixels: NDArray[Any], mask: MaskPicture, known: Any) -> NDArray[Any]:
    """Pixels, where transparent ones, which become void in any case, have a value that is known."""
    if mask.seen is None:
        return pixels
    seen = mask.seen if pixels.ndim == 2 else mask.seen[..., None]
    return np.where(seen, pixels, np.asarray(known, pixels.dtype))


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]}x{shape[0]}"
